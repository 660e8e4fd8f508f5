#!/usr/bin/env python3
"""Time the network beside ONNX Runtime on the same weights, images and threads.

    python3 benches/compare.py [--json] [--rounds N] [--threads N]

builds deepct, installs the peers into benches/.venv, and prints a row for each network
and size: median milliseconds of a run of each side (the fastest too with --json), the
ratio, and the largest error over the largest value against float64. The two sides take
turns, A B A B, so that what else the machine does falls on both.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = Path(__file__).resolve().parent / ".venv"
REQUIREMENTS = ("numpy==2.4.6", "onnx==1.22.0", "onnxruntime==1.31.0", "safetensors==0.8.0")
SIZES = ((32, 32), (256, 256))
NETWORKS = {"cloudct-10": (10, 81), "pearls-32": (32, 33)}
LEVELS = 32
SECONDS_A_TURN = 0.1
"""A turn is as many runs as fit into this."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON array")
    parser.add_argument("--rounds", type=int, default=15, help="turns of each side")
    parser.add_argument("--threads", type=int, default=2, help="threads of each side")
    arguments = parser.parse_args()
    python = VENV / "bin" / "python"
    if Path(sys.prefix).resolve() != VENV.resolve():
        install(python)
        os.execv(python, [str(python), __file__, *sys.argv[1:]])
    timer = build_timer()
    rows = [
        compare(timer, name, size, arguments.rounds, arguments.threads)
        for name in NETWORKS
        for size in SIZES
    ]
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    heads = ("size", "deepct ms", "ONNX RT ms", "ratio", "error", "ONNX RT")
    print(f"{'network':<12}" + "".join(f"{head:>12}" for head in heads))
    for row in rows:
        times = (row["deepct_ms"], row["onnxruntime_ms"], row["ratio"])
        errors = (row["deepct_error"], row["onnxruntime_error"])
        print(
            f"{row['network']:<12}{row['size']:>12}"
            + "".join(f"{value:>12.2f}" for value in times)
            + "".join(f"{value:>12.1e}" for value in errors)
        )


def install(python: Path) -> None:
    """Make the environment of the peers."""
    if not python.exists():
        venv.create(VENV, with_pip=True)
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *REQUIREMENTS], check=True)


def build_timer() -> Path:
    """The program that runs our side."""
    subprocess.run(
        ["cargo", "build", "--release", "--quiet", "-p", "deepct-core", "--example", "infer_timer"],
        cwd=ROOT,
        check=True,
    )
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return target / "release" / "examples" / "infer_timer"


def channels_of(views: int, layers: int) -> list[int]:
    """Channels before, between and after the layers of the paper's network."""
    growing = [min(views + 2 * layer, LEVELS) for layer in range(layers)]
    return [*growing, LEVELS]


def make_layers(channels: list[int], random) -> list[tuple]:
    """Weights that hand on most of what they get, as those of a trained network do."""
    import numpy as np

    layers = []
    for inputs, outputs in zip(channels, channels[1:]):
        weight = random.normal(0.0, 0.3 / np.sqrt(9 * inputs), (outputs, inputs, 3, 3))
        for channel in range(min(inputs, outputs)):
            weight[channel, channel, 1, 1] += 0.9
        layers.append((weight.astype(np.float32), np.full(outputs, 0.02, np.float32)))
    return layers


def write_weights(path: Path, channels: list[int], layers: list[tuple]) -> None:
    """The layers as `deepct` reads them (see io/weights.rs)."""
    from safetensors.numpy import save_file

    views = channels[0]
    metadata = {
        "format_version": 1,
        "formation": "none",
        "architecture": {"channels": channels, "last_relu": True},
        "view_geometry": {
            "sun_zenith_deg": 30.0,
            "sun_azimuth_deg": 45.0,
            "view_zenith_deg": [0.0] * views,
            "view_azimuth_deg": [0.0] * views,
            "pixel_km": [0.05] * views,
        },
        "target_altitude_km": 1.0,
        "wavelength_um": 0.672,
        "image_layout": "camera",
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.5, "count": channels[-1], "spacing_km": 0.04},
        "input_scale": 1.0,
        "output_scale": 1.0,
        "training": {"data": "none", "identity": "none", "samples": 0, "seed": 0},
        "scores": {},
        "program": "compare.py",
        "configuration": None,
    }
    tensors = {}
    for index, (weight, bias) in enumerate(layers):
        tensors[f"layers.{index}.weight"], tensors[f"layers.{index}.bias"] = weight, bias
    save_file(tensors, path, {"deepct": json.dumps(metadata)})


