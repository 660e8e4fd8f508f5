#!/usr/bin/env python3
"""Retrieval of extinction and effective radius from one and from two bands.

    python3 benches/microphysics.py --clouds FOLDER --work FOLDER [--count 12] \
        [--solver monte-carlo] [--program target/release/deepct]

The clouds are samples of `recipes/bomex-test.toml`. For each of them, the ten views of a formation are
rendered at 0.672 and 2.13 um and exposed with the default sensor, and each method retrieves the cloud
from the estimate of the network for the images at 0.672 um. Prints a table of the means over the
clouds, and a table for one camera that is 3 % too bright. Existing files in the working folder are used
again. The results are reported in docs/notes/microphysics.md. Requires numpy, h5py, xarray and h5netcdf.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

LIGHT = ["--views", "cloudct-10", "--air", "--phase", "mie", "--set", "optics.extinction=mie"]
BANDS = {"visible": 0.672, "infrared": 2.13}
ONE, TWO = ["visible"], ["visible", "infrared"]
METHODS: dict[str, tuple[list[str], list[str]]] = {
    "one band, mean radius of the cloud given": (ONE, []),
    "one band, 10 um for all clouds": (ONE, ["--effective-radius", "10"]),
    "one band, one unknown radius": (ONE, ["--radius", "uniform"]),
    "one band, adiabatic profile": (ONE, ["--radius", "adiabatic"]),
    "two bands, one unknown radius": (TWO, ["--radius", "uniform"]),
    "two bands, adiabatic profile": (TWO, ["--radius", "adiabatic"]),
    "two bands, radius of each voxel": (TWO, ["--radius", "field"]),
}
"""The bands and options of each method."""
BRIGHTER, CAMERA = 1.03, 3
"""Factor of the wrong gain, and the number of its camera."""
GAINS = {"known": [], "unknown": ["--set", "inversion.camera_gain_error=0.02"]}
LEAST_EXTINCTION = 100.0
"""Smallest sum of the extinctions of the voxels of a cloud (1/km); thinner clouds are left out."""


class Bench:
    """The working folder and the program."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.work, self.program = arguments.work, arguments.program.resolve()
        self.solver = arguments.solver

    def run(self, *arguments: object) -> None:
        command = [str(self.program), "-q", *map(str, arguments)]
        # An inversion that does not explain the images has the exit status 1.
        subprocess.run(command, check="invert" not in command, stdout=subprocess.DEVNULL)

    def droplets(self, cloud: Path) -> Path:
        """The droplets of a cloud, without its extinction, which depends on the wavelength."""
        out = self.work / f"{cloud.stem}-droplets.nc"
        if not out.exists():
            with xr.open_dataset(cloud, engine="h5netcdf") as data:
                data[["lwc", "reff", "veff"]].to_netcdf(out, engine="h5netcdf")
        return out

    def images(self, cloud: Path, band: str) -> Path:
        """The noisy images of a cloud in a band."""
        clean, noisy = (self.work / f"{cloud.stem}-{band}{end}.nc" for end in ("-clean", ""))
        if not clean.exists():
            options = [*LIGHT, "--wavelength", BANDS[band], "--solver", self.solver]
            self.run("render", self.droplets(cloud), *options, "--out", clean)
        if not noisy.exists():
            self.run("sense", clean, "--out", noisy)
        return noisy

    def start(self, cloud: Path) -> Path:
        """The estimate of the network for the visible images."""
        out = self.work / f"{cloud.stem}-network.nc"
        if not out.exists():
            self.run("infer", self.images(cloud, "visible"), "--weights", "cloudct-10", "--out", out)
        return out

    def brighter(self, cloud: Path) -> Path:
        """The visible images, with one camera that is too bright."""
        out = self.work / f"{cloud.stem}-brighter.nc"
        if not out.exists():
            shutil.copyfile(self.images(cloud, "visible"), out)
            with h5py.File(out, "r+") as file:
                file["radiance"][CAMERA] = BRIGHTER * file["radiance"][CAMERA]
        return out

    def invert(self, cloud: Path, name: str, images: list[Path], options: list[str]) -> dict:
        """The errors of an inversion and its duration (s)."""
        out, result = (self.work / f"{cloud.stem}-{name}{end}" for end in (".nc", ".json"))
        if not result.exists():
            began, start = time.time(), self.start(cloud)
            grid = ["--grid", start, "--init", start]
            self.run("invert", *images, *grid, *options, "--out", out)
            errors = compare(cloud, out) | {"seconds": time.time() - began}
            result.write_text(json.dumps(errors))
        return json.loads(result.read_text())


def compare(truth: Path, found: Path) -> dict:
    """The errors of a retrieved cloud."""
    with xr.open_dataset(truth, engine="h5netcdf") as cloud:
        extinction, water, radius = (cloud[n].values for n in ("extinction", "lwc", "reff"))
    with xr.open_dataset(found, engine="h5netcdf") as cloud:
        retrieved = cloud["extinction"].values
        given = float((extinction * radius).sum() / extinction.sum())
        radii = cloud["reff"].values if "reff" in cloud else np.full_like(radius, given)
        # The liquid water content is proportional to extinction times radius.
        scale = water.sum() / (extinction * radius).sum()
        lwc = cloud["lwc"].values if "lwc" in cloud else scale * retrieved * radii
    seen = extinction * (radii > 0)
    return {
        "epsilon": float(np.abs(retrieved - extinction).sum() / extinction.sum()),
        "radius": float((seen * np.abs(radii - radius)).sum() / seen.sum()),
        "water": float(np.abs(lwc - water).sum() / water.sum()),
        "mass": float(abs(lwc.sum() / water.sum() - 1.0)),
    }


def row(name: str, results: list[dict]) -> str:
    mean = {key: float(np.mean([result[key] for result in results])) for key in results[0]}
    columns = [f"{mean['epsilon']:.3f}", f"{mean['radius']:.2f}", f"{mean['water']:.3f}",
               f"{100 * mean['mass']:.1f} %", f"{mean['seconds']:.0f} s"]
    return f"| {name} | " + " | ".join(columns) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--clouds", type=Path, required=True, help="folder of the samples")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--count", type=int, default=12, help="number of clouds")
    parser.add_argument("--solver", default="monte-carlo", help="solver of the images")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    bench, results = Bench(arguments), {}
    clouds = [path for path in sorted(arguments.clouds.glob("*.nc")) if is_thick(path)]
    chosen = clouds[:: max(1, len(clouds) // arguments.count)][: arguments.count]
    for cloud in chosen:
        images = {band: bench.images(cloud, band) for band in BANDS}
        for number, (name, (bands, options)) in enumerate(METHODS.items()):
            found = bench.invert(cloud, str(number), [images[band] for band in bands], options)
            results.setdefault(name, []).append(found)
        for known, options in GAINS.items():
            for name, path in [("right", images["visible"]), ("wrong", bench.brighter(cloud))]:
                found = bench.invert(cloud, f"{name}-{known}", [path], options)
                results.setdefault(f"gains {known}, one camera {name}", []).append(found)
        print(f"{cloud.stem} of {len(chosen)} clouds", flush=True)
    print("| method | epsilon | radius (um) | epsilon of water | total water | time |")
    print("|---|---|---|---|---|---|")
    for name, found in results.items():
        print(row(name, found))


def is_thick(path: Path) -> bool:
    with xr.open_dataset(path, engine="h5netcdf") as cloud:
        return float(cloud["extinction"].sum()) > LEAST_EXTINCTION


if __name__ == "__main__":
    main()
