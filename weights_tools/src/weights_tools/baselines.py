"""Baseline estimates without a network, for comparison on the validation clouds."""

from __future__ import annotations

import tempfile
from pathlib import Path

import h5py
import numpy as np
import torch
from torch import Tensor

from weights_tools.dataset import Dataset
from weights_tools.program import run_program
from weights_tools.sensor import Sensor
from weights_tools.training import scores, validation_images

CONSTANTS = torch.cat([torch.zeros(1), torch.logspace(-1.0, 2.0, 121)]).double()
"""Constant extinctions (1/km) of the carved mask from which the best one is selected."""


def baselines(
    data: Dataset, seed: int, sensor: Sensor, deepct: str
) -> dict[str, tuple[float, float]]:
    """Mean epsilon and delta of each baseline: zero, the mean training cloud, the carved mask.

    ``deepct carve`` derives the mask from the same noisy images on which a training with this
    seed is scored. The mask is filled with the constant extinction that has the smallest epsilon
    for these clouds (0 if most of the mask is clear) and with the one whose mean delta is 0.

    Raises :class:`InputError` if ``deepct`` fails.
    """
    truth = data.validation.extinction
    masks = carved_masks(data, validation_images(data, sensor, seed), deepct)
    epsilon = [scores(float(value) * masks, truth)[0] for value in CONSTANTS]
    best = float(CONSTANTS[int(np.argmin(epsilon))])
    _, excess = scores(masks, truth)
    right_mass = 1.0 / (1.0 - excess)
    return {
        "zero": scores(torch.zeros_like(truth), truth),
        "mean training cloud": scores(data.train.extinction.mean(0).expand_as(truth), truth),
        f"carved mask filled with {best:.3g} / km (best epsilon)": scores(best * masks, truth),
        f"carved mask filled with {right_mass:.3g} / km (delta 0)": scores(
            right_mass * masks, truth
        ),
    }


def carved_masks(data: Dataset, images: Tensor, deepct: str) -> Tensor:
    """The masks ``[n, z, y, x]`` (0 or 1) of ``deepct carve`` for the validation images."""
    masks = []
    with tempfile.TemporaryDirectory() as folder:
        noisy, carved = Path(folder, "images.nc"), Path(folder, "mask.nc")
        for path, radiance in zip(data.files("validation"), images):
            _copy_views(path, noisy, data.views, radiance.numpy())
            command = [deepct, "carve", str(noisy), "--grid", str(path), "--out", str(carved)]
            run_program(command, f" on {path}")
            with h5py.File(carved, "r") as file:
                masks.append(torch.from_numpy(file["mask"][...].astype(np.float32)))
    return torch.stack(masks)


def _copy_views(source: Path, target: Path, views: tuple[int, ...], radiance: np.ndarray) -> None:
    """Copy the images of a sample with other radiances and a subset of its views."""
    lengths = dict(zip(("view", "row", "col"), radiance.shape), component=3)
    with h5py.File(source, "r") as sample, h5py.File(target, "w") as file:
        for name, length in lengths.items():
            file[name] = np.arange(length)
            file[name].make_scale(name)
        for name, variable in sample.items():
            dimensions = [dimension.label or _scale(dimension) for dimension in variable.dims]
            if name in lengths or name == "radiance_standard_error" or "z" in dimensions:
                continue
            values = variable[...]
            if dimensions[:1] == ["view"]:
                values = radiance if name == "radiance" else values[list(views)]
            elif dimensions:
                continue
            file[name] = values
            for axis, dimension in enumerate(dimensions):
                file[name].dims[axis].attach_scale(file[dimension])


def _scale(dimension: h5py._hl.dims.DimensionProxy) -> str:
    return dimension[0].name.strip("/") if len(dimension) else ""
