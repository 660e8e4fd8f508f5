"""The complete network as an ONNX graph, for use without deepct."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.parser
from google.protobuf.message import DecodeError
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor

import weights_tools
from weights_tools.errors import InputError
from weights_tools.files import read_file
from weights_tools.lift import Lift, wavelengths_of
from weights_tools.model import RADII

OPSET = 17
"""Version of the ONNX operator set; version 16 contains all operators used here as well."""

IR_VERSION = 8
"""Version of the file format that belongs to :data:`OPSET`; software since 2022 can read it."""

UNITS = {
    "extinction": "1/km",
    "uncertainty": "1/km, the expected absolute error of extinction",
    "effective_radius": "um, 0 where there is no extinction",
}
"""Units of the outputs."""

_LIFT = """
lift (float[cloud, view, row, col] scaled) => (float[cloud, channel, y, x] planes)
{
    # Type codes of Cast: 1 is float, 7 is int64, 11 is double.
    zero = Constant <value = double {0.0}> ()
    half = Constant <value = double {0.5}> ()
    one = Constant <value = double {1.0}> ()
    least_depth = Constant <value = double {0.001}> ()
    upright = Constant <value = int64[2] {-1, 1}> ()
    flat = Constant <value = int64[2] {0, -1}> ()
    two_by_two = Constant <value = int64[2] {1, 2}> ()
    two_rows = Constant <value = double[2, 1, 1, 1, 1] {0.0, 1.0}> ()
    two_cols = Constant <value = double[2, 1, 1, 1] {0.0, 1.0}> ()

    # The size of the images and of the target plane, which has a margin on all sides.
    row_shape = Shape <start = 2, end = 3> (scaled)
    row_count = Squeeze (row_shape)
    rows = Cast <to = 11> (row_count)
    row_end = Add (rows, row_margin)
    row_start = Neg (row_margin)
    ground_rows = Sub (row_end, row_start)
    last_row = Sub (rows, one)
    middle_row = Mul (last_row, half)
    col_shape = Shape <start = 3, end = 4> (scaled)
    col_count = Squeeze (col_shape)
    cols = Cast <to = 11> (col_count)
    col_end = Add (cols, col_margin)
    col_start = Neg (col_margin)
    ground_cols = Sub (col_end, col_start)
    last_col = Sub (cols, one)
    middle_col = Mul (last_col, half)

    # The same as integers. (tract cannot multiply by a shape that it knows as a symbol only.)
    whole_rows = Cast <to = 7> (rows)
    whole_cols = Cast <to = 7> (cols)
    whole_ground_rows = Cast <to = 7> (ground_rows)
    whole_ground_cols = Cast <to = 7> (ground_cols)

    # Positions of the voxels of the target plane relative to the target (km): [y, 1] and [x].
    row_steps = Range (row_start, row_end, one)
    row_offsets = Sub (row_steps, middle_row)
    y_line = Mul (row_offsets, row_km)
    y = Reshape (y_line, upright)
    col_steps = Range (col_start, col_end, one)
    col_offsets = Sub (col_steps, middle_col)
    x = Mul (col_offsets, col_km)

    # Their projections, in pixels from the centre of each image: [view, y, x].
    depth_x = Mul (depth_by_x, x)
    depth_y = Mul (depth_by_y, y)
    nearer = Add (depth_x, depth_y)
    signed_depth = Sub (one, nearer)
    depth = Max (signed_depth, least_depth)
    row_x = Mul (row_by_x, x)
    row_y = Mul (row_by_y, y)
    row_far_off = Add (row_x, row_y)
    row_from_middle = Div (row_far_off, depth)
    col_x = Mul (col_by_x, x)
    col_y = Mul (col_by_y, y)
    col_far_off = Add (col_x, col_y)
    col_from_middle = Div (col_far_off, depth)

    # Relative to the first pixel, limited to the image.
    row_anywhere = Add (row_from_middle, middle_row)
    row_not_before = Max (row_anywhere, zero)
    row = Min (row_not_before, last_row)
    col_anywhere = Add (col_from_middle, middle_col)
    col_not_before = Max (col_anywhere, zero)
    col = Min (col_not_before, last_col)

    # The two nearest rows and columns and their interpolation weights:
    # [2, 1, view, y, x] and [2, view, y, x].
    row_before = Floor (row)
    row_around = Add (row_before, two_rows)
    row_signed = Sub (row, row_around)
    row_distance = Abs (row_signed)
    row_weight = Sub (one, row_distance)
    row_within = Min (row_around, last_row)
    row_pixel = Cast <to = 7> (row_within)
    col_before = Floor (col)
    col_around = Add (col_before, two_cols)
    col_signed = Sub (col, col_around)
    col_distance = Abs (col_signed)
    col_weight = Sub (one, col_distance)
    col_within = Min (col_around, last_col)
    col_pixel = Cast <to = 7> (col_within)

    # Bilinear interpolation between the four pixels, [cloud, view, y, x]. Pixels are numbered
    # consecutively over all images, in integers: some runtimes compute in single precision, which
    # cannot represent all numbers above 2^24.
    view_rows = Mul (view_number, whole_rows)
    row_in_all = Add (view_rows, row_pixel)
    row_pixels = Mul (row_in_all, whole_cols)
    pixel_numbers = Add (row_pixels, col_pixel)
    pixels = Reshape (scaled, flat)
    around = Gather <axis = 1> (pixels, pixel_numbers)
    exact_weights = Mul (row_weight, col_weight)
    weights = Cast <to = 1> (exact_weights)
    weighted = Mul (around, weights)
    ground = ReduceSum <keepdims = 0> (weighted, two_by_two)

    # The planes, by the same indexing: sections of the target plane of the size of the images,
    # displaced by the parallax of each channel.
    ground_voxels = Reshape (ground, flat)
    view_corners = Mul (channel_view, whole_ground_rows)
    row_corners = Add (view_corners, channel_row)
    row_line = Range (zero, rows, one)
    row_upright = Reshape (row_line, upright)
    row_column = Cast <to = 7> (row_upright)
    voxel_rows = Add (row_corners, row_column)
    row_voxels = Mul (voxel_rows, whole_ground_cols)
    col_line = Range (zero, cols, one)
    whole_col_line = Cast <to = 7> (col_line)
    voxel_cols = Add (channel_col, whole_col_line)
    voxel_numbers = Add (row_voxels, voxel_cols)
    planes = Gather <axis = 1> (ground_voxels, voxel_numbers)
}
"""
"""The resampling onto planes of :class:`Lift`, for images of any size. Positions are computed in
float64 up to the interpolation weights. (``GridSample`` rounds positions to float32, which causes
noticeable errors in images of a hundred pixels, and is not faster.)"""


_RADIUS = """
radius (float[cloud, z, y, x] raw_radius) => (float[cloud, z, y, x] effective_radius)
{
    scaled_radius = Mul (raw_radius, radius_scale)
    limited_radius = Clip (scaled_radius, least_radius, most_radius)
    is_cloud = Greater (extinction, nothing)
    cloud = Cast <to = 1> (is_cloud)
    effective_radius = Mul (limited_radius, cloud)
}
"""
"""The limits of the effective radius, which is 0 where there is no extinction."""


def onnx_model(
    layers: dict[str, Tensor], lift: Lift | None, header: dict[str, Any]
) -> onnx.ModelProto:
    """The graph from radiance ``[cloud, view, row, col]`` (1/sr; the views of the first band, then
    those of the next one) to extinction ``[cloud, z, y, x]`` (1/km), float32, for any number of
    clouds, rows and columns.

    ``layers`` and ``header`` are the layers and the metadata of a weights file; the metadata are
    stored as JSON under ``deepct``. The graph includes the scaling and the resampling onto planes.
    A network with several outputs has one named output for each.
    """
    constants = {name: values.numpy() for name, values in layers.items()}
    constants["input_scale"] = np.float32(header["input_scale"])
    constants["output_scale"] = np.float32(header["output_scale"])
    nodes = [helper.make_node("Mul", ["radiance", "input_scale"], ["scaled"])]
    value = "scaled"
    if lift is not None:
        constants.update(_lift_constants(lift))
        nodes += onnx.parser.parse_graph(_LIFT).node
        value = "planes"
    for index in range(len(header["architecture"]["channels"]) - 1):
        operands = [value, f"layers.{index}.weight", f"layers.{index}.bias"]
        value = f"layers.{index}"
        # Some runtimes require the attributes that have a default value as well.
        attributes = {
            "kernel_shape": layers[operands[1]].shape[2:],
            "strides": [1, 1],
            "dilations": [1, 1],
            "pads": [1, 1, 1, 1],
        }
        nodes.append(helper.make_node("Conv", operands, [f"{value}.sum"], **attributes))
        nodes.append(helper.make_node("Relu", [f"{value}.sum"], [value]))
    outputs = header["outputs"]
    scaled = "outputs" if len(outputs) > 1 else outputs[0]
    nodes.append(helper.make_node("Mul", [value, "output_scale"], [scaled]))
    if len(outputs) > 1:
        parts = ["raw_radius" if name == "effective_radius" else name for name in outputs]
        nodes.append(helper.make_node("Split", [scaled], parts, axis=1))
    if "effective_radius" in outputs:
        scale = header["effective_radius_scale"] / header["output_scale"]
        constants["radius_scale"] = np.float32(scale)
        constants["nothing"] = np.float32(0.0)
        for name, radius in zip(("least_radius", "most_radius"), RADII):
            constants[name] = np.float32(radius)
        nodes += onnx.parser.parse_graph(_RADIUS).node
    model = _model(nodes, constants, header)
    onnx.checker.check_model(model, full_check=True)
    return model


def onnx_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata of a file written by :func:`onnx_model`.

    Raises :class:`InputError` for any other file.
    """
    remedy = "export it with `weights_tools export`"
    content = read_file(path, remedy)
    try:
        model = onnx.load_from_string(content)
        return json.loads({entry.key: entry.value for entry in model.metadata_props}["deepct"])
    except (DecodeError, KeyError, ValueError) as problem:
        raise InputError(path, f"is not an ONNX file of weights ({problem})", remedy) from None


