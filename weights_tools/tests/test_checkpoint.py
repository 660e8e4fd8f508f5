"""Files that are no checkpoints are refused in one line that says what to do."""

import os
import signal
import warnings

import pytest
import torch
import torch.distributed
from conftest import saved, seasoned_network, weights_metadata, write_dataset
from safetensors.torch import save, save_file

from weights_tools.__main__ import main
from weights_tools.checkpoint import load_checkpoint, state_dict_of
from weights_tools.clouds import Simulation
from weights_tools.dataset import load_dataset
from weights_tools.errors import InputError
from weights_tools.export import export

IMAGES = torch.rand(1, 3, 8, 8)


@pytest.fixture
def state():
    return seasoned_network([3, 4]).state_dict()


@pytest.fixture
def pipe(tmp_path):
    """A named pipe. If it is opened, the alarm ends the process, which would wait for ever."""
    if not hasattr(os, "mkfifo"):
        pytest.skip("the system has no named pipes")
    os.mkfifo(tmp_path / "pipe")
    signal.alarm(60)
    yield tmp_path / "pipe"
    signal.alarm(0)


def refusal(path):
    """The message for a file that is exported."""
    with pytest.raises(InputError) as error:
        export(path, path.with_name("w.safetensors"), weights_metadata(3, 4))
    message = str(error.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    assert "weights_only" not in message
    return message


@pytest.mark.parametrize(
    "command",
    [
        "export PIPE --out w.safetensors",
        "export PIPE.safetensors --out w.safetensors",
        "export NETWORK --metadata PIPE --out w.safetensors",
        "check NETWORK --weights PIPE",
        "check NETWORK --weights PIPE.onnx",
        "train PIPE --dataset data --out run",
        "scenes PIPE --simulations data --out pool",
        "calibrate PIPE --pool pool --out w.safetensors",
    ],
)
def test_named_pipes_are_refused_and_not_opened(tmp_path, pipe, state, command, capsys):
    if ".onnx" in command:
        pytest.importorskip("onnx")
    for suffix in (".safetensors", ".onnx"):
        (tmp_path / f"pipe{suffix}").symlink_to(pipe)
    torch.save(state, tmp_path / "network.pt")
    names = {"PIPE": str(pipe), "NETWORK": str(tmp_path / "network.pt")}
    for word, path in names.items():
        command = command.replace(word, path)
    assert main(command.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is not a regular file; " in line


def test_named_pipes_among_the_data_are_refused(tmp_path, pipe):
    folder = write_dataset(tmp_path / "dataset")
    for name in ("samples/000002.nc", "manifest.json"):
        (folder / name).unlink()
        (folder / name).symlink_to(pipe)
        with pytest.raises(InputError, match=f"{name}: is not a regular file"):
            load_dataset(folder, "cloudct-10")
    with pytest.raises(InputError, match="pipe: is not a regular file"):
        Simulation(pipe, 0, 1)


@pytest.mark.parametrize("length", [0, 5, 300, -1])
def test_damaged_safetensors_are_refused(tmp_path, state, length):
    path = tmp_path / "network.safetensors"
    path.write_bytes(save(state)[:length])
    assert "is damaged or not safetensors" in refusal(path)
    assert main(["export", str(path), "--out", str(tmp_path / "w.safetensors")]) == 2


def test_a_name_that_is_not_that_of_the_format_is_named(tmp_path, state):
    saved(tmp_path / "torch.safetensors", seasoned_network([3, 4]), False)
    assert "name a file of torch.save NAME.pt" in refusal(tmp_path / "torch.safetensors")
    save_file(state, tmp_path / "network.pt")
    expected = "is a safetensors file; name it NAME.safetensors"
    assert refusal(tmp_path / "network.pt").endswith(expected)
    save_file(state, tmp_path / "network.safetensors")
    metadata = weights_metadata(3, 4)
    export(tmp_path / "network.safetensors", tmp_path / "w.safetensors", metadata)


@pytest.mark.parametrize("kind", [torch.float8_e4m3fn, torch.complex64, torch.int8])
def test_values_of_other_types_are_refused(tmp_path, state, kind):
    state = {name: values.to(kind) for name, values in state.items()}
    torch.save(state, tmp_path / "network.pt")
    save_file(state, tmp_path / "network.safetensors")
    for name in ("network.pt", "network.safetensors"):
        problem = f"is of type {str(kind).removeprefix('torch.')}, not float32"
        assert problem in refusal(tmp_path / name)


def test_whole_modules_are_refused(tmp_path):
    torch.save({"model": seasoned_network([3, 4])}, tmp_path / "network.pt")
    message = refusal(tmp_path / "network.pt")
    assert "holds more than tensors and plain values, such as weights_tools.model." in message
    assert "save model.state_dict() with torch.save" in message


def test_programs_are_refused_with_the_way_to_their_state_dict(tmp_path):
    network, metadata = seasoned_network([3, 4]), weights_metadata(3, 4)
    script, program = tmp_path / "network.pt", tmp_path / "network.pt2"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.trace(network, IMAGES), script)
        torch.export.save(torch.export.export(network, (IMAGES,)), program)
        states = torch.jit.load(script).state_dict(), torch.export.load(program).state_dict
    problem = "is a TorchScript file; give the file of torch.save(torch.jit.load(FILE).state_dict()"
    assert problem in refusal(script)
    problem = "is an archive of torch.export; give the file of torch.save(torch.export.load(FILE)."
    assert problem in refusal(program)
    for state in states:
        torch.save(state, tmp_path / "state.pt")
        export(tmp_path / "state.pt", tmp_path / "w.safetensors", metadata)


def test_shards_of_a_distributed_training_are_refused(tmp_path, state):
    name = "torch.distributed._shard.sharded_tensor.api"
    (tmp_path / "sharded.pt").write_bytes(f"c{name}\nShardedTensor\n.".encode())
    (tmp_path / "__0_0.distcp").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / ".metadata").write_bytes(b"")
    for name in ("sharded.pt", "__0_0.distcp", "folder"):
        assert "holds the shards of a distributed training; consolidate" in refusal(tmp_path / name)


