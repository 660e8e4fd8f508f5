#!/usr/bin/env python3
"""Retrieval of extinction and effective radius from one and from two bands.

    python3 benches/microphysics.py --clouds FOLDER --work FOLDER [--count 12] \
        [--solver monte-carlo] [--program target/release/deepct] [--figure FILE.png] \
        [--methods 0 2 6] [--members 4]

The clouds are samples of `recipes/bomex-test.toml` of 60 to 400 voxels, or the files given. For each of
them, the ten views of a formation are rendered at 0.672 and 2.13 um (Monte Carlo, 1.5 % noise in bright
pixels) and exposed with the default sensor, and each method retrieves the cloud from the estimate of the
network for the images at 0.672 um. Prints a table of the means over the clouds, one of expected and found
errors, and one for a camera that is 3 % too bright or points 0.3 pixels elsewhere. Existing files in the
working folder are used again. The results are reported in docs/notes/microphysics.md. Requires numpy,
h5py, xarray and h5netcdf, and matplotlib for the figure.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

LIGHT = ["--views", "cloudct-10", "--air", "--phase", "mie", "--set", "optics.extinction=mie"]
BANDS = {"visible": 0.672, "infrared": 2.13}
NOISE = {"monte-carlo": ["--noise", "0.015"], "ordinates": []}
ONE, TWO = ["visible"], ["visible", "infrared"]
METHODS: dict[str, tuple[list[str], list[str]]] = {
    "one band, mean radius of the cloud given": (ONE, ["--members"]),
    "one band, 10 um for all clouds": (ONE, ["--effective-radius", "10"]),
    "one band, one unknown radius": (ONE, ["--radius", "uniform"]),
    "one band, adiabatic profile": (ONE, ["--radius", "adiabatic"]),
    "two bands, one unknown radius": (TWO, ["--radius", "uniform"]),
    "two bands, adiabatic profile": (TWO, ["--radius", "adiabatic"]),
    "two bands, radius of each voxel": (TWO, ["--radius", "field", "--members"]),
    "the same, deviations of 15 % and smooth": (TWO, [
        "--radius", "field", "--set", "inversion.radius_error=0.15",
        "--set", "inversion.radius_gradient=1.5"]),
}
"""The bands and options of each method; the number of members is that of the command line."""
BRIGHTER, SHIFT, CAMERA = 1.03, 0.3, 3
"""Factor of the wrong gain, distance of the wrong direction (pixels), and the number of the camera."""
CAMERAS = {
    "all cameras right": ("visible", []),
    "all right, gains unknown": ("visible", ["--set", "inversion.camera_gain_error=0.02"]),
    "one 3 % too bright": ("brighter", []),
    "one 3 % too bright, gains unknown": ("brighter", ["--set", "inversion.camera_gain_error=0.02"]),
    "all right, directions unknown": ("visible", ["--set", "inversion.pointing_error=0.3"]),
    "one 0.3 pixels elsewhere": ("shifted", []),
    "one 0.3 pixels elsewhere, directions unknown":
        ("shifted", ["--set", "inversion.pointing_error=0.3"]),
}
SIZES = (60, 400)
"""Smallest and largest number of voxels of the clouds."""


class Bench:
    """The working folder and the program."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.work, self.program = arguments.work, arguments.program.resolve()
        self.solver = arguments.solver

    def run(self, *arguments: object) -> None:
        command = [str(self.program), "-q", *map(str, arguments)]
        # An inversion that does not explain the images has the exit status 1.
        may_fail = command[2] in ("invert", "hybrid")
        subprocess.run(command, check=not may_fail, stdout=subprocess.DEVNULL)

    def droplets(self, cloud: Path) -> Path:
        """The droplets of a cloud, without its extinction, which depends on the wavelength."""
        out = self.work / f"{cloud.stem}-droplets.nc"
        if not out.exists():
            with xr.open_dataset(cloud, engine="h5netcdf") as data:
                known = [name for name in ("lwc", "reff", "veff") if name in data]
                data[known].to_netcdf(out, engine="h5netcdf")
        return out

    def images(self, cloud: Path, band: str) -> Path:
        """The noisy images of a cloud in a band."""
        clean, noisy = (self.work / f"{cloud.stem}-{band}{end}.nc" for end in ("-clean", ""))
        if not clean.exists():
            options = [*LIGHT, "--wavelength", BANDS[band], "--solver", self.solver]
            self.run("render", self.droplets(cloud), *options, *NOISE[self.solver], "--out", clean)
        if not noisy.exists():
            self.run("sense", clean, "--out", noisy)
        return noisy

    def start(self, cloud: Path) -> Path:
        """The estimate of the network for the visible images."""
        out = self.work / f"{cloud.stem}-network.nc"
        if not out.exists():
            self.run("infer", self.images(cloud, "visible"), "--weights", "cloudct-10", "--out", out)
        return out

    def wrong(self, cloud: Path, name: str) -> Path:
        """The visible images, with one camera that is too bright or whose stated position is wrong."""
        out = self.work / f"{cloud.stem}-{name}.nc"
        if not out.exists():
            shutil.copyfile(self.images(cloud, "visible"), out)
            with h5py.File(out, "r+") as file:
                if name == "brighter":
                    file["radiance"][CAMERA] = BRIGHTER * file["radiance"][CAMERA]
                else:
                    file["target_row"][CAMERA] = file["target_row"][CAMERA] + SHIFT
        return out

    def invert(self, cloud: Path, name: str, images: list[Path], options: list[str]) -> dict:
        """The errors of an inversion and its processor time (s)."""
        out, result = (self.work / f"{cloud.stem}-{name}{end}" for end in (".nc", ".json"))
        if not result.exists():
            start = self.start(cloud)
            grid = ["--grid", start, "--init", start]
            begun = processor_time()
            self.run("invert", *images, *grid, *options, "--out", out)
            used = processor_time() - begun
            result.write_text(json.dumps(compare(cloud, out) | {"seconds": used}))
        return json.loads(result.read_text())


