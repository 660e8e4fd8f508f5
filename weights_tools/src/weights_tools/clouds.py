"""Clouds of large-eddy simulations and of the generator of ``deepct``, on the grid of a network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from weights_tools.errors import InputError
from weights_tools.files import regular_file

SIZE = 32
"""Voxels of a scene along x, y and z."""

THINNEST = 0.01
"""Liquid water content (g/m3) below which a voxel is clear."""

LEAST_COLUMNS = 10
"""Smallest number of columns of a cloud that is selected."""

LEAST_PATH = 20.0
"""Smallest maximum of the liquid water path (g/m2) of a cloud that is selected."""

WIDEST = 88
"""Largest extent of a cloud along x and along y (columns of the simulation)."""

_GENERATED = "generated-{}.npz"
_GENERATED_SIZE = 128
"""Columns of the clear surroundings of a generated cloud, more than a scene covers."""


@dataclass(frozen=True)
class Snapshot:
    """A field of clouds at one time, periodic along x and y."""

    water: np.ndarray
    """Liquid water content (g/m3), float32 ``[z, y, x]``."""
    labels: np.ndarray
    """Numbers of the connected columns of each cloud, 0 where it is clear, ``[y, x]``."""
    clouds: np.ndarray
    """The labels of the clouds that can be selected."""
    bottom_km: float
    """Altitude of the lower boundary of the first level."""
    level_km: float


@dataclass(frozen=True)
class Extent:
    """Where a cloud is, in columns and levels of its simulation."""

    centre_y: float
    centre_x: float
    first: int
    last: int
    columns: int
    """The larger of the extents along x and y."""


@dataclass(frozen=True)
class Placement:
    """How a cloud is resampled onto the grid of a scene."""

    factor: float
    """Size of a voxel of the scene divided by that of the simulation; multiplies the extinction."""
    zoom: float
    """Factor by which the cloud is narrower along x and y."""
    stretch: float
    """Factor by which the cloud is higher."""
    lean: tuple[float, float]
    """Displacement of a level relative to the one below, along y and x (voxels of the scene)."""
    base: float
    """Height of the cloud base in the scene (levels)."""
    aside: tuple[float, float]
    """Displacement of the cloud from the centre of the scene, along y and x (columns)."""


class Simulation:
    """A range of times of a file with the variables ``lwc(time, z, y, x)`` and ``z``."""

    def __init__(self, path: Path, first: int, last: int) -> None:
        """Raises :class:`InputError` if the file cannot be read or has fewer times."""
        self.path, self.first, self.last = path, first, last
        remedy = "name a file with lwc(time, z, y, x), or correct the range of times"
        regular_file(path, remedy)
        try:
            with h5py.File(path) as file:
                shape = file["lwc"].shape
                altitudes = file["z"][:].astype(float)
        except (OSError, KeyError) as problem:
            raise InputError(path, f"cannot be read ({problem})", remedy) from None
        if len(shape) != 4 or not 0 <= first <= last < shape[0]:
            problem = f"has lwc of shape {list(shape)} for the times {first} to {last}"
            raise InputError(path, problem, remedy)
        # Altitudes in metres are recognised by their size.
        altitudes = altitudes / 1000.0 if altitudes.max() > 100.0 else altitudes
        self.level_km = float(np.diff(altitudes).mean())
        self.bottom_km = float(altitudes[0]) - 0.5 * self.level_km
        self._read = lru_cache(maxsize=4)(self._snapshot)

    def draw(self, random: np.random.Generator) -> tuple[Snapshot, int]:
        """A cloud of a random time: the snapshot and the label of the cloud."""
        while True:
            snapshot = self._read(int(random.integers(self.first, self.last + 1)))
            if len(snapshot.clouds):
                return snapshot, int(snapshot.clouds[random.integers(len(snapshot.clouds))])

    def _snapshot(self, time: int) -> Snapshot:
        with h5py.File(self.path) as file:
            variable = file["lwc"]
            packed = variable[time]
            scale, offset = (
                float(np.ravel(variable.attrs.get(name, default))[0])
                for name, default in (("scale_factor", 1.0), ("add_offset", 0.0))
            )
        water = np.maximum(packed.astype(np.float32) * scale + offset, 0.0).astype(np.float32)
        return snapshot_of(water, self.bottom_km, self.level_km)


class Generated:
    """Clouds of the generator of ``deepct``, with the seeds 1 to ``count``.

    They are read from the folder of the simulations if :meth:`write` has written them there, so
    that they can be used where ``deepct_py`` is not installed.
    """

    def __init__(self, folder: Path, count: int) -> None:
        """Raises :class:`InputError` without the file and without ``deepct_py``."""
        self.count = count
        path = folder / _GENERATED.format(count)
        self._water = None
        if path.exists():
            file = regular_file(path, "write it again with `weights_tools pack`")
            self._water = np.load(file)["water"]
        else:
            _deepct()

    def draw(self, random: np.random.Generator) -> tuple[Snapshot, int]:
        """A random cloud: a snapshot that contains no other cloud, and its label."""
        seed = int(random.integers(1, self.count + 1))
        water = self.cloud(seed) if self._water is None else self._water[seed - 1]
        margin = (_GENERATED_SIZE - SIZE) // 2
        padded = np.pad(water.astype(np.float32), [(0, 0), (margin, margin), (margin, margin)])
        snapshot = snapshot_of(padded, bottom_km=0.48, level_km=0.04)
        labels = np.where(snapshot.labels > 0, 1, 0)
        return Snapshot(padded, labels, np.array([1]), 0.48, 0.04), 1

    def write(self, folder: Path) -> Path:
        """Write all clouds to a folder of simulations."""
        water = np.stack([self.cloud(seed) for seed in range(1, self.count + 1)])
        path = folder / _GENERATED.format(self.count)
        np.savez_compressed(path, water=water)
        return path

    def cloud(self, seed: int) -> np.ndarray:
        """Liquid water content (g/m3) of one cloud, float16 ``[z, y, x]``."""
        deepct = _deepct()
        corner = (-0.5 * SIZE * 0.05, -0.5 * SIZE * 0.05, 0.48)
        grid = deepct.Grid((SIZE, SIZE, SIZE), (0.05, 0.05, 0.04), corner)
        cloud = deepct.generate_cloud(grid, seed=seed)
        return np.asarray(cloud.liquid_water_content, np.float16)


def _deepct() -> Any:
    try:
        import deepct_py
    except ImportError as problem:
        remedy = "install it, or make scenes.generated 0"
        raise InputError("deepct_py", f"cannot be imported ({problem})", remedy) from None
    return deepct_py


def snapshot_of(water: np.ndarray, bottom_km: float, level_km: float) -> Snapshot:
    """A snapshot with its clouds, from liquid water contents (g/m3) ``[z, y, x]``."""
    labels = connected(np.asarray(water > THINNEST).any(0))
    path = water.sum(0) * level_km * 1e3
    columns = np.bincount(labels.ravel())
    largest = np.zeros(len(columns), path.dtype)
    np.maximum.at(largest, labels.ravel(), path.ravel())
    large = (columns >= LEAST_COLUMNS) & (largest >= LEAST_PATH)
    large[0] = False
    return Snapshot(water, labels, np.flatnonzero(large), bottom_km, level_km)


def connected(cloudy: np.ndarray) -> np.ndarray:
    """Labels of the columns ``[y, x]`` that touch along x or y, with periodic sides. The label of a
    cloud is one more than the smallest index of its columns; clear columns have the label 0."""
    far = cloudy.size
    index = np.arange(far).reshape(cloudy.shape)
    labels = np.where(cloudy, index, far)
    while True:
        smallest = labels
        for axis in (0, 1):
            for step in (-1, 1):
                smallest = np.minimum(smallest, np.roll(labels, step, axis))
        smallest = np.where(cloudy, smallest, far)
        # A label is itself the index of a column, whose label may be smaller still.
        smallest = np.append(smallest.ravel(), far)[smallest]
        if np.array_equal(smallest, labels):
            return np.where(cloudy, labels + 1, 0)
        labels = smallest


def extent_of(snapshot: Snapshot, label: int) -> Extent:
    """The extent of a cloud, which may cross the periodic sides."""
    own = snapshot.labels == label
    first_y, rows = _span(own.any(1))
    first_x, cols = _span(own.any(0))
    levels = np.flatnonzero((snapshot.water[:, own] > THINNEST).any(1))
    middle_y, middle_x = first_y + 0.5 * (rows - 1), first_x + 0.5 * (cols - 1)
    return Extent(middle_y, middle_x, int(levels[0]), int(levels[-1]), max(rows, cols))


def _span(line: np.ndarray) -> tuple[int, int]:
    """Start and length of the shortest periodic interval that contains all true elements."""
    at = np.flatnonzero(line)
    gaps = np.diff(np.append(at, at[0] + len(line)))
    widest = int(gaps.argmax())
    return int(at[(widest + 1) % len(at)]), len(line) - int(gaps[widest]) + 1


def placed(snapshot: Snapshot, label: int, isolated: bool, placement: Placement) -> np.ndarray:
    """Liquid water content (g/m3) on the grid of a scene, float32 ``[z, y, x]``.

    The field is interpolated linearly and averaged over the voxels of the scene. With
    ``isolated``, other clouds are removed.
    """
    extent = extent_of(snapshot, label)
    water = snapshot.water
    if isolated:
        water = water * (snapshot.labels == label)
    at = np.arange(SIZE) + 0.5
    vertical = placement.factor / placement.stretch
    heights = extent.first - 0.5 + (at - placement.base) * vertical
    matrix = _averaging(heights, vertical, water.shape[0], periodic=False)
    levels = (matrix @ water.reshape(len(water), -1)).reshape(SIZE, *water.shape[1:])
    # Leaning does not displace the middle of the cloud.
    middle = placement.base + 0.5 * (extent.last + 1 - extent.first) / vertical
    horizontal = placement.factor * placement.zoom
    along = []
    for centre, lean, aside, count in zip(
        (extent.centre_y, extent.centre_x), placement.lean, placement.aside, water.shape[1:]
    ):
        offset = at - 0.5 * SIZE + lean * (at - middle)[:, None]
        along.append(_averaging(centre + aside + offset * horizontal, horizontal, count, True))
    result = along[0] @ levels @ along[1].transpose(0, 2, 1)
    return np.where(result > THINNEST, result, 0.0).astype(np.float32)


def _averaging(positions: np.ndarray, width: float, count: int, periodic: bool) -> np.ndarray:
    """Matrices ``[..., position, count]`` of the linear interpolation between ``count`` values,
    averaged over intervals of ``width`` around each position. Beyond the ends, the values are
    zero, or those of the other side."""
    parts = max(1, int(np.ceil(width)))
    matrix = np.zeros((*positions.shape, count), np.float32)
    lines = matrix.reshape(-1, count)
    rows = np.arange(len(lines))
    for part in range(parts):
        point = positions.ravel() + ((part + 0.5) / parts - 0.5) * width
        whole = np.floor(point).astype(int)
        share = point - whole
        for index, weight in ((whole, 1.0 - share), (whole + 1, share)):
            inside = np.ones(len(index), bool) if periodic else (index >= 0) & (index < count)
            lines[rows[inside], index[inside] % count] += weight[inside] / parts
    return matrix
