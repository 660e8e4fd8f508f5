#!/usr/bin/env python3
"""Masks of clouds above bright surfaces (docs/guide/pages/inversion.md).

    python3 benches/bright_ground.py

A generated cloud in the views of cloudct-10, and balls of two extinctions in five views, above surfaces of
an albedo of 0.15 to 0.7 at solar zenith angles of 10 to 70 degrees; Monte Carlo images without sensor
noise. The script prints the ratio of the brightest pixels to the surface, the share of the voxels that
the mask keeps, the share of the extinction outside it, and whether there is a warning. Requires
deepct_py.
"""

from __future__ import annotations

import math
import warnings

import deepct_py as deepct
import numpy as np


def ball(extinction: float) -> deepct.Cloud:
    """A ball of about 2.5 voxels radius."""
    z, y, x = np.indices((10, 12, 12))
    distance = ((z - 6) / 2.2) ** 2 + ((y - 5.5) / 2.5) ** 2 + ((x - 5.5) / 2.5) ** 2
    grid = deepct.Grid((10, 12, 12), (0.05, 0.05, 0.05), (0.0, 0.0, 0.1))
    return deepct.Cloud(grid, extinction=np.where(distance < 1.0, extinction, 0.0))


def main() -> None:
    balls = [ball(40.0), ball(10.0)]
    middle = balls[0].grid.center
    five = deepct.Views([
        deepct.View.orthographic(abs(zenith), 0 if zenith >= 0 else 180, middle, 0.05, (20, 20))
        for zenith in (-50, -25, 0, 25, 50)
    ])
    scenes = [("ball, 40 km-1", balls[0], five), ("ball, 10 km-1", balls[1], five),
              ("generated", deepct.generate_cloud(seed=3), "cloudct-10")]
    print("| cloud | albedo | Sun zenith | brightest over surface | kept | missed | warning |")
    print("|---|---|---|---|---|---|---|")
    for name, cloud, views in scenes:
        for albedo in (0.15, 0.25, 0.35, 0.5, 0.7):
            for zenith in (10, 40, 60, 70):
                light = deepct.Light(sun=(zenith, 200), surface_albedo=albedo)
                images = deepct.render(cloud, views=views, light=light, samples=400)
                surface = albedo * math.cos(math.radians(zenith)) / math.pi
                contrast = np.quantile(images.radiance, 0.99) / surface
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    mask = deepct.carve(images, grid=cloud.grid).mask
                missed = cloud.extinction[~mask].sum() / cloud.extinction.sum()
                print(f"| {name} | {albedo} | {zenith} | {contrast:.2f} | {mask.mean():.3f} "
                      f"| {missed:.3f} | {'yes' if caught else ''} |", flush=True)


if __name__ == "__main__":
    main()