def onnx_session(channels: list[int], layers: list[tuple], threads: int):
    """The same network in ONNX Runtime."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants, value = [], [], "images"
    for index, (weight, bias) in enumerate(layers):
        names = [value, f"weight{index}", f"bias{index}"]
        constants += [numpy_helper.from_array(weight, names[1])]
        constants += [numpy_helper.from_array(bias, names[2])]
        nodes.append(helper.make_node("Conv", names, [f"sum{index}"], pads=[1, 1, 1, 1]))
        value = "volume" if index + 1 == len(layers) else f"layer{index}"
        nodes.append(helper.make_node("Relu", [f"sum{index}"], [value]))
    shapes = ([1, channels[0], "rows", "cols"], [1, channels[-1], "rows", "cols"])
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in zip(("images", "volume"), shapes)
    ]
    graph = helper.make_graph(nodes, "network", ends[:1], ends[1:], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # A peer that spins while it waits would take the processor from the other side.
    options.add_session_config_entry("session.force_spinning_stop", "1")
    return onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )


def exact(images, layers: list[tuple]):
    """The network in float64, by the definition of a convolution."""
    import numpy as np

    values = images.astype(np.float64)
    for weight, bias in layers:
        rows, cols = values.shape[1:]
        padded = np.pad(values, ((0, 0), (1, 1), (1, 1)))
        values = np.broadcast_to(bias[:, None, None], (len(bias), rows, cols)).astype(np.float64)
        for row in range(3):
            for col in range(3):
                seen = padded[:, row : row + rows, col : col + cols]
                values += np.tensordot(weight[:, :, row, col].astype(np.float64), seen, 1)
        values = np.maximum(values, 0.0)
    return values


def compare(timer: Path, name: str, size: tuple[int, int], rounds: int, threads: int) -> dict:
    """One row: both sides on one network and one size."""
    import numpy as np

    random = np.random.default_rng(1)
    channels = channels_of(*NETWORKS[name])
    layers = make_layers(channels, random)
    images = random.random((channels[0], *size), np.float32)
    expected = exact(images, layers)
    with tempfile.TemporaryDirectory() as folder:
        weights, source, result = (Path(folder, part) for part in ("w", "input", "output"))
        write_weights(weights, channels, layers)
        images.tofile(source)
        ours = subprocess.Popen(
            [str(part) for part in (timer, weights, source, *size, result)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "RAYON_NUM_THREADS": str(threads)},
        )
        session = onnx_session(channels, layers, threads)

        def run_ours(count: int) -> list[float]:
            ours.stdin.write(f"{count}\n")
            ours.stdin.flush()
            return json.loads(ours.stdout.readline())

        def run_peer(count: int) -> list[float]:
            times = []
            for _ in range(count):
                start = time.perf_counter()
                session.run(None, {"images": images[None]})
                times.append(1e3 * (time.perf_counter() - start))
            return times

        runs = {run_ours: [], run_peer: []}
        # The first turn of each side warms it up and says how many runs make a turn.
        counts = {run: max(1, round(1e3 * SECONDS_A_TURN / min(run(3)))) for run in runs}
        for _ in range(rounds):
            for run, times in runs.items():
                times += run(counts[run])
        ours.stdin.close()
        ours.wait()
        found = np.fromfile(result, np.float32).reshape(expected.shape)
        (peer,) = session.run(None, {"images": images[None]})
    deepct_ms, peer_ms = (statistics.median(times) for times in runs.values())
    deepct_fastest, peer_fastest = (min(times) for times in runs.values())
    return {
        "network": name,
        "size": f"{size[0]}x{size[1]}",
        "threads": threads,
        "deepct_ms": deepct_ms,
        "onnxruntime_ms": peer_ms,
        "ratio": deepct_ms / peer_ms,
        "deepct_fastest_ms": deepct_fastest,
        "onnxruntime_fastest_ms": peer_fastest,
        "deepct_error": relative_error(found, expected),
        "onnxruntime_error": relative_error(peer[0], expected),
    }


def relative_error(found, expected) -> float:
    """Largest error over largest value."""
    return float(abs(found - expected).max() / abs(expected).max())


if __name__ == "__main__":
    main()