def processor_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def compare(truth: Path, found: Path) -> dict:
    """The errors of a retrieved cloud, and those that its standard errors let expect."""
    with xr.open_dataset(truth, engine="h5netcdf") as cloud:
        fields = (cloud[name].values for name in ("extinction", "lwc", "reff"))
        # The radius is missing outside the clouds of some files.
        extinction, water, radius = map(np.nan_to_num, fields)
    with xr.open_dataset(found, engine="h5netcdf") as cloud:
        retrieved = cloud["extinction"].values
        given = float((extinction * radius).sum() / extinction.sum())
        radii = cloud["reff"].values if "reff" in cloud else np.full_like(radius, given)
        # The liquid water content is proportional to extinction times radius.
        scale = water.sum() / (extinction * radius).sum()
        lwc = cloud["lwc"].values if "lwc" in cloud else scale * retrieved * radii
        errors = {name: cloud[f"{name}_standard_error"].values
                  for name in ("extinction", "reff", "lwc") if f"{name}_standard_error" in cloud}
    seen = extinction * (radii > 0)
    # Mean absolute errors of normally distributed ones.
    expected = {
        "extinction": lambda error: error.sum() / extinction.sum(),
        "lwc": lambda error: error.sum() / water.sum(),
        "reff": lambda error: (seen * error).sum() / seen.sum(),
    }
    return {
        "epsilon": float(np.abs(retrieved - extinction).sum() / extinction.sum()),
        "radius": float((seen * np.abs(radii - radius)).sum() / seen.sum()),
        "water": float(np.abs(lwc - water).sum() / water.sum()),
        "mass": float(abs(lwc.sum() / water.sum() - 1.0)),
    } | {
        f"expected_{name}": float(np.sqrt(2 / np.pi) * expected[name](error))
        for name, error in errors.items()
    }


def row(name: str, results: list[dict], columns: dict[str, str]) -> str:
    cells = [form.format(np.mean([result[key] for result in results])) for key, form in columns.items()]
    return f"| {name} | " + " | ".join(cells) + " |"


