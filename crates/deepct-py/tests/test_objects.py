"""What all objects can do, and what arguments may be."""

import copy
import multiprocessing
import pathlib
import pickle
import subprocess
import sys

import numpy as np
import pytest

import deepct_py
from deepct_py import Grid, Light, Observation, View, Views


@pytest.fixture(scope="module")
def objects():
    """Pairs of equal objects of every class, and an object of the same class that differs."""
    grid = Grid((4, 8, 8), (0.05, 0.05, 0.04), (0.1, 0.2, 1 / 3))
    views = Views.load("cloudct-10", grid.center, (8, 8))
    cloud = deepct_py.Cloud(
        grid, liquid_water_content=np.full(grid.shape, 0.1),
        effective_radius=np.full(grid.shape, 8.0),
    )
    light = Light(sun=(33.3, 120.1), wind_speed=3, assumed=["air"])
    rendering = deepct_py.render(cloud, views=views, light=light, samples=4)
    noisy = deepct_py.sense(rendering)
    carved = deepct_py.Carved(grid, rendering.radiance[:4] > 0.01, [0.01])
    network = deepct_py.Network.load("cloudct-10")
    inverted = deepct_py.invert(
        rendering.replace(light=Light()), grid=grid, truth=cloud, iterations=1, coarse=[],
        corrections=1, mask=np.ones(grid.shape, int), probes=0,
    )
    estimate = deepct_py.Estimate(grid, cloud.extinction, 0.1 * cloud.extinction, light,
                                  effective_radius=cloud.effective_radius)
    looking_up = View.orthographic(130.7, 33.3, grid.center, 0.05, looks_up=True)
    pairs = [
        (grid, Grid((4, 8, 8), (0.05, 0.05, 0.04))),
        (cloud, deepct_py.Cloud(grid, extinction=cloud.extinction)),
        (light, light.replace(air=True)),
        (deepct_py.Lineage(time=3, units="s", history="a"), deepct_py.Lineage(history="a")),
        (views[0], views[0].part((1, 2), (3, 4))),
        (looking_up, View.orthographic(30.7, 33.3, grid.center, 0.05)),
        (views, views[:3]),
        (Observation(rendering.radiance, views), Observation(2 * rendering.radiance, views)),
        (rendering, rendering.replace()),
        (noisy, deepct_py.sense(rendering, seed=2)),
        (deepct_py.sense(rendering.radiance), deepct_py.sense(rendering.radiance, seed=2)),
        (carved, deepct_py.Carved(grid, carved.mask)),
        (estimate, deepct_py.Estimate(grid, cloud.extinction)),
        (inverted, deepct_py.Reconstruction(
            grid, inverted.extinction, inverted.mask, [], inverted.ending, inverted.light)),
        (network, deepct_py.Network.load("general")),
        (deepct_py.score(cloud, estimate), deepct_py.score(cloud, 0.5 * cloud.extinction)),
        (deepct_py.Sensor.preset("cmv4000"), deepct_py.Sensor(
            full_well=1e4, read_noise=1, dark_current=0, bits=12, exposure=1e-3, pixel_pitch=5)),
        (deepct_py.Renderer(grid, views, light, accuracy=0.05),
         deepct_py.Renderer(grid, views, light, accuracy=0.05, tolerance=1e-4)),
        (deepct_py.plot(cloud), deepct_py.plot(cloud, title="another")),
        (deepct_py.view(cloud), deepct_py.view(cloud, title="another")),
    ]
    classes = {type(one) for one, _ in pairs}
    public = {getattr(deepct_py, name) for name in deepct_py.__all__}
    assert classes == {one for one in public if isinstance(one, type)} - {deepct_py.DeepctError}
    return pairs


def test_objects_are_pickled_and_copied(objects):
    for one, other in objects:
        for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
            assert pickle.loads(pickle.dumps(one, protocol)) == one
        for same in (copy.copy(one), copy.deepcopy(one)):
            assert same == one and type(same) is type(one)
            assert hash(same) == hash(one)
        assert one != other and one != 1 and not one == "text"


def test_a_deep_copy_has_arrays_of_its_own(objects):
    cloud = objects[1][1]
    other = copy.deepcopy(cloud)
    other.extinction[0, 0, 0] += 1.0
    assert other != cloud


def test_objects_are_keys(objects):
    table = {one: name for name, (one, _) in enumerate(objects)}
    for name, (one, other) in enumerate(objects):
        assert table[copy.copy(one)] == name and other not in table
    views = Views.load("cloudct-10", (0, 0, 1))
    assert len({hash(views[:count]) for count in range(1, 11)}) == 10


