import numpy as np
import pytest
import torch

from weights_tools.errors import InputError
from weights_tools.general_recipe import load_general_recipe
from weights_tools.scenes import VOXEL_KM
from weights_tools.stream import (
    Batches,
    Pool,
    chunk_numbers,
    chunk_path,
    cropped,
    generate,
    mirrored,
    wait_for,
)

CPU = torch.device("cpu")


class Painter:
    """A renderer whose images state the number of the view, on a pattern."""

    def __init__(self):
        self.scenes = 0

    def render(self, scenes):
        self.scenes += len(scenes)
        views = np.arange(len(scenes[0].pixel_km), dtype=np.float32)
        pattern = 0.1 + 0.001 * np.arange(32 * 32, dtype=np.float32).reshape(32, 32) / 1024.0
        return np.stack([pattern + 0.001 * views[:, None, None] for _ in scenes])


@pytest.fixture(scope="module")
def recipe(simulations):
    from dataclasses import replace

    recipe = load_general_recipe(simulations / "recipe.toml")
    stream = replace(recipe.stream, chunk=3)
    return replace(recipe, stream=stream, scenes=replace(recipe.scenes, validation=4))


@pytest.fixture
def folder(recipe, simulations, tmp_path):
    lines = generate(recipe, simulations, tmp_path, Painter())
    for _ in range(5):
        next(lines)
    return tmp_path


def test_the_first_generator_writes_the_validation_scenes_first(folder):
    assert chunk_numbers(folder, "validation") == [0, 1]
    assert chunk_numbers(folder, "train") == [0, 1, 2]
    pool = Pool(folder, "validation", 2, CPU)
    pool.update()
    assert len(pool) == 4


def test_generators_continue_after_an_interruption(recipe, simulations, folder):
    painter = Painter()
    line = next(generate(recipe, simulations, folder, painter))
    assert line.startswith("train chunk 3") and painter.scenes == 3
    second = generate(recipe, simulations, folder, Painter(), (1, 2))
    assert next(second).startswith("train chunk 5")
    assert not list(folder.glob("*/.*"))


def test_a_pool_reads_new_chunks_and_replaces_the_oldest(recipe, simulations, folder):
    pool = Pool(folder, "train", 3, CPU)
    assert pool.update() == 3 and len(pool) == 9 and pool.update() == 0
    chunk_path(folder, "train", 3).write_bytes(b"damaged")
    assert pool.update() == 1 and len(pool) == 9
    assert not chunk_path(folder, "train", 3).exists()
    next(generate(recipe, simulations, folder, Painter()))
    assert pool.update() == 1 and len(pool) == 9 and pool.rendered == 12
    assert sorted(pool.numbers) == [1, 2, 3]
    assert chunk_numbers(folder, "train") == [1, 2, 3]


def test_chosen_views_have_their_images_and_geometry(recipe, simulations, folder):
    from weights_tools.scenes import SceneGenerator

    pool = Pool(folder, "train", 3, CPU)
    pool.update()
    chosen = torch.tensor([[40, 3], [7, 16]])
    extinction, images, views, paper = pool.take(torch.tensor([4, 2]), chosen)
    source = SceneGenerator(recipe.scenes, recipe.split("train"), simulations)
    scene = source.scene(4)
    np.testing.assert_allclose(extinction[0], scene.extinction, rtol=1e-3)
    np.testing.assert_allclose(images[0, :, 0, 0], [0.14, 0.103], rtol=1e-3)
    np.testing.assert_allclose(views.towards[0], scene.towards[[40, 3]], rtol=1e-6)
    np.testing.assert_allclose(views.pixel[0] * VOXEL_KM, scene.pixel_km[[40, 3]], rtol=1e-6)
    assert bool(paper[0]) == scene.paper


def test_batches_have_various_formations_and_fit_together(recipe, folder):
    pool = Pool(folder, "train", 3, CPU)
    pool.update()
    batches = Batches(recipe, pool, cropping=True, seed=3)
    counts, sizes = set(), set()
    for _ in range(60):
        batch = batches.draw()
        scenes, views, planes = batch.planes.shape[:3]
        assert planes == recipe.network.planes
        assert batch.truth.shape == (scenes, 32, *batch.planes.shape[3:])
        assert batch.views.towards.shape == (scenes, views, 3)
        assert scenes * views <= recipe.training.views_per_batch
        assert torch.isfinite(batch.planes).all()
        counts.add(views)
        sizes.add(batch.planes.shape[-1])
    assert sizes == {22, 32}
    assert len(counts) >= 8 and min(counts) == 3 and max(counts) == 40
    again = Batches(recipe, pool, cropping=True, seed=3).draw()
    first = Batches(recipe, pool, cropping=True, seed=3).draw()
    assert torch.equal(again.planes, first.planes)


def test_any_views_are_different_ones_of_the_scene(recipe, folder):
    pool = Pool(folder, "train", 3, CPU)
    pool.update()
    batches = Batches(recipe, pool, cropping=False, seed=1)
    for count in (3, 10, 16, 40):
        chosen = batches._any_views(200, count)
        assert chosen.shape == (200, count)
        assert all(len(set(views)) == count for views in chosen.tolist())
        assert chosen.min() >= 0 and chosen.max() < 48
        on_track, scattered = (chosen < 32).all(1), (chosen >= 32).all(1)
        assert 40 < on_track.sum() < 130 if count <= 16 else not on_track.any()
        assert 40 < scattered.sum() < 120 if count <= 16 else not scattered.any()


def test_crops_are_parts_at_their_corners():
    volume = torch.arange(2 * 3 * 5 * 6).reshape(2, 3, 5, 6)
    parts = cropped(volume, 2, torch.tensor([[1, 0], [3, 4]]))
    assert torch.equal(parts[0], volume[0, :, 1:3, 0:2])
    assert torch.equal(parts[1], volume[1, :, 3:5, 4:6])


def test_all_eight_symmetries_are_different():
    square = torch.arange(9).reshape(1, 3, 3).expand(8, 3, 3)
    turns = torch.tensor([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=torch.bool)
    results = {tuple(each.flatten().tolist()) for each in mirrored(square, turns)}
    assert len(results) == 8


def test_waiting_ends_with_an_error_if_no_generator_runs(tmp_path):
    def alive():
        raise InputError("a generator of scenes", "ended with status 1", "see its log")

    pool = Pool(tmp_path, "train", 3, CPU)
    with pytest.raises(InputError, match="status 1"):
        wait_for(pool, 1, alive)
