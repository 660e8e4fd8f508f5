#!/usr/bin/env python3
"""Render one cloud with deepct and with Mitsuba 3, and compare the product of time and variance.

    python3 benches/mitsuba.py FOLDER [--json] [--seconds S] [--threads N]

FOLDER contains rico32_cloud.nc and rico32_views.nc. The script builds deepct, installs Mitsuba into
benches/.venv-mitsuba, renders the five views with both, using the same number of threads for about
S seconds per view, and prints a row for each phase function and mode of deepct: the noise and the
seconds of both, and the ratio of the time of Mitsuba to that of deepct for the same noise.

The noise is the standard error divided by the radiance, as the root mean square over the bright
pixels of a view, which have at least half the radiance of its brightest pixel. For Mitsuba, it is
the standard deviation of repeated renderings. With strongly forward-peaked scattering, the noise of
Mitsuba has a heavy-tailed distribution, so that a short run underestimates it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = Path(__file__).resolve().parent / ".venv-mitsuba"
REQUIREMENTS = ("mitsuba==3.9.1", "h5py==3.15.1", "numpy==2.4.6")
VIEWS = {"nadir": 0.0, "plus26": 26.0, "minus26": -26.0, "plus46": 46.0, "minus46": -46.0}
PLANE_KM = 1.44
"""Altitude of the plane that contains the pixels of the views."""
PIXEL_KM = 0.02
BRIGHT = 0.5
REPEATS = 32
"""Number of renderings with Mitsuba from which its noise is estimated."""
ASYMMETRIES = (0.0, 0.85)
MODES = {"unbiased": "never", "similar": "4"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with the cloud and its views")
    parser.add_argument("--json", action="store_true", help="print one JSON array")
    parser.add_argument("--seconds", type=float, default=20.0, help="time per view and renderer")
    parser.add_argument("--threads", type=int, default=2, help="threads of each renderer")
    arguments = parser.parse_args()
    python = VENV / "bin" / "python"
    if not sys.flags.isolated:
        install(python)
        # Isolated mode, as otherwise this file would be imported instead of the package mitsuba.
        os.execv(python, [str(python), "-I", __file__, *sys.argv[1:]])
    timer = build_timer()
    rows = []
    for asymmetry in ASYMMETRIES:
        peer = {name: mitsuba(arguments, name, asymmetry) for name in VIEWS}
        for mode, similarity_after in MODES.items():
            if asymmetry > 0.0 or mode == "unbiased":
                ours = {
                    name: deepct(timer, arguments, name, asymmetry, similarity_after)
                    for name in VIEWS
                }
                rows.append(compare(asymmetry, mode, ours, peer))
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    heads = ("deepct s", "noise %", "Mitsuba s", "noise %", "time ratio", "means %")
    print(f"{'asymmetry':<10}{'mode':<10}" + "".join(f"{head:>12}" for head in heads))
    for row in rows:
        numbers = (
            row["deepct_seconds"],
            100 * row["deepct_noise"],
            row["mitsuba_seconds"],
            100 * row["mitsuba_noise"],
            row["ratio"],
            100 * row["means_differ"],
        )
        print(
            f"{row['asymmetry']:<10}{row['mode']:<10}"
            + "".join(f"{number:>12.2f}" for number in numbers)
        )


def install(python: Path) -> None:
    """Create the virtual environment of Mitsuba."""
    if not python.exists():
        venv.create(VENV, with_pip=True)
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *REQUIREMENTS], check=True)


def build_timer() -> Path:
    """Build the program that renders with deepct."""
    subprocess.run(
        ["cargo", "build", "--release", "--quiet", "-p", "deepct-core", "--example", "render_timer"],
        cwd=ROOT,
        check=True,
    )
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return target / "release" / "examples" / "render_timer"


def deepct(timer: Path, arguments, name: str, asymmetry: float, similarity_after: str) -> dict:
    """Radiance and standard error of a view rendered with deepct, and the seconds required."""
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "radiance"

        def run(samples: int):
            command = [timer, arguments.folder, name, asymmetry, samples, similarity_after, output]
            environment = {**os.environ, "RAYON_NUM_THREADS": str(arguments.threads)}
            printed = subprocess.run(
                [str(part) for part in command],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            return json.loads(printed)

        seconds, _, _ = run(64)
        samples = max(64, int(64 * arguments.seconds / seconds))
        seconds, rows, cols = run(samples)
        radiance, error = np.fromfile(output).reshape(2, rows, cols)
    return {"radiance": radiance, "error": error, "seconds": seconds}


def mitsuba(arguments, name: str, asymmetry: float) -> dict:
    """Radiance and standard error from repeated renderings with Mitsuba, and the seconds."""
    import mitsuba
    import numpy as np

    # The vectorised variants require an LLVM library on the system; for a cloud of this size they
    # were slower than the scalar variant.
    mitsuba.set_variant("scalar_rgb")
    threads = mitsuba.Thread if hasattr(mitsuba, "Thread") else None
    if threads is not None and hasattr(threads, "set_thread_count"):
        threads.set_thread_count(arguments.threads)
    scene = mitsuba_scene(mitsuba, arguments.folder, name, asymmetry)

    def run(samples: int, seed: int):
        return np.array(mitsuba.render(scene, spp=samples, seed=seed), dtype=float)[..., 0]

    start = time.perf_counter()
    run(4, 12345)
    seconds = (time.perf_counter() - start) / 4
    samples = max(4, int(arguments.seconds / seconds / REPEATS))
    start = time.perf_counter()
    images = np.stack([run(samples, seed) for seed in range(REPEATS)])
    seconds = time.perf_counter() - start
    error = images.std(axis=0, ddof=1) / np.sqrt(REPEATS)
    # The rows of Mitsuba start at the top of the image, that is, in the north.
    return {"radiance": images.mean(axis=0)[::-1], "error": error[::-1], "seconds": seconds}


def mitsuba_scene(mitsuba, folder: Path, name: str, asymmetry: float):
    """A scene of the cloud between its outermost nodes, the Sun and an orthographic camera."""
    import h5py
    import numpy as np

    with h5py.File(folder / "rico32_cloud.nc") as file:
        extinction = file["extinction"][:].astype(np.float32)
        axes = [file[axis][:].astype(float) for axis in "xyz"]
    with h5py.File(folder / "rico32_views.nc") as file:
        x, y = (file[name][axis][:].astype(float) for axis in "xy")
    lower, upper = (np.array([axis[end] for axis in axes]) for end in (0, -1))
    half = np.array([axis[1] - axis[0] for axis in axes]) / 2
    transform = mitsuba.ScalarTransform4f
    volume = {
        "type": "gridvolume",
        "grid": mitsuba.VolumeGrid(extinction[..., None]),
        "filter_type": "trilinear",
        # The values are located at the cell centres of a unit cube.
        "to_world": transform()
        .translate(list(lower - half))
        .scale(list(upper - lower + 2 * half)),
    }
    phase = {"type": "hg", "g": asymmetry} if asymmetry else {"type": "isotropic"}
    zenith = np.radians(VIEWS[name])
    target = np.array([x.mean(), y.mean(), PLANE_KM])
    away = np.array([np.sin(zenith), 0.0, np.cos(zenith)])
    side = max(len(x), len(y))
    return mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 10_000, "rr_depth": 100},
            "cloud": {
                "type": "cube",
                "to_world": transform()
                .translate(list((lower + upper) / 2))
                .scale(list((upper - lower) / 2)),
                "bsdf": {"type": "null"},
                "interior": {
                    "type": "heterogeneous",
                    "sigma_t": volume,
                    "albedo": 1.0,
                    "phase": phase,
                },
            },
            "sun": {
                "type": "directional",
                "direction": [
                    np.sin(np.pi / 6) * np.cos(np.pi / 4),
                    np.sin(np.pi / 6) * np.sin(np.pi / 4),
                    -np.cos(np.pi / 6),
                ],
                "irradiance": 1.0,
            },
            "sensor": {
                "type": "orthographic",
                "to_world": transform()
                .look_at(origin=list(target + 10 * away), target=list(target), up=[0, 1, 0])
                .scale([side * PIXEL_KM / 2 * np.cos(zenith), side * PIXEL_KM / 2, 1.0]),
                "film": {
                    "type": "hdrfilm",
                    "width": side,
                    "height": side,
                    "crop_offset_x": (side - len(x)) // 2,
                    "crop_offset_y": (side - len(y)) // 2,
                    "crop_width": len(x),
                    "crop_height": len(y),
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
                "sampler": {"type": "independent"},
            },
        }
    )


def compare(asymmetry: float, mode: str, ours: dict, peer: dict) -> dict:
    """Noise, seconds, and the ratio of the products of time and variance, over all views."""
    import numpy as np

    def noise(side: dict) -> float:
        squares = []
        for name in VIEWS:
            radiance = ours[name]["radiance"]
            bright = radiance >= BRIGHT * radiance.max()
            # Relative to the radiance of deepct, which has the lower noise.
            squares.append((side[name]["error"][bright] / radiance[bright]) ** 2)
        return float(np.sqrt(np.mean(np.concatenate(squares))))

    def mean(side: dict) -> float:
        return float(np.mean([side[name]["radiance"].mean() for name in VIEWS]))

    def seconds(side: dict) -> float:
        return sum(side[name]["seconds"] for name in VIEWS)

    return {
        "asymmetry": asymmetry,
        "mode": mode,
        "deepct_seconds": seconds(ours),
        "deepct_noise": noise(ours),
        "mitsuba_seconds": seconds(peer),
        "mitsuba_noise": noise(peer),
        "ratio": seconds(peer) * noise(peer) ** 2 / (seconds(ours) * noise(ours) ** 2),
        "means_differ": mean(ours) / mean(peer) - 1.0,
    }


if __name__ == "__main__":
    main()
