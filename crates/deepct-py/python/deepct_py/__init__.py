"""Retrieval of the 3D extinction field of a cloud from multi-satellite images.

Each processing stage is a function with the name of the corresponding command of ``deepct``::

    import deepct_py as deepct

    cloud = deepct.generate_cloud(seed=7)
    light = deepct.Light(air=True, phase="mie")
    images = deepct.sense(deepct.render(cloud, views="cloudct-10", light=light))
    estimate = deepct.Network.load("cloudct-10").estimate(images)
    print(deepct.score(cloud, estimate))

    images.to_netcdf("images.nc")
    deepct.plot(estimate, cloud, out="figure.png")

Volumes are arrays ``[z, y, x]`` and images are arrays ``[view, row, col]`` of 32-bit floats.
Functions take them as arrays of any number type, as xarray objects, whose axes are found by name
and whose units are converted, as objects of this module, which also state the grid, the views and
the scene illumination, or as the names of their files. Lengths are in km, extinction is in 1/km,
and radiance is in 1/sr for a solar irradiance of 1. Rows increase towards the north and columns
towards the east.

All objects can be compared, hashed, copied and pickled. Those with arrays have ``to_netcdf`` and
``to_xarray``; ``read_cloud``, ``read_images``, ``read_mask`` and ``read_volume`` read the files.
Objects and files keep the time of a field and its history (``lineage``).

The functions raise ``ValueError`` for an invalid argument, ``OSError`` for an error of the
operating system and ``DeepctError`` for invalid contents of a file. They release the global
interpreter lock while they run.
"""

from ._deepct import (
    Carved,
    Cloud,
    DeepctError,
    Estimate,
    Exposure,
    Figure,
    Grid,
    Light,
    Lineage,
    Network,
    Observation,
    Page,
    Reconstruction,
    Renderer,
    Rendering,
    Scores,
    Sensed,
    Sensor,
    View,
    Views,
    __version__,
    camera_from_ecef,
    carve,
    generate_cloud,
    hybrid,
    import_cloud,
    invert,
    plot,
    read_cloud,
    read_images,
    read_mask,
    read_volume,
    render,
    score,
    sense,
    set_threads,
    view,
)
from ._fields import infer

__all__ = [
    "Carved",
    "Cloud",
    "DeepctError",
    "Estimate",
    "Exposure",
    "Figure",
    "Grid",
    "Light",
    "Lineage",
    "Network",
    "Observation",
    "Page",
    "Reconstruction",
    "Renderer",
    "Rendering",
    "Scores",
    "Sensed",
    "Sensor",
    "View",
    "Views",
    "camera_from_ecef",
    "carve",
    "generate_cloud",
    "hybrid",
    "import_cloud",
    "infer",
    "invert",
    "plot",
    "read_cloud",
    "read_images",
    "read_mask",
    "read_volume",
    "render",
    "score",
    "sense",
    "set_threads",
    "view",
]
