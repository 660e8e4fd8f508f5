"""Comparison of exported weights with PyTorch on the same images."""

from __future__ import annotations

import copy
import json
import math
import tempfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Callable, NamedTuple

import h5py
import numpy as np
import torch
from safetensors import SafetensorError, safe_open

from weights_tools.errors import InputError
from weights_tools.export import GET_ONNX, is_onnx, load_network, onnx_graph
from weights_tools.files import regular_file
from weights_tools.lift import wavelengths_of
from weights_tools.model import RADII, Network
from weights_tools.program import run_program

SAME = 1e-5
"""Tolerance of the error relative to the largest value."""

SINGLE = 1e-4
"""Tolerance for runtimes that compute the positions of the pixels in single precision."""

OPENVINO_SETTINGS = (
    "INFERENCE_PRECISION_HINT=f32: with its default settings, OpenVINO computes in bfloat16 on "
    "processors that support it, and the answer is wrong"
)

TOLERANCES = {"direct": SAME, "winograd-f4": 1e-4}
"""Tolerance for each convolution algorithm of ``deepct``: direct summation, and the algorithm with
the fewest multiplications, which has larger rounding errors."""

SIZES = ((1, 1), (32, 32), (31, 45), (33, 32), (128, 96))
"""Rows and columns of the test images."""


class Engine(NamedTuple):
    """A program or library that runs a weights file."""

    name: str
    tolerance: float
    """Tolerance of the error relative to the largest value."""
    run: Callable[[np.ndarray, dict[str, Any]], np.ndarray]
    """Function of images ``[view, row, col]`` (1/sr), the views of the first band, then those of
    the next one, and the metadata of the weights. It returns all outputs (1/km; um), concatenated
    along the first axis."""
    settings: str = ""
    """The settings that differ from the defaults of the library, and the reason."""


def engines(weights: str | Path, deepct: str) -> list[Engine]:
    """The engines for a weights file: ``deepct`` with each algorithm or, for an ONNX graph, ONNX
    Runtime, and OpenVINO and tract where they are installed."""
    if not is_onnx(weights):
        return [
            Engine(algorithm, tolerance, partial(_infer, deepct, weights, algorithm))
            for algorithm, tolerance in TOLERANCES.items()
        ]
    found = [Engine("onnxruntime", SAME, partial(_onnx_runtime, weights))]
    if find_spec("openvino"):
        run = partial(_openvino, weights)
        found.append(Engine("openvino", SINGLE, run, OPENVINO_SETTINGS))
    if find_spec("tract"):
        found.append(Engine("tract", SAME, partial(_tract, weights)))
    return found


def check(
    checkpoint: str | Path, weights: str | Path, engine: Engine, seed: int = 1
) -> list[float]:
    """The error of an engine relative to PyTorch for each image size of :data:`SIZES`.

    The error is the largest difference divided by the largest value of PyTorch's output, for
    random images with radiances in the range of those of clouds.

    Raises :class:`InputError` for files that cannot be used and if the engine is missing or fails.
    """
    metadata = weights_metadata(weights)
    if "view_geometry" not in metadata:
        raise InputError(weights, "is not of a network for one formation", "give such weights")
    network, _ = load_network(checkpoint, metadata)
    random = np.random.default_rng(seed)
    errors = []
    for rows, cols in SIZES:
        views = len(metadata["view_geometry"]["pixel_km"])
        shape = (len(wavelengths_of(metadata)) * views, rows, cols)
        radiance = (0.3 * random.random(shape) ** 2).astype(np.float32)
        found = engine.run(radiance, metadata).astype(np.float64)
        outputs = found, answer(network, radiance, metadata)
        errors.append(_relative(*(_comparable(values, metadata) for values in outputs)))
    return errors


def _comparable(outputs: np.ndarray, metadata: dict[str, Any]) -> np.ndarray:
    """Outputs of which the effective radius, which begins abruptly where the extinction does, is
    multiplied by the extinction over its largest value."""
    if "effective_radius" not in metadata.get("outputs", ()):
        return outputs
    levels = metadata["levels"]["count"]
    extinction = outputs[:levels]
    radius = outputs[-levels:] * extinction / (extinction.max() or 1.0)
    return np.concatenate([outputs[:-levels], radius])


