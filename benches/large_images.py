#!/usr/bin/env python3
"""Networks on images that are larger than the memory: time, memory, and continuation after a kill.

    python3 benches/large_images.py FIELD.nc [--pixels 2048] [--program target/release/deepct] [--work DIR]
        [--kill [SECONDS]] [--workers]

FIELD.nc is a field of clouds with periodic sides, such as a large-eddy simulation read by `deepct cloud
import`. Its images by ten parallel cameras (Monte Carlo, 32 photon paths per pixel) are repeated to the
number of pixels along each side. The script prints the elapsed time, the processor time and the largest
memory of `deepct infer`, and the sizes of the files. With --kill, the command is also killed three
times, after so many seconds, and repeated until it ends, and the bytes of both results are compared. With
--workers alone, the field is computed by dask with one and with two worker processes of one thread each, in
turns. Requires numpy, xarray, h5netcdf and, for --workers, distributed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr

VIEWS = [(46, 180), (34, 180), (26, 180), (18, 180), (9, 180), (0, 0), (9, 0), (18, 0), (26, 0), (34, 0)]
"""Zenith and azimuth (degrees) of the cameras: those of cloudct-10."""

TURNS = (1, 2, 1, 2)
"""Numbers of workers, in turns."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("field", type=Path, help="file of the field of clouds")
    parser.add_argument("--pixels", type=int, default=2048, help="pixels along each side")
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--work", type=Path, help="folder that keeps the images")
    parser.add_argument(
        "--kill", type=float, nargs="?", const=20.0, metavar="SECONDS",
        help="also kill the command three times after so many seconds, and continue it",
    )
    parser.add_argument("--workers", action="store_true", help="compute the field by dask instead")
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp())
    work.mkdir(parents=True, exist_ok=True)
    images = repeated(rendered(arguments, work), work, arguments.pixels)
    print(f"{arguments.pixels} x {arguments.pixels} pixels, {len(VIEWS)} views", flush=True)
    if arguments.workers:
        distributed(images)
        return
    out = work / "volume.nc"
    line = [arguments.program, "infer", images, "--carve", "--quiet", "--out", out]
    start = time.monotonic()
    _, status, usage = os.wait4(subprocess.Popen([*map(str, line)]).pid, 0)
    if status != 0:
        raise SystemExit("infer failed")
    seconds = time.monotonic() - start
    cpu = usage.ru_utime + usage.ru_stime
    print(f"{seconds:.0f} s, {cpu:.0f} s of processors, {usage.ru_maxrss * 1024 / 1e9:.2f} GB of memory")
    print(f"images {images.stat().st_size / 1e9:.2f} GB, estimate {out.stat().st_size / 1e9:.2f} GB", flush=True)
    if arguments.kill:
        killed(line, out, arguments.kill)


def rendered(arguments: argparse.Namespace, work: Path) -> Path:
    """The images of the field between periodic sides."""
    views, out = work / "views.toml", work / "field.nc"
    if not out.exists():
        views.write_text(
            "".join(
                f"[[view]]\nview_zenith_deg = {zenith}\nview_azimuth_deg = {azimuth}\npixel_km = 0.05\n"
                for zenith, azimuth in VIEWS
            )
        )
        line = ["render", arguments.field, "--views", views, "--like", "general", "--periodic"]
        line += ["--samples", 32, "--quiet", "--out", out]
        subprocess.run([arguments.program, *map(str, line)], check=True)
    return out


def repeated(field: Path, work: Path, pixels: int) -> Path:
    """The images, repeated to so many pixels along each side; written row by row."""
    out = work / f"images_{pixels}.nc"
    if out.exists():
        return out
    import h5netcdf

    with xr.open_dataset(field, engine="h5netcdf") as images, h5netcdf.File(out, "w") as file:
        radiance = images.radiance.values
        views, rows, cols = radiance.shape
        file.dimensions = {"view": views, "row": pixels, "col": pixels, "component": 3}
        for name in ["target", "view_zenith_deg", "view_azimuth_deg", "pixel_km"]:
            variable = images[name]
            file.create_variable(name, variable.dims, data=variable.values).attrs["units"] = variable.units
        for name in ["sun_zenith_deg", "sun_azimuth_deg", "wavelength"]:
            file.create_variable(name, (), data=images[name].values).attrs["units"] = images[name].units
        chunks = (1, 256, 256)
        options = {"chunks": chunks, "compression": "gzip", "compression_opts": 1, "shuffle": True}
        written = file.create_variable("radiance", ("view", "row", "col"), "f4", **options)
        written.attrs["units"] = "sr-1"
        wide = np.tile(radiance, (1, 1, -(-pixels // cols)))[:, :, :pixels]
        for first in range(0, pixels, rows):
            count = min(rows, pixels - first)
            written[:, first : first + count] = wide[:, :count]
    return out


def killed(line: list, out: Path, seconds: float) -> None:
    """Kill the command three times, continue it, and compare its result."""
    again = out.with_name("continued.nc")
    line = [*map(str, line[:-1]), str(again)]
    kills = 0
    while True:
        process = subprocess.Popen(line)
        try:
            if process.wait(timeout=seconds if kills < 3 else None) != 0:
                raise SystemExit("infer failed")
            break
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            kills += 1
    same = out.read_bytes() == again.read_bytes()
    print(f"killed {kills} times: {'the same bytes' if same else 'OTHER BYTES'}")


def distributed(images: Path) -> None:
    """Compute the field by one and by two workers, in turns.

    On a machine that does nothing else, the ratio of the elapsed times is the gain. On a busy one, the
    processor time tells it: that of one worker by the largest of two, both without their start.
    """
    import deepct_py
    from dask.distributed import Client, LocalCluster

    os.environ["RAYON_NUM_THREADS"] = "1"
    options = {"threads_per_worker": 1, "dashboard_address": None, "memory_limit": "4GB"}
    used = {1: [], 2: []}
    for workers in TURNS:
        with LocalCluster(n_workers=workers, **options) as cluster, Client(cluster) as client:
            with xr.open_dataset(images, engine="h5netcdf") as opened:
                field = deepct_py.infer(opened, carve=True)
                client.run(begin)
                before, own = client.run(time.process_time), time.process_time()
                start = time.monotonic()
                total = field.extinction.sum(dtype="f8").compute().item()
                elapsed = time.monotonic() - start
                after, own = client.run(time.process_time), time.process_time() - own
        cpu = [after[worker] - before[worker] for worker in before]
        used[workers].append((elapsed, max(cpu)))
        print(
            f"{workers} workers: {elapsed:.1f} s, {' and '.join(f'{one:.1f}' for one in cpu)} s of processors, "
            f"{own:.1f} s of the client, sum {total:.8e}",
            flush=True,
        )
    elapsed, cpu = ([min(one) / min(two) for one, two in zip(zip(*used[1]), zip(*used[2]))])
    print(f"two workers are {elapsed:.2f} times as fast, {cpu:.2f} times by processor time")


def begin() -> None:
    """What a worker does once."""
    import deepct_py
    import h5netcdf  # noqa: F401

    deepct_py.Network.load()


if __name__ == "__main__":
    main()