def test_distributed_tensors_are_refused(tmp_path, state):
    store = torch.distributed.HashStore()
    torch.distributed.init_process_group("gloo", store=store, rank=0, world_size=1)
    try:
        from torch.distributed.device_mesh import init_device_mesh
        from torch.distributed.tensor import Shard, distribute_tensor

        mesh = init_device_mesh("cpu", (1,))
        name = "net.body.0.body.0.weight"
        shards = {**state, name: distribute_tensor(state[name], mesh, [Shard(0)])}
        torch.save(shards, tmp_path / "network.pt")
        assert "holds the shards of a distributed training" in refusal(tmp_path / "network.pt")
        whole = {**shards, name: shards[name].full_tensor()}
    finally:
        torch.distributed.destroy_process_group()
    torch.save(whole, tmp_path / "whole.pt")
    found = state_dict_of(load_checkpoint(tmp_path / "whole.pt"), "whole.pt")
    assert torch.equal(found[name], state[name])


def test_a_changed_byte_is_refused_or_changes_nothing(tmp_path):
    path = tmp_path / "network.pt"
    state = {"weight": torch.arange(500.0), "epoch": torch.tensor(3)}
    torch.save(state, path)
    content = path.read_bytes()
    refused = 0
    for at in range(0, len(content), 17):
        changed = bytearray(content)
        changed[at] ^= 4
        path.write_bytes(changed)
        try:
            found = load_checkpoint(path)
        except InputError:
            refused += 1
            continue
        assert found.keys() == state.keys(), at
        assert all(torch.equal(found[name], values) for name, values in state.items()), at
    # What is left are the time stamps of the archive, and the padding before its members.
    assert refused > 0.7 * len(range(0, len(content), 17))
