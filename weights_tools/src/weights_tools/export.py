"""Conversion of PyTorch checkpoints to the weights files of ``deepct`` and to ONNX."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import safetensors.torch
from torch import Tensor

import weights_tools
from weights_tools.checkpoint import load_checkpoint, state_dict_of, write_whole
from weights_tools.errors import InputError
from weights_tools.files import read_file
from weights_tools.lift import lift_of
from weights_tools.model import Network, channels_of, network_from_state
from weights_tools.unbiased import BIASED_SCORES, unbiased_scale

FORMAT_VERSION = 5
"""Version of the metadata in a weights file."""

_KINDS = {
    "configuration": "any",
    "effective_radius_scale": "number",
    "formation": "text",
    "horizontal_spacing_km": "list",
    "image_layout": "any",
    "input_scale": "number",
    "levels.bottom_km": "number",
    "levels.count": "whole number",
    "levels.spacing_km": "number",
    "output_scale": "number",
    "outputs": "list",
    "scores": "object",
    "target_altitude_km": "number",
    "training.data": "text",
    "training.identity": "text",
    "training.samples": "whole number",
    "training.seed": "whole number",
    "view_geometry.camera_distance_km": "list",
    "view_geometry.pixel_km": "list",
    "view_geometry.sun_azimuth_deg": "number",
    "view_geometry.sun_zenith_deg": "number",
    "view_geometry.view_azimuth_deg": "list",
    "view_geometry.view_zenith_deg": "list",
    "wavelength_um": "number or list",
}
"""The metadata of a weights file and what they are."""

_TYPES = {
    "list": (list,),
    "number": (int, float),
    "number or list": (int, float, list),
    "object": (dict,),
    "text": (str,),
    "whole number": (int,),
}
"""The types of the values of each kind; any of them for others."""

_OPTIONAL = ("view_geometry.camera_distance_km", "effective_radius_scale")
"""Metadata that may be missing: the cameras are then at an unknown distance, and the effective
radius is no output."""

METADATA_KEYS = tuple(
    dict.fromkeys(name.partition(".")[0] for name in _KINDS if name not in _OPTIONAL)
)
"""The metadata that every weights file requires in addition to the layers."""

DERIVED = ("architecture", "format_version", "layers", "parameters", "program", "receptive_field")
"""What ``deepct weights inspect --json`` also prints, and what follows from the network."""

BATCH_NORM_EPSILON = 1e-5
"""Number added to the variances of a batch normalisation unless the configuration in the metadata
has another ``batch_norm_epsilon``."""

GET_ONNX = "install it with `pip install 'weights_tools[onnx]'`"
"""Remedy if a package for ONNX is missing."""

_PAD_ZEROS = "weights files can only be of networks that pad with zeros: train such a network"


def load_network(
    path: str | Path, changes: dict[str, Any] | None = None
) -> tuple[Network, dict[str, Any]]:
    """The network of a checkpoint or state dict, and its metadata.

    Entries of ``changes`` replace those of the checkpoint; objects are merged key by key. A state
    dict contains neither the epsilon of the batch normalisation nor the kind of the padding. They
    are ``batch_norm_epsilon`` (:data:`BATCH_NORM_EPSILON`) and ``padding_mode`` (``zeros``) of the
    configuration in the metadata.

    Raises :class:`InputError` if the file does not contain a network, if the input channels of
    the network do not match the planes given in the metadata, and for other padding than by zeros.
    """
    checkpoint = load_checkpoint(path)
    metadata = merge(checkpoint.get("metadata", {}), changes or {})
    state = state_dict_of(checkpoint, path)
    try:
        lift = lift_of(metadata) if "image_layout" in metadata else None
    except (KeyError, TypeError, ValueError) as problem:
        remedy = "give the view_geometry and the planes of the images with --metadata"
        raise InputError(path, f"its metadata of planes are wrong ({problem!r})", remedy) from None
    try:
        network = network_from_state(state, lift)
    except ValueError as problem:
        remedy = (
            "every layer, the last one too, must be a Conv2d of 3 x 3 pixels with a bias "
            "(net.body.{i}.body.0), a BatchNorm2d (net.body.{i}.body.1) and a ReLU, in float32"
        )
        raise InputError(path, str(problem), remedy) from None
    _configure(network, metadata.get("configuration"), path)
    return network, metadata


def _configure(network: Network, configuration: Any, path: str | Path) -> None:
    """Set the epsilon of the batch normalisation."""
    # The configuration may be any JSON.
    known = configuration if isinstance(configuration, dict) else {}
    padding = known.get("padding_mode", "zeros")
    if padding != "zeros":
        raise InputError(path, f"its padding_mode is {padding!r}", _PAD_ZEROS)
    epsilon = known.get("batch_norm_epsilon", BATCH_NORM_EPSILON)
    if type(epsilon) not in (int, float) or not 0.0 < epsilon < float("inf"):
        raise InputError(path, f"its batch_norm_epsilon is {epsilon!r}", "give a positive number")
    for block in network.net.body:
        block.body[1].eps = float(epsilon)


def read_metadata(path: str | Path) -> dict[str, Any]:
    """Read metadata from a JSON file, for a checkpoint that contains none.

    What ``deepct weights inspect --json`` prints of other weights is such a file; its
    :data:`DERIVED` values are left out.
    """
    content = read_file(path, "give a JSON file of metadata")
    try:
        metadata = json.loads(content.decode("utf-8"))
    except ValueError as problem:
        raise InputError(path, f"is not JSON ({problem})", "correct it") from None
    if not isinstance(metadata, dict):
        raise InputError(path, "is not a JSON object", f"give {', '.join(METADATA_KEYS)}")
    return {key: value for key, value in metadata.items() if key not in DERIVED}


def metadata_like(name: str, path: str | Path) -> dict[str, Any]:
    """Metadata of a state dict for the situation (views, Sun, levels) of built-in weights.

    Whether the network takes camera images or images on planes, and whether it has the uncertainty
    as an output, follow from its numbers of channels. Radiances (1/sr) and extinctions (1/km) are
    taken to be its input and output as they are.

    Raises :class:`InputError` if there are no such weights, or if the channels do not fit.
    """
    try:
        import deepct_py
    except ImportError:
        raise InputError("--like", "needs deepct_py", "install it, or give --metadata") from None
    remedy = "give the weights of one formation, such as cloudct-10"
    try:
        known = deepct_py.Network.load(name).metadata
    except (OSError, ValueError) as problem:
        raise InputError("--like", str(problem), remedy) from None
    if "view_geometry" not in known:
        raise InputError("--like", f"{name} is for any formation", remedy)
    try:
        channels = channels_of(state_dict_of(load_checkpoint(path), path))
    except ValueError as problem:
        raise InputError(path, str(problem), "give the state dict of such a network") from None
    layout = known["image_layout"]
    views, levels = len(known["view_geometry"]["view_zenith_deg"]), known["levels"]["count"]
    layouts = {views: "camera"}
    if layout != "camera":
        layouts[views * len(layout["planes"]["altitudes_km"])] = layout
    outputs = {levels: ["extinction"], 2 * levels: ["extinction", "uncertainty"]}
    for which, count, fitting in (
        ("first layer takes", channels[0], layouts),
        ("last layer gives", channels[-1], outputs),
    ):
        if count not in fitting:
            expected = " or ".join(map(str, fitting))
            problem = f"its {which} {count} channels, but {name} has {expected}"
            raise InputError(path, problem, "give other weights as --like, or --metadata")
    situation = ("formation", "view_geometry", "target_altitude_km", "wavelength_um",
                 "horizontal_spacing_km", "levels")
    return {
        **{key: known[key] for key in situation},
        "image_layout": layouts[channels[0]],
        "outputs": outputs[channels[-1]],
        "input_scale": 1.0,
        "output_scale": 1.0,
        "configuration": {},
        "scores": {},
        "training": {"data": "not stated", "identity": "not stated", "samples": 0, "seed": 0},
    }


def export(
    checkpoint_path: str | Path,
    output: str | Path,
    changes: dict[str, Any],
    unbiased: float = 0.0,
) -> list[str]:
    """Write the weights of a checkpoint with folded batch normalisation: as an ONNX graph of the
    complete network if ``output`` ends in ``.onnx``, otherwise as safetensors.

    Entries of ``changes`` replace the metadata of the checkpoint (objects are merged key by key).
    Bare state dicts and the checkpoints of the paper's authors have no metadata; for these,
    ``changes`` must contain all :data:`METADATA_KEYS`.

    ``unbiased`` is the share (0 to 1) of the mean delta of the validation clouds that is removed
    by a larger scale of the output. Training with squared errors makes a network underestimate the
    extinction where the images do not determine it. The scores of the original scale remain in the
    file under the names ``{name}_biased``, as those of the new scale have not been measured.

    Returns lines that state what was assumed and what the scores in the file are.

    Raises :class:`InputError` for a checkpoint that cannot be used and for metadata that
    are missing or unknown.
    """
    network, metadata = load_network(checkpoint_path, changes)
    _check_metadata(metadata, checkpoint_path)
    _check_outputs(network, metadata, checkpoint_path)
    epsilon = network.net.body[0].body[1].eps
    lines = [f"assumed: padding with zeros, batch normalisation with epsilon {epsilon:g}"]
    if unbiased:
        scale, scores = unbiased_scale(
            metadata["output_scale"], metadata["scores"], unbiased, checkpoint_path
        )
        metadata = {**metadata, "output_scale": scale, "scores": scores}
        lines.append(BIASED_SCORES)
    header = {
        "format_version": FORMAT_VERSION,
        "architecture": {"channels": network.channels, "last_relu": True},
        "program": f"weights_tools {weights_tools.__version__}",
        **metadata,
    }
    write = _onnx if is_onnx(output) else _safetensors
    write_whole(Path(output), write(network, header))
    return lines


def _check_metadata(metadata: dict[str, Any], path: str | Path) -> None:
    """Refuse metadata of which some are missing, unknown or of another kind."""
    groups = {name.partition(".")[0] for name in _KINDS if "." in name}
    values: dict[str, Any] = {}
    for key, value in metadata.items():
        if key not in groups:
            values[key] = value
        elif isinstance(value, dict):
            values.update({f"{key}.{name}": part for name, part in value.items()})
        else:
            raise InputError(path, f"its {key} is {value!r}", "give an object with --metadata")
    missing = [
        name if name.partition(".")[0] in metadata else name.partition(".")[0]
        for name in _KINDS
        if name not in values and name not in _OPTIONAL
    ]
    if missing:
        problem = f"has no metadata {', '.join(dict.fromkeys(missing))}"
        raise InputError(path, problem, "give them in a JSON file with --metadata")
    unknown = sorted(set(values) - set(_KINDS))
    if unknown:
        problem = f"unknown metadata {', '.join(unknown)}"
        raise InputError(path, problem, f"the keys are {', '.join(_KINDS)}")
    for name, kind in _KINDS.items():
        types = _TYPES.get(kind)
        if types and name in values and type(values[name]) not in types:
            problem = f"its {name} is {values[name]!r}"
            raise InputError(path, problem, f"give --metadata in which it is of kind {kind}")


def _check_outputs(network: Network, metadata: dict[str, Any], path: str | Path) -> None:
    remedy = "correct the levels or the outputs with --metadata"
    try:
        channels = len(metadata["outputs"]) * metadata["levels"]["count"]
    except (KeyError, TypeError):
        raise InputError(path, "its metadata lack outputs or levels.count", remedy) from None
    if network.channels[-1] != channels:
        problem = f"its last layer gives {network.channels[-1]} channels, its metadata {channels}"
        raise InputError(path, problem, remedy)


def is_onnx(path: str | Path) -> bool:
    """Whether the name of a weights file is that of an ONNX graph."""
    return Path(path).suffix.lower() == ".onnx"


def _safetensors(network: Network, header: dict[str, Any]) -> bytes:
    text = json.dumps(header, sort_keys=True, allow_nan=False)
    return safetensors.torch.save(folded_layers(network), {"deepct": text})


def _onnx(network: Network, header: dict[str, Any]) -> bytes:
    model = onnx_graph().onnx_model(folded_layers(network), network.lift, header)
    return model.SerializeToString()


def onnx_graph() -> ModuleType:
    """The module for ONNX, imported on demand as its package is optional."""
    try:
        return importlib.import_module("weights_tools.graph")
    except ImportError as problem:
        raise InputError("onnx", f"cannot be imported ({problem})", GET_ONNX) from None


def folded_layers(network: Network) -> dict[str, Tensor]:
    """``layers.{i}.weight`` and ``.bias`` of convolutions that include the batch normalisation.

    They are computed in float64 and rounded once: ``w' = w g / s``,
    ``b' = (b - mean) g / s + beta`` with ``s = sqrt(variance + epsilon)``.

    Raises :class:`InputError` for a network with other padding than by zeros.
    """
    layers: dict[str, Tensor] = {}
    for index, block in enumerate(network.net.body):
        convolution, norm = block.body[0], block.body[1]
        if convolution.padding_mode != "zeros":
            problem = f"its padding_mode is {convolution.padding_mode!r}"
            raise InputError(f"net.body.{index}.body.0", problem, _PAD_ZEROS)
        factor = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
        weight = convolution.weight.double() * factor[:, None, None, None]
        bias = (convolution.bias.double() - norm.running_mean.double()) * factor
        layers[f"layers.{index}.weight"] = weight.detach().float().contiguous()
        layers[f"layers.{index}.bias"] = (bias + norm.bias.double()).detach().float()
    return layers


def merge(metadata: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Metadata in which ``changes`` replace entries; objects are merged key by key."""
    merged = dict(metadata)
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            value = merge(merged[key], value)
        merged[key] = value
    return merged
