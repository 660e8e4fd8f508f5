"""Interruptions, forked processes, and arrays that cannot be used."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings

import deepct_py as deepct
import numpy as np
import pytest
import xarray

GRID = deepct.Grid((16, 16, 16), (0.05, 0.05, 0.04), (-0.4, -0.4, 0.5))


@pytest.fixture(scope="module")
def scene():
    cloud = deepct.generate_cloud(GRID, seed=3, width_km=0.5)
    views = deepct.Views.load("cloudct-10", GRID.center, (16, 16))
    rendering = deepct.render(cloud.extinction, GRID, views, solver="ordinates", accuracy=0.05)
    return cloud, views, rendering


LONG = """
import threading, os, signal, time
import deepct_py as deepct
import numpy as np
grid = deepct.Grid((16, 16, 16), (0.05, 0.05, 0.04), (-0.4, -0.4, 0.5))
cloud = deepct.generate_cloud(grid, seed=3, width_km=0.5)
views = deepct.Views.load("cloudct-10", grid.center, (16, 16))
images = deepct.render(cloud.extinction, grid, views, solver="ordinates", accuracy=0.05)
signal.signal(signal.SIGINT, signal.default_int_handler)

def press():
    global pressed
    pressed = time.monotonic()
    os.kill(os.getpid(), signal.SIGINT)

threading.Timer(0.5, press).start()
try:
    {call}
    print("was not interrupted")
except KeyboardInterrupt:
    print(time.monotonic() - pressed)
