"""A second cloud beside a cloud, as more training data: what a field looks like.

Light that has left a cloud for a camera adds up: where two clouds do not hide each other, the
images of both are the sum of what each adds to the clear sky. That they shade each other and
that the nearer hides the farther is left out; seen beside the wrong image of a neighbour in
slanted views, which is what spoils a reconstruction, it is little.
"""

from __future__ import annotations

import torch
from torch import Tensor

from weights_tools.dataset import Samples
from weights_tools.shift import Shifter, interpolation

GAP = (2, 10)
"""Fewest and most clear columns between the two clouds (voxels)."""


class Neighbours:
    """Sets another cloud of the training set beside each of a batch, or some of them."""

    def __init__(self, samples: Samples, shifter: Shifter, share: float) -> None:
        """``share`` is how many of the clouds get a neighbour, from 0 to 1."""
        self.samples, self.shifter, self.share = samples, shifter, share
        edges = torch.cat([samples.radiance[:, :, row, :] for row in (0, -1)], -1)
        self.sky = edges.median(-1).values.median(0).values
        """Radiance of the clear sky by view: what most pixels at the edges of images show."""

    def draw(
        self, extinction: Tensor, radiance: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Clouds ``[n, z, y, x]`` and images ``[n, view, row, col]`` with their neighbours."""
        count = len(extinction)
        other = torch.randperm(len(self.samples), generator=generator)[:count]
        chosen = torch.rand(len(other), generator=generator) < self.share
        extinction, radiance = extinction.clone(), radiance.clone()
        for index in chosen.nonzero().flatten().tolist():
            cloud = self.samples.extinction[other[index]]
            north, east = _displacement(extinction[index], cloud, generator)
            extinction[index] += moved(moved(cloud, north, 1), east, 2)
            image = self.samples.radiance[other[index]] - self.sky[:, None, None]
            rows = interpolation(north * self.shifter.rows_per_voxel, radiance.shape[2])
            cols = interpolation(east * self.shifter.columns_per_voxel, radiance.shape[3])
            radiance[index] += rows @ image @ cols.transpose(-1, -2)
        return extinction, radiance.clamp_(min=0.0)


def _displacement(cloud: Tensor, other: Tensor, generator: torch.Generator) -> tuple[int, int]:
    """How far to the north and to the east the other cloud goes to stand clear of this one."""

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
    """A volume moved along an axis; what leaves it is gone and what enters is clear."""
    length = volume.shape[axis]
    result = torch.zeros_like(volume)
    kept = length - abs(voxels)
    if kept > 0:
        source = volume.narrow(axis, max(-voxels, 0), kept)
        result.narrow(axis, max(voxels, 0), kept).copy_(source)
    return result
