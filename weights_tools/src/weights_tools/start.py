"""Parameters with which a training starts, from the weights file of a smaller network.

The network may have further bands, and the effective radius as a further output. The kernels of the
further bands are zero at first, so that the network begins with the estimates of the smaller one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from weights_tools.checkpoint import load_checkpoint
from weights_tools.errors import InputError
from weights_tools.files import weights_header
from weights_tools.lift import wavelengths_of
from weights_tools.model import Network

_SAME = ("view_geometry", "target_altitude_km", "image_layout", "horizontal_spacing_km", "levels")
"""Metadata that both networks must have in common."""

_RADIUS_FACTOR = 0.25
"""First factor of the batch normalisation of the scaled effective radius: about its variation."""


def load_start(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The layers and the metadata of a weights file of one formation.

    Raises :class:`InputError` for any other file.
    """
    remedy = "give a weights file of one formation, or a checkpoint of a training"
    layers = load_checkpoint(path)
    header = weights_header(path.read_bytes(), path, remedy)
    if not all(key in header for key in _SAME) or "layers.0.weight" not in layers:
        raise InputError(path, "is not a weights file of one formation", remedy)
    return layers, header


def start(
    network: Network,
    path: Path,
    metadata: dict[str, Any],
    images: Tensor,
    volumes: Tensor,
) -> dict[str, Any]:
    """Set the parameters of a network from the weights file ``path`` of a smaller one, whose batch
    normalisation is folded. ``metadata`` are those of the network; its new batch normalisations
    have the statistics of ``images``, typical inputs of the first layer. If the effective radius is
    a new output, it begins at the mean of that in the scaled ``volumes``.

    Returns the training metadata of the file. Raises :class:`InputError` if the networks differ in
    more than the bands after the first ones and the effective radius.
    """
    layers, header = load_start(path)
    bands = wavelengths_of(metadata)
    before, outputs = wavelengths_of(header), header.get("outputs", ["extinction"])
    remedy = "start from weights of a network like that of the recipe, perhaps with fewer bands"
    differing = [key for key in _SAME if not _is_near(header[key], metadata[key])]
    if not _is_near(before, bands[: len(before)]):
        differing.append("wavelength_um")
    if metadata["outputs"] not in (outputs, [*outputs, "effective_radius"]):
        differing.append("outputs")
    if header["architecture"]["channels"][1:-1] != network.channels[1:-1]:
        differing.append("architecture")
    if differing:
        raise InputError(path, f"has another {differing[0]}", remedy)
    views = len(header["view_geometry"]["view_zenith_deg"])
    last = len(network.net.body) - 1
    network.eval()
    with torch.no_grad():
        for index, block in enumerate(network.net.body):
            convolution, norm = block.body[0], block.body[1]
            weight = layers[f"layers.{index}.weight"].clone()
            bias = layers[f"layers.{index}.bias"].clone()
            known = len(weight)
            # The scales of the recipe may be others.
            if index == last:
                scale = header["output_scale"] / metadata["output_scale"]
                weight, bias = scale * weight, scale * bias
            if index == 0:
                weight *= header["input_scale"] / metadata["input_scale"]
                # The channels of a plane are the views of each band.
                kernels = convolution.weight[:known].unflatten(1, (-1, len(bands), views))
                kernels.zero_()
                kernels[:, :, : len(before)] = weight.unflatten(1, (-1, len(before), views))
            else:
                convolution.weight[:known] = weight
            convolution.bias.zero_()
            convolution.bias[:known] = bias
            # The normalisation of typical data changes nothing.
            found = convolution(images)
            mean, variance = found.mean((0, 2, 3)), found.var((0, 2, 3))
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance)
            norm.weight.copy_((variance + norm.eps).sqrt())
            norm.bias.copy_(mean)
            if known < len(mean):
                extinction, product = volumes.sum((0, 2, 3, 4))
                norm.weight[known:] = _RADIUS_FACTOR
                norm.bias[known:] = product / extinction
            images = block(images)
    network.train()
    return header["training"]


def _is_near(one: Any, other: Any) -> bool:
    """Whether metadata are the same except for rounding errors."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_is_near(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_is_near, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= 1e-6 * max(abs(one), 1.0)
    return one == other
