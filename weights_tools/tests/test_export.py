"""Conversion of checkpoints to weights files."""

import json
import math
import os
import pickle
import subprocess
from pathlib import Path

import pytest
import torch
from conftest import saved, seasoned_network, weights_metadata
from safetensors import safe_open
from safetensors.torch import load_file
from test_files import DEEPCT

from weights_tools.__main__ import main
from weights_tools.errors import InputError
from weights_tools.export import METADATA_KEYS, export, folded_layers

TRAINING = {"data": "none", "identity": "none", "samples": 0, "seed": 0}
WEIGHTS = Path(__file__).parents[2] / "crates/deepct-core/weights"


@pytest.mark.parametrize("wrapped", [False, True])
def test_both_kinds_of_checkpoint_become_the_same_weights(tmp_path, wrapped):
    network = seasoned_network([3, 6, 4])
    checkpoint = saved(tmp_path / "network.pt", network, wrapped)
    export(checkpoint, tmp_path / "w.safetensors", weights_metadata(3, 4))
    tensors = load_file(tmp_path / "w.safetensors")
    assert set(tensors) == {f"layers.{i}.{part}" for i in (0, 1) for part in ("weight", "bias")}
    images = torch.rand(2, 3, 9, 5)
    output = images
    for layer in range(2):
        weight, bias = tensors[f"layers.{layer}.weight"], tensors[f"layers.{layer}.bias"]
        output = torch.nn.functional.conv2d(output, weight, bias, padding=1).relu()
    with torch.no_grad():
        assert torch.allclose(output, network(images), rtol=1e-5, atol=1e-5)
    with safe_open(tmp_path / "w.safetensors", "pt") as file:
        header = json.loads(file.metadata()["deepct"])
    assert header["architecture"] == {"channels": [3, 6, 4], "last_relu": True}
    assert set(header) == {*METADATA_KEYS, "architecture", "format_version", "program"}


def test_folding_is_exact_to_the_last_bit_of_f32():
    network = seasoned_network([2, 3])
    layers = folded_layers(network)
    block = network.double().net.body[0]
    images = torch.rand(1, 2, 6, 6, dtype=torch.float64)
    with torch.no_grad():
        folded = torch.nn.functional.conv2d(
            images, layers["layers.0.weight"].double(), layers["layers.0.bias"].double(), padding=1
        )
        normed = block.body[1](block.body[0](images))
    assert (folded - normed).abs().max() < 2e-7 * normed.abs().max() * 18


def test_another_epsilon_of_the_batch_normalisation_is_folded(tmp_path, capsys):
    network = seasoned_network([3, 6, 4])
    for block in network.net.body:
        block.body[1].eps = 1e-3
        block.body[1].running_var.mul_(1e-2)
    checkpoint = saved(tmp_path / "network.pt", network, False)
    (tmp_path / "metadata.json").write_text(json.dumps(weights_metadata(3, 4)))
    command = ["export", str(checkpoint), "--out", str(tmp_path / "w.safetensors"), "--metadata"]
    assert main([*command, str(tmp_path / "metadata.json")]) == 0
    assumed = "assumed: padding with zeros, batch normalisation with epsilon"
    assert f"{assumed} 1e-05\n" in capsys.readouterr().out
    others = load_file(tmp_path / "w.safetensors")
    metadata = {**weights_metadata(3, 4), "configuration": {"batch_norm_epsilon": 1e-3}}
    (tmp_path / "metadata.json").write_text(json.dumps(metadata))
    assert main([*command, str(tmp_path / "metadata.json")]) == 0
    assert f"{assumed} 0.001\n" in capsys.readouterr().out
    found = load_file(tmp_path / "w.safetensors")
    for index, block in enumerate(network.net.body):
        name = f"layers.{index}.weight"
        variance = block.body[1].running_var.double()
        for layers, epsilon in ((others, 1e-5), (found, 1e-3)):
            factor = block.body[1].weight.double() / (variance + epsilon).sqrt()
            expected = block.body[0].weight.double() * factor[:, None, None, None]
            torch.testing.assert_close(layers[name], expected.float(), rtol=1e-6, atol=0.0)
    images = torch.rand(2, 3, 9, 5, dtype=torch.float64)
    output = images
    for index in range(2):
        weight, bias = (found[f"layers.{index}.{part}"].double() for part in ("weight", "bias"))
        output = torch.nn.functional.conv2d(output, weight, bias, padding=1).relu()
    with torch.no_grad():
        expected = network.double()(images)
    assert (output - expected).abs().max() < 1e-6 * expected.max()
    with safe_open(tmp_path / "w.safetensors", "pt") as file:
        header = json.loads(file.metadata()["deepct"])
    assert header["configuration"] == {"batch_norm_epsilon": 1e-3}


