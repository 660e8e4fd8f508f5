"""Images of training scenes: by the Monte Carlo program ``photon_paths.cu`` on a GPU or the CPU, or
by ``deepct_py``.

Both give the same radiance within their noise, which the tests compare. On a GPU, the Monte Carlo
program is compiled by nvcc where it is installed and otherwise by NVRTC, which PyTorch contains.
"""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from weights_tools.droplets import droplet_table, table_index
from weights_tools.errors import InputError
from weights_tools.scenes import Scene

SOURCE = Path(__file__).with_name("photon_paths.cu")

AIR_EXTINCTION = 0.00509
"""Rayleigh extinction at the surface (1/km) at 0.672 um (Bodhaine et al. 1999, equation 29)."""
AIR_HEIGHT_KM = 8.45
"""Scale height for which the optical depth of the air is that of equation 30, 0.0430."""

PIXELS = 32
"""Rows and columns of the images."""

FEW = 256
"""Number of photon paths of a pixel whose lines of sight meet no cloud."""

COMPILERS = ("c++", "g++", "clang++")
_FLAGS = ["-x", "c++", "-std=c++14", "-O3", "-ffast-math", "-shared", "-fPIC"]
_BLOCK = 256


class Renderer(Protocol):
    """A method of computing images."""

    def render(self, scenes: Sequence[Scene]) -> np.ndarray:
        """The radiance (1/sr) of scenes with equal numbers of views, float32
        ``[n, v, row, col]``. It depends on the scene only, not on the others."""


class DeepctRenderer:
    """Images by ``deepct_py``: by discrete ordinates, or by its Monte Carlo solver."""

    def __init__(
        self, solver: str = "ordinates", noise: float = 0.05, samples: int | None = None
    ) -> None:
        """``noise`` is the relative noise of the bright pixels up to which the Monte Carlo solver
        continues, and the accuracy of the ordinates; ``samples`` is the number of photon paths of a
        pixel instead.

        Raises :class:`InputError` if ``deepct_py`` is not installed.
        """
        try:
            import deepct_py
        except ImportError as problem:
            remedy = "install deepct_py, or render with --renderer photon-paths"
            raise InputError("deepct_py", f"cannot be imported ({problem})", remedy) from None
        self._deepct: Any = deepct_py
        self.solver = solver
        error = "accuracy" if solver == "ordinates" else "noise"
        self._accuracy = {error: noise} if samples is None else {"samples": samples}

    def render(self, scenes: Sequence[Scene]) -> np.ndarray:
        return np.stack([self._one(scene) for scene in scenes])

    def _one(self, scene: Scene) -> np.ndarray:
        deepct = self._deepct
        levels, rows, cols = scene.extinction.shape
        voxel, level = scene.voxel_km, scene.level_km
        corner = (-0.5 * cols * voxel, -0.5 * rows * voxel, scene.bottom_km)
        grid = deepct.Grid((levels, rows, cols), (voxel, voxel, level), corner)
        target = np.array([0.0, 0.0, scene.bottom_km + 0.5 * levels * level])
        positions = target + scene.towards * scene.distance_km[:, None]
        views = [
            deepct.View.perspective(tuple(position), tuple(target), tangent, (PIXELS, PIXELS))
            for position, tangent in zip(positions, scene.pixel_km / scene.distance_km)
        ]
        light = deepct.Light(
            sun_zenith_deg=float(np.degrees(np.arccos(scene.sun[2]))),
            sun_azimuth_deg=float(np.degrees(np.arctan2(scene.sun[0], scene.sun[1]))) % 360.0,
            air=True,
            phase="mie",
            extinction="mie",
            surface_albedo=scene.albedo,
        )
        rendering = deepct.render(
            scene.extinction,
            grid,
            views,
            light,
            solver=self.solver,
            **self._accuracy,
            seed=scene.seed,
            effective_radius=scene.effective_radius,
            estimate_error=False,
        )
        return np.asarray(rendering.radiance, np.float32)


