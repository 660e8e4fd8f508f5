"""Simulation of the sensor: radiance is converted to electrons, grey levels and back to radiance.

The noise variance of a pixel is ``V = i + D dt + read^2 + g^2 / 12`` in electrons squared
(Sde-Chen et al. 2021, section 2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

MANY = 200.0
"""Number of electrons above which a normal distribution replaces the Poisson distribution, which
is ten times faster. The skewness of 7 % at this number is negligible compared with the read and
quantisation noise."""


@dataclass(frozen=True)
class Sensor:
    """An image sensor, described by its data sheet; the default is the paper's CMV4000."""

    full_well: float = 13_500.0
    """Full-well capacity of a pixel (electrons)."""
    read_noise: float = 13.0
    """Standard deviation of the read noise (electrons)."""
    dark_current: float = 125.0
    """Dark current (electrons per second)."""
    bits: int = 10
    """Bits per pixel: the full well is divided into ``2 ** bits`` grey levels."""
    exposure: float = 762e-6
    """Exposure time (seconds)."""

    def __post_init__(self) -> None:
        if self.full_well <= 0.0 or self.exposure <= 0.0:
            raise ValueError("full_well and exposure must be positive")
        if self.read_noise < 0.0 or self.dark_current < 0.0:
            raise ValueError("read_noise and dark_current must not be negative")
        if not 1 <= self.bits <= 24:
            raise ValueError(f"bits is {self.bits}, not between 1 and 24")

    @property
    def electrons_per_count(self) -> float:
        return self.full_well / 2**self.bits

    @property
    def dark_charge(self) -> float:
        """Mean dark charge per exposure (electrons)."""
        return self.dark_current * self.exposure

    def variance(self, electrons: float) -> float:
        """Noise variance (electrons squared) for a mean photoelectric charge of ``electrons``."""
        quantisation = self.electrons_per_count**2 / 12.0
        return electrons + self.dark_charge + self.read_noise**2 + quantisation

    def sense(
        self,
        radiance: Tensor,
        generator: torch.Generator,
        brightest: Tensor | None = None,
        normal: bool = False,
    ) -> Tensor:
        """The measured radiance for noise-free ``radiance`` ``[..., view, row, col]``.

        The brightest pixel over all views of a scene reaches the full-well capacity; ``brightest``
        ``[..., 1, 1, 1]`` is its radiance if it is not among these pixels. The mean dark charge is
        subtracted, so that the value of a dark pixel can be slightly negative. With ``normal``, all
        numbers of electrons are normally distributed, which a GPU computes without interruption.
        """
        if brightest is None:
            brightest = radiance.amax((-3, -2, -1), keepdim=True)
        scale = self.full_well / brightest
        charge = _arrivals(radiance * scale + self.dark_charge, generator, normal)
        noise = torch.randn(radiance.shape, generator=generator, device=radiance.device)
        gain = self.electrons_per_count
        counts = ((charge + self.read_noise * noise) / gain).round_().clamp_(0, 2**self.bits - 1)
        return (counts * gain - self.dark_charge) / scale


def _arrivals(mean: Tensor, generator: torch.Generator, normal: bool) -> Tensor:
    """Numbers of electrons drawn from Poisson distributions with the given means."""
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    charge = mean.addcmul(mean.sqrt(), noise)
    if normal:
        return charge
    few = mean < MANY
    charge[few] = torch.poisson(mean[few], generator=generator)
    return charge