@pytest.mark.parametrize("epsilon", [0.0, -1e-3, math.inf, math.nan, "1e-3", True])
def test_an_epsilon_that_is_not_positive_is_refused(tmp_path, epsilon):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    metadata = {**weights_metadata(3, 4), "configuration": {"batch_norm_epsilon": epsilon}}
    with pytest.raises(InputError, match="network.pt: its batch_norm_epsilon is"):
        export(checkpoint, tmp_path / "w.safetensors", metadata)


@pytest.mark.parametrize("padding", ["circular", "reflect", "replicate"])
def test_other_padding_than_by_zeros_is_refused(tmp_path, padding):
    network = seasoned_network([3, 4])
    checkpoint = saved(tmp_path / "network.pt", network, False)
    metadata = {**weights_metadata(3, 4), "configuration": {"padding_mode": padding}}
    for name in ("w.safetensors", "w.onnx"):
        with pytest.raises(InputError, match=f"its padding_mode is '{padding}'"):
            export(checkpoint, tmp_path / name, metadata)
    network.net.body[0].body[0].padding_mode = padding
    with pytest.raises(InputError, match=f"net.body.0.body.0: its padding_mode is '{padding}'"):
        folded_layers(network)


def test_a_pickle_with_code_is_refused_and_does_not_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    for name, write in (
        ("zip.pt", lambda path: torch.save({"model_state_dict": Trap()}, path)),
        ("plain.pt", lambda path: path.write_bytes(pickle.dumps(Trap()))),
    ):
        write(tmp_path / name)
        with pytest.raises(InputError, match=name):
            export(tmp_path / name, tmp_path / "w.safetensors", weights_metadata(3, 4))
    assert not (tmp_path / "sprung").exists()
    assert not (tmp_path / "w.safetensors").exists()


@pytest.mark.parametrize(
    "content", [b"", b"not a checkpoint", b"PK\x03\x04 cut", pickle.dumps({"state": "words"})]
)
def test_files_that_are_no_checkpoint_are_refused(tmp_path, content):
    (tmp_path / "network.pt").write_bytes(content)
    with pytest.raises(InputError, match="network.pt"):
        export(tmp_path / "network.pt", tmp_path / "w.safetensors", weights_metadata(3, 4))


