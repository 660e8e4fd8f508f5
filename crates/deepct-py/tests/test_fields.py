"""Fields that are larger than the memory, estimated as dask arrays."""

import os
import signal
import time

import numpy as np
import pytest

import deepct_py

xarray = pytest.importorskip("xarray")
pytest.importorskip("dask.array")

ROWS, COLS = 24, 150
LINEAGE = deepct_py.Lineage(
    time=3.5, units="hours since 2004-07-01", calendar="standard", history="sense images.nc"
)


@pytest.fixture(scope="module")
def observation():
    """A row of clouds, six columns in every twenty, seen by four parallel cameras."""
    target = (0.025 * COLS, 0.025 * ROWS, 1.0)
    angles = [(0, 0), (35, 80), (35, 260), (20, 170)]
    views = [deepct_py.View.orthographic(*angle, target, 0.05, (ROWS, COLS)) for angle in angles]
    view, row, col = np.indices((len(views), ROWS, COLS))
    cloudy = (row >= 9) & (row < 15) & ((col + view) % 20 < 6)
    radiance = np.where(cloudy, 0.15 + 0.01 * ((col // 20) % 5), 0.02)
    return deepct_py.Observation(radiance, views, deepct_py.Light(), lineage=LINEAGE)


@pytest.fixture(scope="module")
def file(observation, tmp_path_factory):
    path = tmp_path_factory.mktemp("fields") / "images.nc"
    observation.to_netcdf(path)
    return path


@pytest.fixture(scope="module")
def whole(observation):
    return deepct_py.Network.load().estimate(observation)


def check(field, whole):
    largest = whole.extinction.max()
    assert largest > 1.0
    np.testing.assert_allclose(field.extinction, whole.extinction, atol=1e-4 * largest)
    np.testing.assert_allclose(field.x, whole.grid.x)
    assert field.extinction.dims == ("z", "y", "x") and field.extinction.units == "km-1"


def test_a_field_is_computed_when_it_is_needed(file, whole):
    with xarray.open_dataset(file, chunks={"row": 16, "col": 40}) as images:
        field = deepct_py.infer(images, side=64)
        assert field.extinction.chunks == ((32,), (24,), (64, 64, 22))
        check(field, whole)
        assert set(field) == {"extinction", "uncertainty"}
        field.isel(x=slice(0, 8)).to_netcdf(file.with_name("field.nc"))
        lineage = deepct_py.read_volume(file.with_name("field.nc")).lineage
        assert lineage == LINEAGE.then("infer")
        assert lineage.history == f"deepct {deepct_py.__version__}: infer\nsense images.nc"
        part = field.extinction[:, 3:9, 70:80].compute()
        np.testing.assert_array_equal(part, field.extinction.compute()[:, 3:9, 70:80])


def test_images_in_memory_have_the_estimate_of_the_network(file, whole, observation):
    assert deepct_py.infer(observation) == whole
    network = deepct_py.Network.load()
    mask = deepct_py.carve(observation, grid=whole.grid)
    expected = network.estimate(observation, mask=mask)
    assert deepct_py.infer(observation, network, carve=True) == expected
    assert deepct_py.infer(observation, grid=whole, carve=True) == expected
    for wrong in (file, observation.radiance):
        with pytest.raises(TypeError, match=r"xarray.open_dataset\(path\).*deepct_py.read_images\(path\)"):
            deepct_py.infer(wrong)


def test_rows_from_the_north_and_bare_pixels(file, whole):
    with xarray.open_dataset(file, chunks={}) as images:
        check(deepct_py.infer(images.isel(row=slice(None, None, -1)), side=64), whole)
        bare = images.drop_vars(["row", "col", "target_row", "target_col"])
        check(deepct_py.infer(bare, side=64), whole)


def test_the_mask_is_carved_tile_by_tile(file, whole, observation):
    mask = deepct_py.carve(observation, grid=whole.grid).mask
    with xarray.open_dataset(file, chunks={}) as images:
        field = deepct_py.infer(images, side=64, carve=True).extinction.compute()
    assert 0.01 < mask.mean() < 0.6
    assert not field.values[~mask].any()


@pytest.fixture(scope="module")
def client():
    """A cluster of two workers, which replaces those that are killed."""
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        yield client


def test_a_cluster_gives_the_same_also_if_a_worker_is_killed(file, whole, client):
    with xarray.open_dataset(file, chunks={}) as images:
        field = client.persist(deepct_py.infer(images, side=20))
        killed = next(iter(client.run(os.getpid).values()))
        os.kill(killed, signal.SIGKILL)
        check(field.compute(), whole)


def test_a_cluster_reads_and_writes_zarr_also_if_a_worker_is_killed(file, whole, client, tmp_path):
    """Each worker reads its own parts of the images and writes its own parts of the field."""
    pytest.importorskip("zarr")
    with xarray.open_dataset(file) as images:
        images.to_zarr(tmp_path / "images.zarr")
        alone = deepct_py.infer(images, side=20).compute(scheduler="synchronous")
    with xarray.open_dataset(tmp_path / "images.zarr", engine="zarr") as images:
        field = deepct_py.infer(images, side=20)
        # One task for each tile, besides those of its two variables and of the weights.
        tiles = [key for key in field.__dask_graph__() if "_estimate" in str(key)]
        assert len(tiles) == 2 * 8
        written = client.compute(field.to_zarr(tmp_path / "field.zarr", compute=False))
        chunks = tmp_path / "field.zarr" / "extinction"
        deadline = time.monotonic() + 120
        while sum(path.is_file() for path in chunks.rglob("*")) < 4:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert not written.done()
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        written.result()
    with xarray.open_dataset(tmp_path / "field.zarr", engine="zarr") as found:
        check(found, whole)
        for name in ("extinction", "uncertainty"):
            np.testing.assert_array_equal(found[name], alone[name])
