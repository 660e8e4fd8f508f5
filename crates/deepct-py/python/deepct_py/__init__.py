"""The 3D extinction field of a cloud from its images by several satellites.

Each stage is a function of the same name as the verb of the command line::

    import deepct_py as deepct

    cloud = deepct.generate_cloud(seed=7)
    views = deepct.Views.load("cloudct-10", target=(0.8, 0.8, 1.0))
    images = deepct.sense(deepct.render(cloud.extinction, cloud.grid, views).radiance)
    mask = deepct.carve(images.radiance, views, cloud.grid).mask

Volumes are arrays ``[z, y, x]`` and images ``[view, row, col]``, 32-bit floats; what is
not is converted, and xarray objects are taken as they are. Lengths are in km, extinction
in 1/km, radiance in 1/sr for a Sun of unit irradiance; row grows to the north and column
to the east. Errors are ``ValueError`` for an argument, ``OSError`` where the operating
system refuses, and ``DeepctError`` for what a file holds. Functions release the
interpreter's lock while they work.
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
    "carve",
    "generate_cloud",
    "hybrid",
    "invert",
    "render",
    "score",
    "sense",
]
