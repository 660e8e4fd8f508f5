"""Reading of data sets written by ``deepct dataset generate``."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
from torch import Tensor

from weights_tools.errors import InputError
from weights_tools.files import read_file

FORMAT = "deepct-dataset 2"
"""The current format of manifests."""
FORMATS = ("deepct-dataset 1", FORMAT)
"""The formats that can be read. In the first one, the light is distributed over the settings."""

CLOUDCT_10_DEG = (-46.0, -34.0, -26.0, -18.0, -9.0, 0.0, 9.0, 18.0, 26.0, 34.0)
"""View zenith angles of the paper's 10 satellites (degrees), negative for views from the south."""

SPLITS = ("train", "validation", "test")
"""The splits of a data set. The test split is not used by this package."""

SAME_DIRECTION_DEG = 0.1
"""Largest angle between two directions that are regarded as the same view (degrees)."""

_BY_VIEW = ("view_zenith_deg", "view_azimuth_deg", "pixel_km")

_REMEDY = "write the dataset again with `deepct dataset generate`"


@dataclass(frozen=True)
class ViewGeometry:
    """Geometry of the images; tuples have one entry per view, in the order of the images."""

    sun_zenith_deg: float
    sun_azimuth_deg: float
    view_zenith_deg: tuple[float, ...]
    """View zenith angle: the angle at the target between +z and each satellite, not negative."""
    view_azimuth_deg: tuple[float, ...]
    """Azimuth from the target to each satellite, clockwise from north."""
    pixel_km: tuple[float, ...]
    """Size of a pixel at the target, perpendicular to the line of sight for a camera at a finite
    distance and in the horizontal plane for parallel rays."""
    camera_distance_km: tuple[float | None, ...] = ()
    """Distance of each camera from the target; ``None`` for parallel rays."""

    def __len__(self) -> int:
        return len(self.view_zenith_deg)

    def select(self, views: list[int]) -> ViewGeometry:
        """The geometry of a subset of the views, in the given order."""
        return ViewGeometry(
            self.sun_zenith_deg,
            self.sun_azimuth_deg,
            tuple(self.view_zenith_deg[view] for view in views),
            tuple(self.view_azimuth_deg[view] for view in views),
            tuple(self.pixel_km[view] for view in views),
            tuple(self.camera_distance_km[view] for view in views if self.camera_distance_km),
        )

    def find(self, zenith_deg: float, azimuth_deg: float) -> int:
        """The index of the view in the given direction.

        Raises ``ValueError`` if no view is within :data:`SAME_DIRECTION_DEG` of it.
        """
        wanted = _direction(zenith_deg, azimuth_deg)
        angles = [
            math.degrees(math.acos(min(1.0, float(wanted @ _direction(*angles)))))
            for angles in zip(self.view_zenith_deg, self.view_azimuth_deg)
        ]
        nearest = int(np.argmin(angles))
        if angles[nearest] > SAME_DIRECTION_DEG:
            raise ValueError(f"no view at zenith {zenith_deg}, azimuth {azimuth_deg} degrees")
        return nearest


def _direction(zenith_deg: float, azimuth_deg: float) -> np.ndarray:
    zenith, azimuth = math.radians(zenith_deg), math.radians(azimuth_deg)
    return np.array(
        [
            math.sin(zenith) * math.sin(azimuth),
            math.sin(zenith) * math.cos(azimuth),
            math.cos(zenith),
        ]
    )


@dataclass(frozen=True)
class Samples:
    """Clouds and their images."""

    volumes: Tensor
    """Extinction ``[n, z, y, x]`` (1/km), or ``[n, 2, z, y, x]`` with, second, its product with the
    effective radius (um/km). Where clouds are added, both are sums, and the quotient is the
    effective radius of all droplets."""
    radiance: Tensor
    """``[n, view, row, col]`` (1/sr): the views of the first band, then those of the next one."""

    def __len__(self) -> int:
        return len(self.volumes)

    @property
    def extinction(self) -> Tensor:
        """``[n, z, y, x]`` (1/km)."""
        return first_volume(self.volumes)


def first_volume(volumes: Tensor) -> Tensor:
    """The extinction of clouds, which may be the first of several quantities."""
    return volumes if volumes.ndim == 4 else volumes[:, 0]


