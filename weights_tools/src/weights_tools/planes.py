"""Resampling of the images of a batch of scenes, each with its own views, onto horizontal planes.

The result is that of :class:`weights_tools.lift.Lift`, which has one formation for all scenes.
Lengths are in units of the horizontal voxel size, as in :mod:`weights_tools.views`.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from weights_tools.lift import ROUNDING
from weights_tools.views import Views

LEAST_DEPTH = 1e-3
"""Lower limit of the depth of a point divided by the distance of the target."""


def plane_heights(planes: int, levels: int, level_height: float) -> Tensor:
    """Heights of the planes above the target (voxels), at the centres of equal parts of the
    vertical range of ``levels`` levels of ``level_height``; float64, ``[plane]``."""
    part = levels * level_height / planes
    return (torch.arange(planes, dtype=torch.float64) + 0.5) * part - 0.5 * levels * level_height


def on_planes(
    images: Tensor,
    views: Views,
    heights: Tensor,
    size: tuple[int, int] | None = None,
    corner: Tensor | None = None,
    pointing: Tensor | None = None,
) -> Tensor:
    """Images ``[n, v, row, col]`` on horizontal planes, ``[n, v, plane, y, x]``.

    ``heights`` ``[plane]`` are those above the target. ``size`` and ``corner`` ``[n, (y, x)]``
    select rows and columns of the result of each scene, which otherwise has the size of the images.
    ``pointing`` ``[n, v, (row, col)]`` are errors of the pointing of the cameras (pixels). Beyond
    its edge, an image is continued with the values of the edge.
    """
    scenes, count, rows, cols = images.shape
    size = size or (rows, cols)
    towards = views.towards
    column, row, depth = _camera(views)
    # Whole voxels, as a sum over the kernels of the first layer cannot represent fractions.
    tangent = towards[..., None, :2] / towards[..., None, 2:]
    shift = -heights.to(images)[:, None] * tangent - ROUNDING
    shift = shift.sign() * (shift.abs() + 0.5).floor()
    first = images.new_zeros(scenes, 2) if corner is None else corner.to(images)
    y, x = (
        torch.arange(lines, dtype=images.dtype, device=images.device)
        + (0.5 - 0.5 * whole + first[:, None, None, at, None])
        + shift[..., 1 - at, None]
        for at, (lines, whole) in enumerate(zip(size, (rows, cols)))
    )

    def along(factors: Tensor) -> Tensor:
        """The product of the factors for x and y with the points, ``[n, v, plane, y, x]``."""
        at = factors[:, :, None, :, None]
        return (at[..., 0, :] * x)[..., None, :] + (at[..., 1, :] * y)[..., :, None]

    # Coordinates from -1 to 1 between the edges of the image.
    scale = (1.0 - along(depth)).clamp_min_(LEAST_DEPTH).reciprocal_()
    pixels = (along(column * (2.0 / cols)).mul_(scale), along(row * (2.0 / rows)).mul_(scale))
    if pointing is not None:
        for pixel, axis, count_along in zip(pixels, (1, 0), (cols, rows)):
            pixel += pointing[..., axis, None, None, None] * (2.0 / count_along)
    grid = torch.stack(pixels, -1).reshape(scenes * count, -1, size[1], 2)
    flat = images.reshape(scenes * count, 1, rows, cols)
    result = nn.functional.grid_sample(flat, grid, padding_mode="border", align_corners=False)
    return result.reshape(scenes, count, len(heights), *size)


def _camera(views: Views) -> tuple[Tensor, Tensor, Tensor]:
    """Factors ``[n, v, 2]`` of ``(x, y)`` for the column, the row and the relative depth ``d`` of a
    point in the plane of the target. Column and row are divided by ``1 - d``."""
    towards = views.towards
    # The column axis is the horizontal east without its part along the line of sight.
    column = torch.stack(
        [
            1.0 - towards[..., 0].square(),
            -towards[..., 0] * towards[..., 1],
            -towards[..., 0] * towards[..., 2],
        ],
        -1,
    )
    column = nn.functional.normalize(column, dim=-1)
    row = torch.linalg.cross(towards, column)
    # The images of parallel rays are given on the horizontal plane of the target.
    parallel = views.distance.isinf()[..., None]
    east = torch.zeros_like(towards[..., :2])
    east[..., 0] = 1.0
    column = torch.where(parallel, east, column[..., :2])
    row = torch.where(parallel, east.flip(-1), row[..., :2])
    pixel = views.pixel[..., None]
    return column / pixel, row / pixel, towards[..., :2] / views.distance[..., None]
