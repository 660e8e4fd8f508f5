"""Training: learning, resuming after an interruption, and refusal of invalid input."""

import csv
import subprocess
import sys
import time
from dataclasses import replace

import pytest
import torch

from weights_tools.__main__ import main
from weights_tools.checkpoint import load_checkpoint
from weights_tools.curves import figure
from weights_tools.dataset import load_dataset
from weights_tools.distributed import Processes
from weights_tools.errors import InputError
from weights_tools.recipe import LossRecipe, NetworkRecipe, Recipe, TrainingRecipe, load_recipe
from weights_tools.training import BEST, LAST, Training, learning_rate, loss_of

RECIPE = Recipe(
    "cloudct-10",
    NetworkRecipe(layers=3),
    training=TrainingRecipe(
        epochs=4,
        batch=2,
        muon_learning_rate=0.02,
        shift_voxels=1,
        shift_levels=1,
        neighbours=0.5,
        crop=6,
        crop_shift=1,
        reduced_precision=False,
    ),
)
CPU = Processes(torch.device("cpu"))


def silent(_: str) -> None:
    pass


@pytest.fixture
def data(dataset_folder):
    return load_dataset(dataset_folder, "cloudct-10")


class Killed(Exception):
    pass


def kill_after(epochs: int):
    def report(line: str) -> None:
        if line.startswith(f"epoch {epochs}/"):
            raise Killed

    return report


def test_a_run_that_was_killed_ends_like_one_that_was_not(data, tmp_path):
    Training(RECIPE, data, tmp_path / "whole", CPU).run(None, silent)
    with pytest.raises(Killed):
        Training(RECIPE, data, tmp_path / "cut", CPU).run(None, kill_after(2))
    lines = []
    Training(RECIPE, data, tmp_path / "cut", CPU).run(None, lines.append)
    assert lines[0] == "resuming after epoch 2" and len(lines) == 3
    for name in (LAST, BEST):
        whole, cut = (load_checkpoint(tmp_path / run / name) for run in ("whole", "cut"))
        for part, values in whole["model_state_dict"].items():
            assert torch.equal(values, cut["model_state_dict"][part]), part
        for number, optimizer in whole["optimizer_state_dict"].items():
            for parameter, state in optimizer["state"].items():
                for key, values in state.items():
                    found = cut["optimizer_state_dict"][number]["state"][parameter][key]
                    assert torch.equal(values, found)
    assert [row["loss"] for row in whole["history"]] == [row["loss"] for row in cut["history"]]


TOML = """
formation = "cloudct-10"
[network]
layers = 2
[training]
epochs = 60
batch = 2
"""


