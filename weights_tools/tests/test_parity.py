"""``deepct`` and PyTorch on the paper's two networks, at their full depth.

Wants ``deepct`` on the PATH, or built with ``cargo build --release``.
"""

import json
import shutil
from pathlib import Path

import pytest
import torch
from conftest import saved, weights_metadata

from weights_tools.check import SIZES, TOLERANCE, check
from weights_tools.export import export
from weights_tools.model import Network, growing_channels

BUILT = Path(__file__).parents[2] / "target" / "release" / "deepct"


def well_conditioned_network(channels: list[int]) -> Network:
    """Random layers that hand on most of what they get, as those of a trained network do.

    Layers that are random and nothing else amplify a rounding error with every batch norm:
    81 of them give another answer in float32 than in float64, whoever computes it.
    """
    torch.manual_seed(0)
    network = Network(channels)
    for block in network.net.body:
        convolution, norm = block.body[0], block.body[1]
        passed_on = torch.nn.init.dirac_(torch.empty_like(convolution.weight))
        convolution.weight.data.mul_(0.3).add_(passed_on)
        torch.nn.init.uniform_(convolution.bias, -0.2, 0.2)
        torch.nn.init.uniform_(norm.weight, 0.6, 1.4)
        torch.nn.init.uniform_(norm.bias, 0.0, 1.0)
    network.train()
    with torch.no_grad():
        for _ in range(40):
            network(torch.rand(8, channels[0], 16, 16) ** 2)
    return network.eval()


@pytest.mark.parametrize(("views", "layers"), [(32, 33), (10, 81)])
def test_the_published_layouts_agree(tmp_path: Path, views: int, layers: int) -> None:
    deepct = shutil.which("deepct") or str(BUILT)
    network = well_conditioned_network(growing_channels(views, 32, layers))
    checkpoint = saved(tmp_path / "network.pt", network, wrapped=False)
    weights = tmp_path / "network.safetensors"
    export(checkpoint, weights, weights_metadata(views, 32))
    errors = check(checkpoint, weights, deepct)
    print(json.dumps(dict(zip(map(str, SIZES), errors))))
    assert len(errors) == len(SIZES)
    assert max(errors) <= TOLERANCE, errors
