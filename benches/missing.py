#!/usr/bin/env python3
"""Relative error of the networks from images with missing pixels.

    python benches/missing.py [--clouds 5]

Requires the Python module. Clouds of the generator are seen by the ten cameras of `cloudct-10` (discrete
ordinates with air and Mie droplets, noise of the CMV4000). Prints the mean relative error of the
estimates without some of the pixels.
"""

import argparse
import warnings

import deepct_py
import numpy as np

SIZE = 32


def cases(random):
    """Names and masks of missing pixels [view, row, col]."""
    missing = np.zeros((10, SIZE, SIZE), bool)
    yield "none", missing
    for share in (0.01, 0.05, 0.2):
        yield f"{100 * share:.0f} % of the pixels, at random", random.random(missing.shape) < share
    for side in (8, 12):
        corner = missing.copy()
        corner[:, :side, :side] = True
        yield f"a corner of {side} x {side} in all views", corner
    quarter = missing.copy()
    quarter[:3, :16, :16] = True
    yield "a corner of 16 x 16 in three views", quarter
    line = missing.copy()
    line[:, 15] = True
    yield "a row in the middle of all views", line
    view = missing.copy()
    view[4] = True
    yield "all pixels of one view", view


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clouds", type=int, default=5)
    clouds = parser.parse_args().clouds
    networks = {name: deepct_py.Network.load(name) for name in ("general", "cloudct-10")}
    light = deepct_py.Light(air=True, phase="mie", effective_radius=10.0)
    random = np.random.default_rng(1)
    found = {}
    for seed in range(1, clouds + 1):
        cloud = deepct_py.generate_cloud(seed=seed)
        views = deepct_py.Views.load("cloudct-10", (*cloud.grid.center[:2], 1.12))
        images = deepct_py.render(cloud.extinction, cloud.grid, views, light, solver="ordinates")
        images = deepct_py.sense(images, "cmv4000", seed=seed)
        for case, missing in cases(random):
            seen = images.replace(radiance=np.where(missing, np.nan, images.radiance))
            for name, network in networks.items():
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        estimate = network.infer(seen, grid=cloud.grid)
                except ValueError:
                    continue
                error = deepct_py.score(cloud.extinction, estimate).relative_error
                found.setdefault(case, {}).setdefault(name, []).append(error)
    print("| Missing | " + " | ".join(networks) + " |")
    print("|---|" + "---|" * len(networks))
    for case, errors in found.items():
        cells = [f"{np.mean(errors[name]):.3f}" if name in errors else "refused" for name in networks]
        print(f"| {case} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
