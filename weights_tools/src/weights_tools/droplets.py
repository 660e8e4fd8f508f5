"""Scattering by cloud droplets at one wavelength, by Mie theory.

The droplets have gamma distributions of their radius with the effective variance 0.1, as in
``deepct``. The series are those of Bohren and Huffman (1983, chapter 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

WAVELENGTH_UM = 0.672
WATER = 1.3307 + 2.1e-8j
"""Refractive index of water at :data:`WAVELENGTH_UM` (Hale and Querry 1973)."""

EFFECTIVE_VARIANCE = 0.1

EFFECTIVE_RADII_UM = np.geomspace(2.0, 21.0, 28)
"""Effective radii of the table; smaller and larger droplets scatter as the first and last."""

WIDTH_FACTOR = 0.8
"""Ratio of the cubes of the volume-mean and the effective radius (Martin et al. 1994)."""

LARGEST_RADIUS_UM = 20.0
"""Upper limit of the effective radius, as in Sde-Chen et al. (2021)."""

PEAK_DEG = 10.0
"""Scattering angle within which the forward peak of the phase function is truncated."""

ANGLES = 1801
"""Number of scattering angles of a phase function, from 0 to 180 degrees."""

CUMULATIVE = 2048
"""Number of points of the inverse cumulative distribution of the cosine."""

_RADII_UM = np.geomspace(0.5, 66.0, 1400)


@dataclass(frozen=True)
class DropletTable:
    """The phase functions of droplets, without the forward peak.

    Light that is scattered into the peak continues almost undeflected and is treated as if it were
    not scattered (Potter 1970). Outside of the peak, the product of extinction and phase function
    is unchanged, so that single scattering is exact there.
    """

    phase: np.ndarray
    """Phase functions without the peak, whose integrals over all directions are 1 (1/sr), at
    equidistant angles; float32, ``[radius, ANGLES]``."""
    cosine: np.ndarray
    """Cosines of the scattering angle at the centres of equal parts of the cumulative distribution;
    float32, ``[radius, CUMULATIVE]``."""
    removed: np.ndarray
    """The fraction of the scattered light in the peak, ``[radius]``."""


def effective_radius(water: np.ndarray, number: float) -> np.ndarray:
    """Effective radius (um) for liquid water contents (g/m3) and ``number`` droplets per cm3; that
    of clear air is zero."""
    cubed = 3.0e-12 * np.asarray(water) / (4.0 * np.pi * WIDTH_FACTOR * number)
    return np.minimum(1e6 * np.cbrt(cubed), LARGEST_RADIUS_UM)


def extinction(water: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Extinction (1/km) of liquid water (g/m3) in droplets of an effective radius (um)."""
    efficiency = np.interp(radius, EFFECTIVE_RADII_UM, extinction_efficiencies())
    return 750.0 * efficiency * water / np.maximum(radius, 0.5)


def table_index(radius: np.ndarray) -> np.ndarray:
    """Continuous index of effective radii (um) in the table, float32."""
    first, second = np.log(EFFECTIVE_RADII_UM[:2])
    index = (np.log(np.maximum(radius, EFFECTIVE_RADII_UM[0])) - first) / (second - first)
    return np.clip(index, 0.0, len(EFFECTIVE_RADII_UM) - 1.0).astype(np.float32)


@lru_cache(maxsize=1)
def extinction_efficiencies() -> np.ndarray:
    """Extinction cross-section divided by the geometric one, at :data:`EFFECTIVE_RADII_UM`."""
    orders, first, second = _coefficients()
    wavenumber = 2.0 * np.pi / WAVELENGTH_UM
    factors = (2.0 * orders + 1.0)[:, None]
    cross_section = 2.0 * np.pi / wavenumber**2 * (factors * (first + second).real).sum(0)
    weights = _size_weights()
    return (weights @ cross_section) / (weights @ (np.pi * _RADII_UM**2))


