"""Errors of a reconstruction for each cloud (Sde-Chen et al. 2021, section 5)."""

from __future__ import annotations

from torch import Tensor

_VOLUME = (-3, -2, -1)

LEAST_CLOUD = 0.1
"""Lower limit of the sum by which the error of a cloud is divided in a loss, as a crop may contain
only a small part of the cloud."""


def relative_error(truth: Tensor, estimate: Tensor) -> Tensor:
    """``epsilon = ||truth - estimate||_1 / ||truth||_1`` of each volume ``[..., z, y, x]``."""
    truth, estimate = truth.double(), estimate.double()
    return (truth - estimate).abs().sum(_VOLUME) / truth.abs().sum(_VOLUME)


def mass_error(truth: Tensor, estimate: Tensor) -> Tensor:
    """``delta = (||truth||_1 - ||estimate||_1) / ||truth||_1`` of each volume."""
    total = truth.double().abs().sum(_VOLUME)
    return (total - estimate.double().abs().sum(_VOLUME)) / total
