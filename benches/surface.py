#!/usr/bin/env python3
"""Scores of general weights for the scenes of a pool, and variants of the adjustment to the surface
(docs/notes/general_network.md, docs/notes/learning.md).

    python -m weights_tools scenes RECIPE.toml --simulations FOLDER --out POOL --chunks 30
    python benches/surface.py --pool POOL --weights general.safetensors --variants
    python benches/surface.py --pool POOL --weights a.safetensors,b.safetensors --split validation

Without --variants, the script prints epsilon and delta of each network for the scenes in the light
of the paper with the views of cloudct-10, without carving, as the training does for its validation.
With --variants, it prints epsilon for ten random views of the scenes with any surface, by the
albedo that is found, with other constants of `weights_tools.surface`.

Needs weights_tools and PyTorch.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from weights_tools import surface
from weights_tools.general import GeneralNetwork, with_extremes
from weights_tools.general_file import load_general
from weights_tools.metrics import mass_error, relative_error
from weights_tools.planes import on_planes
from weights_tools.scenes import CLOUDCT_10, PEARLS_32_DEG
from weights_tools.sensor import Sensor
from weights_tools.stream import Pool
from weights_tools.views import Views

BATCH = 16
ALBEDOS = (0.0, 0.03, 0.045, 0.055, 0.08, 0.12, 0.16, 0.3)
"""Limits of the classes of the variants."""
ANY = tuple(range(len(PEARLS_32_DEG), len(PEARLS_32_DEG) + 10))
"""Ten views in random directions."""


class Judge:
    """A network and the scenes of a pool."""

    def __init__(self, weights: str, pool: Pool) -> None:
        loaded = load_general(weights)
        network = loaded.network
        if not network.architecture.extremes:
            network = with_extremes(network)
        self.network: GeneralNetwork = network.eval()
        self.description, self.pool = loaded.description, pool

    def scores(self, scenes: torch.Tensor, views: tuple[int, ...],
               reference: float | None) -> np.ndarray:
        """Epsilon, delta and the albedo that is found, ``[scene, 3]``."""
        generator, parts = torch.Generator().manual_seed(5), []
        for part in scenes.split(BATCH):
            chosen = torch.tensor(views).expand(len(part), -1)
            truth, radiance, geometry, _ = self.pool.take(part, chosen)
            images = Sensor().sense(radiance, generator, normal=True)
            albedo = found_albedo(images, geometry)
            if reference is not None:
                images = surface.above_surface(images, geometry, reference)
            scaled = images * self.description.input_scale
            planes = on_planes(scaled, geometry, self.network.architecture.heights)
            with torch.no_grad():
                outputs = self.network(planes, geometry).float() * self.description.output_scale
            estimate = outputs.chunk(2, 1)[0]
            errors = relative_error(truth, estimate), mass_error(truth, estimate)
            parts.append(torch.stack([*errors, albedo.double()], 1))
        return torch.cat(parts).numpy()


def found_albedo(images: torch.Tensor, views: Views) -> torch.Tensor:
    path, factor = (each[..., None, None] for each in surface.clear_radiance(views))
    return ((images - path) / factor).flatten(1).quantile(0.25, dim=1)


def variants(judge: Judge, scenes: torch.Tensor) -> None:
    print("| | all | " + " | ".join(f"{low} to {high}" for low, high in
                                    zip(ALBEDOS[:-1], ALBEDOS[1:])) + " |")
    share, hiding = surface.CLEAR_SHARE, surface.HIDING
    for name, values in {
        "without": (None, share, hiding), "same in all pixels": (0.05, share, 1e9),
        "hiding 0.3": (0.05, share, 0.3), "hiding 0.15": (0.05, share, 0.15),
        "hiding 0.1": (0.05, share, 0.1), "hiding 0.03": (0.05, share, 0.03),
        "darkest tenth": (0.05, 0.1, hiding), "to 0.045": (0.045, share, hiding),
        "to 0.06": (0.06, share, hiding),
    }.items():
        reference, surface.CLEAR_SHARE, surface.HIDING = values
        epsilon, _, albedo = judge.scores(scenes, ANY, reference).T
        classes = [epsilon[(albedo >= low) & (albedo < high)]
                   for low, high in zip(ALBEDOS[:-1], ALBEDOS[1:])]
        print(f"| {name} | {epsilon.mean():.3f} | "
              + " | ".join(f"{each.mean():.3f}" if len(each) else "" for each in classes) + " |",
              flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pool", type=Path, required=True)
    parser.add_argument("--weights", required=True, help="files, with commas")
    parser.add_argument("--split", default="train", choices=["train", "validation"])
    parser.add_argument("--scenes", type=int, default=480, help="number of scenes, at most")
    parser.add_argument("--variants", action="store_true")
    arguments = parser.parse_args()
    pool = Pool(arguments.pool, arguments.split, 400, torch.device("cpu"))
    pool.update()
    for weights in arguments.weights.split(","):
        judge = Judge(weights, pool)
        if arguments.variants:
            lit = pool.take(pool.all, torch.zeros(len(pool.all), 1, dtype=torch.long))[3]
            variants(judge, pool.all[~lit][: arguments.scenes])
            continue
        epsilon, delta, _ = judge.scores(pool.paper[: arguments.scenes], CLOUDCT_10,
                                         judge.description.surface_albedo).T
        print(f"{weights}: {len(epsilon)} scenes, epsilon {epsilon.mean():.3f}, "
              f"delta {delta.mean():+.3f}", flush=True)


if __name__ == "__main__":
    main()
