"""The sensor's noise: radiance to electrons to grey levels and back.

The variance of a pixel is the paper's, ``V = i + D dt + read^2 + g^2 / 12`` in electrons
squared (Sde-Chen et al. 2021, section 2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

MANY = 200.0
"""Electrons from which on Poisson's distribution is drawn as a normal one, ten times faster:
its skewness, 7 % there, drowns in the readout and the grey levels."""


@dataclass(frozen=True)
class Sensor:
    """A sensor by the numbers of its data sheet; the default is the paper's CMV4000."""

    full_well: float = 13_500.0
    """Charge that fills a pixel (electrons)."""
    read_noise: float = 13.0
    """Standard deviation of the readout (electrons)."""
    dark_current: float = 125.0
    """Charge that gathers without light (electrons per second)."""
    bits: int = 10
    """The full well is divided into ``2 ** bits`` grey levels."""
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
        """Mean dark charge of an exposure (electrons)."""
        return self.dark_current * self.exposure

    def variance(self, electrons: float) -> float:
        """The paper's variance (electrons squared) where light frees ``electrons`` on average."""
        quantisation = self.electrons_per_count**2 / 12.0
        return electrons + self.dark_charge + self.read_noise**2 + quantisation

    def sense(
        self, radiance: Tensor, generator: torch.Generator, brightest: Tensor | None = None
    ) -> Tensor:
        """What the sensor makes of ``radiance`` ``[..., view, row, col]`` without noise.

        The brightest pixel over all views of a scene fills its well; ``brightest``
        ``[..., 1, 1, 1]`` gives its radiance where it is not among these pixels. The mean dark
        charge is subtracted, so a dark pixel may come out slightly negative.
        """
        if brightest is None:
            brightest = radiance.amax((-3, -2, -1), keepdim=True)
        scale = self.full_well / brightest
        charge = _arrivals(radiance * scale + self.dark_charge, generator)
        noise = torch.randn(radiance.shape, generator=generator, device=radiance.device)
        gain = self.electrons_per_count
        counts = ((charge + self.read_noise * noise) / gain).round_().clamp_(0, 2**self.bits - 1)
        return (counts * gain - self.dark_charge) / scale


def _arrivals(mean: Tensor, generator: torch.Generator) -> Tensor:
    """Numbers of electrons that are freed one by one."""
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    charge = mean.addcmul(mean.sqrt(), noise)
    few = mean < MANY
    charge[few] = torch.poisson(mean[few], generator=generator)
    return charge