os._exit(0)
"""


@pytest.mark.parametrize(
    "call",
    [
        "deepct.invert(images.radiance, views, grid, images.light, misfit=0.0, change=0.0)",
        "deepct.render(cloud.extinction, grid, views, samples=10_000_000)",
        "deepct.render(cloud.extinction, grid, views, solver='ordinates', accuracy=0.004)",
        "[deepct.Renderer(grid, views, images.light).images(cloud) for _ in range(100)]",
        "deepct.generate_cloud(deepct.Grid((60, 800, 800), (0.05, 0.05, 0.04), (0.0, 0.0, 0.48)), "
        "kind='field')",
        "deepct.sense(np.broadcast_to(np.float32(1.0), (24, 1024, 1024)))",
        "deepct.carve(images.radiance, views, deepct.Grid((600, 600, 600), (1e-3, 1e-3, 1e-3), "
        "(-0.3, -0.3, 0.5)))",
    ],
)
def test_ctrl_c_ends_a_computation(call):
    """In a process of its own, as a computation may go on in the background."""
    script = LONG.replace("{call}", call)
    command = [sys.executable, "-c", script]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    # A tenth of a second on an idle machine.
    assert float(run.stdout) < 5.0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_computes(scene):
    cloud, views, rendering = scene
    child = os.fork()
    if child == 0:
        again = deepct.render(cloud.extinction, GRID, views, solver="ordinates", accuracy=0.05)
        os._exit(0 if np.array_equal(again.radiance, rendering.radiance) else 1)
    for _ in range(600):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            assert os.waitstatus_to_exitcode(status) == 0
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    pytest.fail("the child does not end")


def test_many_threads_use_one_network(scene):
    _, views, rendering = scene
    network = deepct.Network.load("cloudct-10")
    views = deepct.Views.load("cloudct-10", network.grid(views).center, (16, 16))
    expected = network.infer(rendering.radiance, views, rendering.light)
    results = []

    def infer():
        results.append(network.infer(rendering.radiance, views, rendering.light))

    threads = [threading.Thread(target=infer) for _ in range(64)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 64
    assert all(np.array_equal(result, expected) for result in results)


class OnlyDLPack:
    """An array of a library without the array interface of NumPy."""

    def __init__(self, array):
        self.__dlpack__, self.__dlpack_device__ = array.__dlpack__, array.__dlpack_device__


def test_arrays_that_cannot_be_used_are_refused(scene):
    cloud, views, rendering = scene
    network = deepct.Network.load("cloudct-10")
    for radiance, error, message in [
        (rendering.radiance > 0.05, TypeError, "bool"),
        (np.where(rendering.radiance > 0.05, np.inf, rendering.radiance), ValueError, "finite"),
        (np.full_like(rendering.radiance, np.nan), ValueError, "weights of one formation need all images"),
        (rendering.radiance.astype(complex), TypeError, "complex"),
        (np.zeros((10, 0, 0)), ValueError, "at least 1"),
        (OnlyDLPack(rendering.radiance), TypeError, r"numpy\.from_dlpack\(radiance\)"),
    ]:
        with pytest.raises(error, match=message):
            network.infer(radiance, views, rendering.light)
    # Nothing is masked here.
    network_views = deepct.Views.load("cloudct-10", network.grid(views).center, (16, 16))
    network.infer(np.ma.array(rendering.radiance), network_views, rendering.light)
    mie = deepct.Light(phase="mie")
    for radius in (0.0, np.nan, -1.0):
        radii = np.full(GRID.shape, radius, np.float32)
        with pytest.raises(ValueError, match="effective radius"):
            deepct.render(cloud.extinction, GRID, views, mie, effective_radius=radii)
    with pytest.raises(ValueError, match="standard error"):
        negative = -np.ones_like(rendering.radiance)
        deepct.invert(
            rendering.radiance, views, GRID, rendering.light, standard_error=negative, iterations=1
        )
    far = deepct.Grid((4, 4, 4), (0.05, 0.05, 0.04), (50.0, 50.0, 0.48))
    with pytest.raises(ValueError, match="no image shows"):
        deepct.invert(rendering.radiance, views, far, rendering.light, iterations=1)


def test_coordinates_that_contradict_the_grid_or_each_other_are_refused(scene):
    cloud, views, rendering = scene
    grid = {"z": GRID.z, "y": GRID.y, "x": GRID.x}

    def array(values, coordinates, units=None):
        array = xarray.DataArray(values, dims=list(coordinates), coords=coordinates)
        for axis in array.coords.values() if units else ():
            axis.attrs["units"] = units
        return array

    def moved(axis, by=0.05):
        return {**grid, axis: grid[axis] + by}

    truth = array(cloud.extinction, grid)
    assert deepct.score(truth, array(cloud.extinction, grid)).relative_error == 0.0
    metres = {axis: 1e3 * values for axis, values in grid.items()}
    assert deepct.score(truth, array(cloud.extinction, metres, "m")).relative_error == 0.0
    with pytest.raises(ValueError, match="estimate is on another grid"):
        deepct.score(truth, array(cloud.extinction, moved("x")))
    settings = {"solver": "ordinates", "accuracy": 0.1}
    for coordinates in (grid, {axis: np.arange(16.0) for axis in grid}):
        deepct.render(array(cloud.extinction, coordinates), GRID, views, **settings)
    for axis in grid:
        with pytest.raises(ValueError, match="extinction is on another grid"):
            deepct.render(array(cloud.extinction, moved(axis)), GRID, views, **settings)
    images = {"view": np.arange(10), "row": np.arange(16), "col": np.arange(16)}
    radiance = array(rendering.radiance, images)
    light = rendering.light
    volumes = {"init": cloud.extinction, "truth": cloud.extinction, "mask": cloud.extinction > 0.0}
    for name, values in volumes.items():
        with pytest.raises(ValueError, match=f"{name} is on another grid"):
            deepct.invert(radiance, views, GRID, light, **{name: array(values, moved("z"))})
    error = array(0.01 * rendering.radiance, {**images, "row": np.arange(16) + 8})
    with pytest.raises(ValueError, match="standard_error has coordinates along row"):
        deepct.invert(radiance, views, GRID, light, standard_error=error)
    with pytest.raises(ValueError, match="standard_error has coordinates along row"):
        deepct.sense(radiance, standard_error=error)
    with pytest.raises(ValueError, match="standard_error has coordinates along row"):
        deepct.carve(radiance, views, GRID, standard_error=error)


def test_sizes_above_the_memory_are_refused():
    with pytest.raises(ValueError, match="memory|voxels"):
        deepct.Grid((2**20, 2**11, 1), (0.05, 0.05, 0.04), (0.0, 0.0, 0.0)).x
    with pytest.raises(ValueError, match="memory"):
        deepct.View.perspective((0, 0, 600), (0, 0, 1), 1e-4, (2**40, 2**40))


def test_units_of_arrays_are_those_of_the_argument(scene):
    cloud, views, _ = scene
    extinction = cloud.extinction
    axes = ("z", "y", "x")
    own = xarray.DataArray(extinction, dims=axes, attrs={"units": "km-1"})
    assert deepct.score(own, extinction).relative_error == 0.0
    metres = xarray.DataArray(extinction / 1000.0, dims=axes, attrs={"units": "m-1"})
    assert deepct.score(extinction, metres).relative_error < 1e-6
    for units in ("g m-3", "sr-1", "apples"):
        with pytest.raises(ValueError, match=f'has the units "{units}", but km-1 is expected'):
            deepct.render(own.assign_attrs(units=units), GRID, views, samples=2)
    images = xarray.DataArray(
        np.full((10, 16, 16), 300.0), dims=("view", "row", "col"),
        attrs={"units": "W m-2 sr-1 um-1"},
    )
    with pytest.raises(ValueError, match='has the units "W m-2 sr-1 um-1", but sr-1'):
        deepct.Observation(images, views)
    stated = deepct.Observation(images, views, deepct.Light(solar_irradiance=1530.0))
    assert stated.radiance.max() == 300.0
    downwards = own.assign_coords(z=-np.arange(float(len(extinction))))
    assert deepct.score(downwards, extinction[::-1]).relative_error == 0.0
    shuffled = own.assign_coords(z=np.arange(float(len(extinction))) % 5)
    with pytest.raises(ValueError, match="along z that do not ascend"):
        deepct.score(shuffled, extinction)
    mie = deepct.Light(phase="mie")
    radii = np.full(extinction.shape, 8e-6, np.float32)
    with pytest.raises(ValueError, match="from 0.1 to 100"):
        deepct.render(extinction, GRID, views, mie, effective_radius=radii, samples=2)


def test_lists_of_masked_arrays_are_refused(scene):
    extinction = scene[0].extinction
    parts = [np.ma.masked_greater(level, 1.0) for level in extinction]
    with pytest.raises(ValueError, match="masked"):
        deepct.score(extinction, parts)


@pytest.fixture(scope="module")
def sensed():
    """A cloud and its images by ten cameras with the noise of a sensor."""
    cloud = deepct.generate_cloud(seed=2)
    light = deepct.Light(air=True, phase="mie", effective_radius=10.0)
    views = deepct.Views.load("cloudct-10", (*cloud.grid.center[:2], 1.12))
    images = deepct.render(cloud.extinction, cloud.grid, views, light, solver="ordinates", accuracy=0.05)
    return cloud, deepct.sense(images, "cmv4000")


def without(images, missing):
    return images.replace(radiance=np.where(missing, np.nan, images.radiance))


def test_missing_pixels_have_many_forms(sensed, tmp_path):
    images = sensed[1]
    missing = np.random.default_rng(1).random(images.radiance.shape) < 0.05
    expected = without(images, missing)
    assert np.array_equal(np.isnan(expected.radiance), missing)
    assert np.array_equal(np.isinf(expected.standard_error), missing)
    errors = np.where(missing, np.inf, images.standard_error)
    masked = np.ma.array(images.radiance, mask=missing)
    parts = [np.ma.array(image, mask=mask) for image, mask in zip(images.radiance, missing)]
    for other in ({"standard_error": errors}, {"radiance": masked}, {"radiance": parts}):
        assert images.replace(**other) == expected
    expected.to_netcdf(tmp_path / "images.nc")
    read = deepct.read_images(tmp_path / "images.nc")
    assert np.array_equal(read.radiance, expected.radiance, equal_nan=True)
    again = deepct.sense(deepct.Observation(np.maximum(expected.radiance, 0), images.views), "cmv4000")
    assert np.array_equal(np.isnan(again.radiance), missing)


def test_networks_interpolate_missing_pixels(sensed):
    cloud, images = sensed
    truth = cloud.extinction
    random = np.random.default_rng(2)
    for name in ("general", "cloudct-10"):
        network = deepct.Network.load(name)
        epsilon = {}
        for share in (0.0, 0.01, 0.05):
            missing = random.random(images.radiance.shape) < share
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                estimate = network.infer(without(images, missing), grid=cloud.grid)
            epsilon[share] = deepct.score(truth, estimate).relative_error
        assert max(epsilon.values()) < min(epsilon.values()) + 0.03, epsilon
        corner = np.zeros(images.radiance.shape, bool)
        corner[:, :8, :8] = True
        with pytest.warns(UserWarning, match="missing pixels in wide gaps, which are interpolated, is 0.035"):
            network.infer(without(images, corner), grid=cloud.grid)


def test_a_view_without_pixels_is_left_out(sensed):
    cloud, images = sensed
    missing = np.zeros(images.radiance.shape, bool)
    missing[4] = True
    views = [number for number in range(10) if number != 4]
    nine = deepct.Observation(
        images.radiance[views],
        [images.views[view] for view in views],
        images.light,
        standard_error=images.standard_error[views],
        saturated=images.saturated[views],
    )
    general = deepct.Network.load("general")
    left = general.infer(without(images, missing), grid=cloud.grid)
    assert np.array_equal(left, general.infer(nine, grid=cloud.grid))
    assert np.array_equal(
        deepct.carve(without(images, missing), grid=cloud.grid).mask, deepct.carve(nine, grid=cloud.grid).mask
    )
    with pytest.raises(ValueError, match="missing in view 4"):
        deepct.Network.load("cloudct-10").infer(without(images, missing))


def test_missing_pixels_neither_carve_nor_invert(sensed):
    cloud, images = sensed
    missing = np.random.default_rng(3).random(images.radiance.shape) < 0.2
    some = without(images, missing)
    carved, whole = deepct.carve(some, grid=cloud.grid), deepct.carve(images, grid=cloud.grid)
    cloudy = cloud.extinction > 0.0
    assert (cloudy & ~carved.mask).sum() <= (cloudy & ~whole.mask).sum()
    assert whole.mask.sum() < carved.mask.sum() < 3 * whole.mask.sum()
    # What the missing pixels would show does not matter.
    strange = images.replace(
        radiance=np.where(missing, 0.5, images.radiance), standard_error=np.where(missing, np.inf, 1e-3)
    )
    known = some.replace(standard_error=np.full(missing.shape, 1e-3))
    options = {"iterations": 1, "corrections": 1, "coarse": []}
    answers = [deepct.invert(each, grid=cloud.grid, mask=carved, **options).extinction for each in (strange, known)]
    assert np.array_equal(*answers) and answers[0].max() > 0.0


def test_images_of_different_sizes(sensed):
    cloud, images = sensed
    sizes = [(32 - 2 * (view % 3), 32 - view % 4) for view in range(10)]
    first = [((32 - rows) // 2, (32 - cols) // 2) for rows, cols in sizes]
    parts = [
        image[row : row + size[0], col : col + size[1]]
        for image, (row, col), size in zip(images.radiance, first, sizes)
    ]
    views = [view.part(place, size) for view, place, size in zip(images.views, first, sizes)]
    ragged = deepct.Observation(parts, views, images.light)
    assert ragged.radiance.shape == (10, 32, 32)
    for part, (row, col), size, image in zip(parts, first, sizes, ragged.radiance):
        assert np.array_equal(part, image[row : row + size[0], col : col + size[1]])
    assert np.isfinite(ragged.radiance).sum() == sum(part.size for part in parts)
    for view, whole in zip(ragged.views, images.views):
        np.testing.assert_allclose(view.ray(3.0, 5.0)[1], whole.ray(3.0, 5.0)[1], atol=1e-9)
    network = deepct.Network.load("general")
    complete = network.infer(images, grid=cloud.grid)
    difference = np.abs(network.infer(ragged, grid=cloud.grid) - complete).sum() / complete.sum()
    assert 0.0 < difference < 0.2, difference
    carved = deepct.carve(ragged, grid=cloud.grid)
    assert (cloud.extinction * ~carved.mask).sum() < 0.02 * cloud.extinction.sum()
    solved = deepct.hybrid(ragged, network=network, grid=cloud.grid, iterations=1, corrections=1)
    assert deepct.score(cloud.extinction, solved).relative_error < 0.7
    with pytest.raises(ValueError, match="image size"):
        deepct.Observation(parts, images.views[:9] + [images.views[9].part((0, 0), (5, 5))], images.light)


def test_voxels_that_are_too_thick_are_told(scene):
    _, views, _ = scene
    grid = deepct.Grid((2, 2, 2), (0.05, 0.05, 0.04), (-0.05, -0.05, 0.5))
    thick = np.full(grid.shape, 1000.0, np.float32)
    with pytest.warns(UserWarning, match="voxels are too thick"):
        deepct.render(thick, grid, views, solver="ordinates", accuracy=0.05)


def test_a_trilinear_medium_is_surrounded_by_clear_voxels(scene):
    _, views, _ = scene
    full = np.ones(GRID.shape, np.float32)
    with pytest.raises(ValueError, match="surround it by clear voxels"):
        deepct.render(full, GRID, views, trilinear=True, samples=2)
    inner = np.zeros(GRID.shape, np.float32)
    inner[1:-1, 1:-1, 1:-1] = 1.0
    deepct.render(inner, GRID, views, trilinear=True, samples=2)


def as_lines(view, altitude=0.0):
    """A view with the lines of sight of another."""
    rows, cols = view.size
    rays = [[view.ray(row + 0.5, col + 0.5) for col in range(cols)] for row in range(rows)]
    origins, directions = np.moveaxis(np.array(rays), 2, 0)
    points = origins + directions * ((altitude - origins[..., 2:]) / directions[..., 2:])
    return deepct.View.lines_of_sight(points, -directions, view.target)


def test_a_camera_by_its_lines_of_sight(sensed, tmp_path):
    cloud, images = sensed
    views = deepct.Views([as_lines(view) for view in images.views])
    seen = images.replace(views=views)
    for view, camera in zip(views, images.views):
        assert view.position is None and view.points.shape == view.directions.shape == (32, 32, 3)
        assert abs(view.zenith_deg - camera.zenith_deg) < 1e-4
        assert pickle.loads(pickle.dumps(view)) == view
    # The number of rays per pixel depends on the size of its pixels, which is that of these.
    # Beside the target, none is in a face of the voxels.
    target = (0.8031, 0.8077, 1.12)
    parallel = [deepct.View.orthographic(v.zenith_deg, v.azimuth_deg, target, 0.06) for v in images.views]
    options = {"solver": "ordinates", "accuracy": 0.05, "estimate_error": False}
    rendered, expected = (
        deepct.render(cloud.extinction, cloud.grid, each, images.light, **options).radiance
        for each in ([as_lines(view) for view in parallel], parallel)
    )
    np.testing.assert_allclose(rendered, expected, rtol=1e-4)
    sampled, expected = (
        deepct.render(cloud.extinction, cloud.grid, each, images.light, samples=16, seed=3)
        for each in (views, images.views)
    )
    error = np.hypot(sampled.standard_error, expected.standard_error)
    assert (np.abs(sampled.radiance - expected.radiance) < 6.0 * error + 1e-6).mean() > 0.99
    masks = [deepct.carve(each, grid=cloud.grid).mask for each in (seen, images)]
    assert (masks[0] ^ masks[1]).sum() < 0.005 * masks[1].sum()
    network = deepct.Network.load("general")
    answers = [network.infer(each, grid=cloud.grid) for each in (seen, images)]
    errors = [deepct.score(cloud.extinction, answer).relative_error for answer in answers]
    assert abs(errors[0] - errors[1]) < 0.05, errors
    seen.to_netcdf(tmp_path / "lines.nc")
    read = deepct.read_images(tmp_path / "lines.nc")
    for view, other in zip(read.views, views):
        np.testing.assert_allclose(view.points, other.points, atol=1e-9)
        np.testing.assert_allclose(view.target, other.target, atol=1e-9)
    with pytest.raises(ValueError, match="give such images"):
        deepct.Network.load("cloudct-10").infer(seen)


def test_a_scanner(sensed, tmp_path):
    """Perspective across its track and parallel along it, from aircraft at an altitude of 20 km."""
    cloud, images = sensed
    light = images.light
    x, y = (0.05 * (np.arange(48) - 8.0) + 0.025 for _ in range(2))
    views = []
    for angle in np.radians([-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0]):
        points = np.stack([*np.meshgrid(x, y), np.full((48, 48), 1.0)], axis=-1)
        aircraft = np.stack([np.full(48, 0.8), y + 19.0 * np.tan(angle), np.full(48, 20.0)], axis=-1)
        views.append(deepct.View.lines_of_sight(points, aircraft[:, None] - points))
    rendered = deepct.render(cloud.extinction, cloud.grid, views, light, solver="ordinates", accuracy=0.05)
    noisy = deepct.sense(rendered, "cmv4000")
    carved = deepct.carve(noisy, grid=cloud.grid)
    lost = (cloud.extinction * ~carved.mask).sum() / cloud.extinction.sum()
    assert lost < 0.02 and carved.mask.mean() < 0.2, (lost, carved.mask.mean())
    solved = deepct.invert(noisy, grid=cloud.grid, mask=carved, init="auto", iterations=6, corrections=1)
    assert deepct.score(cloud.extinction, solved).relative_error < 0.8
    noisy.to_netcdf(tmp_path / "scanner.nc")
    again = deepct.carve(deepct.read_images(tmp_path / "scanner.nc"), grid=cloud.grid).mask
    assert (again ^ carved.mask).sum() < 0.002 * carved.mask.sum()
    with pytest.raises(ValueError, match="within 2 degrees for a network"):
        deepct.Network.load("general").infer(noisy)
