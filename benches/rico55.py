#!/usr/bin/env python3
"""Retrieval of the dense RICO cloud of HybridCT's validation from nine views.

    python3 benches/rico55.py --truth truth_RICO_40m_80kmx80km_T_qc_30.0h_id055.nc --work DIR \
        [--program target/release/deepct]

Writes the cloud as a volume of deepct, renders the views of `recipes/misr-nine-views.toml` with
Monte Carlo and 2 % noise (which takes minutes), and inverts the images with the true and with the
carved mask. The log of each inversion (epsilon by step and second) is stored in DIR. The results
are reported in docs/notes/deterministic_solver.md. Requires numpy and h5py.
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

import h5py
import numpy as np

SPACING = 0.04
"""Side of a voxel (km)."""
LIGHT = ["--surface-albedo", "0", "--set", "optics.phase=mie",
         "--set", "optics.effective_radius=10"]


def write(path: Path, name: str, values: np.ndarray, units: str) -> None:
    """Write a field (z, y, x) on a grid whose lower corner is at z = 1 km and y = x = 0."""
    with h5py.File(path, "w") as file:
        field = file.create_dataset(name, data=values)
        field.attrs["units"] = units
        for axis, (letter, lowest) in enumerate([("z", 1.0), ("y", 0.0), ("x", 0.0)]):
            centres = lowest + SPACING * (np.arange(values.shape[axis]) + 0.5)
            scale = file.create_dataset(letter, data=centres)
            scale.attrs["units"] = "km"
            scale.make_scale(letter)
            field.dims[axis].attach_scale(scale)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--program", type=Path, default=Path("target/release/deepct"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    cloud, mask, images = (arguments.work / n for n in ("cloud.nc", "mask.nc", "images.nc"))
    with h5py.File(arguments.truth) as file:
        # The first level only fills the space between the surface and the cloud.
        extinction = np.nan_to_num(file["extinction"][...])[:, :, 1:].transpose(2, 1, 0)
    write(cloud, "extinction", extinction.astype(np.float32), "km-1")
    write(mask, "mask", (extinction > 0).astype(np.uint8), "1")
    views = Path(__file__).parent.parent / "recipes" / "misr-nine-views.toml"
    if not images.exists():
        subprocess.run([arguments.program, "render", cloud, "--views", views, "--noise", "0.02",
                        "--similarity-after", "4", "--sun-zenith", "45.73", "--sun-azimuth", "140",
                        "--seed", "3", *LIGHT, "--out", images], check=True)
    for name, known in [("true", ["--mask", mask]), ("carved", [])]:
        command = [arguments.program, "invert", images, "--grid", cloud, "--truth", cloud, *known,
                   *LIGHT, "--out", arguments.work / f"{name}-mask.nc"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        (arguments.work / f"{name}-mask.log").write_text(done.stderr + done.stdout)
        print(f"{name} mask\n{done.stdout}")


if __name__ == "__main__":
    main()