def _relative(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference divided by the largest expected value, unless that is zero."""
    largest = float(abs(expected).max())
    return float(abs(found - expected).max()) / (largest or 1.0)


def answer(network: Network, radiance: np.ndarray, metadata: dict[str, Any]) -> np.ndarray:
    """All outputs of PyTorch (1/km; um) for images ``[view, row, col]``, computed in float64.

    The float32 parameters of ``network`` are unchanged. The sums have no float32 rounding errors,
    so that a difference is due to the rounding errors of the other engine only.
    """
    images = torch.from_numpy(radiance * np.float32(metadata["input_scale"])).double()
    with torch.no_grad():
        output = copy.deepcopy(network).double()(images[None])[0]
    outputs = output.numpy() * metadata["output_scale"]
    if "effective_radius" in metadata.get("outputs", ()):
        levels = metadata["levels"]["count"]
        scale = metadata["effective_radius_scale"] / metadata["output_scale"]
        radius = (scale * outputs[-levels:]).clip(*RADII)
        outputs[-levels:] = np.where(outputs[:levels] > 0.0, radius, 0.0)
    return outputs


def weights_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata of a weights file."""
    if is_onnx(path):
        return onnx_graph().onnx_metadata(path)
    remedy = "export it with `weights_tools export`"
    regular_file(path, remedy)
    try:
        with safe_open(str(path), "pt") as file:
            header = file.metadata() or {}
        return json.loads(header["deepct"])
    except (OSError, SafetensorError, KeyError, ValueError) as problem:
        raise InputError(path, f"is not a weights file ({problem})", remedy) from None


def write_images(path: Path, radiance: np.ndarray, metadata: dict[str, Any]) -> None:
    """Write images ``[view, row, col]`` that ``deepct`` can read, with the views of the weights;
    those of several bands, one after the other, on the dimension ``wavelength``."""
    geometry, wavelengths = metadata["view_geometry"], wavelengths_of(metadata)
    views = len(radiance) // len(wavelengths)
    images = ("view", "row", "col")
    zenith, azimuth = (
        np.radians(geometry["view_zenith_deg"]),
        np.radians(geometry["view_azimuth_deg"]),
    )
    direction = np.stack(
        [np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], 1
    )
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    target = np.tile([0.0, 0.0, metadata["target_altitude_km"]], (views, 1))
    # Views without a camera distance have parallel rays.
    distances = geometry.get("camera_distance_km") or [None] * views
    distance = np.array([math.nan if at is None else at for at in distances])
    by_view = {
        "view_zenith_deg": geometry["view_zenith_deg"],
        "view_azimuth_deg": geometry["view_azimuth_deg"],
        "projection": np.isnan(distance).astype(np.uint8),
        "camera_position": target + distance[:, None] * direction,
        "camera_direction": direction,
        "target": target,
        "pixel_tangent": geometry["pixel_km"] / distance,
        "pixel_km": geometry["pixel_km"],
    }
    lengths = dict(zip(images, (views, *radiance.shape[1:])), component=3)
    with h5py.File(path, "w") as file:
        for name, length in lengths.items():
            file[name] = np.arange(length)
            file[name].make_scale(name)
        if len(wavelengths) > 1:
            file["wavelength"] = wavelengths
            file["wavelength"].make_scale("wavelength")
            images = ("wavelength", *images)
            radiance = radiance.reshape(len(wavelengths), views, *radiance.shape[1:])
        else:
            file["wavelength"] = float(wavelengths[0])
        file["radiance"] = radiance
        _on(file, "radiance", *images)
        for name, values in by_view.items():
            file[name] = values
            _on(file, name, *("view", "component")[: file[name].ndim])
        file["sun_zenith_deg"] = float(geometry["sun_zenith_deg"])
        file["sun_azimuth_deg"] = float(geometry["sun_azimuth_deg"])
        file["sun_irradiance"] = 1.0


def _on(file: h5py.File, name: str, *dimensions: str) -> None:
    for axis, dimension in enumerate(dimensions):
        file[name].dims[axis].attach_scale(file[dimension])


def _onnx_runtime(
    weights: str | Path, radiance: np.ndarray, metadata: dict[str, Any]
) -> np.ndarray:
    try:
        import onnxruntime
    except ImportError as problem:
        raise InputError("onnxruntime", f"cannot be imported ({problem})", GET_ONNX) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    session = onnxruntime.InferenceSession(weights, options, providers=["CPUExecutionProvider"])
    outputs = session.run(metadata["outputs"], {"radiance": radiance[None]})
    return np.concatenate([output[0] for output in outputs])


def _openvino(
    weights: str | Path, radiance: np.ndarray, metadata: dict[str, Any]
) -> np.ndarray:
    import openvino

    properties = {
        "INFERENCE_PRECISION_HINT": "f32",
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
    }
    model = openvino.Core().compile_model(str(weights), "CPU", properties)
    outputs = model({"radiance": radiance[None]})
    return np.concatenate([outputs[name][0] for name in metadata["outputs"]])


def _tract(weights: str | Path, radiance: np.ndarray, metadata: dict[str, Any]) -> np.ndarray:
    import tract

    model = tract.onnx().load(str(weights))
    # tract cannot reshape for a number of clouds that it does not know.
    model.set_input_fact(0, f"1,{len(radiance)},row,col,f32")
    outputs = model.into_model().into_runnable().run([radiance[None]])
    return np.concatenate([output.to_numpy()[0] for output in outputs])


def _infer(
    deepct: str,
    weights: str | Path,
    algorithm: str,
    radiance: np.ndarray,
    metadata: dict[str, Any],
) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        images, volume = Path(folder, "images.nc"), Path(folder, "volume.nc")
        write_images(images, radiance, metadata)
        command = [deepct, "infer", str(images), "--weights", str(weights), "--out", str(volume)]
        command += ["--set", f"convolution.algorithm={algorithm}"]
        run_program(command)
        with h5py.File(volume, "r") as file:
            outputs = metadata.get("outputs", ["extinction"])
            names = {"effective_radius": "reff"}
            return np.concatenate([file[names.get(name, name)][...] for name in outputs])
