#!/usr/bin/env python3
"""Physics on whole fields: time, memory and error of the network and the hybrid by number of columns.

    python3 benches/whole_field.py LES.nc [--time N] [--columns 64 128 256] [--methods network quick]
        [--program target/release/deepct] [--work DIR]

LES.nc is a field of clouds on voxels of 50 x 50 x 40 m. Its south-western columns, between open sides,
are seen by ten views: Monte Carlo images (128 photon paths per pixel) with the noise of a sensor. For
each method the script prints epsilon and delta of the whole field, the processor time, the elapsed time
and the largest memory of the process. Results in DIR are used again.

A hybrid of more than 144 columns is computed in tiles of 96. For such a field the script also prints epsilon
within two voxels of the seams between tiles and elsewhere, and epsilon of bands of the same form at all other
places, whose mean and standard deviation tell what chance does. The estimate of the network has no seams: its
epsilon at the same places tells how difficult the clouds there are. Requires numpy and deepct_py.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

import deepct_py
import numpy as np

WHOLE = 144
"""Columns along a side up to which a hybrid is computed as one."""
TILE = 96
"""Columns of a tile along a side."""
NEAR = 2
"""Voxels on each side of a seam that belong to it."""

METHODS = {
    "network": ["infer", "--carve"],
    "quick": ["hybrid", "--quick"],
    "hybrid": ["hybrid"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("field", type=Path, help="file of the simulation")
    parser.add_argument("--time", type=int, default=60, help="step of the simulation")
    parser.add_argument("--columns", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["network", "quick"])
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--work", type=Path, help="folder that keeps the results")
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp())
    work.mkdir(parents=True, exist_ok=True)
    print("columns  method   epsilon    delta  cpu (s)  elapsed (s)  memory (GB)")
    for columns in arguments.columns:
        cloud, noisy = images(arguments, work, columns)
        for method in arguments.methods:
            out = work / f"{method}_{columns}.nc"
            record = work / f"{method}_{columns}.json"
            if not record.exists():
                line = [*METHODS[method], noisy, "--grid", cloud, "--out", out]
                record.write_text(json.dumps(measure(arguments.program, line)))
            used = json.loads(record.read_text())
            line = [arguments.program, "score", "--truth", cloud, out, "--json"]
            score = json.loads(subprocess.run(line, check=True, capture_output=True).stdout)[0]
            print(
                f"{columns:7}  {method:8} {score['relative_error']:6.3f}  {score['mass_error']:+7.3f}"
                f"  {used['cpu']:7.0f}  {used['elapsed']:11.0f}  {used['memory']:11.2f}",
                flush=True,
            )
            if columns > WHOLE:
                print(f"{'':9}{seams(cloud, out)}", flush=True)


def images(arguments: argparse.Namespace, work: Path, columns: int) -> tuple[Path, Path]:
    """The cloud and the noisy images of a field of so many columns along each side."""
    cloud, clean, noisy = (work / f"{name}_{columns}.nc" for name in ("cloud", "images", "noisy"))
    crop = f"0,0,{columns},{columns}"
    steps = [
        (cloud, ["cloud", "import", arguments.field, "--time", arguments.time, "--crop", crop]
         + ["--base", 0.48, "--levels", 32]),
        (clean, ["render", cloud, "--views", "cloudct-10", "--like", "general", "--samples", 128]),
        (noisy, ["sense", clean]),
    ]
    for out, line in steps:
        if not out.exists():
            run(arguments.program, [*line, "--out", out])
    return cloud, noisy


def seams(cloud: Path, out: Path) -> str:
    """Epsilon near the seams and elsewhere."""
    volume = deepct_py.read_volume(out)
    truth = deepct_py.Estimate(volume.grid, deepct_py.read_cloud(cloud), light=volume.light).extinction
    truth = truth.astype("f8")
    error = np.abs(volume.extinction - truth)

    def near(shift: int) -> np.ndarray:
        """The columns within two voxels of the seams, if these were shifted."""
        lines = np.arange(TILE, truth.shape[1], TILE) + shift
        distance = np.abs(np.arange(truth.shape[1])[:, None] + 0.5 - lines).min(axis=1) < NEAR
        return distance[:, None] | distance

    def epsilon(columns: np.ndarray) -> float:
        return error[:, columns].sum() / truth[:, columns].sum()

    at_seams = near(0)
    shifts = [shift for shift in range(-TILE // 2, TILE // 2) if abs(shift) > 2 * NEAR]
    others = [epsilon(near(shift)) for shift in shifts]
    return (
        f"epsilon {epsilon(at_seams):.3f} at the seams, {epsilon(~at_seams):.3f} elsewhere; "
        f"{np.mean(others):.3f} +- {np.std(others):.3f} in such bands at other places"
    )


def run(program: Path, line: list) -> None:
    subprocess.run([program, *map(str, line), "--quiet"], check=True)


def measure(program: Path, line: list) -> dict[str, float]:
    """Processor time, elapsed time (s) and largest memory (GB) of a command."""
    start = time.monotonic()
    process = subprocess.Popen([program, *map(str, line), "--quiet"])
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{program} {' '.join(map(str, line))} failed")
    return {
        "cpu": usage.ru_utime + usage.ru_stime,
        "elapsed": time.monotonic() - start,
        "memory": usage.ru_maxrss * 1024 / 1e9,
    }


if __name__ == "__main__":
    main()