@lru_cache(maxsize=1)
def droplet_table() -> DropletTable:
    """The phase functions at :data:`EFFECTIVE_RADII_UM`, which takes a few seconds."""
    theta = np.linspace(0.0, np.pi, ANGLES)
    orders, first, second = _coefficients()
    pi, tau = _angular_functions(np.cos(theta), len(orders))
    factors = ((2.0 * orders + 1.0) / (orders * (orders + 1.0)))[:, None]
    first, second = factors * first, factors * second
    parallel = pi.T @ second + tau.T @ first
    perpendicular = pi.T @ first + tau.T @ second
    intensity = 0.5 * (abs(parallel) ** 2 + abs(perpendicular) ** 2)
    phase = _size_weights() @ intensity.T
    phase /= _integral(phase, theta)[:, None]
    peak = round(PEAK_DEG / 180.0 * (ANGLES - 1))
    without = phase.copy()
    without[:, :peak] = phase[:, peak : peak + 1]
    remaining = _integral(without, theta)
    without /= remaining[:, None]
    cosine = np.stack([_inverse_cumulative(values, theta) for values in without])
    return DropletTable(without.astype(np.float32), cosine.astype(np.float32), 1.0 - remaining)


def _integral(phase: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Integrals over all directions of functions of the scattering angle."""
    values = 2.0 * np.pi * phase * np.sin(theta)
    return 0.5 * ((values[..., 1:] + values[..., :-1]) * np.diff(theta)).sum(-1)


def _inverse_cumulative(phase: np.ndarray, theta: np.ndarray) -> np.ndarray:
    values = phase * np.sin(theta)
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(theta)
    cumulative = np.concatenate([[0.0], np.cumsum(steps)])
    centres = (np.arange(CUMULATIVE) + 0.5) / CUMULATIVE
    return np.cos(np.interp(centres, cumulative / cumulative[-1], theta))


def _size_weights() -> np.ndarray:
    """Relative numbers of droplets at the radii of the series, ``[effective radius, radius]``."""
    widths = np.gradient(_RADII_UM)
    scaled = _RADII_UM / EFFECTIVE_RADII_UM[:, None]
    logarithm = (1.0 / EFFECTIVE_VARIANCE - 3.0) * np.log(scaled) - scaled / EFFECTIVE_VARIANCE
    weights = np.exp(logarithm - logarithm.max(1, keepdims=True)) * widths
    return weights / weights.sum(1, keepdims=True)


@lru_cache(maxsize=1)
def _coefficients() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The orders ``n`` and the coefficients ``a_n`` and ``b_n`` at all radii, ``[n, radius]``; zero
    beyond the last order that contributes at a radius."""
    x = 2.0 * np.pi * _RADII_UM / WAVELENGTH_UM
    inside = x * WATER
    last = np.floor(x + 4.05 * np.cbrt(x) + 2.0)
    count = int(last[-1])
    start = int(max(count, abs(inside[-1]))) + 16
    # The logarithmic derivative is stable in the direction of decreasing orders.
    derivative = np.zeros((start + 1, len(x)), complex)
    for order in range(start, 0, -1):
        ratio = order / inside
        derivative[order - 1] = ratio - 1.0 / (derivative[order] + ratio)
    first = np.zeros((count, len(x)), complex)
    second = np.zeros_like(first)
    psi = [np.cos(x), np.sin(x)]
    chi = [-np.sin(x), np.cos(x)]
    # Beyond the last order of a radius, the recurrences of the Bessel functions are meaningless.
    with np.errstate(over="ignore", invalid="ignore"):
        for order in range(1, count + 1):
            for pair in (psi, chi):
                pair[:] = pair[1], (2 * order - 1) * pair[1] / x - pair[0]
            outgoing = [a - 1j * b for a, b in zip(psi, chi)]
            for result, factor in ((first, 1.0 / WATER), (second, WATER)):
                inner = factor * derivative[order] + order / x
                value = (inner * psi[1] - psi[0]) / (inner * outgoing[1] - outgoing[0])
                result[order - 1] = np.where(order <= last, value, 0.0)
    return np.arange(1.0, count + 1.0), first, second


def _angular_functions(cosine: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The functions ``pi_n`` and ``tau_n`` of the scattering angle, ``[n, angle]``."""
    pi = np.zeros((count + 1, len(cosine)))
    tau = np.zeros_like(pi)
    pi[1], tau[1] = 1.0, cosine
    for n in range(2, count + 1):
        pi[n] = ((2 * n - 1) * cosine * pi[n - 1] - n * pi[n - 2]) / (n - 1)
        tau[n] = n * cosine * pi[n] - (n + 1) * pi[n - 1]
    return pi[1:], tau[1:]
