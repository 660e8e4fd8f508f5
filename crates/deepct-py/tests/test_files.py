"""Files and data sets of xarray: what is written is read again, by Python and by the command line."""

import logging

import h5py
import numpy as np
import pytest
import xarray

import deepct_py


@pytest.fixture(scope="module")
def cloud():
    return deepct_py.generate_cloud(seed=3, width_km=0.4)


@pytest.fixture(scope="module")
def images(cloud):
    """Noisy images with a standard error, saturated pixels and a light that is not the default."""
    light = deepct_py.Light(sun=(30, 45), air=True, phase="mie", wind_speed=3)
    clean = deepct_py.render(cloud, views="cloudct-10", light=light, samples=8)
    return deepct_py.sense(clean, electrons_per_radiance=2e5)


@pytest.fixture(scope="module")
def results(cloud, images):
    """One object of every class that has a file."""
    mask = deepct_py.carve(images, grid=cloud.grid)
    estimate = deepct_py.Network.load("cloudct-10").estimate(images, mask=mask)
    light = images.light.replace(air=False, wind_speed=None)
    inverted = deepct_py.invert(
        images.replace(light=light), grid=cloud.grid, mask=mask, truth=cloud, init=estimate,
        iterations=1, corrections=1, probes=0,
    )
    given = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction)
    return {"cloud": cloud, "given": given, "images": images, "mask": mask, "estimate": estimate,
            "inverted": inverted}