class PhotonRenderer:
    """Images by the Monte Carlo program of this package."""

    def __init__(self, device: str = "cpu", few: int = FEW, many: int = 1024) -> None:
        """``many`` is the number of paths of a pixel, and ``few`` that of a pixel whose first
        ``few`` lines of sight meet no cloud (multiples of 32).

        Raises :class:`InputError` if the program cannot be compiled.
        """
        self.device = torch.device(device)
        self.few, self.many = few, max(few, many)
        self._run = _gpu_program(self.device) if self.device.type == "cuda" else _cpu_program()

    def render(self, scenes: Sequence[Scene]) -> np.ndarray:
        return self.render_on_device(scenes).cpu().numpy()

    def render_on_device(self, scenes: Sequence[Scene]) -> torch.Tensor:
        """As :meth:`render`, on the device."""
        shape = scenes[0].extinction.shape
        index = np.stack([table_index(scene.effective_radius) for scene in scenes])
        extinction = np.stack([scene.extinction for scene in scenes]).astype(np.float32)
        removed = droplet_table().removed
        extinction *= 1.0 - np.interp(index, np.arange(len(removed)), removed).astype(np.float32)
        views = [_view_records(scene) for scene in scenes]
        count = len(views[0])
        sizes = _Sizes(
            len(scenes),
            count,
            PIXELS,
            PIXELS,
            shape[0],
            shape[1],
            self.few,
            self.many,
            *(table.shape[1] for table in (droplet_table().phase, droplet_table().cosine)),
        )
        radiance = torch.empty(len(scenes), count, PIXELS, PIXELS, device=self.device)
        inputs = [
            self._put(np.array([_scene_record(scene) for scene in scenes], _SCENE)),
            self._put(np.stack(views)),
            self._put(extinction),
            self._put(index),
            *self._tables,
        ]
        arrays = _Arrays(*(tensor.data_ptr() for tensor in (*inputs, radiance)))
        self._run(sizes, arrays)
        return radiance

    @cached_property
    def _tables(self) -> tuple[torch.Tensor, torch.Tensor]:
        table = droplet_table()
        return self._put(table.phase), self._put(table.cosine)

    def _put(self, values: np.ndarray) -> torch.Tensor:
        flat = np.ascontiguousarray(values).view(np.uint8).reshape(-1)
        return torch.from_numpy(flat.copy()).to(self.device)


def renderer_of(name: str, paths: int) -> Renderer:
    """The renderer with a name: ``ordinates`` or ``monte-carlo`` for the solvers of ``deepct_py``,
    ``photon-paths`` for the program of this package with ``paths`` photon paths of a cloudy pixel,
    and ``auto`` for the latter on a GPU and without ``deepct_py``, and otherwise for ordinates.

    Raises :class:`InputError` if it cannot be used.
    """
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "auto":
        installed = importlib.util.find_spec("deepct_py") is not None
        name = "photon-paths" if device == "cuda" or not installed else "ordinates"
    if name == "photon-paths":
        return PhotonRenderer(device, few=min(FEW, paths), many=paths)
    return DeepctRenderer(name)


_SCENE = np.dtype(
    [
        ("voxel", "f4"),
        ("level", "f4"),
        ("bottom", "f4"),
        ("sun", "f4", 3),
        ("albedo", "f4"),
        ("air", "f4"),
        ("air_height", "f4"),
        ("low", "i4", 3),
        ("high", "i4", 3),
        ("seed", "u4"),
    ]
)
_VIEW = np.dtype([("towards", "f4", 3), ("distance", "f4"), ("pixel", "f4")])


class _Sizes(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_int)
        for name in (
            *("scenes", "views", "rows", "cols", "levels", "voxels"),
            *("few", "many", "angles", "cumulative"),
        )
    ]


class _Arrays(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("scenes", "views", "extinction", "droplets", "phase", "cosine", "radiance")
    ]


def _scene_record(scene: Scene) -> tuple[Any, ...]:
    cloudy = scene.extinction > 0.0
    # The extent of the cloud along x, y and z.
    low, high = [], []
    for others in ((0, 1), (0, 2), (1, 2)):
        at = np.flatnonzero(cloudy.any(others))
        low.append(int(at[0]) if len(at) else 0)
        high.append(int(at[-1]) + 1 if len(at) else 0)
    sizes = (scene.voxel_km, scene.level_km, scene.bottom_km)
    air = (AIR_EXTINCTION, AIR_HEIGHT_KM)
    return (*sizes, tuple(scene.sun), scene.albedo, *air, low, high, scene.seed % 2**32)


def _view_records(scene: Scene) -> np.ndarray:
    records = np.zeros(len(scene.distance_km), _VIEW)
    records["towards"] = scene.towards
    records["distance"] = scene.distance_km
    records["pixel"] = scene.pixel_km
    return records


def _cpu_program() -> Any:
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        remedy = "install g++ or clang++, or render with --renderer deepct"
        raise InputError("photon_paths", "no C++ compiler was found", remedy)
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "photon_paths.so")
        _compile([compiler, *_FLAGS, "-march=native", str(SOURCE), "-o", str(library)])
        program = ctypes.CDLL(str(library))

    def run(sizes: _Sizes, arrays: _Arrays) -> None:
        program.render(ctypes.byref(sizes), ctypes.byref(arrays))

    return run


