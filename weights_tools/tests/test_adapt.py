"""Adaptation of the general network to images of unknown clouds."""

from dataclasses import replace
from pathlib import Path

import deepct_py
import numpy as np
import pytest
import torch

from weights_tools.__main__ import main
from weights_tools.adapt import Rehearsal, Scene, Settings, adapt
from weights_tools.general_file import read_general_weights

WEIGHTS = Path(__file__).parents[2] / "crates/deepct-core/weights/general.safetensors"
QUICK = Settings(synthetic=2, steps=6, warm_up=2, patience=1, minutes=0.4)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A file of noisy images of a small cloud, and the cloud."""
    views = deepct_py.Views.load("cloudct-10", (0.0, 0.0, 1.2), (16, 16))
    grid = deepct_py.Network.load("general").grid(views)
    cloud = deepct_py.generate_cloud(grid, seed=3, width_km=0.4)
    images = deepct_py.render(
        cloud, views=views, light=deepct_py.Light(sun=(40, 120)), solver="ordinates",
        accuracy=0.05, estimate_error=False,
    )
    path = tmp_path_factory.mktemp("adapt") / "images.nc"
    deepct_py.sense(images).to_netcdf(path)
    return path, cloud


def test_images_alone_improve_the_estimate(scene, tmp_path):
    path, cloud = scene
    output, lines = tmp_path / "adapted.safetensors", []
    assert adapt(WEIGHTS, [path], output, QUICK, lines.append)
    before, after = (
        deepct_py.score(cloud, deepct_py.Network.load(weights).infer(path)).relative_error
        for weights in (WEIGHTS, output)
    )
    assert after < before
    first, last = read_general_weights(output).description.configuration["adaptation"]["misfits"]
    assert last < first and f"{first:.3f} -> {last:.3f}" in lines[-1]
    # The scores of the training are not those of the adapted network.
    scores = read_general_weights(output).description.scores
    assert scores and all(name.endswith("_before_adaptation") for name in scores)


def test_held_out_views_are_seen_by_neither_network_nor_loss(scene):
    observation = deepct_py.read_images(scene[0])
    made = Scene("images", observation, read_general_weights(WEIGHTS), 0.3, seed=1)
    assert len(made.held) == 3 and len(made.learned) == 7
    assert not set(made.held.tolist()) & set(made.learned.tolist())
    radiance = observation.radiance.copy()
    radiance[made.held.numpy()] *= 1.001
    changed = observation.replace(radiance=radiance)
    other = Scene("images", changed, read_general_weights(WEIGHTS), 0.3, seed=1)
    with torch.no_grad():
        extinction, same = made.extinction(), other.extinction()
        assert torch.equal(made.mask, other.mask) and torch.equal(extinction, same)
        misfits, others = made.misfits(extinction), other.misfits(extinction)
    assert torch.equal(misfits[made.learned], others[made.learned])
    assert (misfits[made.held] != others[made.held]).all()


def test_missing_and_saturated_pixels_do_not_count(scene):
    observation = deepct_py.read_images(scene[0])
    radiance, saturated = observation.radiance.copy(), np.zeros(observation.radiance.shape, bool)
    radiance[0, 2, 3], saturated[1] = np.nan, True
    changed = observation.replace(radiance=radiance, saturated=saturated)
    made = Scene("images", changed, read_general_weights(WEIGHTS), 0.2, seed=1)
    misfits = made.misfits(torch.zeros(made.estimator.grid.shape))
    assert misfits[1] == 0.0 and torch.isfinite(misfits).all() and misfits[0] > 0.0


def test_the_rehearsal_starts_at_zero(scene):
    weights = read_general_weights(WEIGHTS)
    made = Scene("images", deepct_py.read_images(scene[0]), weights, 0.2, seed=1)
    rehearsal = Rehearsal([made], 2, seed=1)
    random = np.random.default_rng(1)
    assert rehearsal.loss(random).item() < 1e-5
    with torch.no_grad():
        weights.network.layers[-1].batch_norm.weight.mul_(1.1)
        weights.network.layers[-1].batch_norm.bias.mul_(1.1)
    assert 0.05 < rehearsal.loss(random).item() < 0.5


def test_weights_that_are_not_better_are_not_written(scene, tmp_path):
    output, lines = tmp_path / "adapted.safetensors", []
    settings = replace(QUICK, learning_rate=0.0, steps=1)
    assert not adapt(WEIGHTS, [scene[0]], output, settings, lines.append)
    assert not output.exists() and "nothing is written" in lines[-1]


def test_wrong_input_is_refused(scene, tmp_path, capsys):
    observation = deepct_py.read_images(scene[0])
    few, droplets, dark = (tmp_path / f"{name}.nc" for name in ("few", "droplets", "dark"))
    parts = {"radiance": observation.radiance[:3], "views": observation.views[:3]}
    parts["standard_error"] = parts["saturated"] = None
    observation.replace(**parts).to_netcdf(few)
    observation.replace(light=deepct_py.Light(phase="mie")).to_netcdf(droplets)
    observation.replace(radiance=0 * observation.radiance + 0.01).to_netcdf(dark)
    output = tmp_path / "adapted.safetensors"
    for weights, images, message in [
        ("missing.safetensors", scene[0], "missing.safetensors: No such file"),
        (str(WEIGHTS), few, "has 3 views; give images of at least 4"),
        (str(WEIGHTS), droplets, "effective radius"),
        (str(WEIGHTS), dark, "shows no cloud"),
        (str(WEIGHTS), WEIGHTS, "give a file of images"),
    ]:
        assert main(["adapt", weights, str(images), "--out", str(output)]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1, error
    assert not output.exists()
