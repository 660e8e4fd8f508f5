"""Write the fixtures of parity.rs: small networks and their outputs by PyTorch in float64.

    python3 crates/deepct-core/tests/parity/generate.py

The script requires numpy, safetensors, torch and weights_tools. For each network NAME it writes

    NAME.safetensors          the weights in the format of deepct, with batch normalisations
                              separate from the convolutions
    NAME.answers.safetensors  tensors "{rows}x{cols}", [output and level, row, col]: the output
                              for the images of the function `images`, which parity.rs evaluates as
                              well
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn
from weights_tools.lift import lift_of, wavelengths_of

FOLDER = Path(__file__).parent
NETWORKS = {
    "views-10": ([10, 12, 14], True),
    "odd": ([3, 17, 5, 33, 2], False),
    "planes": ([12, 9, 6], True),
    "bands": ([24, 9, 6], True),
}
ON_PLANES = {
    "format_version": 2,
    "view_geometry": {
        "sun_zenith_deg": 30.0,
        "sun_azimuth_deg": 45.0,
        "view_zenith_deg": [46.0, 0.0, 60.0, 30.0],
        "view_azimuth_deg": [180.0, 0.0, 70.0, 200.0],
        "pixel_km": [0.069, 0.05, 0.08, 0.06],
        "camera_distance_km": [828.0, 600.0, 1000.0, None],
    },
    "image_layout": {"planes": {"altitudes_km": [0.7, 1.0, 1.43]}},
    "horizontal_spacing_km": [0.05, 0.04],
}
"""Metadata that differ for the network on planes: cameras in all directions, one at infinity."""
IN_BANDS = {
    **ON_PLANES,
    "format_version": 5,
    "wavelength_um": [0.672, 2.13],
    "levels": {"bottom_km": 0.5, "count": 3, "spacing_km": 0.04},
    "outputs": ["extinction", "effective_radius"],
    "effective_radius_scale": 10.0,
}
"""Metadata that differ for the network for two bands, which also estimates the effective radius."""
SIZES = ((1, 1), (31, 45), (33, 32))


def images(views: int, rows: int, cols: int) -> np.ndarray:
    """Pseudo-random multiples of 1/128 in [0, 1), which are exact in float32."""
    index = np.arange(views * rows * cols)
    return ((index * 7919 + index // 97 * 31) % 128 / 128.0).reshape(views, rows, cols)


class Layer(nn.Module):
    """Convolution and batch normalisation, optionally followed by a ReLU."""

    def __init__(self, inputs: int, outputs: int, relu: bool) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm = nn.BatchNorm2d(outputs)
        self.relu = relu
        nn.init.xavier_normal_(self.convolution.weight)
        nn.init.uniform_(self.convolution.bias, -0.2, 0.2)
        nn.init.uniform_(self.norm.weight, 0.6, 1.4)
        nn.init.uniform_(self.norm.bias, -0.3, 0.3)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        values = self.norm(self.convolution(values))
        return values.relu() if self.relu else values


def network(channels: list[int], last_relu: bool) -> nn.Sequential:
    """Create layers whose running statistics are those of batches of uniform noise."""
    last = len(channels) - 2
    layers = [
        Layer(inputs, outputs, last_relu or index < last)
        for index, (inputs, outputs) in enumerate(zip(channels, channels[1:]))
    ]
    result = nn.Sequential(*layers)
    with torch.no_grad():
        for _ in range(30):
            result(torch.rand(8, channels[0], 16, 16))
    return result.eval()


def metadata(name: str) -> dict[str, Any]:
    channels, last_relu = NETWORKS[name]
    views, levels = channels[0], channels[-1]
    changes = {"planes": ON_PLANES, "bands": IN_BANDS}.get(name, {})
    return {
        "format_version": 1,
        "formation": "none",
        "architecture": {"channels": channels, "last_relu": last_relu},
        "view_geometry": {
            "sun_zenith_deg": 30.0,
            "sun_azimuth_deg": 45.0,
            "view_zenith_deg": [2.0 * view for view in range(views)],
            "view_azimuth_deg": [0.0] * views,
            "pixel_km": [0.05] * views,
        },
        "target_altitude_km": 1.0,
        "wavelength_um": 0.672,
        "image_layout": "camera",
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.5, "count": levels, "spacing_km": 0.04},
        "input_scale": 1.0,
        "output_scale": 1.0,
        "training": {"data": "none", "identity": "none", "samples": 0, "seed": 0},
        "scores": {},
        "program": f"generate.py with PyTorch {torch.__version__}",
        "configuration": None,
        **changes,
    }


def main() -> None:
    torch.manual_seed(1)
    for name, (channels, last_relu) in NETWORKS.items():
        layers = network(channels, last_relu)
        tensors = {}
        for index, layer in enumerate(layers):
            prefix = f"layers.{index}"
            for key, value in layer.convolution.state_dict().items():
                tensors[f"{prefix}.{key}"] = value.numpy()
            for key in ("weight", "bias", "running_mean", "running_var"):
                tensors[f"{prefix}.batch_norm.{key}"] = getattr(layer.norm, key).detach().numpy()
        header = {"deepct": json.dumps(metadata(name))}
        save_file(tensors, FOLDER / f"{name}.safetensors", header)
        layers.double()
        lift = lift_of(metadata(name))
        views = len(metadata(name)["view_geometry"]["pixel_km"])
        views *= len(wavelengths_of(metadata(name)))
        answers = {}
        for rows, cols in SIZES:
            values = torch.from_numpy(images(views, rows, cols))[None]
            with torch.no_grad():
                output = layers(values if lift is None else lift(values))[0]
            answers[f"{rows}x{cols}"] = output.float().numpy()
        save_file(answers, FOLDER / f"{name}.answers.safetensors")


if __name__ == "__main__":
    main()
