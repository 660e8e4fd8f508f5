"""Files that `deepct convert` writes, decoded by other programs or by the definition of the format."""

import struct
import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest
from PIL import Image
from test_files import deepct

FIELDS = ("extinction", "lwc", "reff", "veff")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small cloud, which is no cube, its noisy images, and all its conversions."""
    folder = tmp_path_factory.mktemp("conversions")
    shape = "--set shape=[8,12,14] --set width_km=0.3 --set depth_km=0.16"
    deepct(folder, f"cloud generate --seed 7 {shape} --out cloud.nc")
    deepct(folder, "render cloud.nc --views cloudct-10 --samples 4 --seed 7 --out clean.nc")
    deepct(folder, "sense clean.nc --out images.nc")
    for ending in ("vti", "vol", "npz", "mat"):
        deepct(folder, f"convert cloud.nc cloud.{ending}")
    for ending in ("npz", "mat", "tif", "png", "exr"):
        deepct(folder, f"convert images.nc images.{ending}")
    return folder


@pytest.fixture(scope="module")
def cloud(folder):
    with h5py.File(folder / "cloud.nc") as file:
        values = {name: file[name][...] for name in (*"xyz", *FIELDS[1:])}
    wet = values["lwc"] > 0.0
    radius = np.where(wet, values["reff"], np.float32(1.0))
    values["extinction"] = np.where(wet, np.float32(1500.0) * values["lwc"] / radius, 0.0)
    return values


@pytest.fixture(scope="module")
def images(folder):
    with h5py.File(folder / "images.nc") as file:
        return {name: file[name][...] for name in file}


def matlab(path):
    """The arrays of a MATLAB 5 file, by the definition of its elements."""
    data = path.read_bytes()
    assert data[124:128] == b"\x00\x01IM"
    types = {1: "i1", 2: "u1", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8"}

    def elements(start, end):
        while start < end:
            kind, size = struct.unpack_from("<II", data, start)
            yield kind, start + 8, size
            start += 8 + (size + 7) // 8 * 8

    arrays = {}
    for kind, start, size in elements(128, len(data)):
        assert kind == 14
        parts = [np.frombuffer(data, types[part], length // np.dtype(types[part]).itemsize, at)
                 for part, at, length in elements(start, start + size)]
        (number, _), shape, name, values = parts
        assert values.dtype == {6: "<f8", 7: "<f4", 9: "u1"}[number]
        arrays[name.tobytes().decode()] = values.reshape(shape, order="F")
    return arrays


def test_numpy_arrays(folder, cloud, images):
    with np.load(folder / "cloud.npz") as file:
        assert set(file) == {*cloud, "origin_km", "spacing_km"}
        np.testing.assert_allclose(file["origin_km"], [0.0, 0.0, 0.48], atol=1e-12)
        np.testing.assert_allclose(file["spacing_km"], [0.05, 0.05, 0.04], rtol=1e-12)
        for name in FIELDS:
            np.testing.assert_array_equal(file[name], cloud[name])
        for name in "xyz":
            np.testing.assert_allclose(file[name], cloud[name], atol=1e-9)
    with np.load(folder / "images.npz") as file:
        for name in ("radiance", "radiance_standard_error", "saturated", "target"):
            np.testing.assert_array_equal(file[name], images[name])
        for name in ("camera_position", "view_zenith_deg", "view_azimuth_deg", "pixel_km"):
            np.testing.assert_allclose(file[name], images[name], rtol=1e-12)
        assert (file["sun_zenith_deg"], file["wavelength"]) == (pytest.approx(30.0), 0.672)


def test_matlab_arrays(folder, cloud, images):
    arrays = matlab(folder / "cloud.mat")
    assert set(arrays) == {*cloud, "origin_km", "spacing_km"}
    for name in FIELDS:
        np.testing.assert_array_equal(arrays[name], cloud[name])
    np.testing.assert_allclose(arrays["z"], cloud["z"][None], atol=1e-9)
    arrays = matlab(folder / "images.mat")
    np.testing.assert_array_equal(arrays["radiance"], images["radiance"])
    np.testing.assert_array_equal(arrays["camera_position"], images["camera_position"])


def test_vtk_cells(folder, cloud):
    data = (folder / "cloud.vti").read_bytes()
    text, appended = data.split(b'<AppendedData encoding="raw">\n_', 1)
    root = ElementTree.fromstring(text + b"</VTKFile>")
    image = root.find("ImageData")
    assert image.get("WholeExtent") == "0 14 0 12 0 8"
    spacing = [float(number) for number in image.get("Spacing").split()]
    origin = [float(number) for number in image.get("Origin").split()]
    np.testing.assert_allclose(spacing, [0.05, 0.05, 0.04])
    lower = [cloud[axis][0] - 0.5 * step for axis, step in zip("xyz", spacing)]
    np.testing.assert_allclose(origin, lower, atol=1e-9)
    arrays = {array.get("Name"): int(array.get("offset")) for array in root.iter("DataArray")}
    assert list(arrays) == list(FIELDS)
    for name, offset in arrays.items():
        (size,) = struct.unpack_from("<Q", appended, offset)
        values = np.frombuffer(appended, "<f4", size // 4, offset + 8)
        np.testing.assert_array_equal(values.reshape(8, 12, 14), cloud[name])


def test_mitsuba_volume(folder, cloud):
    data = (folder / "cloud.vol").read_bytes()
    assert data[:4] == b"VOL\x03"
    assert struct.unpack_from("<5i", data, 4) == (1, 14, 12, 8, 1)
    box = struct.unpack_from("<6f", data, 24)
    np.testing.assert_allclose(box, [0.0, 0.0, 0.48, 0.7, 0.6, 0.8], atol=1e-6)
    values = np.frombuffer(data, "<f4", offset=48).reshape(8, 12, 14)
    np.testing.assert_array_equal(values, cloud["extinction"])


def test_grey_levels(folder, images):
    radiance = images["radiance"].clip(min=0.0)
    white = radiance.max()
    with Image.open(folder / "images.tif") as file:
        assert file.n_frames == 10
        for number in range(10):
            file.seek(number)
            levels = np.array(file)
            assert levels.dtype == np.uint16
            # Row 0 of an image is its southern edge.
            shown = levels[::-1] * (white / 65535.0)
            np.testing.assert_allclose(shown, radiance[number], atol=0.51 * white / 65535.0)
            scale = float(file.tag_v2[270].split("=")[1].split("*")[0])
            assert scale == pytest.approx(white / 65535.0, rel=1e-6)
            with Image.open(folder / f"images-{number:02}.png") as picture:
                np.testing.assert_array_equal(np.array(picture), levels)
