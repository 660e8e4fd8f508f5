#!/usr/bin/env python3
"""Independent test of the four methods (docs/notes/results.md), with images of another solver.

    python3 benches/independent.py --simulations FOLDER --work DIR \
        [--program target/release/deepct] [--clouds 10 | --samples NAME,NAME] [--noise 0.02] \
        [--methods network,physics,hybrid,quick-hybrid] [--kinds monte-carlo,ordinates] \
        [--radii true,fixed]

Selects clouds of `recipes/bomex-test.toml`, evenly distributed over their sizes, and renders the
ten views of each with the unbiased Monte Carlo solver (relative noise NOISE in bright pixels,
before the sensor noise). For the self-consistent test, the images are rendered with the
discrete-ordinates solver, which the inversions use as well. The noise of the CMV4000 is added to
all images. The inversions use the mean effective radius of the cloud, or 8 um as an assumption
without prior knowledge. The script prints a row for each cloud, method, kind of images and radius,
and the means. Existing files in DIR are not computed again. Requires numpy and h5py.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
from pathlib import Path

import h5py
import numpy as np

HERE = Path(__file__).parent
SMALLEST = 60
"""Minimum number of voxels of a cloud."""
FIXED_RADIUS = 8.0
"""Effective radius (um) that is assumed if it is unknown."""
DROPLETS = ["--set", "optics.phase=mie"]


class Bench:
    """The working folder and the program."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.work, self.program = arguments.work, arguments.program.resolve()
        self.simulations, self.noise = arguments.simulations, arguments.noise
        self.formation = arguments.formation

    def run(self, *arguments: object) -> str:
        """Run a command of the program and return its output."""
        command = [str(self.program), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
        return done.stdout

    def clouds(self, count: int, names: str | None) -> list[Path]:
        """Test samples given by name, or evenly distributed over the number of voxels."""
        folder = self.work / "bomex-test"
        if not (folder / "manifest.json").exists():
            recipe = HERE.parent / "recipes" / "bomex-test.toml"
            self.run("-q", "dataset", "generate", recipe, "--simulations", self.simulations,
                     "--out", folder)
        if names is not None:
            return [folder / "samples" / f"{name}.nc" for name in names.split(",")]
        sizes = sorted((voxels(path), path) for path in folder.glob("samples/*.nc"))
        large = [path for size, path in sizes if size >= SMALLEST]
        return [large[(2 * n + 1) * len(large) // (2 * count)] for n in range(count)]

    def images(self, cloud: Path, kind: str) -> Path:
        """Noisy images of a cloud, rendered with one of the solvers."""
        ending = "" if self.formation == "cloudct-10" else f"-{self.formation}"
        clean = self.work / f"{cloud.stem}-{kind}{ending}.nc"
        noisy = self.work / f"{cloud.stem}-{kind}{ending}-noisy.nc"
        if not clean.exists():
            how = {
                "monte-carlo": ["--noise", self.noise],
                "ordinates": ["--solver", "ordinates"],
            }[kind]
            self.run("-q", "render", cloud, "--views", self.formation, "--air", *DROPLETS, *how,
                     "--seed", 5, "--out", clean)
        if not noisy.exists():
            self.run("-q", "sense", clean, "--sensor", "cmv4000", "--seed", 3, "--out", noisy)
        return noisy

    def score(self, cloud: Path, images: Path, method: str, radius: float) -> dict[str, float]:
        """epsilon, delta and seconds of one method."""
        out = self.work / "answer.nc"
        if method == "network":
            self.run("-q", "infer", images, "--weights", self.formation, "--carve", "--out", out)
            scores = json.loads(self.run("score", "--truth", cloud, out, "--json"))
            row = scores[0] if isinstance(scores, list) else scores
            return {"epsilon": row["relative_error"], "delta": row["mass_error"], "seconds": 0.0}
        light = ["--air", *DROPLETS, "--set", f"optics.effective_radius={radius:.4f}"]
        common = [*light, "--truth", cloud, "--out", out]
        if method == "physics":
            printed = self.run("invert", images, "--grid", cloud, *common)
        else:
            quick = ["--quick"] if method == "quick-hybrid" else []
            printed = self.run("hybrid", images, "--weights", self.formation, *quick, *common)
        number = {
            name: float(re.search(rf"^{name}\s+(-?[\d.]+)", printed, re.MULTILINE)[1])
            for name in ("epsilon", "delta")
        }
        return {**number, "seconds": float(re.search(r"in ([\d.]+) s", printed)[1])}


def voxels(path: Path) -> int:
    """Number of voxels with liquid water."""
    with h5py.File(path) as file:
        return int((file["lwc"][...] > 0).sum())


def mean_radius(path: Path) -> float:
    """Mean effective radius (um), weighted by the extinction."""
    with h5py.File(path) as file:
        water, radius = file["lwc"][...], file["reff"][...]
    wet = water > 0
    return float(water.sum() / (water[wet] / radius[wet]).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, required=True, help="folder of the BOMEX runs")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--clouds", type=int, default=10)
    parser.add_argument("--samples", help="names of samples, in place of --clouds")
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--formation", default="cloudct-10", help="cloudct-10 or pearls-32")
    parser.add_argument("--methods", default="network,physics,hybrid,quick-hybrid")
    parser.add_argument("--kinds", default="monte-carlo,ordinates")
    parser.add_argument("--radii", default="true,fixed")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    bench = Bench(arguments)
    clouds = bench.clouds(arguments.clouds, arguments.samples)
    for method in arguments.methods.split(","):
        for kind in arguments.kinds.split(","):
            for radius in arguments.radii.split(",") if method != "network" else ["true"]:
                rows = []
                for cloud in clouds:
                    size = mean_radius(cloud) if radius == "true" else FIXED_RADIUS
                    row = bench.score(cloud, bench.images(cloud, kind), method, size)
                    rows.append(row)
                    print(f"{method:13} {kind:12} {radius:6} {cloud.stem:16} "
                          f"{voxels(cloud):5} {row['epsilon']:.3f} {row['delta']:+.3f} "
                          f"{row['seconds']:7.1f}", flush=True)
                means = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
                print(f"{method:13} {kind:12} {radius:6} mean of {len(rows):3} clouds      "
                      f"{means['epsilon']:.3f} {means['delta']:+.3f} {means['seconds']:7.1f}",
                      flush=True)


if __name__ == "__main__":
    main()