READERS = {
    "cloud": deepct_py.read_cloud, "given": deepct_py.read_cloud, "images": deepct_py.read_images,
    "mask": deepct_py.read_mask, "estimate": deepct_py.read_volume,
    "inverted": deepct_py.read_volume,
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_written_is_read(results, name, tmp_path):
    written, path = results[name], tmp_path / "file.nc"
    written.to_netcdf(path)
    for found in (READERS[name](path), READERS[name](str(path))):
        for part in ("grid", "views", "light"):
            if hasattr(written, part):
                assert getattr(found, part) == getattr(written, part)
        for part in ("extinction", "liquid_water_content", "effective_radius", "radiance",
                     "standard_error", "saturated", "mask", "uncertainty"):
            if hasattr(written, part) and hasattr(found, part):
                np.testing.assert_array_equal(getattr(found, part), getattr(written, part))


def test_the_images_are_those_of_another_reader(images, tmp_path):
    images.to_netcdf(tmp_path / "images.nc", title="Ten views")
    with h5py.File(tmp_path / "images.nc") as file:
        np.testing.assert_array_equal(file["radiance"], images.radiance)
        np.testing.assert_array_equal(file["radiance_standard_error"], images.standard_error)
        np.testing.assert_array_equal(file["saturated"][...] == 1, images.saturated)
        np.testing.assert_allclose(file["camera_position"], images.views.position, rtol=1e-15)
        np.testing.assert_allclose(file["target"], images.views.target, rtol=1e-15)
        assert file["sun_zenith_deg"][()] == pytest.approx(30.0)
        assert file.attrs["title"] == b"Ten views"


def test_files_of_the_module_are_those_of_the_command_line(results, tmp_path, command_line):
    for name in ("cloud", "images", "estimate"):
        results[name].to_netcdf(tmp_path / f"{name}.nc")
    command_line("infer", tmp_path / "images.nc", "--weights", "cloudct-10", "--carve",
                 "--out", tmp_path / "volume.nc")
    found = deepct_py.read_volume(tmp_path / "volume.nc")
    np.testing.assert_array_equal(found.extinction, results["estimate"].extinction)
    np.testing.assert_array_equal(found.uncertainty, results["estimate"].uncertainty)
    assert found.light == results["images"].light
    # A rendering of the file has the bits of a rendering of the object.
    command_line("render", tmp_path / "cloud.nc", "--views", "cloudct-10", "--samples", 2,
                 "--phase", "mie", "--out", tmp_path / "again.nc")
    light = deepct_py.Light(phase="mie")
    again = deepct_py.render(results["cloud"], views="cloudct-10", light=light, samples=2)
    stored = deepct_py.read_images(tmp_path / "again.nc")
    np.testing.assert_array_equal(stored.radiance, again.radiance)
    assert stored.light == again.light and stored.views == again.views


def test_images_need_no_further_arguments(results, cloud, images, tmp_path):
    images.to_netcdf(tmp_path / "images.nc")
    stored = deepct_py.read_images(tmp_path / "images.nc")
    network = deepct_py.Network.load("cloudct-10")
    np.testing.assert_array_equal(
        network.infer(stored), network.infer(images.radiance, images.views, images.light)
    )
    carved = deepct_py.carve(stored, grid=cloud.grid)
    arguments = {"standard_error": images.standard_error, "saturated": images.saturated}
    same = deepct_py.carve(images.radiance, images.views, cloud.grid, **arguments)
    assert carved == same
    for name in ("views", "light", "standard_error", "saturated"):
        with pytest.raises(ValueError, match=f"{name} belongs to the images"):
            deepct_py.invert(stored, grid=cloud.grid, **{name: getattr(images, name)})
    with pytest.raises(TypeError, match="views is missing"):
        network.infer(images.radiance)
    for message, wrong in [
        ("grid is missing", lambda: deepct_py.carve(stored)),
        ("by their names", lambda: deepct_py.carve(stored, cloud.grid)),
        ("Cloud'>, which has no radiance", lambda: deepct_py.carve(cloud, grid=cloud.grid)),
        ("not of real numbers", lambda: deepct_py.score(stored, cloud)),
    ]:
        with pytest.raises(TypeError, match=message):
            wrong()


def test_data_sets_have_the_contents_of_the_files(results, tmp_path):
    for name, written in results.items():
        path = tmp_path / f"{name}.nc"
        written.to_netcdf(path)
        dataset = written.to_xarray()
        with xarray.open_dataset(path) as expected:
            xarray.testing.assert_identical(dataset, expected.load())
    water = results["cloud"].to_xarray().lwc
    assert water.dims == ("z", "y", "x") and water.units == "g m-3" and water.z.units == "km"


def test_data_sets_become_objects(results, images):
    dataset = images.to_xarray()
    found = deepct_py.Observation.from_dataset(dataset)
    assert found == images.replace() and type(found) is deepct_py.Observation
    assert deepct_py.Views.from_dataset(dataset) == images.views
    assert deepct_py.Light.from_dataset(dataset) == images.light
    assert deepct_py.Cloud.from_dataset(results["cloud"].to_xarray()) == results["cloud"]
    # Axes are found by their names.
    turned = dataset.transpose("col", "component", "row", "view")
    assert deepct_py.Observation.from_dataset(turned) == found
    turned = results["estimate"].to_xarray().transpose("x", "bnds", "z", "y")
    assert deepct_py.Estimate.from_dataset(turned) == results["estimate"]
    assert deepct_py.Estimate.from_dataset(results["estimate"].to_xarray()) == results["estimate"]
    mask = deepct_py.Carved.from_dataset(results["mask"].to_xarray())
    np.testing.assert_array_equal(mask.mask, results["mask"].mask)
    assert deepct_py.Grid.from_dataset(results["mask"].to_xarray()) == results["cloud"].grid
    with pytest.raises(deepct_py.DeepctError, match="the data set: camera_position: is missing"):
        deepct_py.Observation.from_dataset(dataset.drop_vars("camera_position"))
    network = deepct_py.Network.load("cloudct-10")
    np.testing.assert_array_equal(network.infer(dataset), network.infer(images))


def test_coordinates_state_the_grid(cloud):
    field = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction).to_xarray().extinction
    render = {"views": "cloudct-10", "samples": 2}
    expected = deepct_py.render(cloud.extinction, cloud.grid, **render).radiance
    for same in (field, field.transpose("x", "z", "y"), field.isel(z=slice(None, None, -1))):
        np.testing.assert_array_equal(deepct_py.render(same, **render).radiance, expected)
    plain = xarray.DataArray(
        cloud.extinction, dims=("z", "y", "x"),
        coords={axis: (axis, 1000.0 * getattr(cloud.grid, axis), {"units": "m"}) for axis in "zyx"},
    )
    found = deepct_py.Grid.from_dataset(plain)
    np.testing.assert_allclose(found.origin, cloud.grid.origin, atol=1e-12)
    np.testing.assert_allclose(found.spacing, cloud.grid.spacing, rtol=1e-12)
    np.testing.assert_array_equal(
        deepct_py.render(plain, cloud.grid, **render).radiance, expected
    )
    shifted = field.assign_coords(x=field.x + 0.05)
    with pytest.raises(ValueError, match="extinction is on another grid"):
        deepct_py.render(shifted, cloud.grid, **render)
    with pytest.raises(ValueError, match="estimate is on another grid"):
        deepct_py.score(field, shifted)
    stretched = field.assign_coords(z=("z", cloud.grid.z**1.1))
    with pytest.raises(ValueError, match="along z that are not equidistant"):
        deepct_py.score(field, stretched)
    with pytest.raises(ValueError, match="grid is missing"):
        deepct_py.render(field.drop_vars(["x", "y", "z"]), **render)
    with pytest.raises(ValueError, match='in the units "s"'):
        deepct_py.score(field.assign_coords(z=("z", cloud.grid.z, {"units": "s"})), field)


