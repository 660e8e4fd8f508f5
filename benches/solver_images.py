#!/usr/bin/env python3
"""Images of both solvers beside each other, and the glory of a layer of droplets by both.

    python3 benches/solver_images.py images MONTE_CARLO.nc ORDINATES.nc --views 0,5,9 --out FIGURE.png
    python3 benches/solver_images.py accuracy MONTE_CARLO.nc ORDINATES.nc
    python3 benches/solver_images.py glory --depth 10 --out FIGURE.png

`images` draws views of two files of images of the same scene and their difference, and gives the relative
difference of the bright pixels and its standard error by the Monte Carlo noise (root mean squares). `glory` computes the radiance of a horizontally infinite layer of
droplets (effective radius 10 um, black surface) around exact backscatter by both solvers with the Python
module. Needs numpy, h5py, matplotlib and, for `glory`, deepct_py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

BRIGHT = 0.5
"""Pixels with this share of the radiance of the brightest pixel of their view are bright."""


def draw_images(arguments: argparse.Namespace) -> None:
    """Draw views of two files and their difference."""
    import h5py

    with h5py.File(arguments.first) as file:
        expected, error = file["radiance"][...], file["radiance_standard_error"][...]
        zenith, azimuth = file["view_zenith_deg"][...], file["view_azimuth_deg"][...]
    with h5py.File(arguments.second) as file:
        found = file["radiance"][...]
    views = [int(view) for view in arguments.views.split(",")]
    figure, axes = plt.subplots(len(views), 3, figsize=(12, 3.4 * len(views)), squeeze=False,
                                layout="constrained")
    for row, view in zip(axes, views):
        most = expected[view].max()
        for axis, images, title in [(row[0], expected, "Monte Carlo"),
                                    (row[1], found, "discrete ordinates")]:
            image = axis.imshow(images[view], origin="lower", cmap="gray", vmin=0.0, vmax=most)
            axis.set_title(f"{title}, zenith {zenith[view]:.0f}°", fontsize=10)
            figure.colorbar(image, ax=axis, label="radiance (sr$^{-1}$)")
        relative = 100.0 * (found[view] / expected[view] - 1.0)
        difference = 100.0 * (found[view] - expected[view]) / most
        bright = expected[view] >= BRIGHT * most
        noise = 100.0 * np.sqrt(np.mean((error[view] / expected[view])[bright] ** 2))
        image = row[2].imshow(difference, origin="lower", cmap="RdBu_r", vmin=-4.0, vmax=4.0)
        rms = np.sqrt(np.mean(relative[bright] ** 2))
        row[2].set_title(f"bright pixels {rms:.1f} %, noise {noise:.1f} %", fontsize=10)
        figure.colorbar(image, ax=row[2], label="% of the brightest pixel")
        for axis in row:
            axis.set_xlabel("column (to the east)")
            axis.set_ylabel("row (to the north)")
    figure.savefig(arguments.out, dpi=80)


def print_accuracy(arguments: argparse.Namespace) -> None:
    """Print the error of the bright pixels of all views, without the variance of the first file."""
    import h5py

    with h5py.File(arguments.first) as file:
        expected, error = file["radiance"][...], file["radiance_standard_error"][...]
    with h5py.File(arguments.second) as file:
        found = file["radiance"][...]
    bright = expected >= BRIGHT * expected.max(axis=(1, 2), keepdims=True)
    squares = np.mean((found / expected - 1.0)[bright] ** 2)
    noise = np.mean((error / expected)[bright] ** 2)
    print(f"bright pixels {100.0 * np.sqrt(max(squares - noise, 0.0)):.2f} %, "
          f"noise {100.0 * np.sqrt(noise):.2f} %")


def draw_glory(arguments: argparse.Namespace) -> None:
    """Draw the radiance of a layer around backscatter by both solvers."""
    import deepct_py

    grid = deepct_py.Grid((4, 1, 1), (1.0, 1.0, 0.1), (0.0, 0.0, 0.0))
    extinction = np.full(grid.shape, arguments.depth / 0.4, np.float32)
    light = deepct_py.Light(phase="mie", effective_radius=10.0, surface_albedo=0.0, periodic=True)
    angles = np.concatenate([np.arange(-10.0, -2.9, 1.0), np.arange(-2.5, 2.6, 0.25),
                             np.arange(3.0, 10.1, 1.0)])
    views = [
        deepct_py.View.orthographic(30.0 + angle, 45.0, (0.5, 0.5, 0.4), 1e-3, size=(1, 1))
        for angle in angles
    ]
    paths = deepct_py.render(extinction, grid, views, light, samples=arguments.paths)
    smooth = deepct_py.render(extinction, grid, views, light, solver="ordinates")
    expected, found = paths.radiance[:, 0, 0], smooth.radiance[:, 0, 0]
    error = paths.standard_error[:, 0, 0]
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, height_ratios=[2, 1])
    above.errorbar(angles, expected, error, fmt="o", ms=3, label="Monte Carlo")
    above.plot(angles, found, label="discrete ordinates")
    above.set_ylabel("radiance (sr$^{-1}$)")
    above.set_title(f"Glory of a layer of optical depth {arguments.depth:g}, 0.672 um, 10 um")
    above.legend()
    below.errorbar(angles, 100.0 * (found / expected - 1.0), 100.0 * error / expected, fmt="o", ms=3)
    below.axhline(0.0, color="0.5")
    below.set_ylabel("difference (%)")
    below.set_xlabel("angle from exact backscatter (degrees)")
    figure.tight_layout()
    figure.savefig(arguments.out, dpi=100)
    worst = np.abs(found / expected - 1.0).max()
    print(f"largest difference {100.0 * worst:.2f} %, noise {100.0 * (error / expected).max():.2f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(required=True)
    images = verbs.add_parser("images")
    images.add_argument("first", type=Path, help="images by the Monte Carlo solver")
    images.add_argument("second", type=Path, help="images of the same scene by discrete ordinates")
    images.add_argument("--views", default="0")
    images.set_defaults(draw=draw_images)
    accuracy = verbs.add_parser("accuracy")
    accuracy.add_argument("first", type=Path, help="images by the Monte Carlo solver")
    accuracy.add_argument("second", type=Path, help="images of the same scene by discrete ordinates")
    accuracy.set_defaults(draw=print_accuracy)
    glory = verbs.add_parser("glory")
    glory.add_argument("--depth", type=float, default=10.0)
    glory.add_argument("--paths", type=int, default=400_000)
    glory.set_defaults(draw=draw_glory)
    for verb in (images, glory):
        verb.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.draw(arguments)


if __name__ == "__main__":
    main()
