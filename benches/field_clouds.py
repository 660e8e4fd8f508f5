#!/usr/bin/env python3
"""Tell what a field does to a network from what its clouds do: each cloud in it and alone.

    python3 benches/field_clouds.py FIELD.nc [...] --weights NAME [--program target/release/deepct]

FIELD.nc is a sample of `deepct dataset generate recipes/bomex-fields.toml --set formation=NAME`.
Every cloud that stands whole in its field and fits into 32 x 32 columns is put alone into the middle
of that many clear ones and rendered as the field was; to either, with noise, the network answers
inside the carved mask. Printed: epsilon over the columns of the cloud and two around it, alone and
in the field, by cloud, and the ratio of the means. Needs numpy, scipy, xarray and h5netcdf.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage

COLUMNS = 32
"""Columns on each side of a cloud's own scene."""
LARGEST = 26
"""Columns that a cloud may span: the rest is for its parallax."""
LEAST_SHARE = 0.01
"""Of its field's extinction, below which a cloud is a shred."""
CLOUDY = 0.1
"""Extinction (1/km) that counts as cloud."""
MARGIN = 2
"""Columns around a cloud whose errors are its own."""


class Row(NamedTuple):
    """What one cloud came to."""

    optical_depth: float
    alone: float
    in_field: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("fields", type=Path, nargs="+", help="files of the fields")
    parser.add_argument("--weights", default="cloudct-10", help="name of the built-in weights")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    rows: list[Row] = []
    print("field                 optical depth    alone  in the field")
    for path in arguments.fields:
        for row in clouds(path, arguments.program, arguments.weights):
            print(f"{path.stem:20}  {row[0]:13.1f}  {row[1]:7.3f}  {row[2]:12.3f}", flush=True)
            rows.append(row)
    if not rows:
        raise SystemExit("no cloud stands whole in its field and fits into 32 x 32 columns")
    mean = Row(*np.mean(rows, axis=0))
    ratio = mean.in_field / mean.alone
    print(f"{len(rows)} clouds: {mean.alone:.3f} alone, {mean.in_field:.3f} in the field, {ratio:.3f}")


def clouds(path: Path, program: Path, weights: str) -> Iterator[Row]:
    """Each cloud of a field."""
    field = xr.load_dataset(path)[["extinction", "lwc", "reff", "veff"]]
    truth, estimate = field.extinction.values, answer(path, program, weights)
    labels, _ = ndimage.label(truth > CLOUDY, np.ones((3, 3, 3)))
    for number, (_, rows, cols) in enumerate(ndimage.find_objects(labels), 1):
        cloud = labels == number
        spans = [(side.start, side.stop) for side in (rows, cols)]
        cut = min(start for start, _ in spans) == 0 or max(s for _, s in spans) == len(field.x)
        large = max(stop - start for start, stop in spans) > LARGEST
        if cut or large or truth[cloud].sum() < LEAST_SHARE * truth.sum():
            continue
        scene = alone(field, cloud, spans)
        with tempfile.TemporaryDirectory() as name:
            images = render(scene, Path(name), program, weights)
            found = answer(images, program, weights)
        seen = scene.extinction.values
        own = ndimage.binary_dilation(seen.any(0), iterations=MARGIN)
        near = ndimage.binary_dilation(cloud.any(0), iterations=MARGIN)
        near &= ~((labels > 0) & ~cloud).any(0)
        depth = seen.sum(0).max() * float(field.z[1] - field.z[0])
        yield Row(depth, error(seen, found, own), error(truth, estimate, near))


def alone(field: xr.Dataset, cloud: np.ndarray, spans: list[tuple[int, int]]) -> xr.Dataset:
    """One cloud of a field in the middle of clear columns."""
    parts, around, places = {}, {}, {}
    for axis, (start, stop) in zip("yx", spans):
        spacing = float(field[axis][1] - field[axis][0])
        before = (COLUMNS - (stop - start)) // 2
        parts[axis] = slice(start, stop)
        around[axis] = (before, COLUMNS - (stop - start) - before)
        places[axis] = (axis, spacing * (np.arange(COLUMNS) + 0.5), field[axis].attrs)
    scene = field.where(xr.DataArray(cloud, dims=("z", "y", "x")), 0.0).isel(parts)
    return scene.pad(around, constant_values=0.0).assign_coords(places)


def render(scene: xr.Dataset, folder: Path, program: Path, weights: str) -> Path:
    """The images of a scene, as a data set has them."""
    cloud, images = folder / "cloud.nc", folder / "images.nc"
    scene.drop_vars("extinction").to_netcdf(cloud, engine="h5netcdf")
    droplets = ["--set", "optics.phase=mie", "--set", "optics.extinction=mie"]
    light = ["--solver", "ordinates", "--air", *droplets]
    run(program, "render", cloud, "--views", weights, *light, "--out", images)
    return images


def answer(images: Path, program: Path, weights: str) -> np.ndarray:
    """The network's extinction from images to which noise is added."""
    with tempfile.TemporaryDirectory() as name:
        noisy, volume = Path(name) / "noisy.nc", Path(name) / "volume.nc"
        run(program, "sense", images, "--out", noisy)
        run(program, "infer", noisy, "--weights", weights, "--carve", "--out", volume)
        with xr.open_dataset(volume) as estimate:
            return estimate.extinction.values


def error(truth: np.ndarray, estimate: np.ndarray, columns: np.ndarray) -> float:
    """Epsilon over some columns."""
    return float(np.abs(estimate - truth)[:, columns].sum() / truth[:, columns].sum())


def run(program: Path, *arguments: str | Path) -> None:
    subprocess.run([program, "-q", *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