def test_truncated_checkpoints_are_refused(tmp_path):
    whole = saved(tmp_path / "whole.pt", seasoned_network([3, 4]), True).read_bytes()
    for length in (10, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.pt").write_bytes(whole[:length])
        with pytest.raises(InputError, match="cut.pt"):
            export(tmp_path / "cut.pt", tmp_path / "w.safetensors", weights_metadata(3, 4))


@pytest.mark.parametrize("value", [torch.ones(3), {"model_state_dict": [1]}, {"a": torch.ones(1)}])
def test_checkpoints_of_something_else_are_refused(tmp_path, value):
    torch.save(value, tmp_path / "network.pt")
    with pytest.raises(InputError, match="network.pt"):
        export(tmp_path / "network.pt", tmp_path / "w.safetensors", weights_metadata(3, 4))


def test_metadata_has_to_be_complete_and_known(tmp_path, capsys):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    command = ["export", str(checkpoint), "--out", str(tmp_path / "w.safetensors")]
    assert main(command) == 2
    assert "--metadata" in capsys.readouterr().err
    metadata = weights_metadata(3, 4)
    (tmp_path / "metadata.json").write_text(json.dumps({**metadata, "sun": 3}))
    assert main([*command, "--metadata", str(tmp_path / "metadata.json")]) == 2
    assert "unknown metadata sun" in capsys.readouterr().err
    (tmp_path / "metadata.json").write_text(json.dumps(metadata))
    assert main([*command, "--metadata", str(tmp_path / "metadata.json")]) == 0


def test_unbiased_weights_have_the_total_of_their_validation_clouds(tmp_path, capsys):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    metadata = {**weights_metadata(3, 4), "scores": {"epsilon": 0.4, "delta": 0.2}}
    # 0.2 of the total was missing: 0.8 times 1.25 is 1, and 0.8 times 1.125 is 0.9.
    for share, scale in ((1.0, 1.25), (0.5, 1.125)):
        lines = export(checkpoint, tmp_path / "w.safetensors", metadata, unbiased=share)
        assert "the scores of this scale are not measured" in lines[1]
        with safe_open(tmp_path / "w.safetensors", "pt") as file:
            header = json.loads(file.metadata()["deepct"])
        assert header["output_scale"] == pytest.approx(scale * metadata["output_scale"])
        assert header["scores"] == {"epsilon_biased": 0.4, "delta_biased": 0.2}
    for scores, delta in (({}, "None"), ({"delta": 1.0}, "1.0"), ({"delta": math.nan}, "nan")):
        metadata["scores"] = scores
        with pytest.raises(InputError, match=f"its scores have a delta of {delta}"):
            export(checkpoint, tmp_path / "w.safetensors", metadata, unbiased=1.0)
    command = ["export", str(checkpoint), "--out", str(tmp_path / "w.safetensors")]
    with pytest.raises(SystemExit):
        main([*command, "--unbiased", "1.5"])
    assert "from 0 to 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"training": {}},
            "has no metadata training.data, training.identity, training.samples, training.seed; ",
        ),
        ({"levels": {"count": 4}}, "has no metadata levels.bottom_km, levels.spacing_km; "),
        ({"view_geometry": {}}, "has no metadata view_geometry.pixel_km, "),
        ({"training": "bomex"}, "its training is 'bomex'; give an object"),
        ({"training": {**TRAINING, "data": 1}}, "its training.data is 1; "),
        ({"input_scale": "10"}, "its input_scale is '10'; give --metadata in which it is of kind"),
        ({"training": {**TRAINING, "top": 2}}, "unknown metadata training.top; "),
        ({"scores": None}, "its scores is None; "),
    ],
)
def test_incomplete_parts_of_the_metadata_are_refused_by_name(tmp_path, changes, message):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    with pytest.raises(InputError) as error:
        export(checkpoint, tmp_path / "w.safetensors", {**weights_metadata(3, 4), **changes})
    assert message in str(error.value) and "\n" not in str(error.value)
    assert not (tmp_path / "w.safetensors").exists()


@pytest.mark.parametrize("name", ["cloudct-10", "general"])
def test_what_deepct_prints_of_weights_is_metadata(tmp_path, capsys, name):
    """The output of ``deepct weights inspect --json`` exports the same file again."""
    if name == "general":
        network, first = WEIGHTS / "general.safetensors", []
    else:
        network = saved(tmp_path / "network.pt", seasoned_network([3, 6, 4]), False)
        metadata = weights_metadata(3, 4)
        metadata["view_geometry"]["camera_distance_km"] = [600.0, 700.0, None]
        (tmp_path / "metadata.json").write_text(json.dumps(metadata))
        first = ["--metadata", str(tmp_path / "metadata.json")]
    one, other = tmp_path / "one.safetensors", tmp_path / "other.safetensors"
    assert main(["export", str(network), "--out", str(one), *first]) == 0
    command = [DEEPCT, "weights", "inspect", str(one), "--json"]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    (tmp_path / "printed.json").write_text(found)
    printed = ["--metadata", str(tmp_path / "printed.json")]
    assert main(["export", str(network), "--out", str(other), *printed]) == 0
    headers = []
    for path in (one, other):
        with safe_open(path, "pt") as file:
            headers.append(json.loads(file.metadata()["deepct"]))
    assert headers[0] == headers[1]
    for key, values in load_file(one).items():
        assert torch.equal(values, load_file(other)[key])
    capsys.readouterr()