def test_a_subclass_is_a_class_of_its_own(views):
    class Named(Observation):
        pass

    radiance = np.full((10, 16, 16), 0.1)
    assert Named(radiance, views) == Named(radiance, views) != Observation(radiance, views)


def test_objects_are_shown(objects):
    for one, _ in objects:
        name = type(one).__name__
        assert repr(one).startswith(f"{name}(")
        assert len(repr(one)) < 6000
        if name not in ("Figure", "Page"):
            html = one._repr_html_()
            assert f"deepct_py.{name}" in html and html.count("<tr>") == html.count("</tr>") > 0
            assert "<float32" not in html
    # Objects without arrays are the call that makes them.
    names = vars(deepct_py)
    for one, _ in objects:
        if "<" not in repr(one):
            assert eval(repr(one), dict(names)) == one
    assert "extinction=<float32 [4, 8, 8], 1" in repr(objects[1][0])


def test_a_network_of_a_file_is_pickled_without_the_file(tmp_path):
    weights = pathlib.Path(__file__).parents[2] / "deepct-core/weights/cloudct-10.safetensors"
    path = tmp_path / "weights.safetensors"
    path.write_bytes(weights.read_bytes())
    network = deepct_py.Network.load(path)
    contents = pickle.dumps(network)
    path.unlink()
    assert pickle.loads(contents) == network
    assert network.metadata == deepct_py.Network.load("cloudct-10").metadata


def _epsilon(parts):
    network, images, cloud = parts
    return deepct_py.score(cloud, network.estimate(images)).relative_error


def test_objects_go_to_spawned_processes():
    cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
    images = deepct_py.render(cloud, views="cloudct-10", samples=2)
    parts = (deepct_py.Network.load("cloudct-10"), images, cloud)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (found,) = pool.map(_epsilon, [parts])
    assert found == _epsilon(parts)


def test_views_are_a_sequence_with_slices(grid):
    views = Views.load("cloudct-10", grid.center)
    assert len(views[2:5]) == 3 and views[::-1][0] == views[-1] and views[:] == views
    assert views[:3] + views[3:] == views and list(views[:2]) + views[2:] == views
    assert views[:2] + [views[5]] == Views([views[0], views[1], views[5]])
    assert views[np.int64(3)] == views[3]
    with pytest.raises(ValueError, match="number of views"):
        views[3:3]
    with pytest.raises(IndexError):
        views[-11]
    with pytest.raises(TypeError):
        views["north"]
    np.testing.assert_array_equal(views.position, [view.position for view in views])
    np.testing.assert_array_equal(views.direction, [view.direction for view in views])
    np.testing.assert_array_equal(views.target, np.tile(grid.center, (10, 1)))
    offset = views.position - views.target
    np.testing.assert_allclose(
        views.direction, offset / np.linalg.norm(offset, axis=1)[:, None], atol=1e-12
    )
    assert views.size == [(32, 32)] * 10
    parallel = View.orthographic(30.0, 90.0, grid.center, 0.05)
    assert np.isnan(Views([parallel]).position).all() and parallel.pixel_tangent is None
    np.testing.assert_allclose(parallel.direction, (0.5, 0.0, np.sqrt(0.75)), atol=1e-12)


def test_numbers_may_be_of_any_kind():
    expected = Grid((4, 5, 6), (0.05, 0.05, 0.04), (1.0, 2.0, 3.0))
    for kind in (list, np.array, tuple):
        assert Grid(kind([4, 5, 6]), kind([0.05, 0.05, 0.04]), kind([1, 2, 3])) == expected
    single = Grid((4, 5, 6), np.array([0.5, 0.25, 2], np.float32))
    assert single.spacing == (0.5, 0.25, 2.0)
    view = View.perspective((0.0, -300.0, 520.0), (0.0, 0.0, 1.0), 1e-4, (16, 24))
    for kind in (list, np.array):
        same = View.perspective(
            kind([0, -300, 520]), kind([0, 0, 1]), np.float64(1e-4), size=kind([16, 24])
        )
        assert same == view and same.project(kind([0, 0, 1])) == view.project((0, 0, 1))
    assert Light(sun=(40, 120)) == Light(sun_zenith_deg=40.0, sun_azimuth_deg=np.float32(120.0))
    assert Light(sun=np.array([40, 120])).sun == pytest.approx((40.0, 120.0))
    assert deepct_py.camera_from_ecef([5060.7, 3417.3, 3364.0], 32, 35) == pytest.approx(
        deepct_py.camera_from_ecef((5060.7, 3417.3, 3364.0), 32.0, 35.0))