@dataclass(frozen=True)
class Dataset:
    """The training and validation samples of a folder in memory, for one formation."""

    formation: str
    geometry: ViewGeometry
    wavelengths_um: tuple[float, ...]
    """The wavelength of each band."""
    train: Samples
    validation: Samples
    folder: Path
    views: tuple[int, ...]
    """The indices of these views among those of a band in the folder."""
    manifest: dict[str, Any]
    identity: str
    """SHA-256 of the manifest, which contains the SHA-256 of every sample."""

    def files(self, split: str) -> list[Path]:
        """The files of a split, in the order of its samples."""
        samples = self.manifest["samples"]
        return [self.folder / sample["file"] for sample in samples if sample["split"] == split]

    @property
    def name(self) -> str:
        """The names of the simulations that contain the training clouds."""
        sources = {
            Path(sample["source"]).stem
            for sample in self.manifest["samples"]
            if sample["split"] == "train"
        }
        return ", ".join(sorted(sources))

    @property
    def levels(self) -> int:
        return self.train.extinction.shape[1]

    @property
    def image_geometry(self) -> ViewGeometry:
        """The geometry of all images: that of the views, for each band."""
        return self.geometry.select([*range(len(self.geometry))] * len(self.wavelengths_um))

    @property
    def voxel_spacing_km(self) -> tuple[float, float, float]:
        dx, dy, dz = self.manifest["voxel_spacing_km"]
        return dx, dy, dz


def load_dataset(
    folder: str | Path,
    formation: str | None = None,
    required: Sequence[str] = ("train", "validation"),
    effective_radius: bool = False,
) -> Dataset:
    """Load the samples of a folder written by ``deepct dataset generate``.

    ``formation`` selects the views: the formation of the folder itself (or ``None``), or
    ``cloudct-10`` from any folder that contains its ten directions. Splits that are not in
    ``required``, which names at least one, may be empty. With ``effective_radius``, the volumes
    include it.

    Raises :class:`InputError` if the manifest is missing or incomplete, if a sample is missing,
    damaged, of the wrong shape or has impossible values, and if the folder lacks a view.
    """
    folder = Path(folder)
    manifest, identity = _read_manifest(folder / "manifest.json")
    geometry = _geometry(manifest, folder / "manifest.json")
    views = _views(geometry, manifest["formation"], formation, folder / "manifest.json")
    splits: dict[str, list[tuple[Tensor, Tensor]]] = {"train": [], "validation": []}
    for sample in manifest["samples"]:
        if sample["split"] not in splits:
            continue
        volumes, radiance = _read_sample(folder, sample, manifest, len(geometry), effective_radius)
        splits[sample["split"]].append((volumes, radiance[:, views].flatten(0, 1)))
    for split in required:
        if not splits[split]:
            raise InputError(folder / "manifest.json", f"has no {split} sample", _REMEDY)
    # Values that all samples have in common, but that the manifest does not contain.
    first = next(sample for sample in manifest["samples"] if sample["split"] in splits)
    distances, wavelengths_um = _cameras(folder / first["file"], len(geometry))
    some = next(samples[0] for samples in splits.values() if samples)
    none = Samples(*(torch.zeros(0, *part.shape) for part in some))
    train, validation = (
        Samples(*(torch.stack(part) for part in zip(*splits[split]))) if splits[split] else none
        for split in ("train", "validation")
    )
    name = formation or manifest["formation"]
    geometry = replace(geometry, camera_distance_km=distances)
    return Dataset(
        name,
        geometry.select(views),
        wavelengths_um,
        train,
        validation,
        folder,
        tuple(views),
        manifest,
        identity,
    )


def _read_manifest(path: Path) -> tuple[dict[str, Any], str]:
    text = read_file(path, _REMEDY)
    try:
        manifest = json.loads(text)
    except ValueError as problem:
        raise InputError(path, f"is not JSON ({problem})", _REMEDY) from None
    if not isinstance(manifest, dict) or manifest.get("format") not in FORMATS:
        raise InputError(path, f'"format" is not "{FORMAT}"', _REMEDY)
    for key in ("formation", "geometry", "image_shape", "voxel_spacing_km", "levels", "samples"):
        if key not in manifest:
            raise InputError(path, f'"{key}" is missing', _REMEDY)
    for key in ("sun_zenith_deg", "sun_azimuth_deg", *_BY_VIEW):
        if key not in manifest["geometry"]:
            raise InputError(path, f'"geometry.{key}" is missing', _REMEDY)
    for index, sample in enumerate(manifest["samples"]):
        missing = {"file", "split", "source", "sha256"} - set(sample)
        if missing:
            raise InputError(path, f"sample {index} has no {sorted(missing)[0]!r}", _REMEDY)
        if sample["split"] not in SPLITS:
            problem = f"sample {index} has split {sample['split']!r}"
            raise InputError(path, problem, f"a split is one of {', '.join(SPLITS)}")
    return manifest, hashlib.sha256(text).hexdigest()


