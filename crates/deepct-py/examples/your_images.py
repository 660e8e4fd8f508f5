"""Your images: from the orbit of each satellite and its calibrated radiances to a cloud.

    python your_images.py [FOLDER]

writes files and figures to FOLDER (by default the current one). In place of an instrument, the first
part simulates one.
"""

import sys
from pathlib import Path

import numpy as np

import deepct_py

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# What the mission provides: positions in a local system (km, x to the east, y to the north), radiances in
# W m-2 um-1 sr-1 with their noise, the field of view of a pixel, and the Sun.
cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
target = np.array(cloud.grid.center)
true_views = deepct_py.Views.string_of_pearls(target, first=-4, last=5)
irradiance = 1530.0
position = true_views.position
pixel_tangent = np.array([view.pixel_tangent for view in true_views])
measured = deepct_py.sense(
    deepct_py.render(cloud, views=true_views, light=deepct_py.Light(air=True), samples=64)
)
assert measured.standard_error is not None
radiance, noise = irradiance * measured.radiance, irradiance * measured.standard_error

# From ECEF coordinates, `deepct_py.camera_from_ecef(position, latitude, longitude)` gives such positions.
views = deepct_py.Views(
    [
        deepct_py.View.perspective(where, target, tangent, size=radiance.shape[1:])
        for where, tangent in zip(position, pixel_tangent)
    ]
)
print("zenith angles (degrees):", views.zenith_deg.round(1))

# What is not known about the scene is listed in `assumed`.
light = deepct_py.Light(
    sun=(30, 45), wavelength=0.672, solar_irradiance=irradiance, air=True,
    assumed=["surface_albedo", "phase"],
)
images = deepct_py.Observation(radiance, views, light, standard_error=noise)
images.to_netcdf(folder / "own.nc", title="Images of my instrument")
assert deepct_py.read_images(folder / "own.nc") == images
deepct_py.plot(images, title="Images of my instrument", out=folder / "own.png")

# The images know their cameras, light and noise.
network = deepct_py.Network.load()
estimate = network.estimate(images)
mask = deepct_py.carve(images, grid=estimate.grid)
print(f"{mask.mask.mean():.1%} of the voxels may contain cloud")
estimate = network.estimate(images, mask=mask)
estimate.to_netcdf(folder / "volume.nc")

# Only some of the views, for example to see how much each of them matters.
few = deepct_py.Observation(radiance[::2], views[::2], light, standard_error=noise[::2])
other = network.estimate(few, grid=estimate.grid)
print("change without every second view:", deepct_py.score(estimate, other).relative_error)
