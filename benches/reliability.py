#!/usr/bin/env python3
"""Reliability of the program (docs/notes/reliability.md).

    python3 benches/reliability.py kill --verb invert --times 50
    python3 benches/reliability.py mutate --minutes 30
    python3 benches/reliability.py load --inferences 100000

- kill: an inversion is stopped at random moments, twice each time, by SIGKILL or SIGINT, and
  resumed; its extinction is compared with that of a run that was not stopped.
- mutate: files of images, clouds and weights in which single bytes are changed, or whose end is
  missing, are given to the program. Each must be read or refused with the exit status 2.
- load: images of changing sizes and formations are given to networks in one Python process, from
  several threads; its memory must not grow.

Needs numpy and h5py, and deepct_py for load.
"""

from __future__ import annotations

import argparse
import collections
import os
import random
import resource
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

HANGING_S = 60.0
"""Duration after which a command on a damaged file is said to hang."""
LONG_S = 15.0
"""Duration above which a refusal is that of a file whose reading did not end by itself."""


def run(program: Path, arguments: str, folder: Path) -> None:
    subprocess.run([program, "-q", *arguments.split()], cwd=folder, check=True)


def inputs(program: Path, folder: Path) -> None:
    run(program, "cloud generate --seed 5 --out cloud.nc", folder)
    run(program, "render cloud.nc --views cloudct-10 --solver ordinates --out clean.nc", folder)
    run(program, "sense clean.nc --out images.nc", folder)


def kill(arguments: argparse.Namespace, folder: Path) -> None:
    import h5py

    def extinction(name: str) -> np.ndarray:
        with h5py.File(folder / name) as file:
            return file["extinction"][...]

    start = [arguments.program, "-q", arguments.verb, "images.nc", "--grid", "cloud.nc"]
    begun = time.monotonic()
    subprocess.run([*start, "--out", "whole.nc"], cwd=folder, check=True)
    whole, duration = extinction("whole.nc"), time.monotonic() - begun
    different, slowest = 0, 0.0
    for _ in range(arguments.times):
        for name in ("part.nc", "part.nc.checkpoint"):
            (folder / name).unlink(missing_ok=True)
        how = random.choice([signal.SIGKILL, signal.SIGINT])
        for _ in range(2):
            process = subprocess.Popen([*start, "--out", "part.nc", "--resume"], cwd=folder)
            time.sleep(random.uniform(0.05, 0.9) * duration)
            process.send_signal(how)
            sent = time.monotonic()
            process.wait()
            slowest = max(slowest, time.monotonic() - sent)
        subprocess.run([*start, "--out", "part.nc", "--resume"], cwd=folder, check=True)
        different += not np.array_equal(extinction("part.nc"), whole)
    print(f"{arguments.verb}: {different} of {arguments.times} resumed runs differ; ended at most "
          f"{slowest:.2f} s after the signal")


def mutate(arguments: argparse.Namespace, folder: Path) -> None:
    weights = Path(__file__).parents[1] / "crates/deepct-core/weights/general.safetensors"
    sources = {
        "infer changed.nc --out o.nc": (folder / "images.nc").read_bytes(),
        "cloud import changed.nc --out o.nc": (folder / "cloud.nc").read_bytes(),
        "weights inspect changed.safetensors": weights.read_bytes(),
    }
    endings: collections.Counter[str] = collections.Counter()
    end = time.monotonic() + 60.0 * arguments.minutes
    while time.monotonic() < end:
        command = random.choice(list(sources))
        content = bytearray(sources[command])
        for _ in range(random.choice([1, 1, 3, 20])):
            # Most structures of a file are at its beginning.
            limit = len(content) if random.random() < 0.3 else min(len(content), 20_000)
            content[random.randrange(limit)] = random.randrange(256)
        if random.random() < 0.15:
            content = content[: random.randrange(len(content))]
        (folder / command.split()[-1 if "weights" in command else -3]).write_bytes(content)
        process = subprocess.Popen([arguments.program, *command.split()], cwd=folder,
                                   stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        begun = time.monotonic()
        try:
            process.communicate(timeout=HANGING_S)
            ending = {0: "read", 2: "refused"}.get(process.returncode, f"{process.returncode}")
            if time.monotonic() - begun > LONG_S:
                ending += " after a long time"
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            ending = "hangs"
        endings[ending] += 1
        if not ending.startswith(("read", "refused")):
            place = folder / f"{ending}-{endings.total()}"
            place.write_bytes(content)
            print(f"{command}: {ending}, see {place}", flush=True)
    print(f"{endings.total()} files: {dict(endings)}")


def load(arguments: argparse.Namespace, folder: Path) -> None:
    import deepct_py as deepct

    networks = [deepct.Network.load(name) for name in ("cloudct-10", "general")]
    light = deepct.Light(sun_zenith_deg=30.0, sun_azimuth_deg=45.0, air=True)
    target = (0.0, 0.0, 1.12)
    sizes = [(rows, cols) for rows in (8, 12, 20, 33) for cols in (9, 16)]
    scenes = [(np.random.default_rng(at).random((10, *size), np.float32) * 0.1,
               deepct.Views.load("cloudct-10", target, size)) for at, size in enumerate(sizes)]

    def work(count: int, seed: int) -> None:
        draw = random.Random(seed)
        for _ in range(count):
            images, views = draw.choice(scenes)
            draw.choice(networks).estimate(images, views, light)

    part = max(arguments.inferences // 10, 1)
    for number in range(10):
        threads = [threading.Thread(target=work, args=(part // 4, 4 * number + k))
                   for k in range(4)]
        begun = time.monotonic()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rate = part / (time.monotonic() - begun)
        print(f"{(number + 1) * part} inferences: largest memory so far {megabytes:.1f} MB, "
              f"{rate:.0f} per second", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["kill", "mutate", "load"])
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    parser.add_argument("--verb", choices=["invert", "hybrid"], default="invert")
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--inferences", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    arguments.program = arguments.program.absolute()
    random.seed(arguments.seed)
    os.environ.setdefault("PYTHONWARNINGS", "ignore")
    # It is not removed: it holds the files with which the program did not end as it should.
    folder = Path(tempfile.mkdtemp(prefix="deepct-reliability-"))
    if arguments.what != "load":
        inputs(arguments.program, folder)
    {"kill": kill, "mutate": mutate, "load": load}[arguments.what](arguments, folder)


if __name__ == "__main__":
    main()
