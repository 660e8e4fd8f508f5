"""A tour: a cloud, its images, the estimate of a network, and its improvement by an inversion.

    python tour.py [FOLDER]

writes the files and figures of each stage to FOLDER (by default the current one).
"""

import sys
from pathlib import Path

import deepct_py

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# A synthetic cloud, and the images that ten satellites take of it.
cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
light = deepct_py.Light(air=True, phase="mie")
clean = deepct_py.render(cloud, views="cloudct-10", light=light, samples=256, progress=True)
images = deepct_py.sense(clean, "cmv4000")

# The voxels that may contain cloud, and the estimate of the network in them.
mask = deepct_py.carve(images, grid=cloud.grid)
network = deepct_py.Network.load("cloudct-10")
estimate = network.estimate(images, mask=mask)
print("network:", deepct_py.score(cloud, estimate))

# A few steps of an inversion that begins there.
result = deepct_py.hybrid(
    images, network=network, mask=mask, truth=cloud, quick=True, iterations=6, progress=True
)
print("quick hybrid:", deepct_py.score(cloud, result))

# Files that all commands read, figures, and data sets of xarray.
cloud.to_netcdf(folder / "cloud.nc")
images.to_netcdf(folder / "images.nc")
result.to_netcdf(folder / "volume.nc")
deepct_py.plot(images, title="Images", out=folder / "images.png")
deepct_py.plot(result, cloud, title="Quick hybrid", out=folder / "volume.png")
optical_depth = (result.to_xarray().extinction * cloud.grid.spacing[2]).sum("z")
print("largest optical depth:", float(optical_depth.max()))
