"""Views of a batch of scenes, and the features from which the general network derives its layers.

All lengths are in units of the horizontal voxel size: radiative transfer is invariant when all
lengths are multiplied and all extinctions divided by the same factor. Directions are unit vectors
``(x, y, z)`` towards the east, the north and the zenith.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

VIEW_FEATURES = 18
"""Number of features of a view."""

SCENE_FEATURES = 9
"""Number of features of a scene."""

FINEST_PIXEL = 0.9
"""Lower limit of the size of a pixel (voxels) in the features. ``deepct`` averages much smaller
pixels over a voxel, and a training has none."""

STEEPEST = 4.0
"""Limit of the components of the tangent of a view in the features (76 degrees)."""


@dataclass(frozen=True)
class Views:
    """The Sun and the views of ``n`` scenes with up to ``v`` views each."""

    sun: Tensor
    """Directions towards the Sun, ``[n, 3]``."""
    towards: Tensor
    """Directions from the target towards the cameras, ``[n, v, 3]``."""
    distance: Tensor
    """Distances of the cameras from the target (voxels), ``[n, v]``; infinite for parallel rays."""
    pixel: Tensor
    """Sizes of a pixel at the target (voxels), ``[n, v]``."""
    present: Tensor
    """1 for each view and 0 for each unused place of a scene with fewer views, ``[n, v]``."""

    @property
    def count(self) -> Tensor:
        """The number of views of each scene, ``[n]``."""
        return self.present.sum(1)

    def to(self, *target: Any) -> Views:
        """The views on another device or in another precision."""
        return Views(*(values.to(*target) for values in vars(self).values()))

    def __getitem__(self, scenes: Any) -> Views:
        """The views of some scenes, for example ``views[2:4]``."""
        return Views(*(values[scenes] for values in vars(self).values()))

    def select(self, chosen: Tensor) -> Views:
        """The views with the numbers ``chosen`` ``[n, k]`` of each scene, in this order."""
        towards = self.towards.gather(1, chosen[..., None].expand(-1, -1, 3))
        others = (values.gather(1, chosen) for values in (self.distance, self.pixel, self.present))
        return Views(self.sun, towards, *others)

    def mirrored(self, east: Tensor, north: Tensor, swapped: Tensor) -> Views:
        """The views after the symmetries of the ground: x is reversed where ``east`` ``[n]`` is
        true, y where ``north`` is true, and x and y are then exchanged where ``swapped`` is."""
        # Without constants from the host, for which a GPU would have to wait.
        signs = [1.0 - 2.0 * each.to(self.sun) for each in (east, north)]

        def turned(vectors: Tensor) -> Tensor:
            scenes = (-1, *[1] * (vectors.ndim - 2))
            x, y = (sign.reshape(scenes) * vectors[..., at] for at, sign in enumerate(signs))
            exchanged = swapped.reshape(scenes)
            return torch.stack(
                [torch.where(exchanged, y, x), torch.where(exchanged, x, y), vectors[..., 2]], -1
            )

        sun, towards = turned(self.sun), turned(self.towards)
        return replace(self, sun=sun, towards=towards)


def direction(zenith: Tensor, azimuth: Tensor) -> Tensor:
    """Unit vectors ``[..., 3]`` for zenith angles and azimuths, clockwise from north (radians)."""
    sine = zenith.sin()
    return torch.stack([sine * azimuth.sin(), sine * azimuth.cos(), zenith.cos()], -1)


def views_of(geometry: dict[str, Any], voxel_km: float) -> Views:
    """The views of one scene, in float64, from a ``view_geometry`` as in weights files.

    ``voxel_km`` is the horizontal size of the voxels. The keys are ``sun_zenith_deg``,
    ``sun_azimuth_deg``, and lists ``view_zenith_deg``, ``view_azimuth_deg``, ``pixel_km`` and
    ``camera_distance_km`` (``None`` for parallel rays).
    """

    def angles(key: str) -> Tensor:
        return torch.tensor(geometry[key], dtype=torch.float64).deg2rad()

    distances = [torch.inf if at is None else at for at in geometry["camera_distance_km"]]
    pixel = torch.tensor(geometry["pixel_km"], dtype=torch.float64)[None] / voxel_km
    return Views(
        direction(angles("sun_zenith_deg"), angles("sun_azimuth_deg"))[None],
        direction(angles("view_zenith_deg"), angles("view_azimuth_deg"))[None],
        torch.tensor(distances, dtype=torch.float64)[None] / voxel_km,
        pixel,
        torch.ones_like(pixel),
    )


def scene_features(views: Views) -> Tensor:
    """The features of each scene, ``[n, SCENE_FEATURES]``: the direction of the Sun, the mean and
    the second moments of the tangents of the views, and the logarithm of their number. They do not
    depend on the order of the views."""
    tangent = _tangent(views.towards)
    share = (views.present / views.count[:, None])[..., None]
    squares = torch.cat([tangent.square(), tangent.prod(-1, keepdim=True)], -1)
    sun, count = views.sun, views.count[:, None]
    return torch.cat(
        [
            1.5 * sun[:, :2],
            2.0 * sun[:, 2:] - 1.4,
            (share * tangent).sum(1),
            (share * squares).sum(1),
            count.log() - 2.3,
        ],
        -1,
    )


def view_features(views: Views, scene: Tensor) -> Tensor:
    """The features of each view, ``[n, v, VIEW_FEATURES]``, given those of the scenes: the
    directions of the camera and of the Sun, the angle between them, the size of a pixel, and the
    features of the scene that describe the other views."""
    towards = views.towards
    sun = views.sun[:, None].expand_as(towards)
    cosine = (towards * sun).sum(-1, keepdim=True)
    half = towards + sun
    return torch.cat(
        [
            1.5 * towards[..., :2],
            _tangent(towards),
            2.0 * towards[..., 2:] - 1.5,
            1.5 * sun[..., :2],
            2.0 * sun[..., 2:],
            cosine,
            2.0 * cosine.square() - 1.0,
            (half / half.norm(dim=-1, keepdim=True))[..., 2:],
            views.pixel[..., None].clamp_min(FINEST_PIXEL) - 1.0,
            scene[:, None, 3:].expand(-1, towards.shape[1], -1),
        ],
        -1,
    )


def _tangent(towards: Tensor) -> Tensor:
    tangent = towards[..., :2] / towards[..., 2:]
    return 0.5 * tangent.clamp(-STEEPEST, STEEPEST)
