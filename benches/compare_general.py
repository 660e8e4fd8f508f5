#!/usr/bin/env python3
"""The general network end to end, from images to extinction and uncertainty: deepct and PyTorch.

    python3 benches/compare_general.py --weights general.safetensors [--threads 2] [--rounds 15]

Both sides have the layers folded for the geometry beforehand. deepct runs `Network.estimate` of its
Python module, without and with space carving; PyTorch resamples the images onto planes and runs the
folded layers (channels last, float32). The sides take turns; the medians of all rounds and the
median of the ratios are printed, and the largest difference of the results. `new geometry` is the
additional time of deepct for another Sun than that of the images before: the layers are folded and
packed again. Requires deepct_py, weights_tools and PyTorch.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any, Callable

import numpy as np

SIZES = ((32, 32), (64, 64), (256, 256))
FORMATIONS = ("cloudct-10", "pearls-32")
TARGET = (0.0, 0.0, 1.12)


def images(views: int, rows: int, cols: int) -> np.ndarray:
    """A bright spot on a dark surface, with some noise (1/sr)."""
    y, x = np.mgrid[:rows, :cols] - np.array([rows / 2, cols / 2])[:, None, None]
    spot = 0.02 + 0.2 * np.exp(-(x**2 + y**2) / 30.0)
    noise = np.random.default_rng(1).normal(0.0, 0.002, (views, rows, cols))
    return (spot + noise).astype(np.float32)


def seconds(run: Callable[[], Any], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        run()
    return (time.perf_counter() - start) / repeats


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--weights", type=Path, required=True, help="weights of a general network")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    # Read by deepct when it first uses a thread.
    os.environ["RAYON_NUM_THREADS"] = str(arguments.threads)
    import deepct_py as deepct
    import torch
    from weights_tools.general import fold, folded_input, run_folded
    from weights_tools.general_file import read_general_weights
    from weights_tools.planes import on_planes
    from weights_tools.views import views_of

    torch.set_num_threads(arguments.threads)
    weights = read_general_weights(arguments.weights)
    network, described = weights.network, weights.description
    ours = deepct.Network.load(arguments.weights)
    print("| views | size | deepct (ms) | with carving (ms) | PyTorch (ms) | ratio | difference "
          "| new geometry (ms) |")
    print("|---|---|---|---|---|---|---|---|")
    for formation in FORMATIONS:
        for size in SIZES:
            views = deepct.Views.load(formation, TARGET, size)
            light, radiance = deepct.Light(), images(len(views), *size)
            grid = deepct.Grid((32, *size), (0.05, 0.05, 0.04),
                               (-0.025 * size[1], -0.025 * size[0], 0.48))
            geometry = {
                "sun_zenith_deg": 30.0, "sun_azimuth_deg": 45.0,
                "view_zenith_deg": list(views.zenith_deg),
                "view_azimuth_deg": list(views.azimuth_deg), "pixel_km": list(views.pixel_km),
                "camera_distance_km": [
                    float(np.linalg.norm(np.subtract(view.position, TARGET))) for view in views
                ],
            }
            theirs = views_of(geometry, 0.05)
            layers = {name: values.float() for name, values in fold(network, theirs).items()}
            theirs = theirs.to(torch.float32)
            extremes = network.architecture.extremes
            heights = network.architecture.heights.float()
            pixels = torch.from_numpy(radiance)[None]

            def torch_run() -> np.ndarray:
                with torch.inference_mode():
                    planes = on_planes(pixels * described.input_scale, theirs, heights)
                    inputs = folded_input(planes, extremes)
                    inputs = inputs.contiguous(memory_format=torch.channels_last)
                    return run_folded(layers, inputs)[0].numpy() * described.output_scale

            def deepct_run() -> np.ndarray:
                return ours.estimate(radiance, views, light, grid=grid).extinction

            def carved_run() -> None:
                deepct_run()
                deepct.carve(radiance, views, grid)

            first, other = deepct_run(), torch_run()[:32]
            difference = np.abs(first - other).max() / other.max()
            suns = [deepct.Light(sun_zenith_deg=angle) for angle in (40.0, 50.0)]

            def turned_run() -> None:
                for sun in suns:
                    ours.estimate(radiance, views, sun, grid=grid)

            repeats = max(1, 64 * 1024 // (size[0] * size[1]) // 4)
            runs = (deepct_run, carved_run, torch_run, turned_run)
            times = np.array([[seconds(run, repeats) for run in runs]
                              for _ in range(arguments.rounds)]) * 1e3
            middle = np.median(times, axis=0)
            ratio = np.median(times[:, 2] / times[:, 0])
            print(f"| {len(views)} | {size[0]} x {size[1]} | {middle[0]:.2f} | {middle[1]:.2f} "
                  f"| {middle[2]:.2f} | {ratio:.2f} | {difference:.1e} "
                  f"| {middle[3] / 2 - middle[0]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
