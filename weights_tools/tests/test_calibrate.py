from dataclasses import replace

import deepct_py
import numpy as np
import pytest

from weights_tools.__main__ import main
from weights_tools.fixture import SMALL, random_network
from weights_tools.general_file import (
    GeneralDescription,
    GeneralWeights,
    read_general_weights,
    write_general_weights,
)
from weights_tools.general_recipe import load_general_recipe
from weights_tools.stream import generate

TRAINING = {"data": "none", "identity": "none", "samples": 0, "seed": 1}


class Shadows:
    """A renderer whose images are the sums of the extinction over the levels."""

    def render(self, scenes):
        views = len(scenes[0].pixel_km)
        sums = [0.02 + 0.0005 * scene.extinction.sum(0) for scene in scenes]
        return np.stack([np.repeat(each[None], views, 0) for each in sums]).astype(np.float32)


@pytest.fixture(scope="module")
def files(simulations, tmp_path_factory):
    """A pool with validation scenes, and the weights of a random network."""
    folder = tmp_path_factory.mktemp("calibrate")
    recipe = load_general_recipe(simulations / "recipe.toml")
    recipe = replace(recipe, scenes=replace(recipe.scenes, validation=8))
    next(generate(recipe, simulations, folder, Shadows()))
    architecture = replace(SMALL, levels=32)
    description = GeneralDescription(training=TRAINING, scores={"epsilon": 0.5, "delta": 0.0})
    weights = GeneralWeights(random_network(architecture, seed=1), description)
    write_general_weights(folder / "weights.safetensors", weights)
    return folder


def expected_and_found(path, scenes):
    """The mean error that a network expects of itself, and the one found, over the estimate."""
    network = deepct_py.Network.load(path, force=True)
    views = deepct_py.Views.load("cloudct-10", (0.0, 0.0, 1.0))
    grid = deepct_py.Grid((32, 32, 32), (0.05, 0.05, 0.04), (-0.8, -0.8, 0.36))
    pairs = []
    for extinction in scenes:
        images = np.repeat(0.02 + 0.0005 * extinction.sum(0)[None], 10, 0).astype(np.float32)
        answer = network.estimate(images, views, deepct_py.Light(), grid=grid)
        estimate = answer.extinction
        found = np.abs(estimate - extinction).sum()
        pairs.append((answer.uncertainty.sum() / estimate.sum(), found / estimate.sum()))
    return np.mean(pairs, axis=0)


@pytest.mark.filterwarnings("ignore:the network was not trained")
def test_the_expected_error_becomes_the_one_found(files, capsys):
    bare, calibrated = files / "weights.safetensors", files / "calibrated.safetensors"
    assert main(["calibrate", str(bare), "--pool", str(files), "--out", str(calibrated)]) == 0
    assert "expected" in capsys.readouterr().out
    description = read_general_weights(calibrated).description
    expected = [pair[0] for pair in description.calibration]
    assert expected == sorted(expected) and len(expected) == 8
    assert {"background", "brightest", "equal", "explained"} <= set(description.typical)
    assert all(low < high for low, high in description.typical.values())
    with np.load(files / "validation" / "000000.npz") as chunk:
        scenes = chunk["extinction"].astype(np.float32)
    before, after = (expected_and_found(path, scenes) for path in (bare, calibrated))
    assert after[1] == pytest.approx(before[1])
    assert abs(after[0] / after[1] - 1.0) < min(0.3, abs(before[0] / before[1] - 1.0))


def test_a_pool_without_validation_scenes_is_refused(files, tmp_path, capsys):
    command = ["calibrate", str(files / "weights.safetensors"), "--pool", str(tmp_path)]
    assert main([*command, "--out", str(tmp_path / "out.safetensors")]) == 2
    assert "validation scenes" in capsys.readouterr().err
