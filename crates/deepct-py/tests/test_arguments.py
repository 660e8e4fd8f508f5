"""Arguments that mean the same in every form: the light of a truth, grids, networks, files, messages."""

import inspect
import json
import pathlib
import re

import numpy as np
import pytest
import xarray

import deepct_py
from deepct_py._words import in_python

CORE = pathlib.Path(__file__).parents[2] / "deepct-core/src"


@pytest.fixture(scope="module")
def cloud():
    return deepct_py.generate_cloud(seed=3, width_km=0.4)


@pytest.fixture(scope="module")
def light():
    """A light in which the extinction is that by Mie theory, several per cent above the geometric one."""
    return deepct_py.Light(phase="mie", extinction="mie", sun=(30, 45))


@pytest.fixture(scope="module")
def images(cloud, light):
    return deepct_py.render(cloud, views="cloudct-10", light=light, solver="ordinates")


@pytest.fixture(scope="module")
def estimate(images):
    return deepct_py.Network.load("cloudct-10").estimate(images)


@pytest.fixture(scope="module")
def folder(cloud, images, estimate, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    cloud.to_netcdf(folder / "cloud.nc")
    images.to_netcdf(folder / "images.nc")
    estimate.to_netcdf(folder / "estimate.nc")
    deepct_py.carve(images, grid=cloud.grid).to_netcdf(folder / "mask.nc")
    return folder


def epsilon(truth, estimate):
    """The relative error by its definition."""
    truth, estimate = np.float64(truth), np.float64(estimate)
    return np.abs(truth - estimate).sum() / truth.sum()


def test_the_truth_is_in_the_light_of_the_estimate(cloud, light, estimate, folder, command_line):
    rows = command_line("score", "--truth", folder / "cloud.nc", folder / "estimate.nc", "--json")
    expected = json.loads(rows)[0]["relative_error"]
    in_light = deepct_py.Estimate(cloud.grid, cloud, light=light).extinction
    assert expected == pytest.approx(epsilon(in_light, estimate.extinction), rel=1e-6)
    geometric = epsilon(cloud.extinction, estimate.extinction)
    assert abs(geometric / expected - 1.0) > 0.01
    dataset = xarray.open_dataset(folder / "estimate.nc")
    truths = [cloud, cloud.to_xarray(), folder / "cloud.nc", str(folder / "cloud.nc")]
    for truth in truths:
        for found in (estimate, dataset, folder / "estimate.nc"):
            assert deepct_py.score(truth, found).relative_error == expected
        # No light is known.
        plain = deepct_py.score(truth, estimate.extinction).relative_error
        assert plain == pytest.approx(geometric, rel=1e-6)
        assert deepct_py.score(truth, cloud).relative_error == 0.0
    given = deepct_py.Cloud(cloud.grid, extinction=cloud.extinction)
    assert deepct_py.score(given, estimate).relative_error == pytest.approx(geometric, rel=1e-6)


def test_inversions_have_the_epsilon_of_the_command_line(
    cloud, images, estimate, folder, command_line
):
    mask = deepct_py.read_mask(folder / "mask.nc")
    options = {"mask": mask, "iterations": 1, "corrections": 1, "probes": 0}
    for truth in (cloud, folder / "cloud.nc"):
        inverted = deepct_py.invert(images, grid=cloud, init=estimate, truth=truth, **options)
        found = inverted.history[-1]["relative_error"]
        assert found == pytest.approx(deepct_py.score(cloud, inverted).relative_error, rel=1e-5)
        hybrid = deepct_py.hybrid(images, network="cloudct-10", truth=truth, **options)
        found = hybrid.history[-1]["relative_error"]
        assert found == pytest.approx(deepct_py.score(cloud, hybrid).relative_error, rel=1e-5)
    inverted.to_netcdf(folder / "inverted.nc")
    rows = command_line("score", "--truth", folder / "cloud.nc", folder / "inverted.nc", "--json")
    score = json.loads(rows)[0]["relative_error"]
    assert score == pytest.approx(inverted.history[-1]["relative_error"], rel=1e-5)
    # A start at a cloud is that at its extinction in the light of the images.
    start = deepct_py.invert(images, grid=cloud, init=cloud, truth=cloud, **options).history[0]
    assert start["relative_error"] < 1e-6


def test_a_figure_and_a_rendering_take_the_light_too(cloud, light, estimate, folder):
    in_light = deepct_py.Estimate(cloud.grid, cloud, light=light).extinction
    assert deepct_py.plot(estimate, cloud) == deepct_py.plot(estimate, in_light)
    radii = np.full(cloud.grid.shape, 10.0)
    options = {"views": "cloudct-10", "light": light, "samples": 2, "effective_radius": radii}
    by_cloud = deepct_py.render(cloud, **options)
    by_array = deepct_py.render(in_light, cloud, **options)
    np.testing.assert_array_equal(by_cloud.radiance, by_array.radiance)


@pytest.mark.parametrize("axes", ["z", "y", "x", "zyx"])
def test_descending_coordinates_are_turned_everywhere(cloud, estimate, folder, axes):
    turned = {axis: slice(None, None, -1) for axis in axes}
    mask = deepct_py.read_mask(folder / "mask.nc")
    for one in (cloud, estimate, mask):
        dataset = one.to_xarray().isel(turned)
        assert type(one).from_dataset(dataset) == one
        assert deepct_py.Grid.from_dataset(dataset) == one.grid
        plain = dataset.drop_vars([f"{axis}_bnds" for axis in "zyx"])
        for axis in "zyx":
            plain[axis].attrs = {"units": "km"}
        found = deepct_py.Grid.from_dataset(plain)
        np.testing.assert_allclose(found.origin, one.grid.origin, atol=1e-9)
    dataset = estimate.to_xarray().isel(turned)
    assert deepct_py.score(estimate, dataset).relative_error == 0.0
    assert deepct_py.score(cloud.to_xarray().isel(turned), cloud).relative_error == 0.0


def test_files_of_others_are_replaced_only_on_request(cloud, images, estimate, folder, tmp_path):
    inverted = deepct_py.invert(
        images, grid=cloud, init=estimate, iterations=1, corrections=1, probes=0
    )
    mask = deepct_py.read_mask(folder / "mask.nc")
    script = tmp_path / "my_script.py"
    for one in (cloud, images, mask, estimate, inverted):
        script.write_text("print('my work')\n")
        with pytest.raises(FileExistsError, match="my_script.py exists .* overwrite=True"):
            one.to_netcdf(script)
        assert script.read_text() == "print('my work')\n"
        one.to_netcdf(script, overwrite=True)
        # Its own files are replaced, and so are empty ones.
        one.to_netcdf(script)
    script.write_text("")
    cloud.to_netcdf(script)
    picture = tmp_path / "picture.png"
    figure = deepct_py.plot(cloud)
    for write in (
        lambda **options: figure.save(picture, **options),
        lambda **options: deepct_py.plot(cloud, out=picture, **options),
    ):
        picture.write_text("no picture")
        with pytest.raises(FileExistsError, match="picture.png exists"):
            write()
        assert picture.read_text() == "no picture"
        write(overwrite=True)
        write()
        assert picture.read_bytes() == figure.png


def test_a_grid_is_taken_from_what_has_one(cloud, images, estimate, folder):
    network = deepct_py.Network.load()
    mask = deepct_py.carve(images, grid=cloud.grid)
    like = {"views": images.views, "light": images.light}
    expected = network.infer(images.radiance, grid=cloud.grid, **like)
    toml = folder / "grid.toml"
    grid = cloud.grid
    toml.write_text(
        f"origin_km = {list(grid.origin)}\nspacing_km = {list(grid.spacing)}\nshape = {list(grid.shape)}\n"
    )
    grids = [cloud, mask, deepct_py.Estimate(cloud, cloud), cloud.to_xarray(),
             cloud.to_xarray().lwc, folder / "cloud.nc", str(folder / "mask.nc"), toml]
    for grid in grids:
        assert deepct_py.carve(images, grid=grid) == mask
        np.testing.assert_array_equal(network.infer(images, grid=grid), expected)
        assert deepct_py.Cloud(grid, extinction=cloud.extinction).grid == cloud.grid
    for wrong in (3, (4, 8, 8), estimate.extinction):
        with pytest.raises(TypeError, match="grid must be a Grid, an object that has one"):
            deepct_py.carve(images, grid=wrong)
    with pytest.raises(deepct_py.DeepctError, match="none.nc: file: does not exist"):
        deepct_py.carve(images, grid="none.nc")


def test_a_network_is_taken_by_its_name_or_file(images, cloud, tmp_path):
    options = {"iterations": 1, "corrections": 1, "probes": 0}
    weights = tmp_path / "mine.safetensors"
    weights.write_bytes((CORE.parent / "weights/cloudct-10.safetensors").read_bytes())
    network = deepct_py.Network.load("cloudct-10")
    expected = deepct_py.hybrid(images, network=network, **options).extinction
    assert deepct_py.Network(weights).metadata == network.metadata
    for one in ("cloudct-10", weights, str(weights)):
        found = deepct_py.hybrid(images, network=one, **options).extinction
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(deepct_py.DeepctError, match="cloudct-11.*no such file.*cloudct-10"):
        deepct_py.hybrid(images, network="cloudct-11")


def test_files_are_fields_and_images(cloud, images, light, estimate, folder):
    names = {name: folder / f"{name}.nc" for name in ("cloud", "images", "estimate", "mask")}
    mask = deepct_py.read_mask(names["mask"])
    network = deepct_py.Network.load("cloudct-10")
    np.testing.assert_array_equal(
        network.infer(names["images"], mask=names["mask"]), network.infer(images, mask=mask)
    )
    options = {"views": "cloudct-10", "light": light, "samples": 2}
    assert deepct_py.render(str(names["cloud"]), **options) == deepct_py.render(cloud, **options)
    assert deepct_py.sense(names["images"]) == deepct_py.sense(images)
    found = deepct_py.carve(names["images"], grid=cloud)
    assert found == deepct_py.carve(images, grid=cloud)
    few = {"iterations": 1, "corrections": 1, "probes": 0}
    found = deepct_py.invert(
        names["images"], grid=names["cloud"], init=names["estimate"], mask=names["mask"], **few
    )
    again = deepct_py.invert(images, grid=cloud, init=estimate, mask=mask, **few)
    np.testing.assert_array_equal(found.extinction, again.extinction)
    with pytest.raises(deepct_py.DeepctError, match="none.nc: file: does not exist"):
        deepct_py.score("none.nc", estimate)
    with pytest.raises(TypeError, match='standard_error is "e.nc", the name of a file.*read_cloud'):
        deepct_py.carve(images.radiance, images.views, cloud, standard_error="e.nc")


def test_messages_name_arguments_of_python(cloud, tmp_path):
    dataset = cloud.to_xarray()
    large = dataset.assign(lwc=(1000.0 * dataset.lwc).assign_attrs(dataset.lwc.attrs))
    no_units = dataset.copy()
    no_units["lwc"] = dataset.lwc.drop_attrs(deep=False)
    with pytest.raises(deepct_py.DeepctError) as caught:
        deepct_py.Cloud.from_dataset(large)
    assert "`import_cloud(..., units=...)`" in str(caught.value)
    assert "allow_implausible=True of `import_cloud`" in str(caught.value)
    with pytest.raises(deepct_py.DeepctError, match=r'`import_cloud\(\.\.\., units=\{"lwc": "g m-3"\}'):
        deepct_py.Cloud.from_dataset(no_units)
    with pytest.warns(UserWarning, match="^the data set: liquid water content") as warned:
        deepct_py.import_cloud(large, allow_implausible=True)
    assert not any("/" in str(one.message) for one in warned)
    np.save(tmp_path / "plain.npy", np.full((4, 5, 6), 0.1))
    with pytest.raises(deepct_py.DeepctError) as caught:
        deepct_py.import_cloud(tmp_path / "plain.npy", variable="plain")
    assert 'such as axes="z,y,x", spacing=(0.05, 0.05, 0.04)' in str(caught.value)
    assert "--" not in str(caught.value)
    with pytest.raises(ValueError, match="^effective_variance is -0.1, but must be"):
        deepct_py.Light(phase="mie", effective_variance=-0.1)
    images = deepct_py.render(cloud, views="cloudct-10", samples=2).to_xarray()
    with pytest.raises(deepct_py.DeepctError, match="^the data set radiance: sun_zenith_deg: is"):
        deepct_py.sense(images.drop_vars("sun_zenith_deg"))


def test_options_in_messages_of_the_import_are_arguments_of_python():
    """Every option that a message of the import names becomes an argument with the same meaning."""
    files = sorted((CORE / "io/import").glob("*.rs"))
    code = [line for file in files for line in file.read_text().splitlines()
            if not line.lstrip().startswith("//")]
    options = {name for line in code for name in re.findall(r'[ "(`](--[a-z-]*[a-z])', line)}
    assert {"--units", "--axes", "--spacing", "--air-density"} <= options
    known = inspect.signature(deepct_py.import_cloud).parameters
    for option in options:
        assert in_python(f"give {option}").removeprefix("give ").split("=")[0] in known
    for text, expected in [
        ('--units ql="g kg-1" states', 'units={"ql": "g kg-1"} states'),
        ("--units x=m --units y=m.", 'units={"x": "m", "y": "m"}.'),
        ("with --spacing DX,DY,DZ (km)", "with spacing=(DX, DY, DZ) (km)"),
        ("; --base 0 cuts it", "; base=0 cuts it"),
        ("choose --time from 0 to 3", "choose time from 0 to 3"),
        ("see `deepct render --help`", "see `deepct render --help`"),
        ("--air-density FILE:VARIABLE", 'air_density="FILE:VARIABLE"'),
        ("a--b -- c", "a--b -- c"),
        ("optics.phase is bold", "phase is bold"),
        ("/data/optics.nc: lwc", "/data/optics.nc: lwc"),
        ("(`--max-memory`, by default half)", "(by default half)"),
    ]:
        assert in_python(text) == expected
