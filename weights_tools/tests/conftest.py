"""A small synthetic data set in the format of ``deepct dataset generate``."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from weights_tools.check import write_images
from weights_tools.dataset import CLOUDCT_10_DEG, FORMAT
from weights_tools.model import Network

SIZE = 8
LEVELS = 6
OTHER_ZENITHS_DEG = (60.0, -60.0)


@pytest.fixture(autouse=True)
def few_threads():
    torch.set_num_threads(1)


def write_dataset(folder: Path, train: int = 6, validation: int = 3) -> Path:
    """Write random blobs with the ten views in reverse order, between two other views."""
    random = np.random.default_rng(3)
    zeniths = [OTHER_ZENITHS_DEG[0], *reversed(CLOUDCT_10_DEG), OTHER_ZENITHS_DEG[1]]
    geometry = {
        "sun_zenith_deg": 30.0,
        "sun_azimuth_deg": 45.0,
        "view_zenith_deg": [abs(zenith) for zenith in zeniths],
        "view_azimuth_deg": [180.0 if zenith < 0.0 else 0.0 for zenith in zeniths],
        "pixel_km": [0.05 + 0.0005 * abs(zenith) for zenith in zeniths],
        "camera_distance_km": [600.0 + abs(zenith) for zenith in zeniths],
    }
    (folder / "samples").mkdir(parents=True)
    samples = []
    for index in range(train + validation):
        extinction = np.zeros((LEVELS, SIZE, SIZE), np.float32)
        extinction[1:5, 2:6, 2:5] = random.uniform(5.0, 40.0, (4, 4, 3))
        # The radiance depends on the view, so that a wrong order is detected.
        radiance = (
            0.01
            + 0.001 * np.arange(len(zeniths))[:, None, None]
            + 0.2 * (1.0 - np.exp(-0.004 * extinction.sum(0)))
        )
        path = folder / "samples" / f"{index:06}.nc"
        write_sample(path, extinction, radiance.astype(np.float32), geometry)
        samples.append(
            {
                "file": f"samples/{path.name}",
                "split": "train" if index < train else "validation",
                "source": "made_up.nc",
                "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            }
        )
    manifest = {
        "format": FORMAT,
        "formation": "twelve",
        "geometry": geometry,
        "image_shape": [SIZE, SIZE],
        "voxel_spacing_km": [0.05, 0.05, 0.04],
        "levels": {"bottom_km": 0.48, "count": LEVELS, "spacing_km": 0.04},
        "samples": samples,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def write_sample(path: Path, extinction: np.ndarray, radiance: np.ndarray, geometry: dict) -> None:
    """Write images that `deepct` can read, and the true extinction on a grid centred on them."""
    metadata = {**weights_metadata(len(radiance), LEVELS), "view_geometry": geometry}
    metadata["target_altitude_km"] = 0.48 + 0.5 * LEVELS * 0.04
    write_images(path, radiance, metadata)
    corners = {"z": 0.48, "y": -0.5 * SIZE * 0.05, "x": -0.5 * SIZE * 0.05}
    spacings = {"z": 0.04, "y": 0.05, "x": 0.05}
    with h5py.File(path, "r+") as file:
        for (name, corner), length in zip(corners.items(), extinction.shape):
            file[name] = corner + (np.arange(length) + 0.5) * spacings[name]
            file[name].attrs["units"] = "km"
            file[name].make_scale(name)
        file["extinction"] = extinction
        file["extinction"].attrs["units"] = "km-1"
        for axis, name in enumerate("zyx"):
            file["extinction"].dims[axis].attach_scale(file[name])


@pytest.fixture
def dataset_folder(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset")


def change_manifest(folder: Path, change) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def seasoned_network(channels: list[int], seed: int = 0) -> Network:
    """A network whose batch normalisation has the statistics of data and factors as after training.

    Each layer passes on most of its input. Independent random layers would double a rounding error
    every few layers, so that float32 and float64 results differ by half after 81 layers.
    """
    torch.manual_seed(seed)
    network = Network(channels)
    for block in network.net.body:
        weight = block.body[0].weight.data
        weight.mul_(0.25).add_(torch.nn.init.dirac_(torch.zeros_like(weight)))
        torch.nn.init.uniform_(block.body[0].bias, -0.2, 0.2)
        torch.nn.init.uniform_(block.body[1].weight, 0.6, 1.4)
        torch.nn.init.uniform_(block.body[1].bias, -0.3, 0.3)
    network.train()
    with torch.no_grad():
        for _ in range(40):
            network(torch.rand(8, channels[0], 16, 16) ** 2)
    return network.eval()


def saved(path: Path, network: Network, wrapped: bool) -> Path:
    """Save a bare state dict, or one in a checkpoint of the form used by the authors."""
    state = network.state_dict()
    if wrapped:
        state = {"epoch": 7, "model_state_dict": state, "optimizer_state_dict": {"state": {}}}
    torch.save(state, path)
    return path


def weights_metadata(views: int, levels: int) -> dict:
    """Metadata of synthetic weights."""
    zeniths = [2.0 * view for view in range(views)]
    return {
        "formation": "made-up",
        "view_geometry": {
            "sun_zenith_deg": 30.0,
            "sun_azimuth_deg": 45.0,
            "view_zenith_deg": zeniths,
            "view_azimuth_deg": [0.0] * views,
            "pixel_km": [0.05] * views,
            "camera_distance_km": [None] * views,
        },
        "target_altitude_km": 1.12,
        "wavelength_um": 0.672,
        "image_layout": "camera",
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.48, "count": levels, "spacing_km": 0.04},
        "outputs": ["extinction"],
        "input_scale": 5.0,
        "output_scale": 20.0,
        "training": {"data": "none", "identity": "none", "samples": 0, "seed": 0},
        "scores": {},
        "configuration": {},
    }


def planes_metadata(altitudes_km: list[float], levels: int) -> dict:
    """Metadata of weights for images on planes, with cameras at several azimuths and one at
    infinity."""
    return {
        **weights_metadata(4, levels),
        "view_geometry": {
            "sun_zenith_deg": 30.0,
            "sun_azimuth_deg": 45.0,
            "view_zenith_deg": [46.0, 0.0, 60.0, 30.0],
            "view_azimuth_deg": [180.0, 0.0, 70.0, 200.0],
            "pixel_km": [0.069, 0.05, 0.08, 0.06],
            "camera_distance_km": [828.0, 600.0, 1000.0, None],
        },
        "image_layout": {"planes": {"altitudes_km": altitudes_km}},
        "horizontal_spacing_km": [0.05, 0.04],
    }


def write_simulation(path: Path, times: int = 3, size: int = 48, levels: int = 40) -> Path:
    """Write a simulation with a few round clouds, one of which crosses the periodic sides."""
    random = np.random.default_rng(5)
    z, y, x = np.meshgrid(*(np.arange(n) for n in (levels, size, size)), indexing="ij")
    water = np.zeros((times, levels, size, size))
    for time in range(times):
        for centre in ((0, 24), (24, 12), (12, 40)):
            radius, base = random.uniform(4.0, 7.0), random.uniform(4.0, 10.0)
            across = [
                (at - middle + size // 2) % size - size // 2 for at, middle in zip((y, x), centre)
            ]
            distance = np.sqrt(sum(at**2 for at in across) + (z - base - radius) ** 2)
            water[time] += 0.5 * np.clip(1.0 - distance / radius, 0.0, 1.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["lwc"] = np.round(water / 1e-3).astype(np.int16)
        file["lwc"].attrs["scale_factor"] = 1e-3
        file["z"] = 400.0 + 40.0 * np.arange(levels)
    return path


GENERAL_RECIPE = """
kind = "general"

[network]
virtual_views = 3
planes = 2
width = 8
layers = 3

[scenes]
generated = 0.0

[[simulations]]
file = "clouds.nc"
first = 0
last = 1
share = 1.0

[[simulations]]
file = "clouds.nc"
split = "validation"
first = 2
last = 2
share = 1.0
"""


@pytest.fixture(scope="session")
def simulations(tmp_path_factory) -> Path:
    """A folder with a simulation, and a recipe of a small general network."""
    folder = tmp_path_factory.mktemp("simulations")
    write_simulation(folder / "clouds.nc")
    (folder / "recipe.toml").write_text(GENERAL_RECIPE)
    return folder
