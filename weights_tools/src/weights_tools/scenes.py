"""Random training scenes: a cloud, its illumination, and many views of it.

A scene depends on the seed of the recipe, the split and its number only, whatever computes its
images. It has the views of a string of pearls and further views in random directions, of which a
training selects a few each time it uses the scene.

The voxels of all scenes are 0.05 km wide and 0.04 km high. A cloud on voxels of another size is
represented by multiplying its extinction and dividing its altitude by the ratio of the sizes, for
which the radiance is the same except for the small contributions of air and surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from weights_tools.clouds import SIZE, Extent, Generated, Placement, Simulation, extent_of, placed
from weights_tools.droplets import effective_radius, extinction
from weights_tools.general_recipe import SceneRecipe, SimulationRecipe

VOXEL_KM = 0.05
LEVEL_KM = 0.04

PEARLS_32_DEG = (
    *(-75.2, -73.5, -71.7, -69.6, -67.4, -64.8, -62.0, -58.8),
    *(-55.2, -51.0, -46.0, -40.6, -34.0, -26.0, -18.0, -9.0),
    *(0.0, 9.0, 18.0, 26.0, 34.0, 40.6, 46.0, 51.0),
    *(55.2, 58.8, 62.0, 64.8, 67.4, 69.6, 71.7, 73.5),
)
"""View zenith angles of the paper's string of pearls (degrees), negative behind the target."""

CLOUDCT_10 = (10, *range(12, 21))
"""Indices of the ten views of ``cloudct-10`` among those of the string of pearls."""

PAPER_SUN_DEG = (30.0, 45.0)
"""Zenith angle and azimuth of the Sun in Sde-Chen et al. (2021)."""
PAPER_BOTTOM_KM = 0.48
PAPER_ALBEDO = 0.05
PAPER_ALTITUDE_KM = 600.0
PAPER_PIXEL_KM = 0.05
"""Size of a pixel at nadir."""

PIXEL_KM = (0.045, 0.12)
ALTITUDES_KM = (100.0, 1000.0)
EARTH_RADIUS_KM = 6371.0

FORMATION_JITTER_DEG = 1.5
"""Standard deviation of the view angles of other strings of pearls."""
LARGEST_VIEW_DEG = 75.3

LEAST_VOXELS = 12
"""Smallest number of cloudy voxels of a scene."""
LARGEST_EXTINCTION = 400.0
"""Upper limit of the extinction (1/km)."""
RADII_UM = (1.05, 20.0)
"""Limits of the effective radius."""
CLEAR_RADIUS_UM = 10.0
"""Effective radius that is stated for clear voxels."""
LOWEST_KM = 0.05
"""Smallest altitude of the lower boundary of a scene."""

_SPLITS = {"train": 0, "validation": 1}


@dataclass(frozen=True)
class Scene:
    """A cloud in the light of the Sun, and the cameras pointed at the centre of its grid."""

    extinction: np.ndarray
    """1/km, float32 ``[z, y, x]``."""
    effective_radius: np.ndarray
    """um, float32 ``[z, y, x]``."""
    bottom_km: float
    """Altitude of the lower boundary of the grid."""
    sun: np.ndarray
    """Direction towards the Sun, ``[3]``."""
    albedo: float
    """Albedo of the Lambertian surface."""
    towards: np.ndarray
    """Directions from the target to the cameras, ``[v, 3]``."""
    distance_km: np.ndarray
    """Distances of the cameras from the target, ``[v]``."""
    pixel_km: np.ndarray
    """Sizes of a pixel at the target, ``[v]``."""
    paper: bool
    """Whether the light is that of the paper and the first 32 views are its string of pearls."""
    factor: float
    """Size of the voxels divided by :data:`VOXEL_KM`."""
    seed: int
    """Seed of the noise of the images."""
    voxel_km: float = VOXEL_KM
    level_km: float = LEVEL_KM

    def select(self, views: list[int]) -> Scene:
        """The scene with some of its views."""
        by_view = {name: getattr(self, name)[views] for name in _BY_VIEW}
        return replace(self, **by_view)


