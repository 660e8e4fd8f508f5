"""Calibration of a general network: the error that it expects against the error found, and the
statistics of images by which ``deepct`` recognises images unlike those of the training.

Both are determined by ``deepct_py`` with the validation scenes of a pool, which the training has
not used, in several formations.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from weights_tools.errors import InputError
from weights_tools.files import regular_file
from weights_tools.general_file import (
    GeneralWeights,
    read_general_weights,
    write_general_weights,
)
from weights_tools.scenes import CLOUDCT_10, LEVEL_KM, PEARLS_32_DEG, VOXEL_KM
from weights_tools.sensor import Sensor
from weights_tools.stream import IMAGE_SCALE, chunk_numbers, chunk_path

SIZE = 32
"""Voxels of a scene along each axis."""

BINS = 8
"""Number of pairs of the calibration, each for an equal number of images."""

USUAL = {"explained": 0.05, "explained_few": 0.05}
"""Share of the images below the typical range of a statistic, before the margin. A wrong geometry
reduces how well images are explained by little, so that more right images are named with it."""
OTHERS = 0.01
"""The same for all other statistics, and the share above the range."""
MARGINS = {"background": (0.5, 0.1), "brightest": (0.3, 0.1)}
"""Relative margins below and above: surfaces may be darker than nearly all of the training."""
MOST_EQUAL = 0.005
"""Share of equal pixels that is typical; images that are not quantised have none."""

_PEARLS = len(PEARLS_32_DEG)
FORMATIONS: tuple[tuple[bool, tuple[int, ...]], ...] = (
    (True, CLOUDCT_10),
    (True, tuple(range(_PEARLS))),
    *((False, tuple(range(_PEARLS, _PEARLS + count))) for count in (3, 5, 8, 16)),
    (False, tuple(range(0, _PEARLS, 5))),
)
"""Whether a formation is for scenes in the light of the paper only, and the indices of its views.
The last one has equidistant satellites on a track."""


@dataclass(frozen=True)
class Found:
    """Results for one scene in one formation."""

    expected: float
    """Expected absolute error over the estimate, as sums over the voxels."""
    found: float
    """Actual absolute error over the estimate."""
    statistics: dict[str, float]


def calibrate(
    path: str | Path, pool: Path, output: str | Path, report: Callable[[str], None]
) -> None:
    """Write the weights ``path`` with ``calibration`` and ``typical`` to ``output``.

    ``pool`` is the folder of the scenes of a training. Raises :class:`InputError` if the weights
    cannot be read or if there are no validation scenes.
    """
    weights = read_general_weights(path)
    bare = replace(weights.description, calibration=[], typical={})
    results = list(_results(replace(weights, description=bare), pool))
    if len(results) < 4 * BINS:
        remedy = "make more validation scenes with `weights_tools scenes`"
        raise InputError(pool, f"has validation scenes for {len(results)} images only", remedy)
    results.sort(key=lambda result: result.expected)
    pairs = []
    for part in np.array_split(np.array(results, dtype=object), BINS):
        means = (float(np.mean([getattr(each, name) for each in part])) for name in _PAIR)
        pairs.append(tuple(means))
        report(f"expected {pairs[-1][0]:.3f}, found {pairs[-1][1]:.3f}")
    typical = {}
    for name in sorted({name for result in results for name in result.statistics}):
        values = [each.statistics[name] for each in results if name in each.statistics]
        low, high = np.quantile(values, [USUAL.get(name, OTHERS), 1.0 - OTHERS])
        below, above = MARGINS.get(name, (0.0, 0.0))
        typical[name] = (float((1.0 - below) * low), float((1.0 + above) * high))
        if name == "equal":
            typical[name] = (0.0, max(MOST_EQUAL, float(high)))
        if name in USUAL:
            typical[name] = (float(low), 1.0)
        report(f"{name}: {typical[name][0]:.4f} to {typical[name][1]:.4f}")
    described = replace(bare, calibration=pairs, typical=typical)
    write_general_weights(output, replace(weights, description=described))


_PAIR = ("expected", "found")


def _results(weights: GeneralWeights, pool: Path) -> Iterator[Found]:
    # On demand, as a machine for training may not have the module.
    import deepct_py as deepct

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "weights.safetensors")
        write_general_weights(path, weights)
        network = deepct.Network.load(path, force=True)
    target = (0.0, 0.0, 1.0)
    spacing = (VOXEL_KM, VOXEL_KM, LEVEL_KM)
    corner = tuple(at - 0.5 * SIZE * step for at, step in zip(target, spacing))
    grid = deepct.Grid((SIZE, SIZE, SIZE), spacing, corner)
    sensor, generator = Sensor(), torch.Generator().manual_seed(1)
    for scene in _scenes(pool):
        for paper, chosen in FORMATIONS:
            if paper and not scene["paper"]:
                continue
            selected = list(chosen)
            clean = torch.from_numpy(scene["images"][selected].astype(np.float32) / IMAGE_SCALE)
            images = sensor.sense(clean[None], generator)[0].numpy()
            cameras = [
                deepct.View.perspective(
                    tuple(np.array(target) + scene["distance"][view] * scene["towards"][view]),
                    target,
                    float(scene["pixel"][view] / scene["distance"][view]),
                    images.shape[1:],
                )
                for view in selected
            ]
            light = deepct.Light(**_sun(scene["sun"]))
            answer = network.estimate(images, cameras, light, grid=grid)
            estimate, uncertainty = answer.extinction, answer.uncertainty
            total = float(estimate.sum())
            if total <= 0.0:
                continue
            error = float(np.abs(estimate - scene["extinction"].astype(np.float32)).sum())
            statistics = network.image_statistics(images, cameras, light, grid=grid)
            yield Found(float(uncertainty.sum()) / total, error / total, statistics)


def _scenes(pool: Path) -> Iterator[dict[str, Any]]:
    for number in chunk_numbers(pool, "validation"):
        path = regular_file(chunk_path(pool, "validation", number), "make the scenes again")
        with np.load(path) as file:
            chunk = {name: file[name] for name in file.files}
        for scene in range(len(chunk["paper"])):
            yield {name: values[scene] for name, values in chunk.items()}


def _sun(direction: np.ndarray) -> dict[str, float]:
    east, north, up = (float(part) for part in direction)
    zenith = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    return {
        "sun_zenith_deg": min(float(zenith), 89.0),
        "sun_azimuth_deg": float(np.degrees(np.arctan2(east, north)) % 360.0),
    }
