#!/usr/bin/env python3
"""Measure the results in docs/notes/results.md and write this page from results_template.md.

    python3 benches/results.py --simulations FOLDER --rico rico32_cloud.nc --work FOLDER \
        [--program target/release/deepct]

The simulations are those of `recipes/bomex-test.toml`. Existing files in the working folder are
used again, so that an interrupted run can be resumed; use a new folder for another program or
network. The page and its figures are written to docs. Requires numpy, scipy, xarray and h5netcdf.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np
import xarray as xr

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs" / "notes"
NETWORKS = {"cloudct-10": "10 views", "pearls-32": "32 views"}
DEPTHS = {"below 10": (0.0, 10.0), "10 to 30": (10.0, 30.0), "above 30": (30.0, np.inf)}
SQUARES = {
    64: ["--set", "counts.test=6"],
    128: ["--set", "counts.test=1", "--set", "columns=128", "--set", "minimum_columns=400"],
}
"""Settings of `bomex-fields.toml` for each number of columns along the side of a field."""
MIE = ["--set", "optics.phase=mie", "--set", "optics.extinction=mie"]
COLUMNS = 32
"""Number of columns along each side of the scene of the RICO cloud."""


class Field(NamedTuple):
    """Mean epsilon (%) of complete clouds, alone and in their field, and of whole fields."""

    clouds: int
    alone: float
    inside: float
    whole: float


class Bench:
    """The working folder and the program."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.simulations, self.rico = arguments.simulations, arguments.rico
        self.work, self.program = arguments.work, arguments.program.resolve()

    def run(self, *arguments: object) -> str:
        """Run a command of the program and return its output."""
        words = [str(argument) for argument in arguments]
        print("deepct", shlex.join(words), flush=True)
        return output([str(self.program), "-q", *words])

    def made(self, name: str, make: Callable[[Path], object]) -> Path:
        """A file or folder of the working folder, which is created unless it is complete."""
        path, done = self.work / name, self.work / f"{name}.done"
        if not done.exists():
            make(path)
            done.touch()
        return path

    def samples(self, name: str, recipe: str, *settings: str) -> Path:
        """Generate a data set and return its folder."""
        source = HERE.parent / "recipes" / recipe
        options = ["--simulations", self.simulations, *settings]
        return self.made(
            name, lambda out: self.run("dataset", "generate", source, *options, "--out", out)
        )

    def experiment(self, name: str, recipe: str, *settings: str) -> list[dict]:
        """Run an experiment and return one result for each cloud and method."""
        source = HERE.parent / "recipes" / recipe
        sets = [word for setting in settings for word in ("--set", setting)]
        out = self.made(name, lambda out: self.run("experiment", source, *sets, "--out", out))
        return [json.loads(path.read_text()) for path in sorted((out / "results").glob("*.json"))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=Path, required=True, help="folder of the BOMEX runs")
    parser.add_argument("--rico", type=Path, required=True, help="the RICO cloud with 20 m voxels")
    parser.add_argument("--work", type=Path, required=True, help="working folder")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    bench = Bench(arguments)
    test = bench.samples("bomex-test", "bomex-test.toml")
    isolated, fields, rico = {}, {}, {}
    for name in NETWORKS:
        settings = [f"dataset={test}", f"weights={name}"]
        isolated[name] = bench.experiment(f"test-{name}", "test-clouds.toml", *settings)
        for columns in SQUARES:
            fields[name, columns] = field(bench, name, columns)
        rico[name] = rico_error(bench, name, plain=False)
    rico["plain"] = rico_error(bench, "cloudct-10", plain=True)
    page = Template((HERE / "results_template.md").read_text()).substitute(
        networks=network_table(isolated),
        depths=depth_table(isolated),
        expected=expected(isolated),
        fields=field_table(fields, isolated),
        rico_10=percent(rico["cloudct-10"]),
        rico_32=percent(rico["pearls-32"]),
        rico_plain=percent(rico["plain"]),
    )
    (DOCS / "results.md").write_text(page)


def output(command: list[str]) -> str:
    """Run a command and return its output."""
    done = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{Path(command[0]).name} failed (see above); repeat the call to resume")
    return done.stdout


def column(results: list[dict], key: str, way: str = "network") -> np.ndarray:
    """One value for each cloud."""
    return np.array([result[key] for result in results if result["method"] == way], float)


def spread(values: np.ndarray, digits: int = 1) -> str:
    """Mean and standard deviation as text."""
    return f"{values.mean():.{digits}f} +- {values.std(ddof=1):.{digits}f}"


def percent(value: float) -> str:
    return f"{100.0 * value:.1f}"


