"""Shifts of a cloud together with its images, as more training data.

Every camera keeps aiming at the middle of the domain. A shift by whole voxels moves the
cloud ``d`` km to the east and ``e`` km to the north, and so its image in a view under
the zenith ``theta`` along the track by ``d / pixel`` columns and ``e cos(theta) / pixel``
rows; one of ``h`` km upwards by ``h sin(theta) / pixel`` rows away from the camera. The
satellites are hundreds of km away: that the perspective changes with the shift is below a
thousandth of it. Of a cloud that is lifted, the light between it and the ground and the air
above it stay as they were, which is little of its radiance.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from weights_tools.dataset import ViewGeometry


class Shifter:
    """Draws shifts of up to ``voxels`` along x and y and ``levels`` along z that leave the
    cloud in its domain, and errors of pointing that leave it where it is."""

    def __init__(
        self,
        geometry: ViewGeometry,
        voxel_spacing_km: tuple[float, float, float],
        voxels: int,
        levels: int = 0,
        pointing: float = 0.0,
    ):
        """``pointing`` is the standard deviation (pixels) of where a camera looks, along rows
        and along columns, drawn for each view of each cloud."""
        for zenith, azimuth in zip(geometry.view_zenith_deg, geometry.view_azimuth_deg):
            if abs(math.sin(math.radians(azimuth)) * math.sin(math.radians(zenith))) > 1e-3:
                raise ValueError("shifts need views along a track from south to north")
        dx, dy, dz = voxel_spacing_km
        pixel = torch.tensor(geometry.pixel_km)
        zenith = torch.tensor(geometry.view_zenith_deg).deg2rad()
        north = torch.tensor(geometry.view_azimuth_deg).deg2rad().cos()
        self.columns_per_voxel = dx / pixel
        self.rows_per_voxel = dy * zenith.cos() / pixel
        self.rows_per_level = -dz * zenith.sin() * north / pixel
        self.voxels, self.levels, self.pointing = voxels, levels, pointing

    def draw(
        self, extinction: Tensor, radiance: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """A batch of clouds ``[n, z, y, x]`` and images ``[n, view, row, col]``, each shifted."""

        def draw(most: int, cloudy: Tensor) -> Tensor:
            shifts = torch.randint(-most, most + 1, (len(extinction),), generator=generator)
            return _within(shifts, cloudy)

        cloudy = extinction > 0.0
        up = draw(self.levels, cloudy.flatten(2).any(2))
        north = draw(self.voxels, cloudy.any(1).any(2))
        east = draw(self.voxels, cloudy.any(1).any(1))
        places = torch.stack([up, north, east], 1).tolist()
        moved = torch.stack([cloud.roll(at, (0, 1, 2)) for cloud, at in zip(extinction, places)])
        northwards = north[:, None] * self.rows_per_voxel + up[:, None] * self.rows_per_level
        eastwards = east[:, None] * self.columns_per_voxel
        errors = self.pointing * torch.randn(2, *radiance.shape[:2], generator=generator)
        rows = interpolation(northwards + errors[0], radiance.shape[2])
        cols = interpolation(eastwards + errors[1], radiance.shape[3])
        return moved, (rows @ radiance @ cols.transpose(-1, -2)).clamp_(min=0.0)


def _within(shifts: Tensor, cloudy: Tensor) -> Tensor:
    """The shifts, cut so that no cloudy line of ``[n, line]`` leaves the domain."""
    lines = cloudy.shape[1]
    first = cloudy.int().argmax(1)
    last = lines - 1 - cloudy.flip(1).int().argmax(1)
    return shifts.clamp(-first, lines - 1 - last)


def interpolation(shifts: Tensor, pixels: int) -> Tensor:
    """Matrices ``[..., pixels, pixels]`` that move a line of pixels by ``shifts`` ``[...]``.

    Cubic (Keys 1981, a = -1/2), so that fine structure stays; the outermost pixel goes
    on beyond the edge. A whole number of pixels moves exactly.
    """
    position = torch.arange(pixels) - shifts[..., None]
    whole = position.floor()
    t = position - whole
    weights = (
        0.5 * t * (-1.0 + t * (2.0 - t)),
        1.0 + t * t * (-2.5 + 1.5 * t),
        0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
        0.5 * t * t * (t - 1.0),
    )
    matrix = torch.zeros(*position.shape, pixels)
    for offset, weight in enumerate(weights):
        pixel = (whole.long() + offset - 1).clamp(0, pixels - 1)
        matrix.scatter_add_(-1, pixel[..., None], weight[..., None])
    return matrix
