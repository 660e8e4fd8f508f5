"""Resampling of images onto horizontal planes, identical to ``Planes`` of ``deepct``."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

ROUNDING = 1e-6
"""Subtracted from a parallax (voxels) before rounding, so that half a voxel is always rounded down
and the result does not depend on the last bit of a tangent."""


class Lift(nn.Module):
    """Resample images ``[n, view, row, col]`` to channels ``[n, plane * views + view, y, x]``,
    where the views are those of the first band, then those of the next one.

    Each image is resampled bilinearly onto the horizontal plane of the target. For a plane at
    another altitude, the result is displaced by the parallax of that altitude, rounded to whole
    voxels. Beyond its edge, an image is continued with the values of the edge. The module has no
    parameters and accepts images of any size whose centre shows the target.
    """

    def __init__(self, metadata: dict[str, Any]) -> None:
        """Initialise from the metadata of weights whose ``image_layout`` has planes."""
        super().__init__()
        geometry = metadata["view_geometry"]
        zenith = torch.tensor(geometry["view_zenith_deg"]).double().deg2rad()
        azimuth = torch.tensor(geometry["view_azimuth_deg"]).double().deg2rad()
        altitudes = torch.tensor(metadata["image_layout"]["planes"]["altitudes_km"]).double()
        dx, dy = metadata["horizontal_spacing_km"]
        shift = -(altitudes[:, None] - metadata["target_altitude_km"]) * zenith.tan()
        parallax = torch.stack([shift * azimuth.cos() / dy, shift * azimuth.sin() / dx], -1)
        bands = len(wavelengths_of(metadata))
        whole: list[list[tuple[int, int]]] = _half_away(parallax - ROUNDING).tolist()
        self.parallax = [plane * bands for plane in whole]
        """Displacement in rows and columns from the plane of the target, by plane and view."""
        offsets = [at for plane in self.parallax for at in plane]
        self.margin = [max(abs(at[axis]) for at in offsets) for axis in (0, 1)]
        self.spacing = (dy, dx)
        self.cameras = _cameras(zenith, azimuth, geometry).repeat(bands, 1, 1)
        self._grids: dict[tuple[Any, ...], Tensor] = {}

    @property
    def channels(self) -> int:
        return len(self.parallax) * len(self.cameras)

    def forward(self, images: Tensor) -> Tensor:
        """The images on all planes, in the order of the input channels of the network."""
        ground = self.ground(images)
        rows, cols = images.shape[2:]
        channels = []
        for plane in self.parallax:
            for view, (north, east) in enumerate(plane):
                top, left = self.margin[0] + north, self.margin[1] + east
                channels.append(ground[:, view, top : top + rows, left : left + cols])
        return torch.stack(channels, 1)

    def ground(self, images: Tensor) -> Tensor:
        """The images on the plane of the target, with the margin required for the other planes."""
        # A batch of views with one channel for each cloud, as the grid depends on the view only.
        grid = self._grid(images.shape[2:], images.dtype, images.device)
        ground = nn.functional.grid_sample(
            images.transpose(0, 1), grid, padding_mode="border", align_corners=False
        )
        return ground.transpose(0, 1)

    def _grid(self, size: torch.Size, kind: torch.dtype, device: torch.device) -> Tensor:
        """The projection of each voxel of the target plane onto each image,
        ``[view, y, x, (col, row)]`` from -1 to 1 between the edges of the image."""
        key = (tuple(size), kind, device)
        if key not in self._grids:
            y, x = (
                step * (torch.arange(lines + 2 * margin).double() + 0.5 - margin - 0.5 * lines)
                for step, lines, margin in zip(self.spacing, size, self.margin)
            )
            point = torch.stack(torch.broadcast_tensors(x, y[:, None]), -1)
            pixel = torch.einsum("vap,yxp->vyxa", self.cameras[:, :2], point)
            depth = 1.0 - torch.einsum("vp,yxp->vyx", self.cameras[:, 2], point)
            pixel = pixel / depth.clamp_min(1e-3)[..., None]
            halves = torch.tensor([0.5 * size[1], 0.5 * size[0]], dtype=torch.float64)
            self._grids[key] = (pixel / halves).to(device, kind)
        return self._grids[key]


def _half_away(values: Tensor) -> Tensor:
    return (values.sign() * (values.abs() + 0.5).floor()).long()


def _cameras(zenith: Tensor, azimuth: Tensor, geometry: dict[str, Any]) -> Tensor:
    """Three pairs of factors for ``(x, y)`` (km from the target) by view: those of the column, of
    the row, and of the relative depth ``d``. Column and row are divided by ``1 - d``."""
    cameras = []
    for view, distance in enumerate(geometry["camera_distance_km"]):
        pixel = geometry["pixel_km"][view]
        if distance is None:
            parallel = [[1.0 / pixel, 0.0], [0.0, 1.0 / pixel], [0.0, 0.0]]
            cameras.append(torch.tensor(parallel, dtype=torch.float64))
            continue
        sine, cosine = zenith[view].sin(), zenith[view].cos()
        towards = torch.stack([sine * azimuth[view].sin(), sine * azimuth[view].cos(), cosine])
        east = torch.tensor([1.0, 0.0, 0.0]).double()
        col = nn.functional.normalize(east - east.dot(towards) * towards, dim=0)
        row = torch.linalg.cross(towards, col)
        cameras.append(torch.stack([col[:2] / pixel, row[:2] / pixel, towards[:2] / distance]))
    return torch.stack(cameras)


def wavelengths_of(metadata: dict[str, Any]) -> list[float]:
    """The wavelength of each band (um) in the metadata of weights."""
    wavelengths = metadata["wavelength_um"]
    return wavelengths if isinstance(wavelengths, list) else [wavelengths]


def lift_of(metadata: dict[str, Any]) -> Lift | None:
    """The resampling that weights with this metadata require; ``None`` for camera images."""
    return None if metadata["image_layout"] == "camera" else Lift(metadata)
