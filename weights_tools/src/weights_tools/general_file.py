"""Weights files of the general network (format 4), from which ``deepct`` derives the layers of any
geometry, and which contain everything that a further training needs but the optimiser's state."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import weights_tools
from weights_tools.checkpoint import load_checkpoint, write_whole
from weights_tools.errors import InputError
from weights_tools.files import read_file, weights_header
from weights_tools.general import GeneralArchitecture, GeneralNetwork, with_extremes
from weights_tools.unbiased import BIASED_SCORES, unbiased_scale

FORMAT_VERSION = 4
"""Version of the metadata in a weights file of a general network."""

OUTPUTS = ["extinction", "uncertainty"]
"""The quantities that the network estimates, each with one channel for every level."""

RANGES = {
    "views": (3.0, 40.0),
    "view_zenith_deg": (0.0, 76.0),
    "sun_zenith_deg": (0.0, 70.0),
    "pixel_per_voxel": (0.1, 6.0),
    "voxel_km": (0.015, 0.15),
    "wavelength_um": (0.63, 0.71),
}
"""The ranges in which a network of this program can be used."""

_COUNTER = "num_batches_tracked"
"""The end of the names of values in a state dict that a weights file does not contain."""

_REMEDY = "give a weights file of `weights_tools export` for a general network"


@dataclass
class GeneralDescription:
    """The metadata of a general network, without its architecture."""

    voxel_km: float = 0.05
    """Horizontal size of a voxel (km) to which lengths are scaled."""
    wavelength_um: float = 0.672
    input_scale: float = 100.0
    """Network input = radiance (1/sr) x input_scale."""
    output_scale: float = 50.0
    """Extinction (1/km) = network output x output_scale, for voxels of ``voxel_km``."""
    surface_albedo: float | None = None
    """Albedo of the surface by whose radiance that of other surfaces is replaced; none: images are
    used as they are."""
    ranges: dict[str, tuple[float, float]] = field(default_factory=lambda: dict(RANGES))
    calibration: list[tuple[float, float]] = field(default_factory=list)
    """Pairs of the expected epsilon that the network states and the epsilon that was found, by
    which the uncertainty is corrected (piecewise linear); may be empty."""
    typical: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges of statistics of the images of the training; may be empty."""
    training: dict[str, Any] = field(default_factory=dict)
    """``data``, ``identity``, ``samples`` and ``seed`` of the training."""
    scores: dict[str, Any] = field(default_factory=dict)
    """``epsilon`` and ``delta`` of the validation scenes."""
    configuration: dict[str, Any] = field(default_factory=dict)
    """The recipe of the training."""


@dataclass
class GeneralWeights:
    """A general network and its description."""

    network: GeneralNetwork
    description: GeneralDescription


def write_general_weights(path: str | Path, weights: GeneralWeights) -> None:
    """Write a weights file (safetensors), atomically.

    Raises :class:`InputError` for values that are not finite and for a description that
    :func:`read_general_weights` would refuse.
    """
    # On demand, as a machine for training may not have the package.
    import safetensors.torch

    tensors = file_tensors(weights.network)
    try:
        _check_values(tensors)
        header = _header(weights)
        text = json.dumps(header, sort_keys=True, allow_nan=False)
        _description(json.loads(text))
    except (ValueError, TypeError) as problem:
        raise InputError(path, f"cannot be written: {problem}", "correct the network") from None
    write_whole(Path(path), safetensors.torch.save(tensors, {"deepct": text}))


def read_general_weights(path: str | Path) -> GeneralWeights:
    """Read a weights file of a general network, in evaluation mode.

    Raises :class:`InputError` for a file that is missing or damaged, of another kind or version,
    or has unknown, missing or impossible values.
    """
    return parse_general_weights(read_file(path, _REMEDY), path)


