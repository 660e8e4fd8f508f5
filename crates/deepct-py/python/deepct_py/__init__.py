"""Retrieval of the 3D extinction field of a cloud from multi-satellite images.

Each processing stage is a function with the name of the corresponding command of ``deepct``::

    import deepct_py as deepct

    cloud = deepct.generate_cloud(seed=7)
    views = deepct.Views.load("cloudct-10", target=(0.8, 0.8, 1.0))
    images = deepct.sense(deepct.render(cloud.extinction, cloud.grid, views).radiance)
    mask = deepct.carve(images.radiance, views, cloud.grid).mask

Volumes are arrays ``[z, y, x]`` and images are arrays ``[view, row, col]`` of 32-bit floats;
other number types and xarray objects are converted. Lengths are in km, extinction is in 1/km,
and radiance is in 1/sr for a solar irradiance of 1. Rows increase towards the north and columns
towards the east. The functions raise ``ValueError`` for an invalid argument, ``OSError`` for an
error of the operating system and ``DeepctError`` for invalid contents of a file. They release
the global interpreter lock while they run.
"""

from ._deepct import (
    Carved,
    Cloud,
    DeepctError,
    Grid,
    Light,
    Network,
    Reconstruction,
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
    invert,
    render,
    score,
    sense,
)

__all__ = [
    "Carved",
    "Cloud",
    "DeepctError",
    "Grid",
    "Light",
    "Network",
    "Reconstruction",
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
    "invert",
    "render",
    "score",
    "sense",
]
