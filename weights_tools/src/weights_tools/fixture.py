"""Fixtures that compare the general network of ``deepct`` with that of PyTorch.

    python -m weights_tools.fixture FOLDER

``general.safetensors`` are the weights of a small random network. ``general.json`` contains random
geometries (``view_geometry`` as in the weights files of fixed formations, ``horizontal_spacing_km``
and ``target_altitude_km``). ``general.answers.safetensors`` contains for the geometry ``k``, all
computed in float64 and stored as float32,

- ``{k}.output`` ``[2 levels, row, col]``: the output of the unfolded network (scaled) for images of
  the function :func:`images`, which are the scaled input;
- ``{k}.layers.0.weight``, ``{k}.layers.0.bias``, ...: the folded layers, for the first
  :data:`DETAILED` geometries;
- ``{k}.view_features``, ``{k}.scene_features``, ``{k}.mixing`` ``[virtual view, view]``.
"""

from __future__ import annotations

import copy
import json
import random
import sys
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

from weights_tools.checkpoint import write_whole
from weights_tools.general import GeneralArchitecture, GeneralNetwork, fold
from weights_tools.general_file import GeneralDescription, GeneralWeights, write_general_weights
from weights_tools.planes import on_planes
from weights_tools.views import Views, scene_features, view_features, views_of

GEOMETRIES = 50
"""Number of geometries of a fixture."""

DETAILED = 5
"""Number of geometries whose folded layers are part of a fixture."""

SIZE = (13, 11)
"""Rows and columns of the images."""

SMALL = GeneralArchitecture(virtual_views=3, planes=2, width=4, layers=3, levels=4)
"""The architecture of the network of a fixture."""


def write_fixture(folder: str | Path, extremes: bool = True, name: str = "general") -> None:
    """Write the three files of a fixture, which begin with ``name``, into an existing folder."""
    folder = Path(folder)
    architecture = GeneralArchitecture(**{**vars(SMALL), "extremes": extremes})
    network = random_network(architecture, seed=1)
    description = GeneralDescription(
        input_scale=1.0,
        output_scale=1.0,
        training={"data": "none", "identity": "none", "samples": 0, "seed": 1},
        scores={"epsilon": 0.5, "delta": 0.0},
    )
    weights = GeneralWeights(network, description)
    write_general_weights(folder / f"{name}.safetensors", weights)
    geometries = random_geometries(GEOMETRIES, seed=2)
    (folder / f"{name}.json").write_text(json.dumps(geometries) + "\n")
    answers: dict[str, Tensor] = {}
    for index, geometry in enumerate(geometries):
        views = views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])
        values = answer(network, views)
        scene = scene_features(views)
        details = {"scene_features": scene[0], "view_features": view_features(views, scene)[0]}
        with torch.no_grad():
            details["mixing"] = copy.deepcopy(network).double().mixing_factors(views, scene)[0]
        if index < DETAILED:
            details.update(fold(network, views))
        answers[f"{index}.output"] = values.float().contiguous()
        for key, tensor in details.items():
            answers[f"{index}.{key}"] = tensor.float().contiguous()
    write_whole(folder / f"{name}.answers.safetensors", safetensors.torch.save(answers))


def answer(network: GeneralNetwork, views: Views) -> Tensor:
    """The output ``[2 levels, row, col]`` for the images of :func:`images`, in float64."""
    pictures = images(views.pixel.shape[1], *SIZE)
    planes = on_planes(pictures[None], views, network.architecture.heights)
    with torch.no_grad():
        return copy.deepcopy(network).double()(planes, views)[0]


def images(views: int, rows: int, cols: int) -> Tensor:
    """Pseudo-random multiples of 1/128 in [0, 1), which are exact in float32, in float64.

    The value of the pixel with the index ``k`` is ``(7919 k + 31 floor(k / 97)) mod 128 / 128``.
    """
    index = torch.arange(views * rows * cols)
    values = (index * 7919 + index // 97 * 31) % 128
    return (values.double() / 128.0).reshape(views, rows, cols)


def random_network(architecture: GeneralArchitecture, seed: int) -> GeneralNetwork:
    """A network with random parameters and the running statistics of random images, in evaluation
    mode. Scales, shifts and mixing factors differ between geometries."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = GeneralNetwork(architecture)
        for layer in network.layers:
            torch.nn.init.uniform_(layer.bias, -0.2, 0.2)
            torch.nn.init.uniform_(layer.batch_norm.weight, 0.6, 1.4)
            torch.nn.init.uniform_(layer.batch_norm.bias, -0.3, 0.3)
        torch.nn.init.normal_(network.modulation[-1].weight, 0.0, 0.2)
        torch.nn.init.normal_(network.modulation[-1].bias, 0.0, 0.1)
        with torch.no_grad():
            for geometry in random_geometries(40, seed):
                views = views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])
                shape = (1, views.pixel.shape[1], architecture.planes, 16, 16)
                network(torch.rand(shape), views.to(torch.float32))
    return network.eval()


def random_geometries(count: int, seed: int) -> list[dict[str, Any]]:
    """Geometries of 3 to 40 views in any direction, some of them along tracks, with parallel rays
    or for voxels of another size."""
    draw = random.Random(seed)
    return [_geometry(draw, index) for index in range(count)]


def _geometry(draw: random.Random, index: int) -> dict[str, Any]:
    count = draw.choice([3, 4, 5, 8, 10, 20, 40])
    voxel = draw.choice([0.05, 0.05, 0.015, 0.1, 0.15])
    azimuth = draw.uniform(0.0, 360.0)

    def view() -> tuple[float, float]:
        if index % 3 == 0:
            angle = draw.uniform(-75.0, 75.0)
            return abs(angle), (azimuth + 180.0 * (angle < 0.0)) % 360.0
        return draw.uniform(0.0, 75.0), draw.uniform(0.0, 360.0)

    views = [view() for _ in range(count)]
    parallel = index % 7 == 6
    return {
        "horizontal_spacing_km": voxel,
        "target_altitude_km": round(draw.uniform(0.5, 2.5), 2),
        "view_geometry": {
            "sun_zenith_deg": round(draw.uniform(0.0, 70.0), 3),
            "sun_azimuth_deg": round(draw.uniform(0.0, 360.0), 3),
            "view_zenith_deg": [round(zenith, 3) for zenith, _ in views],
            "view_azimuth_deg": [round(azimuth, 3) for _, azimuth in views],
            "pixel_km": [round(voxel * draw.uniform(0.4, 2.8), 5) for _ in views],
            "camera_distance_km": [
                None if parallel else round(draw.uniform(100.0, 1500.0), 2) for _ in views
            ],
        },
    }


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m weights_tools.fixture FOLDER")
    write_fixture(sys.argv[1])