_BY_VIEW = ("towards", "distance_km", "pixel_km")


@dataclass(frozen=True)
class _Cloud:
    water: np.ndarray
    """Liquid water content (g/m3), ``[z, y, x]``."""
    bottom_km: float
    number: float
    """Droplets per cm3."""
    factor: float


class SceneGenerator:
    """Draws the scenes of one split."""

    def __init__(
        self,
        recipe: SceneRecipe,
        simulations: tuple[SimulationRecipe, ...],
        folder: Path,
        split: str = "train",
    ) -> None:
        """``simulations`` are those of the split, ``folder`` contains their files.

        Raises :class:`InputError` for a file that cannot be used.
        """
        self.recipe, self.split = recipe, split
        self._simulations = [
            (Simulation(Path(folder, each.file), each.first, each.last), each)
            for each in simulations
        ]
        shares = np.array([each.share for each in simulations])
        self._shares = shares / shares.sum()
        # The clouds of the generator have no validation part.
        self._generated = None
        if recipe.generated > 0.0 and split == "train":
            self._generated = Generated(Path(folder), recipe.generated_clouds)

    def scene(self, number: int) -> Scene:
        """The scene with this number."""
        key = [self.recipe.seed, _SPLITS[self.split], number]
        random = np.random.default_rng(key)
        paper = random.random() < self.recipe.paper
        while True:
            cloud = self._cloud(random, paper)
            if np.count_nonzero(cloud.water) >= LEAST_VOXELS:
                break
        radius = effective_radius(cloud.water, cloud.number)
        radius = np.clip(radius, *RADII_UM)
        beta = np.minimum(extinction(cloud.water, radius) * cloud.factor, LARGEST_EXTINCTION)
        radius = np.where(cloud.water > 0.0, radius, CLEAR_RADIUS_UM)
        sun, albedo = self._light(random, paper)
        towards, distance, pixel = self._views(random, paper)
        return Scene(
            beta.astype(np.float32),
            radius.astype(np.float32),
            cloud.bottom_km,
            sun,
            albedo,
            towards,
            distance,
            pixel,
            paper,
            cloud.factor,
            int(random.integers(1, 2**32)),
        )

    def _cloud(self, random: np.random.Generator, paper: bool) -> _Cloud:
        recipe = self.recipe
        source, few_many = self._source(random)
        snapshot, label = source.draw(random)
        extent = extent_of(snapshot, label)
        isolated = random.random() < recipe.isolated
        placement = self._placement(random, extent, isolated)
        height = (extent.last - extent.first + 1) * placement.stretch / placement.factor
        base = random.uniform(0.0, max(0.0, SIZE - 1.0 - height))
        cloud_base_km = snapshot.bottom_km + extent.first * snapshot.level_km
        # Unmodified clouds in the light of the paper remain at their altitude where they fit.
        usual = (cloud_base_km - PAPER_BOTTOM_KM) / LEVEL_KM
        if paper and placement.factor == 1.0 and 0.0 <= usual <= SIZE - height:
            base = usual
        water = placed(snapshot, label, isolated, replace(placement, base=base))
        if placement.zoom != 1.0:
            water = water * np.float32(random.uniform(0.3, 1.5))
        for axis in (1, 2):
            if random.random() < 0.5:
                water = np.flip(water, axis)
        if random.random() < 0.5:
            water = water.transpose(0, 2, 1)
        bottom = max(cloud_base_km / placement.factor - base * LEVEL_KM, LOWEST_KM)
        if random.random() < 0.3:
            bottom = random.uniform(0.1, 2.5)
        if paper:
            bottom = PAPER_BOTTOM_KM
        few, many = few_many
        number = few * (many / few) ** random.random()
        return _Cloud(np.ascontiguousarray(water), bottom, number, placement.factor)

    def _source(
        self, random: np.random.Generator
    ) -> tuple[Simulation | Generated, tuple[float, float]]:
        if random.random() < self.recipe.generated and self._generated is not None:
            return self._generated, (50.0, 600.0)
        simulation, recipe = self._simulations[random.choice(len(self._shares), p=self._shares)]
        return simulation, recipe.droplets_per_cm3

    def _placement(self, random: np.random.Generator, extent: Extent, isolated: bool) -> Placement:
        zoom = stretch = factor = 1.0
        lean = np.zeros(2)
        if random.random() < self.recipe.varied:
            zoom = math.exp(random.uniform(-0.35, 0.35))
            stretch = math.exp(random.uniform(-0.21, 0.39))
            lean = random.uniform(-0.5, 0.5, 2)
        if random.random() < self.recipe.resized:
            factor = math.exp(random.uniform(-0.5, 0.9))
        # One voxel remains clear at the sides.
        room = SIZE - 1.0
        factor = max(factor, (extent.last - extent.first + 1) * stretch / room)
        if isolated:
            factor = max(factor, extent.columns / zoom / room)
            height = (extent.last - extent.first + 1) * stretch / factor
            lean *= min(1.0, (room - extent.columns / zoom / factor) / (0.5 * height))
        reach = 2.0 if isolated else 12.0
        aside = random.uniform(-reach, reach, 2)
        return Placement(factor, zoom, stretch, (lean[0], lean[1]), 0.0, (aside[0], aside[1]))

    def _light(self, random: np.random.Generator, paper: bool) -> tuple[np.ndarray, float]:
        # Uniform over the directions, so that a high Sun is not too frequent.
        lowest = math.cos(math.radians(self.recipe.sun_zenith_deg))
        zenith = math.acos(random.uniform(lowest, 1.0))
        azimuth = random.uniform(0.0, 2.0 * math.pi)
        albedo = random.uniform(0.02, 0.2) if random.random() < 0.3 else PAPER_ALBEDO
        if paper:
            zenith, azimuth = np.radians(PAPER_SUN_DEG)
            albedo = PAPER_ALBEDO
        return _direction(np.array(zenith), np.array(azimuth)), albedo

    def _views(
        self, random: np.random.Generator, paper: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        altitude, pixel = PAPER_ALTITUDE_KM, PAPER_PIXEL_KM
        if random.random() < 0.2:
            altitude = _log_uniform(random, *ALTITUDES_KM)
        if random.random() < 0.4:
            pixel = _log_uniform(random, *PIXEL_KM)
        track = random.uniform(0.0, 2.0 * math.pi)
        angles = np.array(PEARLS_32_DEG)
        jitter = FORMATION_JITTER_DEG * random.standard_normal(len(angles))
        if paper:
            altitude, pixel, track, jitter = PAPER_ALTITUDE_KM, PAPER_PIXEL_KM, 0.0, 0.0
        angles = np.radians(np.clip(angles + jitter, -LARGEST_VIEW_DEG, LARGEST_VIEW_DEG))
        count = self.recipe.random_views
        largest = math.radians(self.recipe.view_zenith_deg)
        zenith = np.concatenate([abs(angles), largest * random.random(count) ** 0.8])
        anywhere = random.uniform(0.0, 2.0 * math.pi, count)
        azimuth = np.concatenate([track + math.pi * (angles < 0.0), anywhere])
        distance = _distance(zenith, altitude)
        # All cameras have the same field of view.
        return _direction(zenith, azimuth), distance, pixel * distance / altitude


def _direction(zenith: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    sine = np.sin(zenith)
    return np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(zenith)], -1)


def _distance(zenith: np.ndarray, altitude: float) -> np.ndarray:
    """Distance (km) of a camera at an altitude (km) above the curved Earth."""
    down = EARTH_RADIUS_KM * np.cos(zenith)
    return np.sqrt(down**2 + altitude * (2.0 * EARTH_RADIUS_KM + altitude)) - down


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return low * (high / low) ** random.random()
