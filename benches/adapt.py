#!/usr/bin/env python3
"""Adaptation of the general network to the images of clouds of another simulation, without their truth.

    python3 benches/adapt.py --simulations FOLDER --rico CLOUD.nc [CLOUD.nc ...] --work DIR \
        [--weights general] [--minutes 10] [--turns 2] [--clouds 24] [--solver monte-carlo]

Each cloud (anything that `deepct cloud import` reads with x, y, z in km) is placed in the middle of 32 x 32
columns of voxels of 50 x 50 x 40 m, turned by 0, 90, ... degrees (`--turns`), and seen by cloudct-10 under its
Sun (30, 45 degrees), with the molecular atmosphere, the ocean, droplets by Mie theory and the noise of the
CMV4000. `weights_tools adapt general` is run on the images of all. The script prints the mean of epsilon and
delta before and after, carved: of these scenes, of the mirrored clouds (which were not among the images), and
of BOMEX test clouds, as in benches/general.py; and the processor time of the adaptation. Requires deepct_py and
weights_tools. The results are reported in docs/guide/pages/derivatives.md.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from pathlib import Path

import deepct_py as deepct
import numpy as np

import general

COLUMNS, LEVELS, BASE_KM = 32, 32, 0.48
SPACING = (0.05, 0.05, 0.04)


def placed(path: Path) -> general.Cloud:
    """A cloud of a simulation in the middle of clear columns, its base in the second level."""
    units = {axis: "km" for axis in "xyz"}
    found = deepct.import_cloud(path, spacing=SPACING, units={**units, "lwc": "g m-3"})
    cloudy = np.nonzero(found.extinction > 0.0)
    part = tuple(slice(axis.min(), axis.max() + 1) for axis in cloudy)
    values = [found.extinction[part], np.nan_to_num(found.effective_radius[part])]
    shape = values[0].shape
    first = [1, *((COLUMNS - length) // 2 for length in shape[1:])]
    inside = tuple(slice(at, at + length) for at, length in zip(first, shape))
    grid = deepct.Grid((LEVELS, COLUMNS, COLUMNS), SPACING, (0.0, 0.0, BASE_KM))
    extinction, radius = np.zeros(grid.shape, np.float32), np.full(grid.shape, 10.0, np.float32)
    extinction[inside] = values[0]
    # At the edge, the resampling leaves traces of droplets that Mie theory does not cover.
    radius[inside] = np.where(values[0] > 0.0, np.clip(values[1], 2.0, 25.0), 10.0)
    return general.Cloud(path.stem, "RICO", grid, extinction, radius)


def turned(cloud: general.Cloud, turns: int, mirrored: bool) -> general.Cloud:
    def turn(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.rot90(values[:, :, :: -1 if mirrored else 1], turns, (1, 2)))

    name = f"{cloud.name[:8]}-{90 * turns}{'-mirrored' if mirrored else ''}"
    fields = turn(cloud.extinction), turn(cloud.effective_radius)
    return general.Cloud(name, cloud.regime, cloud.grid, *fields)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, help="folder of the BOMEX runs")
    parser.add_argument("--rico", type=Path, nargs="+", required=True, help="files of clouds")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--weights", default="general", help="general weights, a name or file")
    parser.add_argument("--minutes", default="10")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--clouds", type=int, default=24)
    parser.add_argument("--solver", default="monte-carlo")
    arguments = parser.parse_args()
    adapted = arguments.work / "adapted.safetensors"
    clouds = [placed(path) for path in arguments.rico]
    versions = {
        mirrored: [turned(cloud, turns, mirrored) for cloud in clouds for turns in range(arguments.turns)]
        for mirrored in (False, True)
    }
    arguments.rico = []
    bench = general.Bench(arguments.work, [arguments.weights])
    files = []
    for cloud in versions[False]:
        situation = next(general.situations("ten", cloud))
        path = bench.folder / f"{cloud.name}-{arguments.solver}.nc"
        views = situation.views(cloud.grid.center, cloud.grid.shape[1:])
        light = bench.light(situation).replace(effective_radius=float(
            np.average(cloud.effective_radius, weights=cloud.extinction)))
        images = bench.images(cloud, situation, arguments.solver)
        error = deepct.sense(images).noise
        observed = deepct.Observation(images, views, light, standard_error=error)
        observed.to_netcdf(path, overwrite=True)
        files.append(str(path))
    command = [sys.executable, "-m", "weights_tools", "adapt", arguments.weights, *files,
               "--out", str(adapted), "--minutes", arguments.minutes]
    subprocess.run(command, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"processor time of the adaptation: {used.ru_utime + used.ru_stime:.0f} s")
    bench = general.Bench(arguments.work, [arguments.weights, str(adapted)])
    print("\n| clouds | n | weights | epsilon | delta |\n|---|---|---|---|---|")
    for name, group, solver in [
        ("RICO, adapted to their images", versions[False], arguments.solver),
        ("RICO, mirrored", versions[True], "ordinates"),
        ("BOMEX test clouds", general.test_clouds(arguments), "ordinates"),
    ]:
        for weights in (arguments.weights, str(adapted)):
            rows = [bench.row(cloud, next(general.situations("ten", cloud)), solver, weights)
                    for cloud in group]
            print(f"| {name} | {len(rows)} | {Path(weights).stem} "
                  f"| {general.mean(rows, 'epsilon'):.4f} | {general.mean(rows, 'delta'):+.3f} |")


if __name__ == "__main__":
    main()
