#!/usr/bin/env python3
"""Extinction and effective radius by a network for two bands.

    python3 benches/two_bands.py --clouds FOLDER --work FOLDER --weights FILE [--radius 7.3] \
        [--count 16] [--hybrids 3] [--program target/release/deepct]

The clouds are samples of `recipes/bomex-test.toml` of 60 to 400 voxels. The images are those of
`benches/microphysics.py` (0.672 and 2.13 um) by discrete ordinates, exposed with the default sensor.
Prints the means over the clouds for the built-in `cloudct-10` with a constant radius (`--radius`, the
mean of the training set) and for the weights; for the first clouds (`--hybrids`), also the result of
`hybrid --radius field` from both starts, with the time after which each has reached the larger one of
both final misfits. Existing files in the working folder are used again. The results are reported in
docs/notes/microphysics.md. Requires numpy, h5py, xarray and h5netcdf.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import xarray as xr
from microphysics import BANDS, Bench, compare, is_of_size

ONE, TWO = "cloudct-10, constant radius", "two bands"


def estimate(bench: Bench, cloud: Path, name: str, weights: str | Path, bands: list[str]) -> Path:
    """The file of the estimate of a network for the images of some bands."""
    out = bench.work / f"{cloud.stem}-{name}.nc"
    if not out.exists():
        images = [bench.images(cloud, band) for band in bands]
        bench.run("infer", *images, "--weights", weights, "--out", out)
    return out


def constant(truth: Path, found: Path, radius: float) -> float:
    """The mean absolute error (um), weighted by the extinction, of a constant radius, in the voxels where
    an estimate has a radius."""
    with xr.open_dataset(found, engine="h5netcdf") as cloud:
        seen = cloud["reff"].values > 0
    with xr.open_dataset(truth, engine="h5netcdf") as cloud:
        extinction, true = seen * cloud["extinction"].values, cloud["reff"].values
    return float((extinction * abs(true - radius)).sum() / extinction.sum())


def hybrid(bench: Bench, cloud: Path, name: str, weights: str | Path) -> tuple[dict, np.ndarray]:
    """The errors of a hybrid, and its times (s) and misfits after each step."""
    out = bench.work / f"{cloud.stem}-hybrid-{name}.nc"
    if not out.exists():
        images = [bench.images(cloud, band) for band in BANDS]
        options = ["--weights", weights, "--radius", "field"]
        bench.run("hybrid", *images, *options, "--out", out)
    with xr.open_dataset(out, engine="h5netcdf") as result:
        course = np.stack([result["seconds"].values, result["misfit"].values])
    return compare(cloud, out), course


def reached(course: np.ndarray, misfit: float) -> float:
    """The time (s) after which the misfit is reached."""
    seconds, misfits = course
    return float(seconds[np.argmax(misfits <= misfit)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--clouds", type=Path, required=True, help="folder of the samples")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--weights", type=Path, required=True, help="weights for two bands")
    parser.add_argument("--radius", type=float, default=7.3, help="constant effective radius (um)")
    parser.add_argument("--count", type=int, default=16, help="number of clouds")
    parser.add_argument("--hybrids", type=int, default=0, help="number of clouds for the hybrids")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    arguments.solver = "ordinates"
    bench = Bench(arguments)
    clouds = [path for path in sorted(arguments.clouds.glob("*.nc")) if is_of_size(path)]
    clouds = clouds[:: max(1, len(clouds) // arguments.count)][: arguments.count]
    found: dict[str, list[tuple[float, float]]] = {ONE: [], TWO: []}
    for cloud in clouds:
        one = estimate(bench, cloud, "one", "cloudct-10", ["visible"])
        two = estimate(bench, cloud, "two", arguments.weights, list(BANDS))
        found[ONE].append((compare(cloud, one)["epsilon"], constant(cloud, two, arguments.radius)))
        errors = compare(cloud, two)
        found[TWO].append((errors["epsilon"], errors["radius"]))
    print(f"| {len(clouds)} clouds | epsilon | radius (um) |\n|---|---|---|")
    for name, values in found.items():
        epsilon, radius = np.mean(values, 0)
        print(f"| {name} | {epsilon:.3f} | {radius:.2f} |")
    better = np.array(found[TWO]) < np.array(found[ONE])
    print(f"better in epsilon, radius: {better[:, 0].sum()}, {better[:, 1].sum()} clouds")
    if arguments.hybrids:
        print("\n| hybrid from | epsilon | radius (um) | misfit | seconds | to the same misfit |")
        print("|---|---|---|---|---|---|")
    for cloud in clouds[: arguments.hybrids]:
        starts = (ONE, "one", "cloudct-10"), (TWO, "two", arguments.weights)
        results = {name: hybrid(bench, cloud, short, file) for name, short, file in starts}
        common = max(course[1, -1] for _, course in results.values())
        for name, (errors, course) in results.items():
            values = errors["epsilon"], errors["radius"], course[1, -1], course[0, -1]
            print("| {} | {:.3f} | {:.2f} | {:.3f} | {:.0f} | {:.0f} |".format(
                name, *values, reached(course, common)))


if __name__ == "__main__":
    main()