def _geometry(manifest: dict[str, Any], path: Path) -> ViewGeometry:
    """The geometry without the camera distances, which only the samples contain."""
    geometry = manifest["geometry"]
    lists = {key: tuple(float(value) for value in geometry[key]) for key in _BY_VIEW}
    if len({len(values) for values in lists.values()}) != 1:
        problem = "view_zenith_deg, view_azimuth_deg and pixel_km have different lengths"
        raise InputError(path, problem, _REMEDY)
    return ViewGeometry(geometry["sun_zenith_deg"], geometry["sun_azimuth_deg"], **lists)


def _cameras(path: Path, views: int) -> tuple[tuple[float | None, ...], tuple[float, ...]]:
    """The camera distances from the target (km) and the wavelengths (um) of a sample."""
    with h5py.File(path, "r") as file:
        missing = sorted({"camera_position", "target", "wavelength"} - set(file))
        if missing:
            raise InputError(path, f"has no variable {missing[0]}", _REMEDY)
        offsets = file["camera_position"][...] - file["target"][...]
        wavelengths_um = tuple(np.atleast_1d(file["wavelength"][()]).astype(float).tolist())
    if offsets.shape != (views, 3):
        raise InputError(path, f"camera_position is not of {views} views", _REMEDY)
    distances = np.linalg.norm(offsets, axis=1)
    return tuple(float(at) if math.isfinite(at) else None for at in distances), wavelengths_um


def _views(geometry: ViewGeometry, has: str, wants: str | None, path: Path) -> list[int]:
    if wants in (None, has):
        return list(range(len(geometry)))
    if wants != "cloudct-10":
        remedy = "use the folder's own formation or cloudct-10"
        raise InputError(path, f"its views are {has}, not {wants}", remedy)
    try:
        return [geometry.find(abs(zenith), 180.0 * (zenith < 0.0)) for zenith in CLOUDCT_10_DEG]
    except ValueError as problem:
        raise InputError(path, str(problem), f"render the views of {wants}") from None


def _read_sample(
    folder: Path,
    sample: dict[str, Any],
    manifest: dict[str, Any],
    views: int,
    effective_radius: bool,
) -> tuple[Tensor, Tensor]:
    """The volumes of :class:`Samples`, and the radiance ``[band, view, row, col]``."""
    path = folder / sample["file"]
    content = read_file(path, _REMEDY)
    if hashlib.sha256(content).hexdigest() != sample["sha256"]:
        problem = "is not the file that the manifest names (its SHA-256 differs)"
        raise InputError(path, problem, _REMEDY)
    levels = manifest["levels"]["count"]
    names = ["extinction", "radiance", "reff"] if effective_radius else ["extinction", "radiance"]
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            found = {name: _read_variable(file, name, path) for name in names}
    except OSError as problem:
        raise InputError(path, f"is not a readable HDF5 file ({problem})", _REMEDY) from None
    rows, cols = manifest["image_shape"]
    bands = len(manifest.get("configuration", {}).get("bands", ()))
    images = (views, rows, cols) if bands < 2 else (bands, views, rows, cols)
    for name, values in found.items():
        shape = images if name == "radiance" else (levels, rows, cols)
        if tuple(values.shape) != shape:
            problem = f"{name} has shape {tuple(values.shape)}, not {shape}"
            raise InputError(path, problem, _REMEDY)
        if values.amax() <= 0.0:
            raise InputError(path, f"{name} is zero everywhere", "leave the sample out")
    volumes = extinction = found["extinction"]
    if effective_radius:
        volumes = torch.stack([extinction, extinction * found["reff"]])
    return volumes, found["radiance"].reshape(-1, views, rows, cols)


def _read_variable(file: h5py.File, name: str, path: Path) -> Tensor:
    if not isinstance(file.get(name), h5py.Dataset):
        raise InputError(path, f"has no variable {name}", _REMEDY)
    values = torch.from_numpy(file[name][...].astype(np.float32))
    if not torch.isfinite(values).all() or values.amin() < 0.0:
        raise InputError(path, f"{name} has a value that is negative or not finite", _REMEDY)
    return values