TABLE = {"epsilon": "{:.3f}", "radius": "{:.2f}", "water": "{:.3f}", "mass": "{:.1%}", "seconds": "{:.0f} s"}
EXPECTED = {
    "expected_extinction": "{:.3f}", "epsilon": "{:.3f}", "expected_reff": "{:.2f}", "radius": "{:.2f}",
    "expected_lwc": "{:.3f}", "water": "{:.3f}",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--clouds", type=Path, required=True, nargs="+",
                        help="folder of the samples, or files of clouds with droplets and extinction")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--count", type=int, default=12, help="number of clouds of a folder")
    parser.add_argument("--solver", default="monte-carlo", choices=NOISE, help="solver of the images")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--methods", type=int, nargs="+", default=[*range(len(METHODS))],
                        help="numbers of the methods of the first table; the wrong cameras need all")
    parser.add_argument("--members", type=int, default=4, help="members for the expected errors")
    parser.add_argument("--figure", type=Path, help="figure of retrieved and true radii")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    bench = Bench(arguments)
    results: dict[str, list[dict]] = {}
    cameras: dict[str, list[dict]] = {}
    clouds = arguments.clouds
    if clouds[0].is_dir():
        clouds = [path for path in sorted(clouds[0].glob("*.nc")) if is_of_size(path)]
        clouds = clouds[:: max(1, len(clouds) // arguments.count)][: arguments.count]
    for cloud in clouds:
        images = {band: bench.images(cloud, band) for band in BANDS}
        for number, (name, (bands, options)) in enumerate(METHODS.items()):
            if number not in arguments.methods:
                continue
            options = [*options, arguments.members] if "--members" in options else options
            found = bench.invert(cloud, str(number), [images[band] for band in bands], options)
            results.setdefault(name, []).append(found)
        for number, (name, (which, options)) in enumerate(CAMERAS.items()):
            if len(arguments.methods) < len(METHODS):
                break
            path = images["visible"] if which == "visible" else bench.wrong(cloud, which)
            found = bench.invert(cloud, f"camera-{number}", [path], options)
            cameras.setdefault(name, []).append(found)
        print(f"{cloud.stem} of {len(clouds)} clouds", flush=True)
    print("| method | epsilon | radius (um) | epsilon of water | total water | processor time |")
    print("|---|---|---|---|---|---|")
    for name, found in results.items():
        print(row(name, found, TABLE))
    print("\n| method | epsilon: expected | found | radius (um): expected | found | water: expected | found |")
    print("|---|---|---|---|---|---|---|")
    for name, found in results.items():
        columns = {key: form for key, form in EXPECTED.items() if key in found[0]}
        if "expected_extinction" in columns:
            pairs = [key for key in EXPECTED if f"expected_{RETRIEVED.get(key)}" in columns]
            shown = {key: form for key, form in columns.items() if key in pairs or "expected" in key}
            print(row(name, found, shown))
    if cameras:
        print("\n| cameras | epsilon |\n|---|---|")
    for name, found in cameras.items():
        print(row(name, found, {"epsilon": "{:.3f}"}))
    if arguments.figure:
        draw(arguments.figure, bench.work, clouds)


RETRIEVED = {"epsilon": "extinction", "radius": "reff", "water": "lwc"}


def is_of_size(path: Path) -> bool:
    with xr.open_dataset(path, engine="h5netcdf") as cloud:
        return SIZES[0] <= int((cloud["extinction"].values > 1e-3).sum()) <= SIZES[1]


def draw(path: Path, work: Path, clouds: list[Path]) -> None:
    """Profiles of the extinction-weighted radius, and the radii of all voxels, of the clouds."""
    import matplotlib
    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), layout="constrained")
    names = {number: name for number, name in enumerate(METHODS) if name.startswith("two")}
    field = max(names)
    for number, cloud in enumerate(clouds[:6]):
        with xr.open_dataset(cloud, engine="h5netcdf") as truth:
            z, true = truth["z"].values, profile(truth)
        with xr.open_dataset(work / f"{cloud.stem}-{field}.nc", engine="h5netcdf") as found:
            retrieved = profile(found)
        colour = f"C{number}"
        axes[0].plot(true, z, color=colour)
        axes[0].plot(retrieved, z, "--", color=colour)
    axes[0].set(xlabel="effective radius (µm)", ylabel="altitude (km)",
                title="means of each level\n(true, and dashed: retrieved)")
    for axis, number in zip(axes[1:], (min(names), field)):
        pairs = [radii(cloud, work / f"{cloud.stem}-{number}.nc") for cloud in clouds]
        true, found, weight = (np.concatenate(part) for part in zip(*pairs))
        axis.scatter(true, found, s=0.15 * weight, alpha=0.25, linewidths=0)
        axis.plot([2, 18], [2, 18], color="black", linewidth=0.8)
        axis.set(xlabel="true effective radius (µm)", ylabel="retrieved (µm)", xlim=(2, 18), ylim=(2, 18),
                 aspect="equal", title=f"{names[number]}\n(area: extinction)")
    figure.savefig(path, dpi=110)


def profile(cloud: xr.Dataset) -> np.ndarray:
    extinction, radius = cloud["extinction"].values, cloud["reff"].values
    total = extinction.sum((1, 2))
    return np.where(total > 50, (extinction * radius).sum((1, 2)) / np.maximum(total, 1e-9), np.nan)


def radii(truth: Path, found: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The true and retrieved radii, and the extinction, of the voxels of a cloud."""
    with xr.open_dataset(truth, engine="h5netcdf") as cloud:
        extinction, true = cloud["extinction"].values, cloud["reff"].values
    with xr.open_dataset(found, engine="h5netcdf") as cloud:
        retrieved = cloud["reff"].values
    seen = (extinction > 1) & (retrieved > 0)
    return true[seen], retrieved[seen], extinction[seen]


if __name__ == "__main__":
    main()
