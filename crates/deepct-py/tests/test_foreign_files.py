"""Files in deepct's own layout that other programs wrote, converted or joined."""

import subprocess

import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr

FORMATS = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA", "NETCDF4_CLASSIC"]


@pytest.fixture(scope="module")
def files(tmp_path_factory, command_line):
    """A cloud, its images and their mask."""
    folder = tmp_path_factory.mktemp("own")
    paths = {name: folder / f"{name}.nc" for name in ("cloud", "images", "mask")}
    command_line("cloud", "generate", "--seed", 4, "--set", "width_km=0.6", "--out", paths["cloud"])
    render = ("render", paths["cloud"], "--views", "cloudct-10", "--samples", 4)
    command_line(*render, "--out", paths["images"])
    command_line("carve", paths["images"], "--grid", paths["cloud"], "--out", paths["mask"])
    return paths


def refusal(run, *arguments):
    with pytest.raises(subprocess.CalledProcessError) as failure:
        run(*arguments)
    assert failure.value.returncode == 2
    line = failure.value.stderr.rstrip("\n")
    assert "\n" not in line, line
    return line


def values(path, name):
    with h5py.File(path) as file:
        return file[name][...]


def convert(source, target, format):
    with xr.open_dataset(source, decode_cf=False) as dataset:
        dataset.load().to_netcdf(target, format=format, engine="netcdf4")


@pytest.mark.parametrize("format", FORMATS)
def test_the_classic_formats(files, tmp_path, command_line, format):
    """A cloud, images and a mask in another format give the same answers."""
    for name, path in files.items():
        convert(path, tmp_path / f"{name}.nc", format)
    scores = command_line("score", "--truth", files["cloud"], tmp_path / "cloud.nc", "--json")
    assert '"relative_error": 0.0' in scores or '"relative_error":0.0' in scores
    carve = ("carve", tmp_path / "images.nc", "--grid", tmp_path / "mask.nc")
    command_line(*carve, "--out", tmp_path / "again.nc")
    assert np.array_equal(values(tmp_path / "again.nc", "mask"), values(files["mask"], "mask"))


@pytest.mark.parametrize("length", [3, 40, 400])
def test_a_truncated_classic_file(files, tmp_path, command_line, length):
    path = tmp_path / "cut.nc"
    convert(files["cloud"], path, "NETCDF3_CLASSIC")
    whole = path.read_bytes()
    for size in (length, len(whole) - length):
        path.write_bytes(whole[:size])
        line = refusal(command_line, "plot", path, "--out", tmp_path / "plot.png")
        assert "damaged" in line or "not an HDF5 or netCDF file" in line


def field(path, shape=(32, 4, 5), spacing=(0.04, 0.05, 0.05), scale=1.0, units="km"):
    """An extinction of 1 per km with the attributes of deepct's grids."""
    with netCDF4.Dataset(path, "w") as file:
        for name, count, step in zip("zyx", shape, spacing):
            file.createDimension(name, count)
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = scale * (np.arange(count) + 0.5) * step
            axis.units, axis.lower_edge, axis.spacing = units, 0.0, step
        extinction = file.createVariable("extinction", "f4", ("z", "y", "x"))
        extinction.units = "km-1"
        extinction[:] = 1.0
    return path


def test_attributes_that_contradict_a_single_level_are_refused(tmp_path, command_line):
    path = tmp_path / "field.nc"
    score = ("score", "--truth", path, path)
    with xr.open_dataset(field(path)) as whole:
        whole = whole.load()
    averaged = whole.coarsen(z=32).mean()
    averaged["z"].attrs = whole["z"].attrs
    averaged.to_netcdf(path)
    assert "has the attribute `lower_edge` = 0" in refusal(command_line, *score)
    cut = whole.isel(z=[5])
    cut.to_netcdf(path)
    command_line(*score)
    # Metres, with the attributes of kilometres.
    cut = cut.assign_coords(z=("z", 1e3 * cut["z"].values, {**cut["z"].attrs, "units": "m"}))
    cut.to_netcdf(path)
    assert "has the attribute `lower_edge` = 0" in refusal(command_line, *score)


def test_bounds_give_the_size_of_a_single_level(tmp_path, command_line):
    path = tmp_path / "field.nc"
    field(path, (1, 4, 5), (1.28, 0.05, 0.05))
    with netCDF4.Dataset(path, "a") as file:
        for name in ("lower_edge", "spacing"):
            file["z"].delncattr(name)
        file["z"].bounds = "z_bnds"
        file.createDimension("two", 2)
        file.createVariable("z_bnds", "f8", ("z", "two"))[:] = [[0.0, 1.28]]
    command_line("cloud", "import", path, "--spacing", "file", "--out", tmp_path / "out.nc")
    with h5py.File(tmp_path / "out.nc") as file:
        assert file["z"].attrs["spacing"] == pytest.approx(1.28)
        assert file["z"].attrs["lower_edge"] == 0.0
    with netCDF4.Dataset(path, "a") as file:
        file["z"].spacing = 0.04
    line = refusal(command_line, "score", "--truth", path, path)
    assert "has the attribute `spacing` = 0.04, but its cell is 1.28 wide" in line


