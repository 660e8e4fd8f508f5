"""Data augmentation by shifts of a cloud together with its images.

Every camera remains pointed at the centre of the domain. If a shift by whole voxels moves the
cloud ``d`` km to the east and ``e`` km to the north, its image in a view with the zenith angle
``theta`` along the track moves by ``d / pixel`` columns and ``e cos(theta) / pixel`` rows. A shift
of ``h`` km upwards moves the image by ``h sin(theta) / pixel`` rows away from the camera. As the
satellites are hundreds of km away, the change of the perspective is below a thousandth of the
shift. For vertical shifts, the changes of the light between cloud and surface and of the molecular
atmosphere above the cloud are neglected; they are a small part of the radiance.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from weights_tools.dataset import ViewGeometry, first_volume


class Shifter:
    """Draws shifts of up to ``voxels`` along x and y and ``levels`` along z for which the cloud
    remains in its domain, and pointing errors, which move the images only."""

    def __init__(
        self,
        geometry: ViewGeometry,
        voxel_spacing_km: tuple[float, float, float],
        voxels: int,
        levels: int = 0,
        pointing: float = 0.0,
    ):
        """``pointing`` is the standard deviation of the pointing error along rows and columns
        (pixels), which is drawn for each view of each cloud."""
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
        self, volumes: Tensor, radiance: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Shift each cloud of a batch ``[n, z, y, x]``, or ``[n, quantity, z, y, x]``, and its
        images ``[n, view, row, col]``."""

        def draw(most: int, cloudy: Tensor) -> Tensor:
            shifts = torch.randint(-most, most + 1, (len(volumes),), generator=generator)
            return _within(shifts, cloudy)

        cloudy = first_volume(volumes) > 0.0
        up = draw(self.levels, cloudy.flatten(2).any(2))
        north = draw(self.voxels, cloudy.any(1).any(2))
        east = draw(self.voxels, cloudy.any(1).any(1))
        places = torch.stack([up, north, east], 1).tolist()
        moved = torch.stack([cloud.roll(at, (-3, -2, -1)) for cloud, at in zip(volumes, places)])
        northwards = north[:, None] * self.rows_per_voxel + up[:, None] * self.rows_per_level
        eastwards = east[:, None] * self.columns_per_voxel
        errors = self.pointing * torch.randn(2, *radiance.shape[:2], generator=generator)
        rows = interpolation(northwards + errors[0], radiance.shape[2])
        cols = interpolation(eastwards + errors[1], radiance.shape[3])
        return moved, (rows @ radiance @ cols.transpose(-1, -2)).clamp_(min=0.0)


def _within(shifts: Tensor, cloudy: Tensor) -> Tensor:
    """The shifts, limited so that no cloudy line of ``[n, line]`` leaves the domain."""
    lines = cloudy.shape[1]
    first = cloudy.int().argmax(1)
    last = lines - 1 - cloudy.flip(1).int().argmax(1)
    return shifts.clamp(-first, lines - 1 - last)


def interpolation(shifts: Tensor, pixels: int) -> Tensor:
    """Matrices ``[..., pixels, pixels]`` that shift a line of pixels by ``shifts`` ``[...]``.

    The interpolation is cubic (Keys 1981, a = -1/2) to preserve fine structure. Beyond the edge,
    the outermost pixel is repeated. A shift by a whole number of pixels is exact.
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
