"""The files of deepct can be read and edited by xarray, with both of its engines, by h5py, by
netCDF4 and, where they are installed, by the programs of netCDF, by NCO and by CDO."""

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
OF_HDF5 = {"DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"}


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


def test_netcdf_edits_and_extends_a_file(folder):
    path = shutil.copy(folder / "cloud.nc", folder / "edited.nc")
    with netCDF4.Dataset(path, "a") as file:
        lwc = file["lwc"][:]
        file["lwc"].units = "kg m-3"
        file["lwc"][:] = 1e-3 * lwc
        file.comment = "in kilograms"
        file.createVariable("temperature", "f4", FIELD)[:] = 280.0
        assert file.seed == 7 and file.ncattrs()[0] == "Conventions"
    xarray.Dataset({"humidity": (FIELD, np.ones(lwc.shape))}).to_netcdf(path, mode="a")
    deepct(folder, "score --truth cloud.nc edited.nc")
    with xarray.open_dataset(path) as file:
        assert {"temperature", "humidity", "lwc"} <= set(file)
        np.testing.assert_allclose(file.lwc, 1e-3 * lwc, rtol=1e-6)


@pytest.mark.parametrize("file", ["cloud.nc", "mask.nc", "images.nc"])
def test_files_need_no_feature_that_some_programs_lack(folder, file):
    """Types of classic netCDF, text of fixed length, no checksum filter, and fill values that no
    value equals, which programs read that refer to the chunks of a file."""
    classic = {np.dtype(kind) for kind in ("i1", "i4", "f4", "f8")}
    with h5py.File(folder / file) as raw:
        for variable in [raw, *raw.values()]:
            for name in set(variable.attrs) - OF_HDF5:
                kind = variable.attrs.get_id(name).dtype
                assert kind.kind == "S" or kind in classic, name
        for name, variable in raw.items():
            if name != "bnds":
                assert variable.dtype in classic and not variable.fletcher32
                assert not np.any(variable[()] == variable.fillvalue) and variable.fillvalue != 0


@pytest.mark.parametrize("file", ["cloud.nc", "mask.nc", "images.nc"])
def test_references_to_chunks_give_the_values(folder, file):
    hdf = pytest.importorskip("kerchunk.hdf")
    references = hdf.SingleHdf5ToZarr(str(folder / file)).translate()
    options = {"consolidated": False, "storage_options": {"fo": references}}
    with (
        xarray.open_dataset(folder / file) as direct,
        xarray.open_dataset("reference://", engine="zarr", backend_kwargs=options) as referred,
    ):
        for name, variable in direct.variables.items():
            np.testing.assert_array_equal(referred[name].values, variable.values, err_msg=name)


def test_coordinates_have_bounds_and_few_decimals(folder):
    with xarray.open_dataset(folder / "cloud.nc") as cloud:
        assert cloud.z.values.tolist() == [0.5, 0.54, 0.58, 0.62, 0.66, 0.7, 0.74, 0.78]
        assert cloud.z.attrs["bounds"] == "z_bnds"
        faces = cloud.z_bnds.values
        np.testing.assert_array_equal(faces[1:, 0], faces[:-1, 1])
        assert [faces[0, 0], faces[-1, 1]] == [0.48, 0.8]


def run(folder, command):
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, shell=True)


@pytest.mark.skipif(not shutil.which("nccopy"), reason="the programs of netCDF are not installed")
@pytest.mark.parametrize("file", ["cloud.nc", "mask.nc", "images.nc"])
def test_nccopy_writes_classic_files(folder, file):
    for kind in ("classic", "cdf5", "nc7", "nc4"):
        run(folder, f"nccopy -k {kind} {file} copy.nc")
        with (
            xarray.open_dataset(folder / file) as direct,
            xarray.open_dataset(folder / "copy.nc", engine="netcdf4") as copy,
        ):
            assert direct.attrs == copy.attrs
            for name, variable in direct.variables.items():
                np.testing.assert_array_equal(copy[name].values, variable.values, err_msg=name)


@pytest.mark.skipif(not shutil.which("ncatted"), reason="NCO is not installed")
def test_nco_edits_files_and_selects_levels(folder):
    shutil.copy(folder / "cloud.nc", folder / "nco.nc")
    run(folder, "ncatted -a comment,lwc,o,c,edited nco.nc")
    run(folder, "ncrename -v veff,variance nco.nc")
    run(folder, "ncks -A -v mask mask.nc nco.nc")
    run(folder, "ncks -O -d z,0.66,0.7 nco.nc levels.nc")
    with xarray.open_dataset(folder / "levels.nc") as levels:
        assert levels.z.values.tolist() == [0.66, 0.7]
        assert levels.lwc.attrs["comment"] == "edited" and {"variance", "mask"} <= set(levels)


@pytest.mark.skipif(not shutil.which("cdo"), reason="CDO is not installed")
def test_cdo_integrates_between_the_bounds(folder):
    run(folder, "cdo -s -f nc4 vertint -selname,lwc cloud.nc path.nc")
    with (
        xarray.open_dataset(folder / "cloud.nc") as cloud,
        xarray.open_dataset(folder / "path.nc") as path,
    ):
        expected = 0.04 * cloud.lwc.sum("z")
        np.testing.assert_allclose(path.lwc.squeeze(), expected, rtol=1e-5, atol=1e-7)


def write_as_version_0_1(source, target):
    """Copy a file in the form that deepct 0.1.0 wrote: text of variable length, unsigned integers,
    checksums, no fill values and no bounds."""
    with h5py.File(source) as new, h5py.File(target, "w", libver=("v108", "latest")) as old:
        for name, variable in new.items():
            if name.endswith("bnds"):
                continue
            values = variable[()]
            unsigned = values.astype("u1") if values.dtype == np.int8 else values
            chunks = {"chunks": True, "fletcher32": True} if variable.chunks else {}
            old.create_dataset(name, data=unsigned, **chunks)
        for name, variable in old.items():
            if new[name].is_scale:
                variable.make_scale(name)
        for name, variable in [("/", old), *old.items()]:
            for key, value in new[name].attrs.items():
                if key not in OF_HDF5 | {"bounds"}:
                    text = isinstance(value, bytes)
                    variable.attrs[key] = value.decode() if text else value
            for axis, scales in enumerate([] if name == "/" else new[name].dims):
                for scale in scales.keys():
                    if not new[name].is_scale:
                        variable.dims[axis].attach_scale(old[scale])
        old.attrs["seed"] = np.uint64(7)


def test_files_of_version_0_1_are_read(folder):
    for file in ("cloud", "images", "mask"):
        write_as_version_0_1(folder / f"{file}.nc", folder / f"old_{file}.nc")
    deepct(folder, "carve old_images.nc --grid old_cloud.nc --seed 7 --out of_old.nc")
    run(folder, f"{DEEPCT} score --truth old_cloud.nc cloud.nc")
    command = "infer old_images.nc --grid cloud.nc --out {}.nc --mask {}.nc"
    deepct(folder, command.format("of_old_mask", "old_mask"))
    deepct(folder, command.format("of_mask", "mask"))
    with (
        xarray.open_dataset(folder / "mask.nc") as mask,
        xarray.open_dataset(folder / "of_old.nc") as of_old,
        xarray.open_dataset(folder / "of_mask.nc") as volume,
        xarray.open_dataset(folder / "of_old_mask.nc") as of_old_mask,
    ):
        np.testing.assert_array_equal(of_old.mask, mask.mask)
        np.testing.assert_array_equal(of_old_mask.extinction, volume.extinction)


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