@pytest.mark.parametrize("prefix", ["", "model.", "network.module."])
def test_checkpoints_of_lightning_are_found(tmp_path, prefix):
    network = seasoned_network([3, 6, 4])
    state = {f"{prefix}{name}": values for name, values in network.state_dict().items()}
    lightning = {"epoch": 3, "global_step": 7, "pytorch-lightning_version": "2.4.0"}
    torch.save({**lightning, "state_dict": state, "optimizer_states": []}, tmp_path / "last.ckpt")
    export(tmp_path / "last.ckpt", tmp_path / "w.safetensors", weights_metadata(3, 4))
    for name, values in folded_layers(network).items():
        assert torch.equal(load_file(tmp_path / "w.safetensors")[name], values)


def test_a_stack_of_other_layers_is_refused_with_the_one_that_is_needed(tmp_path):
    state = seasoned_network([3, 6, 4]).state_dict()
    plain = {name: values for name, values in state.items() if ".1.body.1." not in name}
    bare = {name: values for name, values in state.items() if name != "net.body.0.body.0.bias"}
    renamed = {f"layers.{name}": values for name, values in plain.items() if "running" in name}
    needed = "every layer, the last one too, must be a Conv2d of 3 x 3 pixels with a bias "
    for wrong, problem in [
        (plain, "layer 1 has no batch normalisation (net.body.1.body.1); "),
        (bare, "net.body.0.body.0.bias"),
        (renamed, "has no parameter named net.body.0.body.0.weight; "),
    ]:
        torch.save(wrong, tmp_path / "network.pt")
        with pytest.raises(InputError) as error:
            export(tmp_path / "network.pt", tmp_path / "w.safetensors", weights_metadata(3, 4))
        message = str(error.value)
        assert problem in message and needed in message and "\n" not in message


def test_a_missing_folder_is_named_and_no_temporary_file(tmp_path, capsys):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    (tmp_path / "metadata.json").write_text(json.dumps(weights_metadata(3, 4)))
    out = tmp_path / "missing" / "w.safetensors"
    options = ["--metadata", str(tmp_path / "metadata.json")]
    assert main(["export", str(checkpoint), "--out", str(out), *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{out}: is to be in the folder {out.parent}, which does not exist; create" in line
    assert ".tmp" not in line


@pytest.mark.parametrize(("views", "layout"), [(10, "camera"), (80, "planes")])
def test_a_state_dict_becomes_weights_in_one_command(tmp_path, capsys, views, layout):
    """Layout and outputs follow from the channels, the situation from built-in weights."""
    network = seasoned_network([views, 8, 64])
    path = tmp_path / "own.pt"
    torch.save({"state_dict": {f"module.{k}": v for k, v in network.state_dict().items()}}, path)
    out = tmp_path / "own.safetensors"
    assert main(["export", str(path), "--like", "cloudct-10", "--out", str(out)]) == 0
    assert "as cloudct-10: input_scale 1, output_scale 1" in capsys.readouterr().out
    own = json.loads(subprocess.check_output([DEEPCT, "weights", "inspect", out, "--json"]))
    like = json.loads(
        subprocess.check_output([DEEPCT, "weights", "inspect", "cloudct-10", "--json"])
    )
    for key in ("view_geometry", "levels", "wavelength_um", "target_altitude_km"):
        assert own[key] == like[key]
    assert own["outputs"] == ["extinction", "uncertainty"]
    assert layout in str(own["image_layout"])
    wrong = tmp_path / "wrong.pt"
    torch.save(seasoned_network([7, 8, 64]).state_dict(), wrong)
    assert main(["export", str(wrong), "--like", "cloudct-10", "--out", str(out)]) == 2
    assert "its first layer takes 7 channels, but cloudct-10 has 10 or 80" in capsys.readouterr().err
