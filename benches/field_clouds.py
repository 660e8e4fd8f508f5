#!/usr/bin/env python3
"""Separate the effect of a field on the network from that of its clouds.

    python3 benches/field_clouds.py FIELD.nc [...] --weights NAME [--program target/release/deepct]

FIELD.nc is a sample of `deepct dataset generate recipes/bomex-fields.toml --set formation=NAME`.
Every cloud that lies completely within its field and fits into 32 x 32 columns is also placed alone
at the centre of a clear scene of this size, which is rendered like the field. With noise added to
the images, the network estimates the extinction inside the carved mask of the field and of the
single cloud. The script prints epsilon of each cloud alone and in the field, over the columns of
the cloud and a margin of two columns, and the ratio of the means. Requires numpy, scipy, xarray and
h5netcdf.
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
"""Number of columns along each side of the scene of a single cloud."""
LARGEST = 26
"""Maximum number of columns that a cloud may span, to leave room for its parallax."""
LEAST_SHARE = 0.01
"""Minimum share of the extinction of the field; smaller clouds are ignored."""
CLOUDY = 0.1
"""Extinction (1/km) above which a voxel is cloudy."""
MARGIN = 2
"""Number of columns around a cloud whose errors are attributed to it."""


class Row(NamedTuple):
    """Optical depth and errors (epsilon) of one cloud."""

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
        raise SystemExit("no cloud lies within its field and fits into 32 x 32 columns")
    mean = Row(*np.mean(rows, axis=0))
    ratio = mean.in_field / mean.alone
    print(f"{len(rows)} clouds: {mean.alone:.3f} alone, {mean.in_field:.3f} in the field, {ratio:.3f}")


def clouds(path: Path, program: Path, weights: str) -> Iterator[Row]:
    """The results for each cloud of a field."""
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
    """One cloud of a field at the centre of a clear scene."""
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
    """The images of a scene, rendered with the settings of the data set."""
    cloud, images = folder / "cloud.nc", folder / "images.nc"
    scene.drop_vars("extinction").to_netcdf(cloud, engine="h5netcdf")
    droplets = ["--set", "optics.phase=mie", "--set", "optics.extinction=mie"]
    light = ["--solver", "ordinates", "--air", *droplets]
    run(program, "render", cloud, "--views", weights, *light, "--out", images)
    return images


def answer(images: Path, program: Path, weights: str) -> np.ndarray:
    """The extinction that the network estimates after noise is added to the images."""
    with tempfile.TemporaryDirectory() as name:
        noisy, volume = Path(name) / "noisy.nc", Path(name) / "volume.nc"
        run(program, "sense", images, "--out", noisy)
        run(program, "infer", noisy, "--weights", weights, "--carve", "--out", volume)
        with xr.open_dataset(volume) as estimate:
            return estimate.extinction.values


def error(truth: np.ndarray, estimate: np.ndarray, columns: np.ndarray) -> float:
    """Epsilon over the given columns."""
    return float(np.abs(estimate - truth)[:, columns].sum() / truth[:, columns].sum())


def run(program: Path, *arguments: str | Path) -> None:
    subprocess.run([program, "-q", *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
