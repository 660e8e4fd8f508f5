#!/usr/bin/env python3
"""Figures of the general network: the expected against the found error, and reconstructions.

    python3 benches/general.py --simulations FOLDER --work DIR [...]
    python3 benches/general_figures.py --simulations FOLDER --work DIR --out docs/notes/results

`general-calibration.png` has a point for each cloud and situation in DIR. `general-clouds.png` shows
five test clouds of all sizes and their estimates for cloudct-10: the optical depth of the columns,
and the extinction on the vertical plane that has most of it. Requires deepct_py, numpy, h5py and
matplotlib.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import deepct_py as deepct
import general
import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

SITUATIONS = {
    "ten": "cloudct-10", "pearls": "pearls-32", "random": "6 to 20 views", "few": "3 to 5 views",
}
SHOWN = 5


def calibration(folder: Path, out: Path) -> None:
    """The error that the network expects, and the one found, both over the estimate."""
    rows = [json.loads(path.read_text()) for path in sorted((folder / "general").glob("*.json"))]
    rows = [row for row in rows if row["weights"] == "general" and row["solver"] == "ordinates"]
    figure, axes = plt.subplots(figsize=(5.2, 5.0), layout="constrained")
    line = np.array([0.2, 1.6])
    axes.fill_between(line, 0.9 * line, 1.1 * line, color="0.9", label="within 10 %")
    axes.plot(line, line, color="0.5", linewidth=1)
    every = []
    for (name, label), color in zip(SITUATIONS.items(), plt.get_cmap("viridis")([0.0, 0.35, 0.6, 0.85])):
        group = [row for row in rows if row["situation"] == name]
        pairs = np.array([(row["expected"], row["found"]) for row in group]).reshape(-1, 2)
        axes.plot(*pairs.T, "o", markersize=4, color=color, label=label)
        every += pairs.tolist()
    quarters = np.array_split(np.array(sorted(every)), 4)
    means = np.array([quarter.mean(0) for quarter in quarters])
    axes.plot(*means.T, "k+", markersize=12, markeredgewidth=2, label="means of the quarters")
    axes.set(xlabel="expected error over the estimate", ylabel="found error over the estimate",
             xlim=line, ylim=line, xscale="log", yscale="log")
    ticks = [0.2, 0.3, 0.5, 0.7, 1.0, 1.5]
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(matplotlib.ticker.FixedLocator(ticks))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(matplotlib.ticker.NullLocator())
    axes.legend(frameon=False)
    figure.savefig(out, dpi=110)


def clouds(arguments: argparse.Namespace, out: Path) -> None:
    """Truth and estimate of clouds from the smallest to the largest."""
    bench = general.Bench(arguments.work, ["general"])
    chosen = sorted(general.test_clouds(arguments), key=lambda cloud: cloud.voxels)
    chosen = [chosen[number * (len(chosen) - 1) // (SHOWN - 1)] for number in range(SHOWN)]
    figure, axes = plt.subplots(SHOWN, 4, figsize=(9.5, 2.2 * SHOWN), layout="constrained")
    for cloud, row in zip(chosen, axes):
        (situation,) = general.situations("ten", cloud)
        images = bench.images(cloud, situation, "ordinates")
        views = situation.views(cloud.grid.center, cloud.grid.shape[1:])
        found = bench.networks["general"].estimate(
            images, views, bench.light(situation), grid=cloud.grid)
        estimate = found.extinction * deepct.carve(images, views, cloud.grid).mask
        error = deepct.score(cloud.extinction, estimate).relative_error
        dx, dy, dz = cloud.grid.spacing
        x, y, z = cloud.grid.origin
        nz, ny, nx = cloud.grid.shape
        fullest = int(cloud.extinction.sum((0, 2)).argmax())
        for start, label, of in (
            (0, "optical depth", lambda field: field.sum(0) * dz),
            (2, f"extinction (km$^{{-1}}$), y = {y + (fullest + 0.5) * dy:.2f} km",
             lambda field: field[:, fullest]),
        ):
            extent = (x, x + nx * dx, y, y + ny * dy) if start == 0 else (x, x + nx * dx, z, z + nz * dz)
            shown = [of(field) for field in (cloud.extinction, estimate)]
            most = float(np.max(shown))
            for column, (picture, name) in enumerate(zip(shown, ("truth", "estimate")), start):
                mesh = row[column].imshow(picture, origin="lower", extent=extent, vmin=0.0, vmax=most,
                                          cmap="viridis")
                title = name if column % 2 == 0 else f"{name}, epsilon {error:.2f}"
                row[column].set_title(title, fontsize=8)
                row[column].tick_params(labelsize=7)
            bar = figure.colorbar(mesh, ax=row[start:start + 2], shrink=0.85)
            bar.set_label(label, fontsize=7)
            bar.ax.tick_params(labelsize=7)
        row[0].set_ylabel(f"{cloud.voxels} voxels\ny (km)", fontsize=8)
        row[2].set_ylabel("z (km)", fontsize=8)
    for column in axes[-1]:
        column.set_xlabel("x (km)", fontsize=8)
    figure.savefig(out, dpi=90, bbox_inches="tight")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, required=True, help="folder of the BOMEX runs")
    parser.add_argument("--work", type=Path, required=True, help="folder of benches/general.py")
    parser.add_argument("--out", type=Path, required=True, help="folder of the figures")
    parser.add_argument("--clouds", type=int, default=24, help="number of test clouds in DIR")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    arguments.rico = []
    calibration(arguments.work, arguments.out / "general-calibration.png")
    clouds(arguments, arguments.out / "general-clouds.png")


if __name__ == "__main__":
    main()
