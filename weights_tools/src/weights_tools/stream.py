"""The pool of rendered scenes, which grows beside the training, and the batches drawn from it.

Generator processes write files of scenes (*chunks*) into a folder; the training reads them as they
appear. A chunk contains the scenes ``number * size`` to ``(number + 1) * size - 1`` of its split.
An interrupted generator continues with the next number.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Callable

import numpy as np
import torch
from torch import Tensor

from weights_tools.files import regular_file
from weights_tools.general_recipe import GeneralRecipe
from weights_tools.planes import on_planes
from weights_tools.renderers import Renderer
from weights_tools.scenes import CLOUDCT_10, PEARLS_32_DEG, VOXEL_KM, Scene, SceneGenerator
from weights_tools.surface import above_surface
from weights_tools.views import Views

IMAGE_SCALE = 100.0
"""Factor of the radiance in the pool, for which float16 has the smallest relative error."""

_PEARLS = len(PEARLS_32_DEG)
_NAMES = ("extinction", "images", "sun", "towards", "distance", "pixel", "paper")

VIEW_COUNTS = (3, 4, 5, 6, 8, 10, 12, 16, 20, 28, 40)
"""Numbers of views of a batch; one number per batch, so that no place is unused."""
FREQUENT_COUNTS = (5, 6, 8, 10, 12)
"""Numbers of views of further batches."""
FREQUENT = 0.4
"""Fraction of the batches of arbitrary formations with these numbers."""
TEN_VIEWS, ALL_PEARLS = 0.30, 0.10
"""Fractions of the batches with the formations ``cloudct-10`` and ``pearls-32``."""
PART_OF_TRACK, SCATTERED = 0.35, 0.35
"""Fractions of the other view selections along the track and among the random directions."""
UNTURNED = 0.5
"""Fraction of the scenes in the light of the paper to which no symmetry is applied."""
CROP_SHIFT = 4.0
"""Largest distance of the centre of a crop from that of the cloud (voxels)."""


@dataclass(frozen=True)
class Batch:
    """Input and truth of one step."""

    planes: Tensor
    """Scaled images on planes, ``[n, v, plane, y, x]``."""
    views: Views
    truth: Tensor
    """Scaled extinction, ``[n, z, y, x]``."""


def chunk_path(folder: Path, split: str, number: int) -> Path:
    """The file of a chunk in the folder of a pool."""
    return folder / split / f"{number:06}.npz"


def chunk_numbers(folder: Path, split: str) -> list[int]:
    """The numbers of the chunks of a split, in ascending order."""
    return sorted(int(path.stem) for path in (folder / split).glob("[0-9]*.npz"))


def write_chunk(path: Path, scenes: list[Scene], images: np.ndarray) -> None:
    """Write scenes and their images ``[n, v, row, col]`` (1/sr), atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    arrays = {
        "extinction": np.stack([scene.extinction for scene in scenes]).astype(np.float16),
        "images": (IMAGE_SCALE * images).astype(np.float16),
        "paper": np.array([scene.paper for scene in scenes]),
    }
    for name, attribute in (
        ("sun", "sun"),
        ("towards", "towards"),
        ("distance", "distance_km"),
        ("pixel", "pixel_km"),
    ):
        values = np.stack([getattr(scene, attribute) for scene in scenes])
        arrays[name] = values.astype(np.float32)
    try:
        with open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def validation_chunks(recipe: GeneralRecipe) -> int:
    """The number of chunks of the validation scenes."""
    return -(-recipe.scenes.validation // recipe.stream.chunk)


def generate(
    recipe: GeneralRecipe,
    simulations: Path,
    folder: Path,
    renderer: Renderer,
    part: tuple[int, int] = (0, 1),
) -> Iterator[str]:
    """Write chunks into the folder of a pool without end; each step yields a line that reports it.

    ``part`` is the number of this generator and that of all generators of the pool. The first one
    writes the validation scenes before all others.
    """
    rank, count = part
    if rank == 0:
        missing = set(range(validation_chunks(recipe)))
        missing -= set(chunk_numbers(folder, "validation"))
        if missing:
            source = _generator(recipe, simulations, "validation")
            for number in sorted(missing):
                yield _write(recipe, source, folder, renderer, number)
    source = _generator(recipe, simulations, "train")
    written = [each for each in chunk_numbers(folder, "train") if each % count == rank]
    number = written[-1] + count if written else rank
    while True:
        yield _write(recipe, source, folder, renderer, number)
        number += count


def _generator(recipe: GeneralRecipe, simulations: Path, split: str) -> SceneGenerator:
    return SceneGenerator(recipe.scenes, recipe.split(split), simulations, split)


def _write(
    recipe: GeneralRecipe, source: SceneGenerator, folder: Path, renderer: Renderer, number: int
) -> str:
    start = time.monotonic()
    size = recipe.stream.chunk
    first, last = number * size, (number + 1) * size
    if source.split == "validation":
        last = min(last, recipe.scenes.validation)
    scenes = [source.scene(each) for each in range(first, last)]
    images = renderer.render(scenes)
    write_chunk(chunk_path(folder, source.split, number), scenes, images)
    spent = (time.monotonic() - start) / len(scenes)
    return f"{source.split} chunk {number}: {len(scenes)} scenes, {spent:.2f} s each"


class Pool:
    """The scenes of one split in memory, on a device. The oldest are replaced if it is full."""

    def __init__(self, folder: Path, split: str, capacity: int, device: torch.device) -> None:
        """``capacity`` is the number of chunks that are held."""
        self.folder, self.split, self.capacity, self.device = folder, split, capacity, device
        self._chunks: dict[int, int] = {}
        self._size = 0
        self._values: dict[str, Tensor] = {}
        self._counts: list[int] = []
        self.rendered = 0
        """Number of scenes that have been read so far."""

    def __len__(self) -> int:
        """The number of scenes."""
        return sum(self._counts)

    @property
    def numbers(self) -> list[int]:
        """The numbers of the chunks that are held."""
        return list(self._chunks)

    def update(self) -> int:
        """Read new chunks; returns their number. A file that is damaged is deleted."""
        new = [each for each in chunk_numbers(self.folder, self.split) if each not in self._chunks]
        for number in new[-self.capacity :]:
            path = chunk_path(self.folder, self.split, number)
            try:
                with np.load(regular_file(path, "make the scenes again")) as file:
                    arrays = {name: torch.from_numpy(file[name]) for name in _NAMES}
            except (OSError, ValueError, KeyError):
                path.unlink(missing_ok=True)
                continue
            self._store(number, arrays)
        if new:
            self._index()
        return len(new)

    def _store(self, number: int, arrays: dict[str, Tensor]) -> None:
        count = len(arrays["paper"])
        if not self._values:
            self._size = count
            for name, values in arrays.items():
                shape = (self.capacity * count, *values.shape[1:])
                self._values[name] = torch.zeros(shape, dtype=values.dtype, device=self.device)
        if len(self._chunks) < self.capacity:
            place = len(self._chunks)
            self._counts.append(0)
        else:
            oldest = min(self._chunks)
            place = self._chunks.pop(oldest)
            chunk_path(self.folder, self.split, oldest).unlink(missing_ok=True)
        self._chunks[number] = place
        self._counts[place] = count
        for name, values in arrays.items():
            start = place * self._size
            self._values[name][start : start + count] = values.to(self.device)
        self.rendered += count

    def _index(self) -> None:
        places = [
            torch.arange(place * self._size, place * self._size + count)
            for place, count in enumerate(self._counts)
        ]
        self.all = torch.cat(places).to(self.device)
        """The indices of all scenes."""
        paper = self._values["paper"][self.all]
        self.paper = self.all[paper]
        """The indices of the scenes in the light of the paper."""

    def take(self, index: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor, Views, Tensor]:
        """Extinction (1/km) ``[n, z, y, x]``, radiance (1/sr) ``[n, v, row, col]``, views, and
        whether the light is that of the paper ``[n]``, for the scenes ``index`` ``[n]`` and their
        views ``chosen`` ``[n, v]``."""
        values = self._values
        images = values["images"][index[:, None], chosen].float() / IMAGE_SCALE
        towards = values["towards"][index[:, None], chosen]
        distance, pixel = (
            values[name][index[:, None], chosen] / VOXEL_KM for name in ("distance", "pixel")
        )
        views = Views(values["sun"][index], towards, distance, pixel, torch.ones_like(pixel))
        return values["extinction"][index].float(), images, views, values["paper"][index]


class Batches:
    """Draws batches for training: new views, noise, pointing errors and symmetries for each use."""

    def __init__(self, recipe: GeneralRecipe, pool: Pool, cropping: bool, seed: int) -> None:
        self.recipe, self.pool, self.cropping = recipe, pool, cropping
        self.device = pool.device
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self._random = np.random.default_rng(seed)
        self._heights = recipe.network.heights.to(self.device, torch.float32)
        self._ten, self._pearls = (
            torch.tensor(views, device=self.device) for views in (CLOUDCT_10, range(_PEARLS))
        )
        self.drawn = 0
        """Number of scenes that have been drawn."""

    def draw(self) -> Batch:
        """The next batch; the pool must not be empty."""
        index, chosen = self._select()
        self.drawn += len(index)
        extinction, radiance, views, paper = self.pool.take(index, chosen)
        images = self.recipe.sensor.sense(radiance, self.generator, normal=True)
        errors = self._normal(*chosen.shape, 2) * self.recipe.stream.pointing_pixels
        size, corner = self._crop(extinction)
        scaling = self.recipe.scaling
        scaled = above_surface(images, views, scaling.surface_albedo) * scaling.input_scale
        planes = on_planes(scaled, views, self._heights, (size, size), corner, errors)
        truth = cropped(extinction, size, corner) / self.recipe.scaling.output_scale
        turns = self._uniform(len(index), 3) < 0.5
        turns &= ~(paper & (self._uniform(len(index)) < UNTURNED))[:, None]
        return Batch(mirrored(planes, turns), views.mirrored(*turns.T), mirrored(truth, turns))

    def _select(self) -> tuple[Tensor, Tensor]:
        """The scenes of a batch and their views."""
        settings, random = self.recipe.training, self._random
        kind = random.random()
        scenes, views = self.pool.all, None
        if len(self.pool.paper) and kind < TEN_VIEWS + ALL_PEARLS:
            scenes = self.pool.paper
            views = self._ten if kind < TEN_VIEWS else self._pearls
            count = len(views)
        else:
            counts = FREQUENT_COUNTS if random.random() < FREQUENT else VIEW_COUNTS
            count = int(random.choice(counts))
        size = max(2, min(settings.batch, settings.views_per_batch // count))
        index = scenes[self._integers(len(scenes), size)]
        chosen = self._any_views(size, count) if views is None else views.expand(size, -1)
        return index, chosen

    def _any_views(self, size: int, count: int) -> Tensor:
        """The indices of ``count`` different views of each of ``size`` scenes."""
        others = self.recipe.scenes.random_views
        kind, even, step, first = self._uniform(4, size, 1)
        part = (kind < PART_OF_TRACK) & (count <= _PEARLS)
        scattered = ~part & (kind < PART_OF_TRACK + SCATTERED) & (count <= others)
        # The views with the smallest random keys; those of the other kind have larger keys.
        keys = self._uniform(size, _PEARLS + others)
        keys[:, _PEARLS:] += 1.0 * part
        keys[:, :_PEARLS] += 1.0 * scattered
        chosen = keys.argsort(1)[:, :count]
        # Equidistant satellites.
        longest = max((_PEARLS - 1) // (count - 1), 1)
        step = (step * longest).long() + 1
        first = (first * (_PEARLS - step * (count - 1)).clamp_min(1)).long()
        equidistant = first + step * torch.arange(count, device=self.device)
        return torch.where(part & (even < 0.5), equidistant, chosen)

    def _crop(self, extinction: Tensor) -> tuple[int, Tensor | None]:
        """The size of the crops and their corners ``[n, (y, x)]`` near the clouds."""
        settings, whole = self.recipe.training, extinction.shape[-1]
        size = settings.crop
        if not self.cropping or not 0 < size < whole or self._random.random() >= settings.cropped:
            return whole, None
        columns = extinction.sum(1)
        places = torch.arange(whole).to(columns)
        total = columns.sum((1, 2)).clamp_min(1e-6)
        centres = torch.stack([columns.sum(2) @ places / total, columns.sum(1) @ places / total], 1)
        aside = CROP_SHIFT * (2.0 * self._uniform(*centres.shape) - 1.0)
        corner = (centres + aside + 0.5 - 0.5 * size).round()
        return size, corner.clamp(0, whole - size).long()

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self.generator, device=self.device)

    def _normal(self, *shape: int) -> Tensor:
        return torch.randn(shape, generator=self.generator, device=self.device)

    def _integers(self, limit: int, count: int) -> Tensor:
        return torch.randint(limit, (count,), generator=self.generator, device=self.device)


def cropped(volume: Tensor, size: int, corner: Tensor | None) -> Tensor:
    """Parts ``[n, z, size, size]`` of volumes, at the corners ``[n, (y, x)]``."""
    if corner is None:
        return volume
    lines = torch.arange(size, device=volume.device)
    scene = torch.arange(len(volume), device=volume.device)[:, None, None, None]
    level = torch.arange(volume.shape[1], device=volume.device)[None, :, None, None]
    row = (corner[:, :1] + lines)[:, None, :, None]
    col = (corner[:, 1:] + lines)[:, None, None, :]
    return volume[scene, level, row, col]


def mirrored(values: Tensor, turns: Tensor) -> Tensor:
    """Apply the symmetries of the ground to ``[n, ..., y, x]``: with the columns of ``turns``
    ``[n, 3]``, x is reversed, y is reversed, and then x and y are exchanged, as in
    :meth:`weights_tools.views.Views.mirrored`."""
    shape = (-1, *[1] * (values.ndim - 1))
    east, north, swapped = (column.reshape(shape) for column in turns.T)
    values = torch.where(east, values.flip(-1), values)
    values = torch.where(north, values.flip(-2), values)
    return torch.where(swapped, values.transpose(-1, -2), values)


def wait_for(pool: Pool, scenes: int, alive: Callable[[], None], seconds: float = 1.0) -> None:
    """Read chunks until the pool has read at least ``scenes`` scenes; ``alive`` raises an error if
    a generator has ended."""
    while pool.rendered < scenes:
        if not pool.update():
            alive()
            time.sleep(seconds)
