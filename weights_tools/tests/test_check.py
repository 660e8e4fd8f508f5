"""The same answer from PyTorch and from deepct."""

import os
import shutil

import pytest
from conftest import planes_metadata, saved, seasoned_network, weights_metadata

from weights_tools.__main__ import main
from weights_tools.check import TOLERANCES, check
from weights_tools.export import export
from weights_tools.model import growing_channels

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")


@pytest.mark.skipif(DEEPCT is None, reason="deepct is not on the PATH")
@pytest.mark.parametrize(("views", "layers"), [(32, 33), (10, 81), (10, 33), (1, 1)])
@pytest.mark.parametrize("algorithm", TOLERANCES)
def test_deepct_gives_the_answer_of_pytorch(tmp_path, views, layers, algorithm):
    network = seasoned_network(growing_channels(views, 32, layers))
    checkpoint = saved(tmp_path / "network.pt", network, True)
    export(checkpoint, tmp_path / "w.safetensors", weights_metadata(views, 32))
    errors = check(checkpoint, tmp_path / "w.safetensors", DEEPCT, algorithm)
    assert max(errors) <= TOLERANCES[algorithm]


@pytest.mark.skipif(DEEPCT is None, reason="deepct is not on the PATH")
@pytest.mark.parametrize("algorithm", TOLERANCES)
def test_deepct_lays_images_on_planes_and_gives_all_outputs_as_pytorch_does(tmp_path, algorithm):
    metadata = planes_metadata([0.6, 0.95, 1.12, 1.61], 16)
    metadata["outputs"] = ["extinction", "uncertainty"]
    network = seasoned_network([4 * 4, 24, 32])
    checkpoint = saved(tmp_path / "network.pt", network, True)
    export(checkpoint, tmp_path / "w.safetensors", metadata)
    errors = check(checkpoint, tmp_path / "w.safetensors", DEEPCT, algorithm)
    assert max(errors) <= TOLERANCES[algorithm]


@pytest.mark.skipif(DEEPCT is None, reason="deepct is not on the PATH")
def test_other_weights_are_found_out(tmp_path, capsys):
    for seed in (1, 2):
        checkpoint = saved(tmp_path / f"{seed}.pt", seasoned_network([3, 8, 4], seed), False)
        export(checkpoint, tmp_path / f"{seed}.safetensors", weights_metadata(3, 4))
    command = ["check", str(tmp_path / "1.pt"), "--deepct", DEEPCT, "--weights"]
    assert main([*command, str(tmp_path / "1.safetensors")]) == 0
    assert main([*command, str(tmp_path / "2.safetensors")]) == 1
    assert "DIFFERENT" in capsys.readouterr().out