def test_averaged_and_converted_levels_follow_from_their_values(tmp_path, command_line):
    """Several values are unambiguous, whatever their attributes say."""
    path = tmp_path / "field.nc"
    with xr.open_dataset(field(path)) as whole:
        averaged = whole.load().coarsen(z=2).mean()
        averaged["z"].attrs = whole["z"].attrs
    averaged.to_netcdf(path)
    expected = field(tmp_path / "expected.nc", (16, 4, 5), (0.08, 0.05, 0.05))
    command_line("score", "--truth", expected, path)
    metres = field(tmp_path / "metres.nc", scale=1e3, units="m")
    command_line("score", "--truth", field(tmp_path / "km.nc"), metres)


def test_images_joined_by_xarray(files, tmp_path, command_line):
    """The Sun becomes one number for each view."""
    with xr.open_dataset(files["images"]) as images:
        images = images.load()
    views = [images.isel(view=[view]) for view in range(images.sizes["view"])]
    joined = xr.concat(views, dim="view", data_vars="all")
    assert joined["sun_zenith_deg"].dims == ("view",)
    joined.to_netcdf(tmp_path / "joined.nc")
    carve = ("--grid", files["cloud"], "--out", tmp_path / "mask.nc")
    command_line("carve", tmp_path / "joined.nc", *carve)
    assert np.array_equal(values(tmp_path / "mask.nc", "mask"), values(files["mask"], "mask"))
    joined["sun_zenith_deg"][1] += 10.0
    joined.to_netcdf(tmp_path / "two_suns.nc")
    line = refusal(command_line, "carve", tmp_path / "two_suns.nc", *carve)
    assert "sun_zenith_deg: has the values 30 and 40; one value applies to all views" in line


def test_angles_that_were_rounded(files, tmp_path, command_line):
    """Instruments store angles with two decimals; another direction is a contradiction."""
    with xr.open_dataset(files["images"]) as images:
        images = images.load()
    angles = images["view_zenith_deg"].values
    carve = ("--grid", files["cloud"], "--out", tmp_path / "mask.nc")
    for change, fits in [(np.round(angles, 2) - angles, True), (np.full(len(angles), 0.2), False)]:
        images["view_zenith_deg"][:] = angles + change
        images.to_netcdf(tmp_path / "angles.nc")
        if fits:
            command_line("carve", tmp_path / "angles.nc", *carve)
            assert np.array_equal(values(tmp_path / "mask.nc", "mask"), values(files["mask"], "mask"))
        else:
            assert "but its camera_position has" in refusal(command_line, "carve", tmp_path / "angles.nc", *carve)


@pytest.mark.parametrize(
    "code, words",
    [
        (-999.0, "may be the code of a missing value"),
        (-9999.0, "may be the code of a missing value"),
        (-32767.0, "may be the code of a missing value"),
        (1e20, "may be the code of a missing value"),
        (np.inf, "write NaN, or the fill value, where a pixel is missing"),
    ],
)
def test_radiances_that_are_codes_of_missing_values(files, tmp_path, command_line, code, words):
    with xr.open_dataset(files["images"]) as images:
        images = images.load()
    images["radiance"][1, :, 3] = code
    images["radiance"].encoding.clear()
    images.to_netcdf(tmp_path / "coded.nc")
    carve = ("--grid", files["cloud"], "--out", tmp_path / "mask.nc")
    assert words in refusal(command_line, "carve", tmp_path / "coded.nc", *carve)


def test_the_direction_in_which_sunlight_travels(files, tmp_path, command_line):
    """SHDOM counts from there: a zenith angle of 165 degrees and an azimuth of 90 are 15 and 270."""
    sun = ("--sun-zenith", 165, "--sun-azimuth", 90, "--samples", 2, "--out", tmp_path / "images.nc")
    line = refusal(command_line, "render", files["cloud"], "--views", "cloudct-10", *sun)
    assert "give 15 and the azimuth towards the Sun, 270" in line


def test_masks_of_real_numbers(files, tmp_path, command_line):
    """CDO converts masks to real numbers."""
    with xr.open_dataset(files["mask"]) as mask:
        mask = mask.load()
    mask["mask"] = mask["mask"].astype("f4")
    mask["mask"].attrs.pop("flag_values", None)
    mask.to_netcdf(tmp_path / "real.nc")
    infer = ("infer", files["images"], "--weights", "cloudct-10", "--out", tmp_path / "volume.nc")
    command_line(*infer, "--mask", tmp_path / "real.nc")
    mask["mask"][0, 0, 0] = 0.5
    mask.to_netcdf(tmp_path / "half.nc")
    assert "holds 0.5" in refusal(command_line, *infer, "--mask", tmp_path / "half.nc")


