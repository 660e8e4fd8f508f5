"""Your large-eddy simulation: what would the satellites see of it, and how well is it retrieved?

    python your_les.py [FOLDER [LES.nc]]

LES.nc is a netCDF file of MicroHH, DALES, UCLA-LES, PALM, SAM, CM1 or WRF. Without one, a small file
like those of MicroHH is written to FOLDER (by default the current one).
"""

import logging
import sys
from pathlib import Path

import numpy as np
import xarray as xr

import deepct_py

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

if len(sys.argv) > 2:
    path = Path(sys.argv[2])
else:
    path = folder / "les.nc"
    z, y, x = 20.0 + 40.0 * np.arange(50), 25.0 + 50.0 * np.arange(32), 25.0 + 50.0 * np.arange(32)
    height, north, east = np.meshgrid(z, y, x, indexing="ij")
    share = np.clip((height - 700.0) / 500.0, 0.0, 1.0)
    inside = (np.hypot(east - 800.0, north - 800.0) < 260.0 - 150.0 * share) & (share > 0.0)
    water = np.where(inside & (share < 1.0), 1e-5 + 6e-4 * share, 0.0)
    xr.Dataset(
        {"ql": (("time", "z", "y", "x"), water[None], {"units": "kg kg-1"})},
        {"time": [0.0], **{name: (name, axis, {"units": "m"}) for name, axis in
                           (("z", z), ("y", y), ("x", x))}},
    ).to_netcdf(path)

# The module logs from which variables it takes each quantity.
logging.basicConfig(level=logging.INFO)
cloud = deepct_py.import_cloud(path, time=0, droplets=100, base=0.48, levels=32)
print(cloud)

# All that xarray can do with the field, in the names and units of CF.
column = cloud.to_xarray().lwc.sum("z") * cloud.grid.spacing[2] * 1e3
print("largest liquid water path (g m-2):", float(column.max()))

# The sides of a simulation are periodic, so are those of the scene. This solver has no noise.
light = deepct_py.Light(sun=(40, 120), surface_albedo=0.05, periodic=True)
images = deepct_py.render(cloud, views="cloudct-10", light=light, solver="ordinates", accuracy=0.05)
print("estimated error of bright pixels:", images.estimated_error)

estimate = deepct_py.Network.load().estimate(images, grid=cloud.grid)
print(deepct_py.score(cloud, estimate))
deepct_py.plot(estimate, cloud, title=path.name, out=folder / "les.png")