def parse_general_weights(contents: bytes, path: str | Path) -> GeneralWeights:
    """The weights in the contents of the file ``path``, as :func:`read_general_weights`."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    header = weights_header(contents, path, _REMEDY)
    try:
        tensors = load(contents)
    except (SafetensorError, ValueError) as problem:
        reason = " ".join(str(problem).split())
        raise InputError(path, f"is not a weights file ({reason})", _REMEDY) from None
    try:
        architecture = _architecture(header)
        description = _description(header)
        _check_values(tensors)
        network = _network(architecture, tensors)
    except ValueError as problem:
        raise InputError(path, str(problem), _REMEDY) from None
    return GeneralWeights(network, description)


def load_general(path: str | Path) -> GeneralWeights:
    """A general network from a weights file (``NAME.safetensors``), a checkpoint of ``train``, or a
    checkpoint of the study that preceded this program (``shape`` and ``state``).

    Raises :class:`InputError` if the file contains no general network.
    """
    if Path(path).suffix.lower() == ".safetensors":
        return read_general_weights(path)
    checkpoint = load_checkpoint(path)
    try:
        if "general" in checkpoint:
            architecture = GeneralArchitecture(**checkpoint["general"])
            description = GeneralDescription(**checkpoint["description"])
            state = checkpoint["model_state_dict"]
        else:
            architecture, state = _study(checkpoint)
            training = {"data": "bomex", "identity": "study", "samples": 0, "seed": 1}
            description = GeneralDescription(training=training)
        tensors = {name: values for name, values in state.items() if not name.endswith(_COUNTER)}
        _check_values(tensors)
        network = _network(architecture, tensors)
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        reason = " ".join(str(problem).split())
        remedy = "give a checkpoint of a training of the general network, or its weights file"
        raise InputError(path, f"holds no general network ({reason})", remedy) from None
    return GeneralWeights(network, description)


def export_general(
    checkpoint: str | Path,
    output: str | Path,
    changes: dict[str, Any],
    unbiased: float = 0.0,
    extremes: bool = False,
) -> list[str]:
    """Write the weights file of a checkpoint that :func:`load_general` reads.

    Entries of ``changes`` replace those of the :class:`GeneralDescription`. ``unbiased`` is the
    share (0 to 1) of the mean delta of the scores that is removed by a larger scale of the output;
    the scores of the original scale remain in the file under the names ``{name}_biased``. With
    ``extremes``, the network is extended by unused inputs for the minimum and maximum over the
    views.

    Returns lines that state what the scores in the file are.

    Raises :class:`InputError` for a checkpoint or for changes that cannot be used.
    """
    weights = load_general(checkpoint)
    # The same as in the weights file, from which they may be given back.
    changes = {key: value for key, value in changes.items() if key not in _OF_THE_NETWORK}
    unknown = sorted(set(changes) - set(_DESCRIBED))
    if unknown:
        remedy = f"the keys are {', '.join(_DESCRIBED)}"
        raise InputError(output, f"unknown metadata {', '.join(unknown)}", remedy)
    description = replace(weights.description, **changes)
    lines = []
    if unbiased:
        scale, scores = unbiased_scale(
            description.output_scale, description.scores, unbiased, checkpoint
        )
        description = replace(description, output_scale=scale, scores=scores)
        lines.append(BIASED_SCORES)
    network = with_extremes(weights.network) if extremes else weights.network
    write_general_weights(output, GeneralWeights(network, description))
    return lines


def is_general(path: str | Path) -> bool:
    """Whether a checkpoint or weights file can be read and is of a general network."""
    try:
        load_general(path)
    except InputError:
        return False
    return True


def file_tensors(network: GeneralNetwork) -> dict[str, Tensor]:
    """The tensors of the weights file: the state dict without counters, in float32."""
    return {
        name: values.detach().float().cpu().contiguous()
        for name, values in network.state_dict().items()
        if not name.endswith(_COUNTER)
    }


def _study(checkpoint: dict[str, Any]) -> tuple[GeneralArchitecture, dict[str, Tensor]]:
    """The architecture and the parameters, with the names of this program."""
    shape, state = checkpoint["shape"], checkpoint["state"]
    architecture = GeneralArchitecture(
        virtual_views=shape["virtual"],
        extremes=shape["extremes"],
        width=shape["width"],
        layers=shape["layers"],
    )
    names = {f"mix.{2 * at}": f"mixing.{at}" for at in range(3)}
    names.update({f"film.{2 * at}": f"modulation.{at}" for at in range(2)})
    for at in range(architecture.layers):
        names[f"conv.{at}"] = f"layers.{at}"
        names[f"norm.{at}"] = f"layers.{at}.batch_norm"
    renamed = {}
    for name, values in state.items():
        module, _, part = name.rpartition(".")
        renamed[f"{names[module]}.{part}"] = values
    return architecture, renamed


def _header(weights: GeneralWeights) -> dict[str, Any]:
    sizes, description = weights.network.architecture, vars(weights.description)
    # An empty table or list is the same as none; an albedo of 0 is not.
    optional = {key: description[key] for key in _OPTIONAL if description[key] not in (None, {}, [])}
    required = {key: value for key, value in description.items() if key not in _OPTIONAL}
    return {
        "format_version": FORMAT_VERSION,
        "network": "general",
        "architecture": {
            "virtual_views": sizes.virtual_views,
            "planes": sizes.planes,
            "extremes": sizes.extremes,
            "width": sizes.width,
            "layers": sizes.layers,
            "last_relu": True,
        },
        "levels": {"count": sizes.levels, "height": sizes.level_height},
        "outputs": OUTPUTS,
        "program": f"weights_tools {weights_tools.__version__}",
        **required,
        **optional,
    }


_OF_THE_NETWORK = ("network", "levels", "outputs")
_OPTIONAL = ("surface_albedo", "calibration", "typical")
_DESCRIBED = tuple(GeneralDescription.__dataclass_fields__)
_KEYS = {
    *("format_version", "network", "architecture", "levels", "outputs", "program"),
    *_DESCRIBED,
}


def _architecture(header: dict[str, Any]) -> GeneralArchitecture:
    if header.get("format_version") != FORMAT_VERSION or header.get("network") != "general":
        version, kind = header.get("format_version"), header.get("network", "fixed")
        problem = f"is of version {version!r}, network {kind!r}"
        raise ValueError(f"{problem}, not {FORMAT_VERSION}, general")
    missing = sorted(_KEYS - set(header) - set(_OPTIONAL))
    unknown = sorted(set(header) - _KEYS)
    if missing or unknown:
        problem = "has no metadata" if missing else "has unknown metadata"
        raise ValueError(f"{problem} {', '.join(missing or unknown)}")
    names = ("virtual_views", "planes", "extremes", "width", "layers", "last_relu")
    sizes = _exactly(header["architecture"], names, "architecture")
    levels = _exactly(header["levels"], ("count", "height"), "levels")
    for key in ("virtual_views", "planes", "width", "layers"):
        _whole(sizes[key], f"architecture.{key}")
    if type(sizes["extremes"]) is not bool:
        raise ValueError(f"architecture.extremes is {sizes['extremes']!r}, not true or false")
    if sizes["last_relu"] is not True:
        raise ValueError(f"architecture.last_relu is {sizes['last_relu']!r}, not true")
    if header["outputs"] != OUTPUTS:
        raise ValueError(f"outputs are {header['outputs']!r}, not {OUTPUTS}")
    return GeneralArchitecture(
        virtual_views=sizes["virtual_views"],
        planes=sizes["planes"],
        extremes=sizes["extremes"],
        width=sizes["width"],
        layers=sizes["layers"],
        levels=_whole(levels["count"], "levels.count"),
        level_height=_positive(levels["height"], "levels.height"),
    )


def _description(header: dict[str, Any]) -> GeneralDescription:
    for key in ("voxel_km", "wavelength_um", "input_scale", "output_scale"):
        _positive(header[key], key)
    albedo = header.get("surface_albedo", 0.0)
    if type(albedo) not in (int, float) or not 0.0 <= albedo <= 1.0:
        raise ValueError(f"surface_albedo is {albedo!r}, not a number from 0 to 1")
    for key in ("training", "scores", "configuration"):
        if not isinstance(header[key], dict):
            raise ValueError(f"{key} is not an object")
    _exactly(header["training"], ("data", "identity", "samples", "seed"), "training")
    ranges = {
        key: _pair(value, f"ranges.{key}", ordered=True)
        for key, value in _exactly(header["ranges"], tuple(RANGES), "ranges").items()
    }
    typical = header.get("typical", {})
    if not isinstance(typical, dict):
        raise ValueError("typical is not an object")
    typical = {key: _pair(value, f"typical.{key}", ordered=True) for key, value in typical.items()}
    pairs = header.get("calibration", [])
    if not isinstance(pairs, list):
        raise ValueError("calibration is not a list")
    calibration = [_pair(pair, "calibration", ordered=False) for pair in pairs]
    expected = [pair[0] for pair in calibration]
    if any(low >= high for low, high in zip(expected, expected[1:])) or any(
        min(pair) <= 0.0 for pair in calibration
    ):
        raise ValueError("calibration is not positive and ascending")
    values = {key: header[key] for key in _DESCRIBED if key in header}
    changes = {"ranges": ranges, "typical": typical, "calibration": calibration}
    return GeneralDescription(**{**values, **changes})


def _network(architecture: GeneralArchitecture, tensors: dict[str, Tensor]) -> GeneralNetwork:
    network = GeneralNetwork(architecture)
    expected = {
        name: tuple(values.shape)
        for name, values in network.state_dict().items()
        if not name.endswith(_COUNTER)
    }
    for name, shape in expected.items():
        if name not in tensors:
            raise ValueError(f"has no tensor {name}")
        if tuple(tensors[name].shape) != shape:
            raise ValueError(f"{name} has shape {list(tensors[name].shape)}, not {list(shape)}")
    unknown = sorted(set(tensors) - set(expected))
    if unknown:
        raise ValueError(f"has an unknown tensor {unknown[0]}")
    network.load_state_dict(tensors, strict=False)
    return network.eval()


def _check_values(tensors: dict[str, Tensor]) -> None:
    for name, values in tensors.items():
        if values.dtype != torch.float32:
            raise ValueError(f"{name} is of type {values.dtype}, not float32")
        if not torch.isfinite(values).all():
            raise ValueError(f"{name} holds a value that is not finite")
        if name.endswith("running_var") and bool((values < 0.0).any()):
            raise ValueError(f"{name} holds a negative variance")


def _exactly(table: Any, keys: tuple[str, ...], name: str) -> dict[str, Any]:
    if not isinstance(table, dict) or set(table) != set(keys):
        raise ValueError(f"{name} has not exactly the keys {', '.join(keys)}")
    return table


def _whole(value: Any, name: str) -> int:
    if type(value) is not int or value < 1:
        raise ValueError(f"{name} is {value!r}, not a positive whole number")
    return value


def _positive(value: Any, name: str) -> float:
    if type(value) not in (int, float) or not 0.0 < value < float("inf"):
        raise ValueError(f"{name} is {value!r}, not a positive number")
    return float(value)


def _pair(value: Any, name: str, ordered: bool) -> tuple[float, float]:
    numbers = isinstance(value, (list, tuple)) and len(value) == 2
    if not numbers or any(type(at) not in (int, float) or abs(at) == float("inf") for at in value):
        raise ValueError(f"{name} is {value!r}, not two numbers")
    if ordered and value[0] > value[1]:
        raise ValueError(f"{name} is {value!r}, not in ascending order")
    return float(value[0]), float(value[1])