def _lift_constants(lift: Lift) -> dict[str, np.ndarray]:
    """The constants of the resampling graph for each view ``[view, 1, 1]`` and channel
    ``[channel, 1, 1]``."""
    planes, views = len(lift.parallax), len(lift.cameras)
    numbers = np.arange(views, dtype=np.int64)
    constants = {"view_number": numbers, "channel_view": np.tile(numbers, planes)}
    parallax = np.array(lift.parallax, np.int64).reshape(-1, 2)
    for axis, name in enumerate(("row", "col")):
        constants[f"channel_{name}"] = lift.margin[axis] + parallax[:, axis]
    for part, name in enumerate(("col", "row", "depth")):
        for axis, place in enumerate("xy"):
            constants[f"{name}_by_{place}"] = lift.cameras[:, part, axis].numpy()
    constants = {name: values[:, None, None] for name, values in constants.items()}
    for axis, name in enumerate(("row", "col")):
        constants[f"{name}_margin"] = np.float64(lift.margin[axis])
        constants[f"{name}_km"] = np.float64(lift.spacing[axis])
    return constants


def _model(
    nodes: list[onnx.NodeProto], constants: dict[str, np.ndarray], header: dict[str, Any]
) -> onnx.ModelProto:
    views = len(wavelengths_of(header)) * len(header["view_geometry"]["pixel_km"])
    levels = header["levels"]["count"]
    radiance = helper.make_tensor_value_info(
        "radiance",
        TensorProto.FLOAT,
        ["cloud", views, "row", "col"],
        "radiance [cloud, view, row, col] in 1/sr for a solar irradiance of 1: "
        "rows increase towards the north, columns towards the east",
        ["cloud", "view", "row", "col"],
    )
    volumes = [
        helper.make_tensor_value_info(
            name,
            TensorProto.FLOAT,
            ["cloud", levels, "row", "col"],
            f"{name} [cloud, z, y, x] in {UNITS[name]}: y and x correspond to row and col",
            ["cloud", "z", "y", "x"],
        )
        for name in header["outputs"]
    ]
    weights = [
        numpy_helper.from_array(np.asarray(values, order="C"), name)
        for name, values in constants.items()
    ]
    graph = helper.make_graph(nodes, "deepct", [radiance], volumes, weights)
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="weights_tools",
        producer_version=weights_tools.__version__,
        doc_string=_description(header),
    )
    helper.set_model_props(model, {"deepct": json.dumps(header, sort_keys=True, allow_nan=False)})
    return model


def _description(header: dict[str, Any]) -> str:
    """A description of the model in a few sentences."""
    levels, (dx, dy) = header["levels"], header["horizontal_spacing_km"]
    top = levels["bottom_km"] + levels["count"] * levels["spacing_km"]
    wavelengths = " and ".join(map(str, wavelengths_of(header)))
    return (
        f"Estimates the extinction of a cloud from images of the formation {header['formation']} "
        f"at {wavelengths} um: voxels of {dx} x {dy} x {levels['spacing_km']} km, "
        f"{levels['count']} levels from {levels['bottom_km']:g} to {top:g} km. The centre of each "
        f"image shows the target, at an altitude of {header['target_altitude_km']:g} km. The "
        "metadata deepct (JSON) contain the complete view geometry."
    )
