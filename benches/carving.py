#!/usr/bin/env python3
"""What space carving loses and keeps of the clouds of a data set, by formation and agreement.

    python3 benches/carving.py DIR     # a data set of `deepct dataset generate recipes/bomex-test.toml`

Images by discrete ordinates with a molecular atmosphere and the noise of the CMV4000. Needs numpy, h5py
and deepct_py.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

import deepct_py

CLOUDS = 8
"""Number of clouds, evenly distributed over the data set."""

paths = sorted(Path(sys.argv[1]).rglob("*.nc"))
shares: dict = {}
for path in paths[:: len(paths) // CLOUDS][:CLOUDS]:
    with h5py.File(path) as file:
        extinction = file["extinction"][...]
        x, y, z = (file[axis][...] for axis in "xyz")
    spacing = tuple(axis[1] - axis[0] for axis in (x, y, z))
    origin = tuple(axis[0] - 0.5 * step for axis, step in zip((x, y, z), spacing))
    grid = deepct_py.Grid(extinction.shape, spacing, origin)
    for formation in ("cloudct-10", "pearls-32"):
        views = deepct_py.Views.load(formation, grid.center, size=extinction.shape[1:])
        light = deepct_py.Light(air=True)
        clean = deepct_py.render(extinction, grid, views, light, solver="ordinates").radiance
        noisy = deepct_py.sense(clean, "cmv4000", seed=1)
        for agreement in (0.8, 0.9, 1.0):
            mask = deepct_py.carve(noisy.radiance, views, grid, standard_error=noisy.noise,
                                   saturated=noisy.saturated, agreement=agreement).mask
            lost = extinction[~mask].sum() / extinction.sum()
            shares.setdefault((formation, agreement), []).append((lost, mask.mean()))
print("formation   agreement  extinction lost (%)  voxels kept (%)")
for (formation, agreement), values in shares.items():
    lost, kept = 100 * np.mean(values, axis=0)
    print(f"{formation}  {agreement:9.1f}  {lost:19.2f}  {kept:15.1f}")
