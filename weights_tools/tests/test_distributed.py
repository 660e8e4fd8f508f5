"""Training with two processes gives the result of one process."""

import os
import socket
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from conftest import write_dataset
from test_training import CPU, RECIPE, Killed, kill_after, silent

from weights_tools.checkpoint import load_checkpoint
from weights_tools.dataset import load_dataset
from weights_tools.distributed import Processes, SharedNorm, processes
from weights_tools.errors import InputError
from weights_tools.training import LAST, Training

# The two processes have shares of two samples and one sample of each batch.
RECIPE = replace(RECIPE, training=replace(RECIPE.training, batch=3))
ENDLESS = replace(RECIPE, training=replace(RECIPE.training, epochs=100_000))
COUNT = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set and trainings on it: with one process, with two, and resumed by two after one."""
    folder = tmp_path_factory.mktemp("together")
    data = load_dataset(write_dataset(folder / "dataset"), "cloudct-10")
    torch.set_num_threads(1)
    Training(RECIPE, data, folder / "alone", CPU).run(None, silent)
    with pytest.raises(Killed):
        Training(RECIPE, data, folder / "resumed", CPU).run(None, kill_after(2))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    torch.multiprocessing.spawn(member, (port, folder), COUNT)
    return folder


def member(rank: int, port: int, folder: Path) -> None:
    """Run one of the processes, with the environment variables that torchrun sets."""
    told = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": COUNT, "MASTER_PORT": port}
    os.environ.update({name: str(value) for name, value in told.items()}, MASTER_ADDR="127.0.0.1")
    torch.set_num_threads(1)
    data = load_dataset(folder / "dataset", "cloudct-10")
    found = {}
    with processes() as ours:
        found["norm"] = normed(ours)
        for name, recipe, minutes in (
            ("together", RECIPE, None),
            ("resumed", RECIPE, None),
            ("limited", ENDLESS, 0.02),
        ):
            run = Training(recipe, data, folder / name, ours)
            lines = []
            run.run(minutes, lines.append)
            found[name] = {
                "network": run.network.state_dict(),
                "optimizers": run.optimizers.state_dict(),
                "history": run.history,
                "progress": run.progress,
                "lines": lines,
            }
    torch.save(found, folder / f"{rank}.pt")


def images_and_norm():
    generator = torch.Generator().manual_seed(1)
    norm = torch.nn.BatchNorm2d(4)
    norm.weight.data = torch.rand(4, generator=generator) + 0.5
    return 3.0 + torch.randn(5, 4, 6, 7, generator=generator), norm


def normed(ours: Processes) -> dict[str, torch.Tensor]:
    """The normalised share of some images, and the gradients of a sum over all shares."""
    images, norm = images_and_norm()
    images = images[ours.share(len(images))].requires_grad_()
    shared = SharedNorm(norm)
    output = shared(images)
    output.pow(3).sum().backward()
    gradients = {f"{name} gradient": values.grad for name, values in shared.named_parameters()}
    return {"output": output.detach(), "images": images.grad, **gradients, **shared.state_dict()}


def found(folder, rank):
    return torch.load(folder / f"{rank}.pt", weights_only=True)


def test_a_norm_over_shares_is_that_of_the_whole_batch(folder):
    images, norm = images_and_norm()
    images, norm = images.double().requires_grad_(), norm.double()
    output = norm(images)
    output.pow(3).sum().backward()
    shares = [found(folder, rank)["norm"] for rank in range(COUNT)]
    assert [len(share["output"]) for share in shares] == [2, 3]
    for name, expected in (("output", output.detach()), ("images", images.grad)):
        together = torch.cat([share[name] for share in shares]).double()
        assert torch.allclose(together, expected, rtol=1e-5, atol=1e-5), name
    for name, parameter in norm.named_parameters():
        total = sum(share[f"{name} gradient"] for share in shares).double()
        assert torch.allclose(total, parameter.grad, rtol=1e-5, atol=1e-3), name
    for share in shares:
        for name in ("running_mean", "running_var", "num_batches_tracked"):
            assert torch.allclose(share[name].double(), norm.state_dict()[name].double(), rtol=1e-6)


@pytest.mark.parametrize("name", ["together", "resumed", "limited"])
def test_all_processes_have_the_same_network(folder, name):
    first, second = (found(folder, rank)[name] for rank in range(COUNT))
    for part, values in first["network"].items():
        assert torch.equal(values, second["network"][part]), part
    assert first["history"] == second["history"]
    assert str(first["optimizers"]) == str(second["optimizers"])


@pytest.mark.parametrize("name", ["together", "resumed"])
def test_two_processes_train_as_one_does(folder, name):
    alone, together = (load_checkpoint(folder / run / LAST) for run in ("alone", name))
    assert alone["epoch"] == together["epoch"] == 4
    for expected, row in zip(alone["history"], together["history"]):
        assert row["loss"] == pytest.approx(expected["loss"], rel=1e-6)
        assert row["learning_rate"] == expected["learning_rate"]
        # The effect of the biases mentioned below on the scores is less than their total change.
        assert row["validation_epsilon"] == pytest.approx(expected["validation_epsilon"], abs=0.01)
    for part, values in alone["model_state_dict"].items():
        # The gradient of a bias before a normalisation consists of rounding errors only, which Adam
        # scales to full steps; the normalisation removes the bias, and its running mean follows.
        if not part.endswith(("body.0.bias", "running_mean")):
            assert torch.allclose(values, together["model_state_dict"][part], atol=1e-6), part


def test_only_the_first_process_reports(folder):
    lines = found(folder, 0)["resumed"]["lines"]
    assert lines[0] == "resuming after epoch 2" and len(lines) == 3


def test_a_time_limit_ends_all_processes_at_the_same_step(folder):
    first, second = (found(folder, rank)["limited"] for rank in range(COUNT))
    assert first["progress"] == second["progress"] == 1.0
    assert first["history"][-1]["learning_rate"] == 0.0
    assert 1 <= len(first["history"]) < 100_000


def test_shares_are_the_whole_batch():
    for count in (1, 2, 3, 7):
        shares = [Processes(torch.device("cpu"), rank, count).share(7) for rank in range(count)]
        assert [at for share in shares for at in range(7)[share]] == list(range(7))


def test_more_processes_than_samples_in_a_batch_are_refused(dataset_folder, tmp_path):
    data = load_dataset(dataset_folder, "cloudct-10")
    with pytest.raises(InputError, match="batches of 3 samples for 4 processes"):
        Training(RECIPE, data, tmp_path, Processes(torch.device("cpu"), 0, 4))
