#!/usr/bin/env python3
"""Reliability of the program (docs/notes/reliability.md).

    python3 benches/reliability.py kill --verb invert --times 25
    python3 benches/reliability.py mutate --minutes 30
    python3 benches/reliability.py load --inferences 100000

- kill: an inversion, the generation of a data set, an experiment or a training is stopped at random
  moments, twice each time, and resumed; its results are compared with those of a run that was not
  stopped.
- mutate: files of images, clouds and weights in which single bytes are changed, or whose end is
  missing, are given to the program. Each must be read or refused with the exit status 2.
- load: images of changing sizes and formations are given to networks in one Python process, from
  several threads; its memory must not grow.

Needs numpy and h5py, deepct_py for load, and weights_tools for kill --verb train.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import resource
import signal
import subprocess
import sys
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


SETTINGS = {
    "dataset.toml": """
formation = "cloudct-10"
columns = 20
[[sources]]
file = "train.nc"
split = "train"
first = 0
last = 0
every = 1
clouds = 4
[[sources]]
file = "validation.nc"
split = "validation"
first = 0
last = 0
every = 1
clouds = 2
""",
    "experiment.toml": """
clouds = ["small.nc"]
generated = 0
weights = "general"
formation = "cloudct-10"
samples_per_pixel = 64
quick_iterations = 3
[inversion]
iterations = 6
""",
    "training.toml": """
formation = "cloudct-10"
[network]
layers = 2
[training]
epochs = 20
batch = 2
""",
}
"""The settings of the commands that are stopped."""

COMMANDS = {
    "invert": "DEEPCT -q invert small_images.nc --grid small.nc --iterations 15 --resume --out OUT",
    "hybrid": "DEEPCT -q hybrid small_images.nc --grid small.nc --iterations 15 --resume --out OUT",
    "dataset": "DEEPCT -q dataset generate dataset.toml --out OUT",
    "experiment": "DEEPCT -q experiment experiment.toml --out OUT",
    "train": "PYTHON -m weights_tools train training.toml --dataset data --threads 1 --out OUT",
}
"""The commands that are stopped, which continue when they are repeated."""


def small_inputs(program: Path, folder: Path) -> None:
    for name, text in SETTINGS.items():
        (folder / name).write_text(text)
    shape = "--set shape=[16,20,20] --set width_km=0.5 --set depth_km=0.3"
    run(program, f"cloud generate --seed 5 {shape} --out small.nc", folder)
    run(program, "render small.nc --views cloudct-10 --samples 64 --out small_images.nc", folder)
    for name, seed in [("train", 3), ("validation", 4)]:
        run(program, f"cloud generate --kind field --seed {seed} --out {name}.nc", folder)


def results(place: Path) -> dict[str, object]:
    """All that a command has computed, without the time that it took."""
    import h5py

    if place.is_file():
        with h5py.File(place) as file:
            return {"extinction": file["extinction"][...].tobytes()}
    found: dict[str, object] = {}
    for path in sorted(place.rglob("*")):
        name = str(path.relative_to(place))
        if path.name.startswith(".") or path.is_dir():
            continue
        if name.startswith("samples/") or path.name == "plan.json":
            found[name] = path.read_bytes()
        elif name.startswith("volumes/"):
            found[name] = results(path)
        elif name.startswith("results/"):
            found[name] = {**json.loads(path.read_text()), "seconds": None}
        elif path.suffix == ".pt":
            from weights_tools.checkpoint import load_checkpoint

            state = load_checkpoint(path)["model_state_dict"]
            found[name] = {part: values.numpy().tobytes() for part, values in state.items()}
    return found


def kill(arguments: argparse.Namespace, folder: Path) -> None:
    how = getattr(signal, f"SIG{arguments.signal}")
    if arguments.verb == "train":
        run(arguments.program, "dataset generate dataset.toml --out data", folder)

    def start(out: str) -> subprocess.Popen:
        words = {"DEEPCT": str(arguments.program), "PYTHON": sys.executable, "OUT": out}
        command = [words.get(word, word) for word in COMMANDS[arguments.verb].split()]
        return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)

    def complete(out: str) -> dict[str, object]:
        if start(out).wait() != 0:
            raise SystemExit(f"{arguments.verb} fails: see {folder}")
        return results(folder / out)

    begun = time.monotonic()
    whole = complete("whole.nc")
    duration = time.monotonic() - begun
    different, running, slowest = 0, 0, 0.0
    for number in range(arguments.times):
        out = f"part-{number}.nc"
        for _ in range(2):
            process = start(out)
            time.sleep(random.uniform(0.05, 0.9) * duration)
            running += process.poll() is None
            process.send_signal(how)
            sent = time.monotonic()
            process.wait()
            slowest = max(slowest, time.monotonic() - sent)
        different += complete(out) != whole
    print(f"{arguments.verb}: {running} runs of about {duration:.0f} s were stopped by "
          f"SIG{arguments.signal}, and ended at most {slowest:.2f} s later; {different} of "
          f"{arguments.times} that were stopped twice have another result")


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
    parser.add_argument("--verb", choices=list(COMMANDS), default="invert")
    parser.add_argument("--signal", choices=["KILL", "INT"], default="KILL")
    parser.add_argument("--times", type=int, default=25)
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
        {"kill": small_inputs, "mutate": inputs}[arguments.what](arguments.program, folder)
    {"kill": kill, "mutate": mutate, "load": load}[arguments.what](arguments, folder)


if __name__ == "__main__":
    main()
