"""Data augmentation by a second cloud beside a cloud, as in a cloud field.

If two clouds do not obscure each other, the image of both is the clear-sky image plus the
contributions of the two clouds. Mutual shading and obscuration are neglected. Their effect on a
reconstruction is small compared with that of the misplaced image of the neighbour in oblique views.
"""

from __future__ import annotations

import torch
from torch import Tensor

from weights_tools.dataset import Samples, first_volume
from weights_tools.shift import Shifter, interpolation

GAP = (2, 10)
"""Minimum and maximum number of clear columns between the two clouds (voxels)."""


class Neighbours:
    """Adds another cloud of the training set beside a share of the clouds of a batch."""

    def __init__(self, samples: Samples, shifter: Shifter, share: float) -> None:
        """``share`` is the fraction of the clouds that get a neighbour (0 to 1)."""
        self.samples, self.shifter, self.share = samples, shifter, share
        edges = torch.cat([samples.radiance[:, :, row, :] for row in (0, -1)], -1)
        self.sky = edges.median(-1).values.median(0).values
        """Clear-sky radiance of each view: that of most pixels at the edges of the images."""

    def draw(
        self, volumes: Tensor, radiance: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Clouds ``[n, z, y, x]``, or ``[n, quantity, z, y, x]``, and images
        ``[n, view, row, col]`` including the neighbours."""
        count = len(volumes)
        extinction, others = first_volume(volumes), self.samples.extinction
        other = torch.randperm(len(self.samples), generator=generator)[:count]
        chosen = torch.rand(len(other), generator=generator) < self.share
        volumes, radiance = volumes.clone(), radiance.clone()
        for index in chosen.nonzero().flatten().tolist():
            north, east = _displacement(extinction[index], others[other[index]], generator)
            volumes[index] += moved(moved(self.samples.volumes[other[index]], north, -2), east, -1)
            image = self.samples.radiance[other[index]] - self.sky[:, None, None]
            rows = interpolation(north * self.shifter.rows_per_voxel, radiance.shape[2])
            cols = interpolation(east * self.shifter.columns_per_voxel, radiance.shape[3])
            radiance[index] += rows @ image @ cols.transpose(-1, -2)
        return volumes, radiance.clamp_(min=0.0)


def _displacement(cloud: Tensor, other: Tensor, generator: torch.Generator) -> tuple[int, int]:
    """The shift to the north and east (voxels) by which the other cloud is clear of this one."""

    def draw(least: int, most: int) -> int:
        return int(torch.randint(least, most + 1, (), generator=generator))

    along = draw(0, 1)
    lines = [volume.amax((0, 2 - along)).nonzero() for volume in (cloud, other)]
    gap = draw(*GAP) + 1
    if draw(0, 1):
        away = int(lines[0].max() - lines[1].min()) + gap
    else:
        away = int(lines[0].min() - lines[1].max()) - gap
    across = cloud.shape[1 + along] // 2
    beside = draw(-across, across)
    return (away, beside) if along == 0 else (beside, away)


def moved(volume: Tensor, voxels: int, axis: int) -> Tensor:
    """A volume shifted along an axis and filled with zeros."""
    length = volume.shape[axis]
    result = torch.zeros_like(volume)
    kept = length - abs(voxels)
    if kept > 0:
        source = volume.narrow(axis, max(-voxels, 0), kept)
        result.narrow(axis, max(voxels, 0), kept).copy_(source)
    return result
