#!/usr/bin/env python3
"""What does not improve the general network without training, and how often wrong images are named.

    python3 benches/general.py --simulations FOLDER --work DIR [...]
    python3 benches/general_variants.py --simulations FOLDER --work DIR

For the clouds, situations and images of `benches/general.py` it prints

- epsilon and delta of the mean of the estimates in several orientations: images, cameras, Sun and
  result turned or mirrored together;
- the same for another scale of the output, and for a power of it with the same sum;
- the share of images for which the network warns that they are unlike those of its training: right
  ones, and such with a wrong geometry.

The rows of docs/notes/general_network.md are those of these tables. Requires deepct_py,
weights_tools and PyTorch.
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import deepct_py as deepct
import general
import numpy as np
import torch
from weights_tools import surface
from weights_tools.general_file import load_general
from weights_tools.planes import on_planes
from weights_tools.stream import mirrored
from weights_tools.views import views_of

SITUATIONS = ("ten", "pearls", "random", "few")
TURNS = tuple(itertools.product([False, True], repeat=3))
"""x reversed, y reversed, then x and y exchanged."""
MEANS = {
    "1 orientation": [0], "2, turned by 180 degrees": [0, 6], "4, mirrored": [0, 2, 4, 6],
    "4, turned": [0, 3, 5, 6], "8": list(range(8)),
}
SCALES = (0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
POWERS = (0.9, 1.1, 1.2)


class Turned:
    """The general network in PyTorch, for images in any orientation."""

    def __init__(self, weights: Path) -> None:
        loaded = load_general(weights)
        self.network, self.description = loaded.network.eval(), loaded.description

    def estimates(self, images: np.ndarray, views: deepct.Views, sun: tuple[float, float],
                  grid: deepct.Grid) -> np.ndarray:
        """The extinction ``[orientation, z, y, x]``, turned back."""
        center = np.array(grid.center)
        distances = [float(np.linalg.norm(np.array(view.position) - center)) for view in views]
        geometry = views_of({
            "sun_zenith_deg": sun[0], "sun_azimuth_deg": sun[1], "pixel_km": list(views.pixel_km),
            "view_zenith_deg": list(views.zenith_deg), "view_azimuth_deg": list(views.azimuth_deg),
            "camera_distance_km": distances,
        }, grid.spacing[0]).to(torch.float32)
        radiance = torch.from_numpy(images)[None]
        if self.description.surface_albedo is not None:
            radiance = surface.above_surface(radiance, geometry, self.description.surface_albedo)
        scaled = radiance * self.description.input_scale
        planes = on_planes(scaled, geometry, self.network.architecture.heights)
        results = []
        for turn in TURNS:
            turns = torch.tensor([turn])
            with torch.no_grad():
                outputs = self.network(mirrored(planes, turns), geometry.mirrored(*turns.T))
            estimate = outputs.float().chunk(2, 1)[0] * self.description.output_scale
            east, north, swapped = turn
            estimate = estimate.transpose(-1, -2) if swapped else estimate
            estimate = estimate.flip(-2) if north else estimate
            results.append((estimate.flip(-1) if east else estimate)[0].numpy())
        return np.array(results)


def wrong(images: np.ndarray, situation: general.Situation
          ) -> Iterator[tuple[str, np.ndarray, general.Situation]]:
    """Images and situations with a wrong geometry."""
    sun = (situation.sun[0], (situation.sun[1] + 180.0) % 360.0)
    yield "right", images, situation
    yield "rows reversed", images[:, ::-1].copy(), situation
    mirror = tuple(-azimuth for azimuth in situation.azimuth)
    yield "azimuths mirrored", images, replace(situation, azimuth=mirror)
    yield "order reversed", images[::-1].copy(), situation
    yield "rows and columns exchanged", images.transpose(0, 2, 1).copy(), situation
    yield "Sun turned", images, replace(situation, sun=sun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, required=True, help="folder of the BOMEX runs")
    parser.add_argument("--work", type=Path, required=True, help="folder of benches/general.py")
    parser.add_argument("--clouds", type=int, default=24)
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--weights", type=Path,
                        default=Path("crates/deepct-core/weights/general.safetensors"))
    arguments = parser.parse_args()
    arguments.rico = []
    bench, turned = general.Bench(arguments.work, ["general"]), Turned(arguments.weights)
    network = bench.networks["general"]
    scores: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    warned: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for cloud in general.test_clouds(arguments):
        for name in SITUATIONS:
            (situation,) = general.situations(name, cloud)
            images = bench.images(cloud, situation, "ordinates")
            size = cloud.grid.shape[1:]
            views = situation.views(cloud.grid.center, size)
            mask = deepct.carve(images, views, cloud.grid).mask

            def add(variant: str, estimate: np.ndarray) -> None:
                found = deepct.score(cloud.extinction, (estimate * mask).astype(np.float32))
                scores[variant, name].append((found.relative_error, found.mass_error))

            estimates = turned.estimates(images, views, situation.sun, cloud.grid)
            for variant, chosen in MEANS.items():
                add(variant, estimates[chosen].mean(0))
            for scale in SCALES:
                add(f"output times {scale}", scale * estimates[0])
            inside = estimates[0] * mask
            for power in POWERS:
                raised = inside**power
                add(f"power {power}", raised * (inside.sum() / raised.sum()))
            for what, given, stated in wrong(images, situation):
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    network.estimate(given, stated.views(cloud.grid.center, size),
                                     bench.light(stated), grid=cloud.grid)
                warned[what, name].append(bool(caught))
    header = "| | " + " | ".join(SITUATIONS) + " |\n|" + "---|" * (len(SITUATIONS) + 1)
    print(f"epsilon, delta\n\n{header}")
    for variant in dict.fromkeys(variant for variant, _ in scores):
        means = [np.mean(scores[variant, name], 0) for name in SITUATIONS]
        print(f"| {variant} | " + " | ".join(f"{e:.3f}, {d:+.2f}" for e, d in means) + " |")
    print(f"\nshare of the images with a warning\n\n{header}")
    for what in dict.fromkeys(what for what, _ in warned):
        shares = [np.mean(warned[what, name]) for name in SITUATIONS]
        print(f"| {what} | " + " | ".join(f"{share:.2f}" for share in shares) + " |")


if __name__ == "__main__":
    main()
