"""PyTorch, deepct and ONNX Runtime give the same results."""

import os
import shutil
import subprocess
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import numpy as np
import pytest
import torch
from conftest import planes_metadata, saved, seasoned_network, weights_metadata
from safetensors.torch import save_file

from weights_tools.__main__ import main
from weights_tools.check import SAME, check, engines
from weights_tools.check import weights_metadata as metadata_of
from weights_tools.export import export
from weights_tools.model import growing_channels

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")
needs_deepct = pytest.mark.skipif(DEEPCT is None, reason="deepct is not on the PATH")


def exported(folder, channels, metadata, suffix):
    checkpoint = saved(folder / "network.pt", seasoned_network(channels), True)
    export(checkpoint, folder / f"w{suffix}", metadata)
    return checkpoint, folder / f"w{suffix}"


@needs_deepct
@pytest.mark.parametrize(("views", "layers"), [(32, 33), (10, 81), (10, 33), (1, 1)])
def test_deepct_gives_the_answer_of_pytorch(tmp_path, views, layers):
    channels, metadata = growing_channels(views, 32, layers), weights_metadata(views, 32)
    checkpoint, weights = exported(tmp_path, channels, metadata, ".safetensors")
    for engine in engines(weights, DEEPCT):
        assert max(check(checkpoint, weights, engine)) <= engine.tolerance, engine.name


@needs_deepct
def test_deepct_lays_images_on_planes_and_gives_all_outputs_as_pytorch_does(tmp_path):
    metadata = planes_metadata([0.6, 0.95, 1.12, 1.61], 16)
    metadata["outputs"] = ["extinction", "uncertainty"]
    checkpoint, weights = exported(tmp_path, [4 * 4, 24, 32], metadata, ".safetensors")
    for engine in engines(weights, DEEPCT):
        assert max(check(checkpoint, weights, engine)) <= engine.tolerance, engine.name


@pytest.mark.parametrize(
    ("channels", "metadata"),
    [
        (growing_channels(10, 32, 33), weights_metadata(10, 32)),
        ([1, 32], weights_metadata(1, 32)),
        ([4 * 4, 24, 32], planes_metadata([0.6, 0.95, 1.12, 1.61], 32)),
        ([3 * 4, 24, 32], planes_metadata([0.6, 1.12, 1.61], 32)),
    ],
)
def test_onnx_runtimes_give_the_answer_of_pytorch(tmp_path, channels, metadata):
    pytest.importorskip("onnxruntime")
    checkpoint, weights = exported(tmp_path, channels, metadata, ".onnx")
    found = engines(weights, "no program")
    # The others, OpenVINO and tract, are compared where they are installed.
    assert found[0].name == "onnxruntime" and found[0].tolerance == SAME
    for engine in found:
        assert max(check(checkpoint, weights, engine)) <= engine.tolerance, engine.name


def test_openvino_is_compared_where_it_is_installed(tmp_path, monkeypatch):
    """With the setting without which it computes in bfloat16 on some processors."""
    metadata, asked = weights_metadata(1, 4), {}
    _, weights = exported(tmp_path, [1, 4], metadata, ".onnx")

    class Core:
        def compile_model(self, path, device, properties):
            asked.update(properties, path=path, device=device)
            return lambda inputs: {"extinction": np.zeros((1, 4, *inputs["radiance"].shape[2:]))}

    module = ModuleType("openvino")
    module.__spec__, module.Core = ModuleSpec("openvino", None), Core
    monkeypatch.setitem(sys.modules, "openvino", module)
    (engine,) = [each for each in engines(weights, "no program") if each.name == "openvino"]
    assert engine.run(np.zeros((1, 5, 6), np.float32), metadata).shape == (4, 5, 6)
    assert asked["INFERENCE_PRECISION_HINT"] == "f32" and asked["path"] == str(weights)
    assert "INFERENCE_PRECISION_HINT=f32" in engine.settings


@needs_deepct
@pytest.mark.parametrize("size", [(5, 9), (32, 32), (150, 70)])
def test_onnx_runtime_gives_the_answer_of_deepct(tmp_path, size):
    pytest.importorskip("onnxruntime")
    metadata = planes_metadata([0.6, 0.95, 1.12, 1.61], 32)
    images = 0.3 * np.random.default_rng(5).random((4, *size), dtype=np.float32)
    answers = []
    for suffix in (".onnx", ".safetensors"):
        _, weights = exported(tmp_path, [4 * 4, 24, 32], metadata, suffix)
        # The first engine of deepct is the direct convolution.
        answers.append(engines(weights, DEEPCT)[0].run(images, metadata_of(weights)))
    assert answers[0].shape == (32, *size)
    assert abs(answers[0] - answers[1]).max() <= SAME * answers[1].max()


@needs_deepct
def test_networks_with_another_epsilon_are_the_same(tmp_path):
    pytest.importorskip("onnxruntime")
    metadata = {**weights_metadata(3, 4), "configuration": {"batch_norm_epsilon": 0.1}}
    for suffix in (".safetensors", ".onnx"):
        checkpoint, weights = exported(tmp_path, [3, 8, 4], metadata, suffix)
        for engine in engines(weights, DEEPCT):
            assert max(check(checkpoint, weights, engine)) <= engine.tolerance, engine.name


@needs_deepct
def test_deepct_shows_the_scores_of_the_scale_that_was_measured(tmp_path):
    metadata = {**weights_metadata(3, 4), "scores": {"epsilon": 0.4, "delta": 0.2}}
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    export(checkpoint, tmp_path / "w.safetensors", metadata, unbiased=1.0)
    command = [DEEPCT, "weights", "inspect", str(tmp_path / "w.safetensors")]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    scores = dict(line.split() for line in run.stdout.splitlines()[-2:])
    assert scores == {"delta_biased": "0.2000", "epsilon_biased": "0.4000"}


def test_weights_of_any_formation_are_not_compared(tmp_path, capsys):
    save_file({"a": torch.ones(1)}, tmp_path / "w.safetensors", {"deepct": "{}"})
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    assert main(["check", str(checkpoint), "--weights", str(tmp_path / "w.safetensors")]) == 2
    assert "is not of a network for one formation" in capsys.readouterr().err


@needs_deepct
def test_other_weights_are_found_out(tmp_path, capsys):
    for seed in (1, 2):
        checkpoint = saved(tmp_path / f"{seed}.pt", seasoned_network([3, 8, 4], seed), False)
        export(checkpoint, tmp_path / f"{seed}.safetensors", weights_metadata(3, 4))
    command = ["check", str(tmp_path / "1.pt"), "--deepct", DEEPCT, "--weights"]
    assert main([*command, str(tmp_path / "1.safetensors")]) == 0
    assert main([*command, str(tmp_path / "2.safetensors")]) == 1
    assert "DIFFERENT" in capsys.readouterr().out
