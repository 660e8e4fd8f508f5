#!/usr/bin/env python3
"""Differences of ONNX runtimes from PyTorch for a network with the views of pearls-32
(docs/guide/pages/other_tools.md).

    pip install onnxruntime openvino tract
    npm install --prefix FOLDER onnxruntime-web
    python benches/runtimes.py FOLDER --sizes 32,800

The network has two random layers: the script tests the resampling of the images onto planes, in which
runtimes differ. PyTorch computes in double precision. Runtimes that are not installed are left out;
onnxruntime-web is run by Node.js from FOLDER, in which the script writes its files as well.

Needs weights_tools.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
from weights_tools.check import Engine, answer, engines, weights_metadata
from weights_tools.export import export, load_network
from weights_tools.model import Network
from weights_tools.scenes import PEARLS_32_DEG

PLANES = [0.6, 0.95, 1.12, 1.61]
"""Altitudes of the planes (km)."""
LEVELS = 32
RUN_IN_NODE = """
import { readFileSync, writeFileSync } from "node:fs";
import * as ort from "onnxruntime-web";

const shape = JSON.parse(process.argv[2]);
const images = readFileSync("images.f32");
const pixels = new Float32Array(images.buffer, images.byteOffset, images.length / 4);
const session = await ort.InferenceSession.create(readFileSync("network.onnx"));
const outputs = await session.run({ radiance: new ort.Tensor("float32", pixels, shape) });
writeFileSync("extinction.f32", new Uint8Array(outputs.extinction.data.slice().buffer));
"""


def metadata() -> dict:
    """The metadata of a network on planes for the string of pearls with 32 satellites."""
    zeniths = np.asarray(PEARLS_32_DEG)
    distance = 600.0 / np.cos(np.radians(abs(zeniths)))
    return {
        "formation": "pearls-32",
        "view_geometry": {
            "sun_zenith_deg": 30.0,
            "sun_azimuth_deg": 45.0,
            "view_zenith_deg": abs(zeniths).tolist(),
            "view_azimuth_deg": [180.0 if zenith < 0.0 else 0.0 for zenith in zeniths],
            "pixel_km": (0.05 * distance / 600.0).tolist(),
            "camera_distance_km": distance.tolist(),
        },
        "target_altitude_km": 1.12,
        "wavelength_um": 0.672,
        "image_layout": {"planes": {"altitudes_km": PLANES}},
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.48, "count": LEVELS, "spacing_km": 0.04},
        "outputs": ["extinction"],
        "input_scale": 5.0,
        "output_scale": 20.0,
        "training": {"data": "none", "identity": "none", "samples": 0, "seed": 0},
        "scores": {},
        "configuration": {},
    }


def in_node(folder: Path, radiance: np.ndarray, _: dict) -> np.ndarray:
    """The estimate of onnxruntime-web."""
    radiance[None].tofile(folder / "images.f32")
    shape = json.dumps([1, *radiance.shape])
    subprocess.run(["node", "run.mjs", shape], cwd=folder, check=True)
    estimate = np.fromfile(folder / "extinction.f32", np.float32)
    return estimate.reshape(LEVELS, *radiance.shape[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sizes", default="32,800", help="rows and columns of the images")
    arguments = parser.parse_args()
    folder = arguments.folder
    torch.manual_seed(1)
    network = Network([len(PLANES) * len(PEARLS_32_DEG), 24, LEVELS]).eval()
    torch.save(network.state_dict(), folder / "network.pt")
    weights = folder / "network.onnx"
    export(folder / "network.pt", weights, metadata())
    network, _ = load_network(folder / "network.pt", metadata())
    known = weights_metadata(weights)
    found = engines(weights, "deepct")
    if (folder / "node_modules" / "onnxruntime-web").exists():
        (folder / "run.mjs").write_text(RUN_IN_NODE)
        found.append(Engine("onnxruntime-web", 1e-5, partial(in_node, folder)))
    random = np.random.default_rng(1)
    for size in map(int, arguments.sizes.split(",")):
        shape = (len(PEARLS_32_DEG), size, size)
        radiance = (0.3 * random.random(shape) ** 2).astype(np.float32)
        expected = answer(network, radiance, known)
        for engine in found:
            start = time.perf_counter()
            error = abs(engine.run(radiance, known) - expected).max() / abs(expected).max()
            print(f"{size:5} {engine.name:16} {error:8.1e} {time.perf_counter() - start:6.1f} s", flush=True)


if __name__ == "__main__":
    main()
