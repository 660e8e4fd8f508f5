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
QUICK = Settings(synthetic=2, steps=6, warm_up=2, most_steps=12, minutes=60)


FORMATION = WEIGHTS.with_name("cloudct-10.safetensors")


def made(folder, altitude_km, sun):
    """A file of noisy images of a small cloud, and the cloud."""
    views = deepct_py.Views.load("cloudct-10", (0.0, 0.0, altitude_km), (16, 16))
    grid = deepct_py.Network.load("general").grid(views)
    cloud = deepct_py.generate_cloud(grid, seed=3, width_km=0.4)
    images = deepct_py.render(
        cloud, views=views, light=deepct_py.Light(sun=sun), solver="ordinates", accuracy=0.05,
        estimate_error=False,
    )
    path = folder / "images.nc"
    deepct_py.sense(images).to_netcdf(path)
    return path, cloud


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return made(tmp_path_factory.mktemp("adapt"), 1.2, (40, 120))


def epsilon(cloud, weights, path):
    return deepct_py.score(cloud, deepct_py.Network.load(weights).infer(path)).relative_error


def test_images_alone_improve_the_estimate(scene, tmp_path):
    path, cloud = scene
    output, lines = tmp_path / "adapted.safetensors", []
    assert adapt(WEIGHTS, [path], output, QUICK, lines.append)
    assert epsilon(cloud, output, path) < epsilon(cloud, WEIGHTS, path)
    first, last = read_general_weights(output).description.configuration["adaptation"]["misfits"]
    assert last < first and f"{first:.3f} -> {last:.3f}" in lines[-1]
    # The scores of the training are not those of the adapted network.
    scores = read_general_weights(output).description.scores
    assert scores and all(name.endswith("_before_adaptation") for name in scores)


def test_networks_of_one_formation_are_adapted(tmp_path):
    path, cloud = made(tmp_path, 1.12, (30, 45))
    output, lines = tmp_path / "adapted.safetensors", []
    assert adapt(FORMATION, [path], output, QUICK, lines.append)
    assert epsilon(cloud, output, path) < epsilon(cloud, FORMATION, path)
    before, after = (deepct_py.Network.load(file).metadata for file in (FORMATION, output))
    assert set(after["scores"]) == {"epsilon_before_adaptation", "delta_before_adaptation"}
    assert after["configuration"].pop("adaptation")["scenes"] == 1
    for key in set(before) - {"scores"}:
        assert after[key] == before[key], key


def test_held_out_views_are_seen_by_neither_network_nor_loss(scene):
    observation = deepct_py.read_images(scene[0])
    first = Scene("images", observation, read_general_weights(WEIGHTS), 0.3, seed=1)
    assert len(first.held) == 3 and len(first.learned) == 7
    assert not set(first.held.tolist()) & set(first.learned.tolist())
    radiance = observation.radiance.copy()
    radiance[first.held.numpy()] *= 1.001
    changed = observation.replace(radiance=radiance)
    other = Scene("images", changed, read_general_weights(WEIGHTS), 0.3, seed=1)
    with torch.no_grad():
        extinction, same = first.extinction(), other.extinction()
        assert torch.equal(first.mask, other.mask) and torch.equal(extinction, same)
        misfits, others = first.misfits(extinction), other.misfits(extinction)
    assert torch.equal(misfits[first.learned], others[first.learned])
    assert (misfits[first.held] != others[first.held]).all()


def test_missing_and_saturated_pixels_do_not_count(scene):
    observation = deepct_py.read_images(scene[0])
    radiance, saturated = observation.radiance.copy(), np.zeros(observation.radiance.shape, bool)
    radiance[0, 2, 3], saturated[1] = np.nan, True
    changed = observation.replace(radiance=radiance, saturated=saturated)
    first = Scene("images", changed, read_general_weights(WEIGHTS), 0.2, seed=1)
    assert 0 not in first._seen.tolist()
    misfits = first.misfits(torch.zeros(first.estimator.grid.shape))
    assert misfits[1] == 0.0 and torch.isfinite(misfits).all() and misfits[0] > 0.0


def test_the_rehearsal_starts_at_zero(scene):
    weights = read_general_weights(WEIGHTS)
    first = Scene("images", deepct_py.read_images(scene[0]), weights, 0.2, seed=1)
    rehearsal = Rehearsal([first], 2, seed=1)
    random = np.random.default_rng(1)
    assert rehearsal.loss(random).item() < 1e-8
    with torch.no_grad():
        weights.network.layers[-1].batch_norm.weight.mul_(1.1)
        weights.network.layers[-1].batch_norm.bias.mul_(1.1)
    # All estimates and their errors, which are smaller, are larger by a tenth.
    assert 0.01 < rehearsal.loss(random).item() < 0.02


def test_weights_that_are_not_better_are_not_written(scene, tmp_path):
    output, lines = tmp_path / "adapted.safetensors", []
    settings = replace(QUICK, learning_rate=0.0, steps=1, most_steps=2)
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
    gaps = observation.radiance.copy()
    gaps[:8, 4, 4] = np.nan
    observation.replace(radiance=gaps).to_netcdf(tmp_path / "gaps.nc")
    output = tmp_path / "adapted.safetensors"
    for weights, images, message in [
        ("missing.safetensors", scene[0], "missing.safetensors: No such file"),
        (str(WEIGHTS), few, "has 3 views; give images of at least 4"),
        (str(WEIGHTS), droplets, "effective radius"),
        (str(WEIGHTS), dark, "shows no cloud"),
        (str(WEIGHTS), tmp_path / "gaps.nc", "views without missing pixels"),
        (str(FORMATION), scene[0], "give images of the formation"),
        (str(WEIGHTS), WEIGHTS, "give a file of images"),
    ]:
        assert main(["adapt", weights, str(images), "--out", str(output)]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1, error
    assert not output.exists()