def test_a_process_that_was_killed_is_resumed(dataset_folder, tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(TOML)

    def command(out):
        options = ["--dataset", str(dataset_folder), "--threads", "1", "--out", str(tmp_path / out)]
        return ["train", str(recipe), *options]

    assert main(command("whole")) == 0
    for number in range(2):
        process = subprocess.Popen([sys.executable, "-m", "weights_tools", *command("cut")])
        last = tmp_path / "cut" / LAST
        before = last.stat().st_mtime_ns if number else None
        while process.poll() is None and not (last.exists() and last.stat().st_mtime_ns != before):
            time.sleep(0.01)
        time.sleep(0.02 * number)
        process.kill()
        process.wait()
    assert load_checkpoint(last)["epoch"] < 60
    assert main(command("cut")) == 0
    whole, cut = (
        load_checkpoint(tmp_path / run / LAST)["model_state_dict"] for run in ("whole", "cut")
    )
    assert whole.keys() == cut.keys()
    assert all(torch.equal(whole[part], cut[part]) for part in whole)


def test_it_learns_and_the_best_epoch_is_kept(data, tmp_path):
    training = replace(RECIPE.training, epochs=60, learning_rate=0.01, shift_voxels=0)
    recipe = replace(RECIPE, training=training)
    run = Training(recipe, data, tmp_path, CPU)
    run.run(None, silent)
    epsilon = [row["validation_epsilon"] for row in run.history]
    assert min(epsilon) < 0.6 < epsilon[0]
    best = load_checkpoint(tmp_path / BEST)
    assert best["epoch"] == 1 + epsilon.index(min(epsilon))
    assert best["metadata"]["scores"]["epsilon"] == min(epsilon)
    assert load_checkpoint(tmp_path / LAST)["epoch"] == 60
    with open(tmp_path / "curves.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["validation_epsilon"]) for row in rows] == epsilon
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert not list(tmp_path.glob(".*"))


def test_the_authors_keys_are_in_a_checkpoint(data, tmp_path):
    Training(replace(RECIPE, training=replace(RECIPE.training, epochs=1)), data, tmp_path, CPU).run(
        None, silent
    )
    assert {"epoch", "model_state_dict", "optimizer_state_dict"} <= set(
        load_checkpoint(tmp_path / LAST)
    )


def test_minutes_end_a_training_with_its_learning_rate_gone(data, tmp_path):
    recipe = replace(RECIPE, training=replace(RECIPE.training, epochs=100_000))
    run = Training(recipe, data, tmp_path, CPU)
    run.run(0.02, silent)
    assert run.progress == 1.0 and 1 <= run.epoch < 100_000
    assert run.history[-1]["learning_rate"] == 0.0


def test_patience_ends_a_training_that_gets_no_better(data, tmp_path):
    # With such a high learning rate, epsilon soon increases again.
    training = replace(RECIPE.training, epochs=200, learning_rate=0.1, patience=3)
    run = Training(replace(RECIPE, training=training), data, tmp_path, CPU)
    lines = []
    run.run(None, lines.append)
    epsilon = [row["validation_epsilon"] for row in run.history]
    best = 1 + epsilon.index(min(epsilon))
    assert run.epoch == best + 3 < 200
    assert lines[-1] == f"ended: no smaller epsilon since epoch {best}"
    assert load_checkpoint(tmp_path / BEST)["epoch"] == best
    # The same command does not continue the training.
    again = Training(replace(RECIPE, training=training), data, tmp_path, CPU)
    assert again.ended
    again.run(None, silent)
    assert again.epoch == run.epoch


def test_a_picture_says_what_its_axes_are():
    history = [
        {"epoch": 1, "loss": 2.0, "validation_epsilon": 0.9, "validation_delta": 0.4},
        {"epoch": 2, "loss": 1.0, "validation_epsilon": 0.7, "validation_delta": 0.2},
        {"epoch": 3, "loss": 0.9, "validation_epsilon": float("nan"), "validation_delta": 0.1},
    ]
    drawing = figure(history)
    names = ("training loss (of scaled extinction)", "relative error epsilon", "mass error delta")
    for axes, name in zip(drawing.axes, names):
        assert axes.get_xlabel() == "epoch" and axes.get_ylabel().startswith(name)
    assert drawing.axes[1].get_title() == "validation clouds; best.pt: epoch 2"


def test_the_scores_of_an_untrained_network_are_in_the_picture():
    history = [{"epoch": 1, "loss": 9.0, "validation_epsilon": 80.0, "validation_delta": -75.0}]
    _, epsilon, delta = figure(history).axes
    for axes, value in ((epsilon, 80.0), (delta, -75.0)):
        assert min(axes.get_ylim()) < value < max(axes.get_ylim())
        # A single value has a mark: a line through one point cannot be seen.
        assert axes.lines[0].get_marker() == "o"


def test_a_checkpoint_from_before_a_setting_goes_on(data, tmp_path):
    with pytest.raises(Killed):
        Training(RECIPE, data, tmp_path, CPU).run(None, kill_after(2))
    checkpoint = load_checkpoint(tmp_path / LAST)
    del checkpoint["recipe"]["training"]["patience"], checkpoint["recipe"]["network"]["planes"]
    torch.save(checkpoint, tmp_path / LAST)
    assert Training(RECIPE, data, tmp_path, CPU).epoch == 2
    patient = replace(RECIPE, training=replace(RECIPE.training, patience=9))
    with pytest.raises(InputError, match="another recipe"):
        Training(patient, data, tmp_path, CPU)


@pytest.mark.parametrize("precision", [False, True])
def test_reduced_precision_is_for_training_only(data, tmp_path, precision):
    training = replace(RECIPE.training, epochs=1, reduced_precision=precision)
    run = Training(replace(RECIPE, training=training), data, tmp_path, CPU)
    run.run(None, silent)
    estimate = run.estimate(run.validation.radiance)["extinction"]
    assert estimate.dtype == torch.float32
    # bfloat16 has a precision of 8 bits, which float32 results exceed.
    assert not torch.equal(estimate, estimate.bfloat16().float())


def test_another_recipe_or_other_data_are_refused(data, tmp_path):
    recipe = replace(RECIPE, training=replace(RECIPE.training, epochs=1))
    Training(recipe, data, tmp_path, CPU).run(None, silent)
    with pytest.raises(InputError, match="another recipe"):
        Training(RECIPE, data, tmp_path, CPU)
    with pytest.raises(InputError, match="other data"):
        Training(recipe, replace(data, identity="other"), tmp_path, CPU)


def test_crops_are_near_the_middle_until_the_last_part_of_the_training(data, tmp_path):
    run = Training(RECIPE, data, tmp_path, CPU)
    generator = torch.Generator().manual_seed(1)
    images = torch.zeros(2, 10, 8, 8)
    crops = [run._crop(images, generator) for _ in range(50)]
    assert {crop.start for pair in crops for crop in pair} == {0, 1, 2}
    assert all(crop.stop - crop.start == 6 for pair in crops for crop in pair)
    assert any(rows.start != cols.start for rows, cols in crops)
    run.progress = 0.9
    assert run._crop(images, generator) == (slice(None), slice(None))


def test_the_learning_rate_rises_and_falls():
    training = TrainingRecipe(learning_rate=1.0, warmup=0.2)
    rates = [learning_rate(training, progress) for progress in (0.0, 0.1, 0.2, 0.6, 1.0)]
    assert rates == pytest.approx([0.01, 0.505, 1.0, 0.5, 0.0])


def test_a_training_starts_from_a_network_of_another(data, tmp_path):
    Training(RECIPE, data, tmp_path / "first", CPU).run(None, silent)
    first = load_checkpoint(tmp_path / "first" / BEST)
    second = Training(RECIPE, data, tmp_path / "second", CPU, tmp_path / "first" / BEST)
    for name, values in second.network.state_dict().items():
        assert torch.equal(values, first["model_state_dict"][name]), name
    with pytest.raises(Killed):
        second.run(None, kill_after(1))
    # The metadata name the origin of the start, also after an interruption.
    Training(RECIPE, data, tmp_path / "second", CPU).run(None, silent)
    last = load_checkpoint(tmp_path / "second" / LAST)
    assert last["metadata"]["configuration"]["started_from"] == first["metadata"]["training"]
    assert "started_from" not in first["metadata"]["configuration"]
    wider = replace(RECIPE, network=NetworkRecipe(layers=3, width=9))
    with pytest.raises(InputError, match="best.pt: is not of a network like"):
        Training(wider, data, tmp_path / "third", CPU, tmp_path / "first" / BEST)


def test_the_loss_by_hand():
    truth = torch.tensor([[1.0, 3.0], [0.0, 2.0]]).reshape(2, 2, 1, 1)
    estimate = torch.tensor([[2.0, 1.0], [0.0, 2.0]]).reshape(2, 2, 1, 1)
    # The differences are 1, -2, 0, 0: squares 5 of 10, absolute values 3 of 4.
    for recipe, expected in (
        (LossRecipe(), 1.25),
        (LossRecipe(squared=0.0, squared_by_cloud=1.0), 0.25),
        (LossRecipe(squared=0.0, relative=1.0), 0.375),
        (LossRecipe(squared=2.0, squared_by_cloud=4.0, relative=2.0), 4.25),
    ):
        assert loss_of(recipe, truth, estimate).item() == pytest.approx(expected)


def test_an_uncertainty_is_judged_by_the_error_and_leaves_it_alone():
    truth = torch.tensor([[1.0, 3.0], [0.0, 2.0]]).reshape(2, 2, 1, 1)
    # The absolute errors are 1 and 2 for the first cloud and zero for the second.
    estimate = torch.tensor([[2.0, 1.0, 1.5, 1.0], [0.0, 2.0, 0.0, 1.0]]).reshape(2, 4, 1, 1)
    estimate.requires_grad_()
    recipe = LossRecipe(squared=0.0, squared_by_cloud=1.0, uncertainty=2.0)
    loss = loss_of(recipe, truth, estimate)
    # The errors of the uncertainty are 0.5 and -1 (over 10), and 0 and 1 (over 4).
    assert loss.item() == pytest.approx(0.25 + 2.0 * 0.5 * (1.25 / 10.0 + 1.0 / 4.0))
    loss.backward()
    # The gradient with respect to the extinction is that of the squared error only.
    by_hand = 0.5 * 2.0 * torch.tensor([1.0, -2.0]) / 10.0
    assert estimate.grad[0, :2].flatten().tolist() == pytest.approx(by_hand.tolist())


def test_a_network_learns_how_wrong_it_is(data, tmp_path):
    """A network that cannot learn the random clouds still learns the size of its error."""
    training = replace(RECIPE.training, epochs=60, learning_rate=0.01, neighbours=0.0)
    network = replace(RECIPE.network, uncertainty=True)
    run = Training(replace(RECIPE, network=network, training=training), data, tmp_path, CPU)
    assert run.network.channels[-1] == 2 * data.levels
    run.run(None, silent)
    run.network.eval()
    with torch.no_grad():
        images = run._input(run.validation.radiance)
        estimate, expected = run.network.layers(images).split(data.levels, 1)
    error = (estimate * run.recipe.scaling.output_scale - run.validation.extinction).abs()
    expected = expected * run.recipe.scaling.output_scale
    assert expected.mean().item() == pytest.approx(error.mean().item(), rel=0.3)
    cloudy = run.validation.extinction > 0.0
    assert expected[cloudy].mean() > 5.0 * expected[~cloudy].mean()
    metadata = load_checkpoint(tmp_path / BEST)["metadata"]
    assert metadata["outputs"] == ["extinction", "uncertainty"]


def test_recipes_that_ship_are_valid():
    from pathlib import Path

    folder = Path(__file__).parents[1] / "recipes"
    paths = [path for path in folder.glob("*.toml") if not path.stem.startswith("general")]
    formations = {path.stem: load_recipe(path).formation for path in paths}
    assert set(formations.values()) == {"cloudct-10", "pearls-32"}
    assert all(name.startswith(formation) for name, formation in formations.items())
    assert len(formations) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('formation = "a"\nepochs = 3', "unknown key epochs"),
        ('formation = "a"\n[training]\nepoch = 3', "unknown key training.epoch"),
        ('formation = "a"\n[training]\nepochs = "3"', "training.epochs is '3'"),
        ('formation = "a"\n[training]\nepochs = 0', "training.epochs is out of range"),
        ('formation = "a"\n[sensor]\nbits = 40', "bits is 40"),
        ('formation = "a"\n[loss]\nsquared = 0', "loss is out of range"),
        ('formation = "a"\ntraining = 3', "training is not a table"),
        ("[training]", "no key formation"),
        ("formation = ", "is not TOML"),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path, text, message):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_recipe(path)
    assert message in str(error.value) and str(path) in str(error.value)
