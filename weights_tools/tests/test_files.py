"""The files of deepct can be read by xarray, with both of its engines, and by h5py."""

import json
import os
import shutil
import subprocess

import h5py
import netCDF4
import numpy as np
import pytest
import xarray

from weights_tools.checkpoint import write_whole

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")
ENGINES = ("h5netcdf", "netcdf4")
FIELD = ("z", "y", "x")


def deepct(folder, arguments):
    assert DEEPCT, "deepct is not on the PATH and DEEPCT does not name it"
    subprocess.run([DEEPCT, *arguments.split(), "--quiet"], cwd=folder, check=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small cloud, its images and a mask."""
    folder = tmp_path_factory.mktemp("files")
    shape = "--set shape=[8,12,14] --set width_km=0.3 --set depth_km=0.16"
    deepct(folder, f"cloud generate --seed 7 {shape} --out cloud.nc")
    deepct(folder, "render cloud.nc --views cloudct-10 --samples 4 --seed 7 --out images.nc")
    deepct(folder, "carve images.nc --grid cloud.nc --seed 7 --out mask.nc")
    return folder


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("file", "dimensions"),
    [
        ("cloud.nc", {"lwc": FIELD, "reff": FIELD, "veff": FIELD}),
        ("mask.nc", {"mask": FIELD}),
        (
            "images.nc",
            {
                "radiance": ("view", "row", "col"),
                "radiance_standard_error": ("view", "row", "col"),
                "view_zenith_deg": ("view",),
                "camera_position": ("view", "component"),
                "sun_zenith_deg": (),
            },
        ),
    ],
)
def test_xarray_sees_named_dimensions_and_the_values_of_h5py(folder, engine, file, dimensions):
    with (
        xarray.open_dataset(folder / file, engine=engine) as dataset,
        h5py.File(folder / file) as raw,
    ):
        for name, expected in dimensions.items():
            assert dataset[name].dims == expected
            assert [list(scales.keys()) for scales in raw[name].dims] == [[d] for d in expected]
            np.testing.assert_array_equal(dataset[name].values, raw[name][()])
        for axis in {axis for axes in dimensions.values() for axis in axes}:
            np.testing.assert_array_equal(dataset[axis].values, raw[axis][()])
        assert dataset.attrs["Conventions"] == "CF-1.10"
        assert dataset.attrs["seed"] == 7
        assert dataset.attrs["deepct_version"] and "=" in dataset.attrs["configuration"]


def test_coordinates_are_voxel_centres_in_km(folder):
    with xarray.open_dataset(folder / "cloud.nc") as cloud:
        np.testing.assert_allclose(cloud.x, 0.025 + 0.05 * np.arange(14), atol=1e-12)
        np.testing.assert_allclose(cloud.z, 0.50 + 0.04 * np.arange(8), atol=1e-12)
        assert cloud.z.attrs["positive"] == "up"
        assert [cloud[axis].attrs["axis"] for axis in FIELD] == ["Z", "Y", "X"]
        assert cloud.lwc.attrs["units"] == "g m-3"
        assert float(cloud.lwc.max()) > 0.1


@pytest.mark.parametrize("engine", ENGINES)
def test_what_xarray_writes_is_read_back(folder, engine):
    """A section of a cloud that xarray selects and writes is a valid cloud file."""
    with xarray.open_dataset(folder / "cloud.nc") as cloud:
        part = cloud.isel(x=slice(2, 12), z=slice(1, 8)).load()
    part.to_netcdf(folder / f"part-{engine}.nc", engine=engine)
    deepct(folder, f"cloud import part-{engine}.nc --spacing file --out again-{engine}.nc")
    with xarray.open_dataset(folder / f"again-{engine}.nc") as again:
        np.testing.assert_allclose(again.lwc, part.lwc, rtol=1e-6)
        np.testing.assert_allclose(again.reff, part.reff, rtol=1e-5)
        np.testing.assert_allclose(again.x, part.x, atol=1e-12)
    deepct(folder, f"carve images.nc --grid part-{engine}.nc --out part-mask.nc")
    with xarray.open_dataset(folder / "part-mask.nc") as mask:
        np.testing.assert_allclose(mask.z, part.z, atol=1e-12)


def test_big_endian_numbers_are_understood(folder):
    with xarray.open_dataset(folder / "cloud.nc") as cloud:
        cloud = cloud.load()
    with netCDF4.Dataset(folder / "big.nc", "w") as file:
        for axis in FIELD:
            file.createDimension(axis, cloud.sizes[axis])
            file.createVariable(axis, ">f8", (axis,), endian="big")[:] = 1e3 * cloud[axis].values
            file[axis].units = "m"
        wet = np.maximum(cloud.reff.values, 1e-6)
        extinction = file.createVariable("extinction", ">f4", FIELD, endian="big")
        extinction.units = "km-1"
        extinction[:] = 1500.0 * cloud.lwc.values / wet
    command = [DEEPCT, "score", "--truth", "cloud.nc", "big.nc", "--json"]
    run = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    assert json.loads(run.stdout)[0]["relative_error"] < 1e-5


def test_a_file_that_is_written_has_the_usual_permissions(tmp_path):
    path = tmp_path / "file"
    write_whole(path, b"content")
    (tmp_path / "other").write_bytes(b"")
    assert path.read_bytes() == b"content"
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode
    assert sorted(each.name for each in tmp_path.iterdir()) == ["file", "other"]