def test_a_simulation_is_imported_as_by_the_command_line(tmp_path, command_line, caplog):
    """Mixing ratios on 4 x 5 x 6 cells without a density: that of the standard atmosphere."""
    water = np.zeros((1, 4, 5, 6))
    water[0, 1:3, 1:4, 2:5] = np.arange(18).reshape(2, 3, 3) * 1e-5 + 1e-4
    axes = {name: (name, step * (np.arange(length) + 0.5), {"units": "m"})
            for name, length, step in (("z", 4, 40.0), ("y", 5, 50.0), ("x", 6, 50.0))}
    path = tmp_path / "les.nc"
    xarray.Dataset(
        {"ql": (("time", "z", "y", "x"), water, {"units": "kg kg-1"})}, axes
    ).to_netcdf(path)
    with caplog.at_level(logging.INFO, "deepct_py"), pytest.warns(UserWarning, match="density"):
        cloud = deepct_py.import_cloud(path, spacing="file", droplets=80, base=np.float64(0.0))
    assert "ql" in caplog.text
    command_line("cloud", "import", path, "--spacing", "file", "--droplets", 80, "--base", 0,
                 "--out", tmp_path / "cloud.nc")
    assert deepct_py.read_cloud(tmp_path / "cloud.nc") == cloud
    with xarray.open_dataset(path) as dataset, pytest.warns(UserWarning, match="density"):
        turned = dataset.transpose("x", "y", "z", "time")
        assert deepct_py.import_cloud(turned, spacing="file", droplets=80, base=0.0) == cloud
    constant = deepct_py.import_cloud(path, spacing=(0.05, 0.05, 0.04), air_density=1.0)
    np.testing.assert_allclose(constant.liquid_water_content, 1e3 * water[0], rtol=1e-6)
    # The unit of the argument replaces that of the file.
    part = deepct_py.import_cloud(path, crop=[2, 1, 3, 2], units={"ql": "kg m-3"})
    np.testing.assert_allclose(
        part.liquid_water_content, 1e3 * water[0, :, 1:3, 2:5], rtol=1e-5, atol=1e-12
    )
    for error, message, arguments in [
        (ValueError, "time is -1", {"time": -1}),
        (ValueError, "crop has 2 values, but must have 4", {"crop": (0, 0)}),
        (ValueError, "air_density is heavy", {"air_density": "heavy"}),
        (deepct_py.DeepctError, "nothing", {"variable": "nothing"}),
    ]:
        with pytest.raises(error, match=message):
            deepct_py.import_cloud(path, **arguments)


def test_files_that_cannot_be_read_or_written_are_reported(cloud, tmp_path):
    for read in set(READERS.values()):
        with pytest.raises((FileNotFoundError, deepct_py.DeepctError), match="none.nc"):
            read(tmp_path / "none.nc")
        (tmp_path / "text.nc").write_text("no netCDF")
        with pytest.raises(deepct_py.DeepctError, match="text.nc"):
            read(tmp_path / "text.nc")
    with pytest.raises(deepct_py.DeepctError, match="missing"):
        cloud.to_netcdf(tmp_path / "missing" / "cloud.nc")
    cloud.to_netcdf(tmp_path / "cloud.nc")
    with pytest.raises(deepct_py.DeepctError, match="radiance"):
        deepct_py.read_images(tmp_path / "cloud.nc")


def test_a_figure_is_that_of_the_command_line(results, tmp_path, command_line):
    for name in ("cloud", "estimate", "images"):
        results[name].to_netcdf(tmp_path / f"{name}.nc")
    command_line("plot", tmp_path / "estimate.nc", "--truth", tmp_path / "cloud.nc",
                 "--out", tmp_path / "estimate.png")
    expected = (tmp_path / "estimate.png").read_bytes()
    for figure in (
        deepct_py.plot(results["estimate"], results["cloud"], title="estimate.nc"),
        deepct_py.plot(tmp_path / "estimate.nc", tmp_path / "cloud.nc"),
    ):
        assert figure.png == figure._repr_png_() == expected
    array = results["estimate"].extinction
    assert deepct_py.plot(array, grid=results["cloud"].grid) == deepct_py.plot(
        deepct_py.Estimate(results["cloud"].grid, array))
    command_line("plot", tmp_path / "images.nc", "--out", tmp_path / "images.png")
    figure = deepct_py.plot(results["images"], title="images.nc", out=tmp_path / "own.png")
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "images.png").read_bytes()
    figure.save(tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == figure.png
    with pytest.raises(ValueError, match="ending in .png, .svg or .pdf"):
        figure.save(tmp_path / "figure.eps")
    with pytest.raises(TypeError, match="cannot be compared"):
        deepct_py.plot(results["images"], results["cloud"])
    middle = tuple(results["cloud"].grid.center)
    command_line("plot", tmp_path / "cloud.nc", "--through", ",".join(map(str, middle)),
                 "--title", "Cloud", "--out", tmp_path / "through.png")
    through = deepct_py.plot(results["cloud"], through=middle, title="Cloud")
    assert (tmp_path / "through.png").read_bytes() == through.png
    with pytest.raises(TypeError, match="no slices"):
        deepct_py.plot(results["images"], through=middle)
    with pytest.raises(ValueError, match="in the grid"):
        deepct_py.plot(results["cloud"], through=(0.0, 0.0, 99.0))


def test_an_incomplete_file_has_a_warning(results, tmp_path):
    path = tmp_path / "volume.nc"
    results["estimate"].to_netcdf(path)
    with h5py.File(path, "a") as file:
        file.attrs["incomplete"] = np.bytes_("stopped after 3 of 60 steps")
    with pytest.warns(UserWarning, match="incomplete: stopped after 3 of 60 steps"):
        deepct_py.read_volume(path)