@pytest.fixture(scope="module")
def carved(files, tmp_path_factory, command_line):
    """The mask of images in any file, on the grid of the cloud."""
    folder = tmp_path_factory.mktemp("carved")

    def carve(images):
        out = folder / "mask.nc"
        command_line("carve", images, "--grid", files["cloud"], "--out", out)
        return values(out, "mask")

    return carve


def minimal(path, projection=None):
    """Images with the variables that are needed only."""
    with xr.open_dataset(path) as dataset:
        dataset = dataset.load()
    needed = ["radiance", "camera_position", "pixel_tangent"]
    images = dataset[needed].drop_vars([*dataset.coords])
    images["target"] = ("xyz", dataset.target.values[0])
    for name in ("sun_zenith_deg", "sun_azimuth_deg", "wavelength"):
        images[name] = float(dataset[name])
    for variable in images.variables.values():
        variable.attrs.clear()
    return images if projection is None else images.assign(projection=projection)


@pytest.mark.parametrize("engine", ["netcdf4", "h5netcdf", "NETCDF3_CLASSIC"])
@pytest.mark.parametrize(
    "projection",
    [None, 0, "perspective", ("view", ["perspective"] * 10), ("view", np.array(["perspective"] * 10, "S"))],
)
def test_a_minimal_file_of_images(files, tmp_path, command_line, carved, projection, engine):
    path = tmp_path / "own.nc"
    options = {"format": engine} if engine.startswith("NETCDF") else {"engine": engine}
    minimal(files["images"], projection).to_netcdf(path, **options)
    assert np.array_equal(carved(path), values(files["mask"], "mask"))
    report = command_line("images", "check", path)
    assert ("derived        projection: perspective" in report) == (projection is None)


def test_an_unknown_projection(files, tmp_path, command_line):
    for projection in ("fisheye", 7):
        minimal(files["images"], projection).to_netcdf(tmp_path / "own.nc")
        line = refusal(command_line, "images", "check", tmp_path / "own.nc")
        assert str(projection) in line and "0 (perspective)" in line


@pytest.mark.parametrize("order", [("row", "col", "view"), ("view", "col", "row"), ("y", "x", "view")])
def test_dimensions_of_images_have_names(files, tmp_path, carved, order):
    images = minimal(files["images"])
    if "y" in order:
        images = images.rename(row="y", col="x")
    images["radiance"] = images.radiance.transpose(*order)
    images["camera_position"] = images.camera_position.T
    images.to_netcdf(tmp_path / "own.nc")
    assert np.array_equal(carved(tmp_path / "own.nc"), values(files["mask"], "mask"))


def test_images_on_the_axes_of_a_map(files, tmp_path, command_line, carved):
    """Positions along the axes of images tell which side is north."""
    images = minimal(files["images"]).rename(row="y", col="x")
    km = 0.05 * np.arange(images.sizes["y"])
    images = images.assign_coords(y=("y", km, {"units": "km"}), x=("x", km, {"units": "km"}))
    images.isel(y=slice(None, None, -1)).to_netcdf(tmp_path / "own.nc")
    assert np.array_equal(carved(tmp_path / "own.nc"), values(files["mask"], "mask"))
    assert "y decreases" in command_line("images", "check", tmp_path / "own.nc")


def test_positions_of_cameras_in_whole_numbers(files, tmp_path, command_line):
    images = minimal(files["images"])
    images["camera_position"] = images.camera_position.round().astype("int32")
    images.to_netcdf(tmp_path / "own.nc")
    command_line("images", "check", tmp_path / "own.nc")


def test_missing_pixels_are_nan_or_the_fill_value(files, tmp_path, command_line, carved):
    """They do not carve, and are counted."""
    masks = []
    for number, fill in enumerate((None, -9999.0)):
        images = minimal(files["images"])
        images["radiance"][:, 4:9, 6] = np.nan
        images["radiance"].encoding = {} if fill is None else {"_FillValue": fill}
        images.to_netcdf(tmp_path / f"{number}.nc")
        assert "0 saturated, 50 missing" in command_line("images", "check", tmp_path / f"{number}.nc")
        masks.append(carved(tmp_path / f"{number}.nc"))
        command_line("plot", tmp_path / f"{number}.nc", "--out", tmp_path / "plot.png")
        command_line("convert", tmp_path / f"{number}.nc", tmp_path / "images.exr")
    assert np.array_equal(*masks)
    assert (masks[0] >= values(files["mask"], "mask")).all()


def test_padded_images(files, tmp_path, command_line, carved):
    """Images of different sizes in one array."""
    whole = minimal(files["images"])
    middle = (np.array([whole.sizes["row"], whole.sizes["col"]]) - 1) / 2
    images = whole.pad(row=(0, 5), col=(2, 0), constant_values=np.nan)
    for name, place in (("target_row", middle[0]), ("target_col", middle[1] + 2)):
        images[name] = ("view", np.full(10, place))
    images["camera_position"] = whole.camera_position
    images.to_netcdf(tmp_path / "padded.nc")
    assert np.array_equal(carved(tmp_path / "padded.nc"), values(files["mask"], "mask"))
