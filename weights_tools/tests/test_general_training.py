import csv
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from weights_tools.__main__ import main
from weights_tools.errors import InputError
from weights_tools.fixture import random_geometries
from weights_tools.general import GeneralArchitecture, GeneralNetwork
from weights_tools.general_file import load_general, read_general_weights
from weights_tools.general_recipe import load_general_recipe
from weights_tools.general_step import Step, general_loss
from weights_tools.general_training import (
    GeneralTraining,
    Generators,
    general_rate,
    loss_weights,
    small,
)
from weights_tools.stream import Batch
from weights_tools.views import views_of

ARCHITECTURE = GeneralArchitecture(virtual_views=3, planes=2, width=8, layers=3)


def test_a_short_training_lowers_the_loss():
    torch.manual_seed(1)
    geometry = random_geometries(1, seed=4)[0]
    views = views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])
    views = views.to(torch.float32)[[0] * 8]
    truth = torch.zeros(8, 32, 12, 12)
    truth[:, 8:16, 3:9, 3:9] = torch.rand(8, 1, 6, 6) + 0.5
    bright = truth.sum(1)[:, None, None].expand(-1, views.pixel.shape[1], 2, -1, -1)
    batch = Batch(0.3 * bright.contiguous(), views, truth)
    network = GeneralNetwork(ARCHITECTURE).train()
    step = Step(network, 3.0, print)
    losses = [step.run(batch, 5e-3, (0.05, 0.5, 1.0, 0.1)).item() for _ in range(60)]
    assert losses[-1] < 0.5 * losses[0]


def test_frozen_normalisations_keep_their_statistics():
    torch.manual_seed(2)
    geometry = random_geometries(1, seed=4)[0]
    views = views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])
    views = views.to(torch.float32)[[0] * 4]
    planes = torch.rand(4, views.pixel.shape[1], 2, 8, 8)
    batch = Batch(planes, views, torch.rand(4, 32, 8, 8))
    network = GeneralNetwork(ARCHITECTURE).train()
    step = Step(network, 3.0, print)
    weights = (0.0, 1.0, 1.0, 0.1)
    step.run(batch, 1e-3, weights)
    step.freeze()
    network.eval()
    network.train()
    norm = network.layers[0].batch_norm
    mean, kernel = norm.running_mean.clone(), network.layers[0].weight.clone()
    step.run(batch, 1e-3, weights)
    assert torch.equal(norm.running_mean, mean)
    assert not torch.equal(network.layers[0].weight, kernel)


def test_the_loss_is_that_of_its_definition():
    truth = torch.zeros(1, 2, 1, 2)
    truth[0, 0] = torch.tensor([[1.0, 3.0]])
    outputs = torch.zeros(1, 4, 1, 2)
    outputs[0, 0] = torch.tensor([[2.0, 1.0]])
    outputs[0, 2] = torch.tensor([[0.5, 2.0]])
    terms = [torch.tensor(weight) for weight in (2.0, 3.0, 0.5)]
    # Errors 1 and -2, of which 0.5 and 2 were expected.
    expected = 2.0 * 3.0 / 4.0 + 3.0 * 5.0 / 10.0 + 0.5 * 0.25 / 10.0
    assert general_loss(outputs, truth, *terms).item() == pytest.approx(expected)


def test_the_learning_rate_and_the_loss_change_with_progress(simulations):
    settings = load_general_recipe(simulations / "recipe.toml").training
    assert general_rate(settings, 0.0) == pytest.approx(0.02 * settings.learning_rate)
    assert general_rate(settings, 0.1) == pytest.approx(settings.learning_rate, rel=0.05)
    assert general_rate(settings, 1.0) == 0.0
    assert loss_weights(settings, 0.0) == (0.3, 1.0)
    assert loss_weights(settings, 0.5) == pytest.approx((0.65, 0.7))
    assert loss_weights(settings, 1.0) == pytest.approx((1.0, 0.4))


@pytest.fixture(scope="module")
def run(simulations, tmp_path_factory):
    """The folder of a short training by the command line."""
    folder = tmp_path_factory.mktemp("run")
    command = ["train", str(simulations / "recipe.toml"), "--simulations", str(simulations)]
    command += ["--out", str(folder), "--small", "--renderer", "photon-paths"]
    assert main([*command, "--minutes", "0.05"]) == 0
    return folder


def test_a_training_writes_checkpoints_curves_and_weights(run):
    assert (run / "best.pt").stat().st_size < 16e6
    assert (run / "curves.png").read_bytes()[:4] == b"\x89PNG"
    with open(run / "curves.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) >= 2 and int(rows[-1]["step"]) > 0
    weights = read_general_weights(run / "best.safetensors")
    checkpoint = load_general(run / "best.pt")
    assert weights.description == checkpoint.description
    state = checkpoint.network.state_dict()
    for name, values in weights.network.state_dict().items():
        if not name.endswith("num_batches_tracked"):
            assert torch.equal(values, state[name]), name


def test_a_training_is_resumed_in_a_new_cycle(run, simulations, capsys):
    before = torch.load(run / "last.pt", weights_only=True)
    assert before["progress"] == 1.0
    command = ["train", str(simulations / "recipe.toml"), "--simulations", str(simulations)]
    command += ["--out", str(run), "--small", "--renderer", "photon-paths"]
    assert main([*command, "--further", "0.03"]) == 0
    after = torch.load(run / "last.pt", weights_only=True)
    assert "a new cycle" in capsys.readouterr().out
    assert after["steps"] > before["steps"]
    assert after["cycle_start_s"] == before["elapsed_s"]
    assert len(after["history"]) > len(before["history"])


def test_another_network_cannot_be_resumed_or_started(run, simulations):
    recipe = load_general_recipe(simulations / "recipe.toml")
    other = replace(recipe, network=replace(recipe.network, width=9))
    generators = Generators(simulations / "recipe.toml", simulations, count=0)
    cpu = torch.device("cpu")
    with pytest.raises(InputError, match=r"is of another \[network\]"):
        GeneralTraining(small(other), run, generators, cpu, print)
    with pytest.raises(InputError, match="has the architecture"):
        GeneralTraining(small(other), run / "new", generators, cpu, print, run / "best.pt")


def test_a_failing_generator_ends_the_training(simulations, tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text((simulations / "recipe.toml").read_text())
    command = ["train", str(recipe), "--simulations", str(tmp_path), "--out", str(tmp_path / "run")]
    assert main([*command, "--small", "--minutes", "1"]) == 2


def test_a_pack_trains_on_its_own(run, simulations, tmp_path):
    folder = tmp_path / "pack"
    command = ["pack", str(simulations / "recipe.toml"), "--simulations", str(simulations)]
    command += ["--out", str(folder), "--start", str(run / "best.pt"), "--small"]
    assert main(command) == 0
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    assert size < 60e6
    out = tmp_path / "out"
    script = ["bash", str(folder / "run.sh"), "0.03", str(out), "--small"]
    environment = {"PYTHON": sys.executable, "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
    result = subprocess.run(
        [*script, "--renderer", "photon-paths"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "starting from" in result.stdout
    assert (out / "best.pt").stat().st_size < 16e6
    assert main(command) == 2
    assert Path(folder, "weights_tools", "photon_paths.cu").exists()
