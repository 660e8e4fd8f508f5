"""Interruptions, forked processes, and arrays that cannot be used."""

import os
import signal
import threading
import time

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


@pytest.fixture
def keyboard():
    """The usual handler of Ctrl-C, which processes in the background lack."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("what", ["invert", "render"])
def test_ctrl_c_ends_a_computation(scene, what, keyboard):
    cloud, views, rendering = scene
    press = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT))
    press.start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        if what == "invert":
            settings = {"misfit": 0.0, "iterations": 10000, "change": 0.0}
            deepct.invert(rendering.radiance, views, GRID, rendering.light, **settings)
        else:
            deepct.render(cloud.extinction, GRID, views, samples_per_pixel=10_000_000)
    # One second on an idle machine.
    assert time.monotonic() - start < 5.0


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
    masked = np.ma.masked_greater(rendering.radiance, 0.05)
    for radiance, error, message in [
        (masked, ValueError, "masked"),
        (rendering.radiance > 0.05, TypeError, "bool"),
        (np.where(rendering.radiance > 0.05, np.nan, rendering.radiance), ValueError, "finite"),
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
    with pytest.raises(ValueError, match='has the units "m-1", but km-1 is expected'):
        deepct.render(metres, GRID, views, samples_per_pixel=2)
    downwards = own.assign_coords(z=-np.arange(float(len(extinction))))
    with pytest.raises(ValueError, match="along z that do not ascend"):
        deepct.score(downwards, extinction)
    mie = deepct.Light(phase="mie")
    radii = np.full(extinction.shape, 8e-6, np.float32)
    with pytest.raises(ValueError, match="from 0.1 to 100"):
        deepct.render(extinction, GRID, views, mie, effective_radius=radii, samples_per_pixel=2)


def test_lists_of_masked_arrays_are_refused(scene):
    extinction = scene[0].extinction
    parts = [np.ma.masked_greater(level, 1.0) for level in extinction]
    with pytest.raises(ValueError, match="masked"):
        deepct.score(extinction, parts)


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
        deepct.render(full, GRID, views, trilinear=True, samples_per_pixel=2)
    inner = np.zeros(GRID.shape, np.float32)
    inner[1:-1, 1:-1, 1:-1] = 1.0
    deepct.render(inner, GRID, views, trilinear=True, samples_per_pixel=2)