def test_numbers_out_of_range_are_named(grid, extinction, views):
    render = lambda **wrong: deepct_py.render(extinction, grid, views, **wrong)  # noqa: E731
    for error, message, wrong in [
        (ValueError, r"shape \(z\) is -4", lambda: Grid((-4, 5, 6), (1, 1, 1))),
        (TypeError, r"shape \(y\) is 5.5", lambda: Grid((4, 5.5, 6), (1, 1, 1))),
        (ValueError, "spacing has 2 values, but must have 3", lambda: Grid((4, 5, 6), (1, 1))),
        (TypeError, "spacing is 0.05", lambda: Grid((4, 5, 6), 0.05)),
        (TypeError, r"origin \(x\) is west", lambda: Grid((4, 5, 6), (1, 1, 1), ("west", 0, 0))),
        (ValueError, r"size \(rows\) is -1",
         lambda: View.perspective((0, 0, 600), (0, 0, 1), 1e-4, (-1, 4))),
        (ValueError, "samples is -1", lambda: render(samples=-1)),
        (ValueError, "samples is 4294967296, but must be from 0 to 4294967295",
         lambda: render(samples=2**32)),
        (ValueError, "seed is -1", lambda: render(seed=-1)),
        (ValueError, "similarity_after is -2", lambda: render(similarity_after=-2)),
        (TypeError, "samples is 2.5", lambda: render(samples=2.5)),
        (ValueError, "samples", lambda: render(samples=4, solver="ordinates")),
        (ValueError, "seed is -3", lambda: deepct_py.generate_cloud(seed=-3)),
        (ValueError, "seed is -3", lambda: deepct_py.sense(np.ones((1, 4, 4)), seed=-3)),
        (ValueError, "first is", lambda: Views.string_of_pearls((0, 0, 1), first=-(2**40))),
        (TypeError, "either sun or sun_zenith_deg", lambda: Light(sun=(1, 2), sun_zenith_deg=3)),
        (TypeError, "position and pixel_tangent", lambda: View(target=(0, 0, 1))),
        (TypeError, "liquid_water_content and", lambda: deepct_py.Cloud(grid)),
        (ValueError, "count is 0", lambda: deepct_py.set_threads(0)),
        (ValueError, "count is -1", lambda: deepct_py.set_threads(-1)),
        (TypeError, "views is missing", lambda: deepct_py.render(extinction, grid)),
    ]:
        with pytest.raises(error, match=message):
            wrong()


def test_progress_is_reported(grid, extinction, views, capfd):
    rendered, steps = [], []
    images = deepct_py.render(extinction, grid, views, noise=0.05, progress=rendered.append)
    assert rendered and all(0.0 <= status["share"] <= 1.0 for status in rendered)
    assert rendered[-1]["samples"] <= images.samples_per_pixel
    options = {"grid": grid, "iterations": 2, "coarse": [], "corrections": 1, "probes": 0}
    result = deepct_py.invert(images, progress=steps.append, **options)
    assert steps == result.history
    deepct_py.invert(images, progress=True, **options)
    error = capfd.readouterr().err
    assert error.startswith("\rstep 0, blocks of 1, misfit") and error.endswith("\n")
    assert "step 2" in error.splitlines()[-1]

    def stop(status):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        deepct_py.invert(images, progress=stop, **options)
    with pytest.raises(TypeError, match="progress must be"):
        deepct_py.invert(images, progress=3, **options)


def test_the_number_of_threads_can_be_set():
    """Counted by the kernel."""
    program = """if True:
        import os, threading, time, numpy, deepct_py
        grid = deepct_py.Grid((8, 16, 16), (0.05, 0.05, 0.04))
        before = len(os.listdir("/proc/self/task"))
        counts = []
        for count in (3, 1):
            deepct_py.set_threads(count)
            seen = set()
            deepct_py.render(numpy.ones(grid.shape), grid, "cloudct-10", samples=2000,
                progress=lambda status: seen.add(len(os.listdir("/proc/self/task")) - before))
            counts.append(max(seen))
            time.sleep(0.2)
        print(*counts)
    """
    if sys.platform != "linux":
        pytest.skip("threads are counted in /proc")
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["3", "1"]
