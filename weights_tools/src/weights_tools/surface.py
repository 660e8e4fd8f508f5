"""Images as they would be above the surface that a general network knows; the same computation as
``network/surface.rs`` of ``deepct``, which explains it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from weights_tools.views import Views

CLEAR_SHARE = 0.25
"""Share of the pixels, by the albedo that would explain them, below which the surface is found."""

LARGEST_ALBEDO = 0.3
"""Largest albedo of a surface; images that are brighter everywhere show clouds."""

HIDING = 0.15
"""Radiance over the cosine of the solar zenith angle (1/sr), above that of the surface, at which a
cloud hides about two thirds of the surface."""

AIR_DEPTH = 0.042998
"""Optical depth of the molecular atmosphere at 0.672 um."""


def clear_radiance(views: Views) -> tuple[Tensor, Tensor]:
    """The radiance of a clear surface is the first tensor and its albedo times the second one, both
    ``[n, v]``."""
    sun, camera = views.sun[:, None, 2], views.towards[..., 2]
    cosine = (views.sun[:, None] * views.towards).sum(-1)
    air_mass = 1.0 / sun + 1.0 / camera
    phase = 0.75 * (1.0 + cosine.square()) / (4.0 * math.pi)
    path = phase * sun / (sun + camera) * (1.0 - (-AIR_DEPTH * air_mass).exp())
    return path, sun / math.pi * (-0.5 * AIR_DEPTH * air_mass).exp()


def above_surface(images: Tensor, views: Views, reference: float) -> Tensor:
    """Images (1/sr) ``[n, v, row, col]`` in which the radiance of the clear surface is that of a
    surface with the albedo ``reference`` where it is brighter; all views must be present."""
    path, factor = (each[..., None, None] for each in clear_radiance(views))
    albedos = ((images - path) / factor).flatten(1)
    dark = int(CLEAR_SHARE * albedos.shape[1])
    albedo = albedos.kthvalue(dark + 1, dim=1).values[:, None, None, None]
    surface = path + albedo * factor
    excess = (images - surface).clamp_min(0.0) / (HIDING * views.sun[:, None, None, None, 2])
    changed = images + (reference - albedo) * factor * (-excess).exp()
    # Only brighter surfaces look like clouds; the albedo found between large shadows is too low.
    brighter = (albedo >= reference) & (albedo <= LARGEST_ALBEDO)
    return torch.where(brighter, changed, images)
