#!/usr/bin/env python3
"""Compare the time of the network with ONNX Runtime, OpenVINO and PyTorch.

    python3 benches/compare.py [--json] [--algorithms] [--rounds N] [--threads N]

builds deepct, installs the other libraries into benches/.venv, and prints a row for each network
and size: the median milliseconds per run of each library, the ratio of deepct to the fastest of
the others, and the largest error of each divided by the largest value in float64. All libraries
run the same trained weights on the same images, which deepct renders. --algorithms compares the
algorithms and kernels of deepct instead.

Each library has its own process, which runs the network the requested number of times and returns
the times. The processes take turns, A B C D A B C D, so that other load on the machine affects all
of them. The threads of some libraries keep spinning after a run, those of ONNX Runtime for about
40 ms. Therefore each turn begins with a pause, in which they go to sleep, and a run to wake them,
which is not counted.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import torch

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / "benches" / ".venv"
PACKAGES = "h5py==3.16.0 numpy==2.4.6 onnx==1.22.0 safetensors==0.8.0"
PEERS = {"onnxruntime": "1.31.0", "openvino": "2026.4.0", "torch": "2.13.0"}
NETWORKS = ("pearls-32", "cloudct-10")
SIZES = ((1, 32, 32), (32, 32, 32), (1, 256, 256))  # images, rows, columns
ALGORITHMS = ("im2col", "direct", "winograd-f2", "winograd-f4")
KERNELS = (
    ("portable", "neon") if platform.machine() == "aarch64" else ("portable", "avx2", "avx512")
)
CLOUDS, CLOUD = 4, 32  # number of rendered clouds; rows and columns of their images
SECONDS_OF_PAUSE, SECONDS_A_TURN = 0.1, 0.1  # duration of the pause and of the counted runs

Layers = list[tuple["np.ndarray", "np.ndarray", bool]]  # weight, bias, whether a ReLU follows


def main() -> None:
    if sys.argv[1:2] == ["serve"]:
        return serve(*sys.argv[2:])
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--algorithms", action="store_true", help="compare deepct's algorithms")
    parser.add_argument("--rounds", type=int, default=11, help="number of turns of each process")
    parser.add_argument("--threads", type=int, default=2, help="threads of each process")
    parser.add_argument("--weights", type=Path, default=ROOT / "benches" / "weights", help="folder")
    options = parser.parse_args()
    files = {name: options.weights / f"{name}.safetensors" for name in NETWORKS}
    if missing := [str(path) for path in files.values() if not path.exists()]:
        sys.exit(f"compare.py: not found: {', '.join(missing)}; give the folder with --weights")
    if Path(sys.prefix).resolve() != VENV.resolve():
        enter_environment()
    programs, rows = build(), []
    commands = list_sides(programs, options.threads, options.algorithms)
    for name, weights in files.items():
        clouds = render(programs / "deepct", name)
        for size in SIZES[::2] if options.algorithms else SIZES:
            row = {"network": name, "size": "{}x{}x{}".format(*size), "threads": options.threads}
            rows.append(row | compare(weights, fill(clouds, size), commands, options.rounds))
            if not options.json:
                (show_algorithms if options.algorithms else show)(rows[-1], heads=len(rows) == 1)
    if options.json:
        print(json.dumps({**provenance(), "rows": rows}, indent=2))


def enter_environment() -> None:
    """Install the other libraries and restart this script in their environment."""
    python = str(VENV / "bin" / "python")
    if not Path(python).exists():
        venv.create(VENV, with_pip=True)
    peers = [f"{name}=={version}" for name, version in PEERS.items()]
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *PACKAGES.split(), *peers], check=True)
    os.execv(python, [python, __file__, *sys.argv[1:]])


def build() -> Path:
    """Build `deepct` and `examples/infer_timer`, and return their folder."""
    command = ["cargo", "build", "--release", "--quiet", "--bins", "--example", "infer_timer"]
    subprocess.run(command, cwd=ROOT, check=True)
    return Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"


def load_weights(path: Path) -> Layers:
    """The layers of a weights file. The scales are included in the first and last weights."""
    import numpy as np
    from safetensors import safe_open

    with safe_open(path, framework="numpy") as file:
        metadata = json.loads(file.metadata()["deepct"])
        if metadata["image_layout"] != "camera":
            sys.exit(f"{path}: resamples images onto planes; this script compares layers only")
        architecture, layers = metadata["architecture"], []
        count = len(architecture["channels"]) - 1
        for index in range(count):
            weight, bias = map(file.get_tensor, (f"layers.{index}.weight", f"layers.{index}.bias"))
            layers.append((weight, bias, index + 1 < count or architecture["last_relu"]))
    incoming, outgoing = np.float32([metadata["input_scale"], metadata["output_scale"]])
    layers[0] = (incoming * layers[0][0], *layers[0][1:])
    layers[-1] = (outgoing * layers[-1][0], outgoing * layers[-1][1], layers[-1][2])
    return layers


def render(deepct: Path, formation: str) -> np.ndarray:
    """Noisy images of several clouds, `[cloud, view, row, col]` (1/sr)."""
    import h5py
    import numpy as np

    stacks = []
    with tempfile.TemporaryDirectory() as folder:
        cloud, images, noisy = (f"{folder}/{part}.nc" for part in ("cloud", "images", "noisy"))
        for seed in range(CLOUDS):
            for verb in (
                ["cloud", "generate", "--out", cloud],
                ["render", cloud, "--views", formation, "--samples", "128", "--out", images],
                ["sense", images, "--out", noisy],
            ):
                subprocess.run([deepct, *verb, "--seed", str(seed), "--quiet"], check=True)
            with h5py.File(noisy) as file:
                stacks.append(np.asarray(file["radiance"], np.float32))
    return np.stack(stacks)


def fill(clouds: np.ndarray, size: tuple[int, int, int]) -> np.ndarray:
    """Images of any size, tiled with the clouds, which are flipped and shifted differently."""
    import numpy as np

    count, rows, cols = size
    filled = np.empty((count, clouds.shape[1], rows, cols), np.float32)
    for index, (image, row, col) in enumerate(np.ndindex(count, rows // CLOUD, cols // CLOUD)):
        tile = np.roll(clouds[index % CLOUDS], (5 * index, 3 * index + index // CLOUD), (1, 2))
        tile = tile[:, :: 1 - 2 * (index // 4 % 2), :: 1 - 2 * (index // 8 % 2)]
        filled[image, :, CLOUD * row :, CLOUD * col :][:, :CLOUD, :CLOUD] = tile
    return filled


def list_sides(programs: Path, threads: int, algorithms: bool) -> dict[str, tuple[list, dict]]:
    """The beginning of the command and the environment of each process."""
    timer, environment = [programs / "examples" / "infer_timer"], os.environ.copy()
    environment["RAYON_NUM_THREADS"] = str(threads)
    sides = {"deepct": (timer, environment)}
    if not algorithms:
        this = [sys.executable, __file__, "serve"]
        return sides | {peer: ([*this, peer, str(threads)], environment) for peer in PEERS}
    for algorithm, kernel in ((one, other) for one in ALGORITHMS for other in KERNELS):
        forced = {"DEEPCT_ALGORITHM": algorithm, "DEEPCT_KERNEL": kernel}
        sides[f"{algorithm} {kernel}"] = (timer, environment | forced)
    sides["bfloat16"] = (timer, environment | {"DEEPCT_PRECISION": "bfloat16"})
    return sides


@dataclass
class Side:
    """A process that runs the network, and the milliseconds of its runs."""

    process: subprocess.Popen[str]
    times: list[float] = field(default_factory=list)
    runs: int = 3

    def take_turn(self) -> list[float]:
        """The milliseconds of the runs of one turn; empty if the process cannot run."""
        time.sleep(SECONDS_OF_PAUSE)
        try:
            print(self.runs + 1, file=self.process.stdin, flush=True)
            return json.loads(self.process.stdout.readline() or "[]")[1:]
        except BrokenPipeError:
            return []


def compare(weights: Path, images: np.ndarray, commands: dict, rounds: int) -> dict:
    """Compare all processes, in turns, for one network and one size."""
    import numpy as np

    expected = exact(load_weights(weights), images)
    count, _, rows, cols = images.shape
    sides: dict[str, Side] = {}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with tempfile.TemporaryDirectory() as folder:
        images.tofile(f"{folder}/input")
        for name, (command, environment) in commands.items():
            files = [weights, f"{folder}/input", count, rows, cols, f"{folder}/{name}"]
            full = [str(part) for part in (*command, *files)]
            side = Side(subprocess.Popen(full, env=environment, **pipes))
            if times := side.take_turn():
                side.runs = max(1, round(1e3 * SECONDS_A_TURN / min(times)))
                sides[name] = side
            elif name in ("deepct", *PEERS):
                sys.exit(f"compare.py: {name} does not run: {shlex.join(side.process.args)}")
        for _ in range(rounds):
            for side in sides.values():
                side.times += side.take_turn()
        found = {}
        for name, side in sides.items():
            side.process.communicate()
            if side.process.returncode:
                sys.exit(f"compare.py: {name} failed: {shlex.join(side.process.args)}")
            answer = np.fromfile(f"{folder}/{name}", np.float32).reshape(expected.shape)
            error = float(abs(answer - expected).max() / abs(expected).max())
            median, fastest = statistics.median(side.times), min(side.times)
            found[name] = {"median_ms": median, "fastest_ms": fastest, "error": error}
    others = min(side["median_ms"] for name, side in found.items() if name != "deepct")
    return {"ratio_to_fastest": found["deepct"]["median_ms"] / others, "sides": found}


def show(row: dict, heads: bool) -> None:
    """Print one row with the results of all libraries."""
    sides, place = row["sides"], f"{row['network']:<11}{row['size']:>9}"
    if heads:
        names = "".join(f"{name:>12}" for name in sides)
        print(f"{'':20}{'milliseconds':>12}{'':{12 * len(sides)}}{'error':>12}")
        print(f"{'network':<11}{'size':>9}{names}{'ratio':>12}{names}")
    times = "".join(f"{side['median_ms']:>12.2f}" for side in sides.values())
    errors = "".join(f"{side['error']:>12.1e}" for side in sides.values())
    print(f"{place}{times}{row['ratio_to_fastest']:>12.2f}{errors}", flush=True)


def show_algorithms(row: dict, heads: bool) -> None:
    """Print one row for each algorithm, relative to the default choice of deepct."""
    if heads:
        print(f"{'network':<11}{'size':>9}  {'side':<20}{'ms':>12}{'to deepct':>12}{'error':>12}")
    for name, side in row["sides"].items():
        relative = side["median_ms"] / row["sides"]["deepct"]["median_ms"]
        values = f"{side['median_ms']:>12.2f}{relative:>12.2f}{side['error']:>12.1e}"
        print(f"{row['network']:<11}{row['size']:>9}  {name:<20}{values}", flush=True)


def provenance() -> dict:
    """The information that is required to repeat a measurement."""
    git = ["git", "describe", "--always", "--dirty", "--exclude=*", "--abbrev=12"]
    source = Path("/proc/cpuinfo")
    lines = source.read_text().splitlines() if source.exists() else []
    fields = dict(map(str.strip, line.partition(":")[::2]) for line in lines)
    known = {key: fields[key] for key in ("model name", "cpu family", "model") if key in fields}
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": subprocess.run(git, cwd=ROOT, capture_output=True, text=True).stdout.strip(),
        "command": shlex.join(["python3", "benches/compare.py", *sys.argv[1:]]),
        "processor": {"machine": platform.machine(), **known},
        "versions": PEERS,
    }


def torch_network(layers: Layers) -> torch.nn.Module:
    """The network in PyTorch, with unchanged weights."""
    from torch import from_numpy, nn

    modules: list[nn.Module] = []
    for weight, bias, relu in layers:
        convolution = nn.Conv2d(weight.shape[1], weight.shape[0], 3, padding=1)
        convolution.weight.data, convolution.bias.data = from_numpy(weight), from_numpy(bias)
        modules += [convolution, nn.ReLU(inplace=True)] if relu else [convolution]
    return nn.Sequential(*modules).eval()


def exact(layers: Layers, images: np.ndarray) -> np.ndarray:
    """The output of the network in float64."""
    import torch

    with torch.inference_mode():
        return torch_network(layers).double()(torch.from_numpy(images).double()).numpy()


def onnx_model(layers: Layers, images: np.ndarray) -> bytes:
    """The network in ONNX, for images of this shape."""
    from onnx import TensorProto, helper, numpy_helper

    nodes, constants, value = [], [], "images"
    for index, (weight, bias, relu) in enumerate(layers):
        names = [value, f"weight{index}", f"bias{index}"]
        constants += map(numpy_helper.from_array, (weight, bias), names[1:])
        nodes.append(helper.make_node("Conv", names, [value := f"sum{index}"], pads=[1, 1, 1, 1]))
        if relu:
            nodes.append(helper.make_node("Relu", [value], [value := f"layer{index}"]))
    describe, kind = helper.make_tensor_value_info, TensorProto.FLOAT
    first = describe("images", kind, images.shape)
    last = describe(value, kind, (len(images), len(layers[-1][1]), *images.shape[2:]))
    graph = helper.make_graph(nodes, "network", [first], [last], constants)
    opset = helper.make_opsetid("", 17)
    return helper.make_model(graph, opset_imports=[opset], ir_version=10).SerializeToString()


def start_onnxruntime(layers: Layers, images: np.ndarray, threads: int) -> Callable:
    import numpy as np
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    model, providers = onnx_model(layers, images), ["CPUExecutionProvider"]
    session = onnxruntime.InferenceSession(model, options, providers=providers)
    (output,), binding = session.get_outputs(), session.io_binding()
    result = np.empty(output.shape, np.float32)
    binding.bind_cpu_input("images", images)
    binding.bind_output(output.name, "cpu", 0, np.float32, result.shape, result.ctypes.data)
    return lambda: session.run_with_iobinding(binding) or result


def start_openvino(layers: Layers, images: np.ndarray, threads: int) -> Callable:
    import openvino

    settings = {"INFERENCE_PRECISION_HINT": "f32", "PERFORMANCE_HINT": "LATENCY"}
    core = openvino.Core()
    model = core.read_model(onnx_model(layers, images))
    compiled = core.compile_model(model, "CPU", settings | {"INFERENCE_NUM_THREADS": threads})
    request = compiled.create_infer_request()
    request.set_input_tensor(openvino.Tensor(images, shared_memory=True))
    return lambda: request.infer() and request.get_output_tensor().data


def start_torch(layers: Layers, images: np.ndarray, threads: int) -> Callable:
    import torch

    torch.set_num_threads(threads)
    module = torch_network(layers).to(memory_format=torch.channels_last)
    pixels = torch.from_numpy(images).to(memory_format=torch.channels_last)
    return torch.inference_mode()(lambda: module(pixels).numpy())


def serve(peer: str, threads: str, weights: str, source: str, *rest: str) -> None:
    """Run the process of a library: read numbers of runs from standard input, print the times."""
    import numpy as np

    count, rows, cols = map(int, rest[:3])
    images = np.fromfile(source, np.float32).reshape(count, -1, rows, cols)
    starts = {"onnxruntime": start_onnxruntime, "openvino": start_openvino, "torch": start_torch}
    run = starts[peer](load_weights(Path(weights)), images, int(threads))
    run().tofile(rest[3])
    for line in sys.stdin:
        times = []
        for _ in range(int(line)):
            start = time.perf_counter()
            run()
            times.append(1e3 * (time.perf_counter() - start))
        print(json.dumps(times), flush=True)


if __name__ == "__main__":
    main()
