#!/usr/bin/env python3
"""Accuracy of networks on test clouds for many formations and Suns (docs/notes/general_network.md).

    python3 benches/general.py --simulations FOLDER --work DIR [--weights general,cloudct-10] \
        [--situations ten,pearls,random,few,land,ten-land,map] [--solvers ordinates,coarse,monte-carlo] [--clouds 24] \
        [--rico CLOUD.nc] [--program target/release/deepct]

Clouds: samples of `recipes/bomex-test.toml`, evenly distributed over their sizes, and optionally a
cloud of another simulation (`extinction`, or `lwc` and `reff`, on x, y, z in km). Situations:

- ten, pearls: the formations cloudct-10 and pearls-32 with their Sun (30, 45 degrees);
- random: 6 to 20 views in random directions up to 60 degrees from the zenith, the Sun at 0 to 60;
- few: the same with 3 to 5 views;
- land: 6 to 20 views as in random, above a surface of an albedo of 0.08 to 0.25, and
  ten-land: cloudct-10 with its Sun above one of 0.15;
- map: every combination of 3, 5, 8, 12, 20 views and Sun at 10, 30, 50, 65 degrees, for the first
  clouds.

All have the molecular atmosphere, the ocean and droplet optics by Mie theory; the images have the
noise of the CMV4000. Monte Carlo images have a noise of 2 % in bright pixels before that. The
estimate is carved. The script prints the means of epsilon and delta over the clouds, by situation,
weights and solver, and those by size and optical depth of the cloud; and the error that the network
expects against the one found, before carving. Results in DIR are not computed again. Requires
deepct_py, numpy and h5py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Iterator

import deepct_py as deepct
import h5py
import numpy as np

HERE = Path(__file__).parent
SMALLEST = 60
"""Minimum number of voxels of a cloud."""
ALTITUDE_KM = 600.0
"""Altitude of the cameras."""
PIXEL_KM = 0.05
"""Pixel size below a camera."""
EARTH_KM = 6371.0
COARSE = 0.05
"""Accuracy of the coarse ordinates, that of the training scenes of weights_tools."""
NOISE = 0.02
"""Relative noise of bright pixels in Monte Carlo images."""
LARGE, THICK = 800, 30.0
"""Number of voxels and optical depth of large and of thick clouds."""


@dataclass(frozen=True)
class Cloud:
    """A test cloud: extinction (1/km) and effective radius (um), both ``[z, y, x]``."""

    name: str
    regime: str
    grid: deepct.Grid
    extinction: np.ndarray
    effective_radius: np.ndarray

    @property
    def voxels(self) -> int:
        return int((self.extinction > 0.0).sum())

    @property
    def optical_depth(self) -> float:
        return float(self.extinction.sum(0).max() * self.grid.spacing[2])


@dataclass(frozen=True)
class Situation:
    """Zenith angles and azimuths of the views and of the Sun (degrees)."""

    name: str
    zenith: tuple[float, ...]
    azimuth: tuple[float, ...]
    sun: tuple[float, float]
    albedo: float = 0.05
    """Albedo of the surface."""

    def views(self, target: tuple[float, float, float], size: tuple[int, int]) -> deepct.Views:
        cameras = []
        for zenith, azimuth in zip(np.radians(self.zenith), np.radians(self.azimuth)):
            down = EARTH_KM * math.cos(zenith)
            far = math.sqrt(down**2 + ALTITUDE_KM * (2 * EARTH_KM + ALTITUDE_KM)) - down
            towards = np.array([math.sin(zenith) * math.sin(azimuth),
                                math.sin(zenith) * math.cos(azimuth), math.cos(zenith)])
            position = tuple(np.array(target) + far * towards)
            cameras.append(deepct.View.perspective(position, target, PIXEL_KM / ALTITUDE_KM, size))
        return deepct.Views(cameras)


def read_cloud(path: Path, regime: str) -> Cloud:
    """Read a cloud file of deepct."""
    with h5py.File(path) as file:
        radius = np.nan_to_num(file["reff"][...]) if "reff" in file else np.zeros(1)
        if "extinction" in file:
            extinction = np.nan_to_num(file["extinction"][...]).astype(np.float32)
        else:
            # The extinction of large droplets, 1500 km-1 per g m-3 and um.
            water = np.nan_to_num(file["lwc"][...])
            extinction = (1500.0 * water / np.where(water > 0.0, radius, 1.0)).astype(np.float32)
        centers = [file[axis][...] for axis in "xyz"]
    spacing = tuple(float(np.diff(axis).mean()) for axis in centers)
    origin = tuple(float(axis[0] - 0.5 * step) for axis, step in zip(centers, spacing))
    grid = deepct.Grid(extinction.shape, spacing, origin)
    radius = np.where(extinction > 0.0, radius if radius.any() else 10.0, 10.0)
    return Cloud(path.stem, regime, grid, extinction, radius.astype(np.float32))


def test_clouds(arguments: argparse.Namespace) -> list[Cloud]:
    folder = arguments.work / "bomex-test"
    if not (folder / "manifest.json").exists():
        recipe = HERE.parent / "recipes" / "bomex-test.toml"
        subprocess.run([arguments.program, "-q", "dataset", "generate", recipe, "--simulations",
                        arguments.simulations, "--out", folder], check=True)
    paths = sorted(folder.glob("samples/*.nc"))
    clouds = sorted((read_cloud(path, "BOMEX") for path in paths), key=lambda cloud: cloud.voxels)
    clouds = [cloud for cloud in clouds if cloud.voxels >= SMALLEST]
    count = min(arguments.clouds, len(clouds))
    chosen = [clouds[(2 * n + 1) * len(clouds) // (2 * count)] for n in range(count)]
    # In an order in which the first clouds are of all sizes.
    order = sorted(range(count), key=lambda n: (n * 7) % count if math.gcd(7, count) == 1 else n)
    chosen = [chosen[n] for n in order]
    return chosen + [read_cloud(path, "RICO") for path in arguments.rico]


def situations(name: str, cloud: Cloud) -> Iterator[Situation]:
    """The situations with a name, for a cloud; they depend on the name of the cloud only."""
    paper = (30.0, 45.0)
    if name in ("ten", "pearls"):
        formation = {"ten": "cloudct-10", "pearls": "pearls-32"}[name]
        views = deepct.Views.load(formation, cloud.grid.center)
        yield Situation(name, tuple(views.zenith_deg), tuple(views.azimuth_deg), paper)
        return
    if name == "ten-land":
        for situation in situations("ten", cloud):
            yield replace(situation, name=name, albedo=0.15)
        return
    draw = np.random.default_rng(list(f"{cloud.name} {name}".encode()))
    if name == "map":
        for sun in (10.0, 30.0, 50.0, 65.0):
            for count in (3, 5, 8, 12, 20):
                yield any_formation(draw, f"map {sun:.0f} {count}", count, sun)
        return
    count = int(draw.integers(3, 6) if name == "few" else draw.integers(6, 21))
    situation = any_formation(draw, name, count, float(draw.uniform(0.0, 60.0)))
    if name == "land":
        situation = replace(situation, albedo=float(draw.uniform(0.08, 0.25)))
    yield situation


def any_formation(draw: np.random.Generator, name: str, count: int, sun: float) -> Situation:
    """Views in random directions, evenly distributed over the solid angle."""
    cosines = draw.uniform(math.cos(math.radians(60.0)), 1.0, count)
    zenith = tuple(np.degrees(np.arccos(cosines)))
    azimuth = tuple(draw.uniform(0.0, 360.0, count))
    return Situation(name, zenith, azimuth, (sun, float(draw.uniform(0.0, 360.0))))


class Bench:
    """The working folder, and the networks."""

    def __init__(self, work: Path, weights: list[str]) -> None:
        self.folder = work / "general"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.networks = {name: deepct.Network.load(name) for name in weights}
        # Weights of a file may change; those that are built in do not within one version.
        self.identities = {
            name: hashlib.sha256(json.dumps(network.metadata, sort_keys=True).encode()).hexdigest()
            for name, network in self.networks.items()
        }

    def images(self, cloud: Cloud, situation: Situation, solver: str) -> np.ndarray:
        """Noisy images ``[view, row, col]`` (1/sr)."""
        light = self.light(situation)
        key = f"{cloud.name}-{situation.name}-{solver}".replace(" ", "-")
        path = self.folder / f"{key}.npy"
        if not path.exists():
            views = situation.views(cloud.grid.center, cloud.grid.shape[1:])
            how = {"solver": "ordinates", "estimate_error": False}
            if solver == "coarse":
                how["accuracy"] = COARSE
            if solver == "monte-carlo":
                how = {"solver": "monte-carlo", "noise": NOISE, "seed": 5}
            rendering = deepct.render(cloud.extinction, cloud.grid, views, light,
                                      effective_radius=cloud.effective_radius, **how)
            np.save(path, rendering.radiance)
        return deepct.sense(np.load(path), "cmv4000", seed=3).radiance

    def light(self, situation: Situation) -> deepct.Light:
        return deepct.Light(sun_zenith_deg=situation.sun[0], sun_azimuth_deg=situation.sun[1],
                            air=True, surface_albedo=situation.albedo, phase="mie",
                            extinction="mie")

    def row(self, cloud: Cloud, situation: Situation, solver: str, name: str) -> dict[str, Any]:
        """The scores of one network for one cloud."""
        key = f"{cloud.name}-{situation.name}-{solver}-{Path(name).stem}".replace(" ", "-")
        path = self.folder / f"{key}.json"
        if path.exists():
            row = json.loads(path.read_text())
            if row["identity"] == self.identities[name]:
                return row
        images = self.images(cloud, situation, solver)
        views = situation.views(cloud.grid.center, cloud.grid.shape[1:])
        answer = self.networks[name].estimate(
            images, views, self.light(situation), grid=cloud.grid)
        estimate, uncertainty = answer.extinction, answer.uncertainty
        mask = deepct.carve(images, views, cloud.grid).mask
        whole = deepct.score(cloud.extinction, estimate)
        carved = deepct.score(cloud.extinction, estimate * mask)
        row = {
            "cloud": cloud.name, "regime": cloud.regime, "voxels": cloud.voxels,
            "optical_depth": cloud.optical_depth, "situation": situation.name, "solver": solver,
            "weights": name, "identity": self.identities[name],
            "epsilon": carved.relative_error, "delta": carved.mass_error,
            "found": float(np.abs(estimate - cloud.extinction).sum() / estimate.sum()),
            "expected": float(uncertainty.sum() / estimate.sum()),
            "whole": whole.relative_error,
        }
        path.write_text(json.dumps(row))
        return row


def mean(rows: list[dict[str, Any]], key: str, absolute: bool = False) -> float:
    return float(np.mean([abs(row[key]) if absolute else row[key] for row in rows]))


def report(rows: list[dict[str, Any]]) -> None:
    """Print the tables."""
    print("\n| situation | clouds | images | weights | n | epsilon | delta | mean of abs(delta) |")
    print("|---|---|---|---|---|---|---|---|")
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        if row["situation"].startswith("map"):
            continue
        common = (row["situation"], row["solver"], row["weights"])
        groups.setdefault((common[0], row["regime"], *common[1:]), []).append(row)
        if row["regime"] == "BOMEX" and row["voxels"] > LARGE:
            name = f"more than {LARGE} voxels"
            groups.setdefault((common[0], name, *common[1:]), []).append(row)
        if row["regime"] == "BOMEX" and row["optical_depth"] > THICK:
            name = f"optical depth above {THICK:.0f}"
            groups.setdefault((common[0], name, *common[1:]), []).append(row)
    for key, group in sorted(groups.items()):
        print(f"| {' | '.join(key)} | {len(group)} | {mean(group, 'epsilon'):.3f} "
              f"| {mean(group, 'delta'):+.3f} | {mean(group, 'delta', True):.3f} |")
    print_map([row for row in rows if row["situation"].startswith("map")])
    print_calibration([row for row in rows if not row["situation"].startswith("map")])


def print_map(rows: list[dict[str, Any]]) -> None:
    for weights in sorted({row["weights"] for row in rows}):
        print(f"\nepsilon of {weights}, Sun zenith (rows) by number of views:\n")
        counts, suns = (3, 5, 8, 12, 20), (10, 30, 50, 65)
        print("| | " + " | ".join(map(str, counts)) + " |\n|" + "---|" * (len(counts) + 1))
        for sun in suns:
            cells = []
            for count in counts:
                name = f"map {sun} {count}"
                group = [row for row in rows
                         if row["situation"] == name and row["weights"] == weights]
                cells.append(f"{mean(group, 'epsilon'):.3f}" if group else "")
            print(f"| {sun} | " + " | ".join(cells) + " |")


def print_calibration(rows: list[dict[str, Any]]) -> None:
    """Error expected and found over the estimate, before carving, by quarters of the expected."""
    for weights in sorted({row["weights"] for row in rows}):
        for regime in sorted({row["regime"] for row in rows}):
            group = [row for row in rows if row["weights"] == weights and row["regime"] == regime]
            group.sort(key=lambda row: row["expected"])
            if len(group) < 4:
                continue
            parts = [group, *np.array_split(np.array(group, dtype=object), 4)]
            text = [f"{mean(list(part), 'expected'):.3f}/{mean(list(part), 'found'):.3f}"
                    for part in parts]
            print(f"\n{weights}, {regime}: error expected/found over the estimate: {text[0]}; "
                  f"by quarters {', '.join(text[1:])}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, required=True, help="folder of the BOMEX runs")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--weights", default="general", help="names or files, with commas")
    parser.add_argument("--situations", default="ten,pearls,random,few")
    parser.add_argument("--solvers", default="ordinates")
    parser.add_argument("--clouds", type=int, default=24)
    parser.add_argument("--map-clouds", type=int, default=6)
    parser.add_argument("--rico", type=Path, nargs="*", default=[], help="files of other clouds")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    bench = Bench(arguments.work, arguments.weights.split(","))
    rows = []
    for number, cloud in enumerate(test_clouds(arguments)):
        for name in arguments.situations.split(","):
            if name == "map" and number >= arguments.map_clouds:
                continue
            for situation in situations(name, cloud):
                for solver in arguments.solvers.split(","):
                    for weights, network in bench.networks.items():
                        fixed = network.metadata.get("formation")
                        own = {"ten": "cloudct-10", "ten-land": "cloudct-10",
                               "pearls": "pearls-32"}.get(name)
                        if fixed is not None and (fixed != own or cloud.regime != "BOMEX"):
                            continue
                        row = bench.row(cloud, situation, solver, weights)
                        rows.append(row)
                        print(f"{cloud.name:16} {cloud.voxels:5} {situation.name:10} {solver:11} "
                              f"{Path(weights).stem:12} {row['epsilon']:.3f} {row['delta']:+.3f}",
                              flush=True)
    report(rows)


if __name__ == "__main__":
    main()