def _gpu_program(device: torch.device) -> Any:
    torch.cuda.init()
    with torch.cuda.device(device):
        # The first allocation creates the context in which the program is loaded.
        torch.zeros(1, device=device)
        architecture = "sm_{}{}".format(*torch.cuda.get_device_capability(device))
        binary = gpu_binary(architecture)
        driver = ctypes.CDLL("libcuda.so.1")
        module, function = ctypes.c_void_p(), ctypes.c_void_p()
        _succeed(driver.cuModuleLoadData(ctypes.byref(module), binary), "cuModuleLoadData")
        status = driver.cuModuleGetFunction(ctypes.byref(function), module, b"render")
        _succeed(status, "cuModuleGetFunction")

    def run(sizes: _Sizes, arrays: _Arrays) -> None:
        warps = sizes.scenes * sizes.views * sizes.rows * sizes.cols
        blocks = (32 * warps + _BLOCK - 1) // _BLOCK
        parameters = (ctypes.c_void_p * 2)(ctypes.addressof(sizes), ctypes.addressof(arrays))
        stream = ctypes.c_void_p(torch.cuda.current_stream(device).cuda_stream)
        grid = (blocks, 1, 1, _BLOCK, 1, 1, 0)
        status = driver.cuLaunchKernel(function, *grid, stream, parameters, None)
        _succeed(status, "cuLaunchKernel")
        # The inputs may be released when this function returns.
        torch.cuda.current_stream(device).synchronize()

    return run


def gpu_binary(architecture: str) -> bytes:
    """The program for a GPU architecture such as ``sm_90``, compiled by nvcc or NVRTC.

    Raises :class:`InputError` if there is neither, or if the compilation fails.
    """
    compiler = shutil.which("nvcc")
    if compiler is None:
        return _nvrtc(architecture)
    with tempfile.TemporaryDirectory() as folder:
        binary = Path(folder, "photon_paths.cubin")
        flags = ["-cubin", f"-arch={architecture}", "-O3", "--use_fast_math", "-std=c++17"]
        _compile([compiler, *flags, str(SOURCE), "-o", str(binary)])
        return binary.read_bytes()


def _nvrtc(architecture: str) -> bytes:
    library = _nvrtc_library()
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    source = SOURCE.read_bytes()
    status = library.nvrtcCreateProgram(
        ctypes.byref(program), source, b"photon_paths.cu", 0, None, None
    )
    _succeed(status, "nvrtcCreateProgram")
    options = [f"--gpu-architecture={architecture}", "--use_fast_math", "--std=c++17"]
    array = (ctypes.c_char_p * len(options))(*(option.encode() for option in options))
    status = library.nvrtcCompileProgram(program, len(options), array)
    if status != 0:
        library.nvrtcGetProgramLogSize(program, ctypes.byref(size))
        log = ctypes.create_string_buffer(size.value)
        library.nvrtcGetProgramLog(program, log)
        problem = " ".join(log.value.decode().split())[:400]
        raise InputError("photon_paths.cu", f"NVRTC failed: {problem}", "report this")
    _succeed(library.nvrtcGetCUBINSize(program, ctypes.byref(size)), "nvrtcGetCUBINSize")
    binary = ctypes.create_string_buffer(size.value)
    _succeed(library.nvrtcGetCUBIN(program, binary), "nvrtcGetCUBIN")
    library.nvrtcDestroyProgram(ctypes.byref(program))
    return binary.raw


def _nvrtc_library() -> Any:
    """NVRTC from the folders of PyTorch's packages or of the system."""
    site = Path(torch.__file__).parents[1]
    found = [*site.glob("nvidia/**/libnvrtc.so*"), *site.glob("torch/lib/libnvrtc*.so*")]
    names = [str(path) for path in sorted(found) if "builtins" not in path.name]
    for name in (*names, "libnvrtc.so", "libnvrtc.so.12", "libnvrtc.so.13", "libnvrtc.so.11.2"):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    remedy = "install the CUDA toolkit, or the package nvidia-cuda-nvrtc-cu12"
    raise InputError("photon_paths", "neither nvcc nor NVRTC was found", remedy)


def _compile(command: list[str]) -> None:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        problem = " ".join(result.stderr.split())[:400]
        raise InputError(SOURCE, f"{command[0]} failed: {problem}", "use another compiler")


def _succeed(status: int, call: str) -> None:
    if status != 0:
        raise InputError("CUDA", f"{call} returned the error {status}", "check the driver")