def table(*rows: list[str]) -> str:
    """A Markdown table whose first row is the header."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def network_table(isolated: dict[str, list[dict]]) -> str:
    rows = [["", "epsilon (%)", "target", "delta (%)", "abs(delta) (%)", "target", "time (ms)"]]
    for (name, views), bar in zip(NETWORKS.items(), (45, 40)):
        delta = 100.0 * column(isolated[name], "mass_error")
        error = f"**{spread(100.0 * column(isolated[name], 'relative_error'))}**"
        seconds = f"{1000.0 * column(isolated[name], 'seconds').mean():.0f}"
        size = f"{np.abs(delta).mean():.1f}"
        rows.append([views, error, str(bar), spread(delta), size, "8", seconds])
    rows.append(["10 views, paper", "86 +- 10", "", "44 +- 16", "", "", "7, RTX 2080"])
    rows.append(["32 views, paper", "82 +- 10", "", "32 +- 16", "", "", ""])
    return table(*rows)


def depth_table(isolated: dict[str, list[dict]]) -> str:
    depths = column(isolated["cloudct-10"], "optical_depth")
    inside = {name: (depths >= low) & (depths < high) for name, (low, high) in DEPTHS.items()}
    head = [f"{name} ({clouds.sum()} clouds)" for name, clouds in inside.items()]
    rows = [["", *head]]
    for name, views in NETWORKS.items():
        error, delta = (column(isolated[name], key) for key in ("relative_error", "mass_error"))
        rows.append(
            [views]
            + [f"{percent(error[c].mean())}, {percent(delta[c].mean())}" for c in inside.values()]
        )
    return table(*rows)


def expected(isolated: dict[str, list[dict]]) -> str:
    """The mean errors that the networks expect, and their correlation with the actual errors."""
    sentences = []
    for name, views in NETWORKS.items():
        told = column(isolated[name], "expected_relative_error")
        correlation = np.corrcoef(told, column(isolated[name], "relative_error"))[0, 1]
        sentences.append(f"{percent(told.mean())} % with {views} (correlation {correlation:.2f})")
    return " and ".join(sentences)


def field(bench: Bench, name: str, columns: int) -> Field:
    """The errors of a network for fields of a given size."""
    place = f"fields-{columns}-{name}"
    choice = [*SQUARES[columns], "--set", "counts.validation=0", "--set", f"formation={name}"]
    folder = bench.samples(place, "bomex-fields.toml", *choice)
    files = sorted((folder / "samples").glob("*.nc"))
    settings = [f"dataset={folder}", f"weights={name}", f"samples={len(files)}"]
    whole = column(
        bench.experiment(f"whole-{place}", "test-clouds.toml", *settings), "relative_error"
    )

    def compare(out: Path) -> None:
        script = [sys.executable, HERE / "field_clouds.py", *files]
        options = ["--weights", name, "--program", bench.program]
        print(f"python3 benches/field_clouds.py {folder}/samples/*.nc --weights {name}", flush=True)
        out.write_text(output([str(word) for word in [*script, *options]]))

    told = bench.made(f"clouds-{place}.txt", compare).read_text()
    found = re.search(r"(\d+) clouds: ([\d.]+) alone, ([\d.]+) in the field", told)
    if found is None:
        raise SystemExit(f"{place}: no mean in the output of field_clouds.py")
    count, alone, inside = found.groups()
    return Field(int(count), 100.0 * float(alone), 100.0 * float(inside), 100.0 * whole.mean())


def field_table(fields: dict[tuple[str, int], Field], isolated: dict[str, list[dict]]) -> str:
    head = ["", "views", "clouds", "alone", "in the field", "ratio (target 1.15)"]
    rows = [[*head, "whole field", "over isolated clouds"]]
    for (name, columns), own in fields.items():
        ratio = own.inside / own.alone
        over = own.whole / (100.0 * column(isolated[name], "relative_error").mean())
        means = [f"{own.alone:.1f}", f"{own.inside:.1f}", f"**{ratio:.2f}**", f"{own.whole:.1f}"]
        square = f"{columns} x {columns}"
        rows.append([square, NETWORKS[name][:2], str(own.clouds), *means, f"{over:.2f}"])
    return table(rows[0], *sorted(rows[1:], key=lambda row: (int(row[0].split()[0]), row[1])))


def rico_error(bench: Bench, name: str, plain: bool) -> float:
    """Epsilon of the single RICO cloud on voxels of 50 m in an otherwise clear scene."""
    scene = bench.made("rico.nc", lambda out: rico_scene(bench, out))
    light = [] if plain else ["--air", *MIE]
    paths = ["--samples", 256 if plain else 128, "--similarity-after", 3]
    images = bench.made(
        f"rico-{name}{'-plain' if plain else ''}.nc",
        lambda out: bench.run("render", scene, "--views", name, *light, *paths, "--out", out),
    )
    noisy, volume = bench.work / "noisy.nc", bench.work / "volume.nc"
    bench.run("sense", images, "--out", noisy)
    bench.run("infer", noisy, "--weights", name, "--carve", "--out", volume)
    optics = [] if plain else ["--set", "optics.extinction=mie"]
    told = bench.run("score", "--truth", scene, volume, *optics, "--json")
    return json.loads(told)[0]["relative_error"]


def rico_scene(bench: Bench, out: Path) -> None:
    imported = bench.work / "rico50.nc"
    bench.run("cloud", "import", bench.rico, "--base", 0.48, "--levels", 32, "--out", imported)
    cloud = xr.load_dataset(imported)[["lwc", "reff", "veff"]]
    free = {axis: COLUMNS - cloud.sizes[axis] for axis in "xy"}
    around = {axis: (free[axis] // 2, free[axis] - free[axis] // 2) for axis in "xy"}
    middles = 0.05 * (np.arange(COLUMNS) + 0.5)
    places = {axis: (axis, middles, {"units": "km"}) for axis in "xy"}
    cloud.pad(around, constant_values=0.0).assign_coords(places).to_netcdf(out, engine="h5netcdf")


if __name__ == "__main__":
    main()
