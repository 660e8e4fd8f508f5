import math

import numpy as np
import pytest
import torch

from weights_tools.fixture import SMALL, random_network
from weights_tools.general_file import GeneralDescription, GeneralWeights, write_general_weights
from weights_tools.planes import on_planes
from weights_tools.surface import above_surface, clear_radiance
from weights_tools.views import direction, views_of

SUN_DEG = (35.0, 120.0)
ZENITH_DEG = (0.0, 30.0, 55.0)
AZIMUTH_DEG = (0.0, 200.0, 310.0)
SIZE = 18
VOXEL_KM = 0.05


@pytest.fixture
def views():
    geometry = {
        "sun_zenith_deg": SUN_DEG[0],
        "sun_azimuth_deg": SUN_DEG[1],
        "view_zenith_deg": list(ZENITH_DEG),
        "view_azimuth_deg": list(AZIMUTH_DEG),
        "pixel_km": [VOXEL_KM] * 3,
        "camera_distance_km": [600.0] * 3,
    }
    return views_of(geometry, VOXEL_KM)


def images(views, albedo):
    """A cloud that hides a third of a surface, with a texture."""
    path, factor = clear_radiance(views)
    cloud = torch.zeros(SIZE, SIZE, dtype=torch.float64)
    cloud[4:14, 5:15] = 0.02 + 0.003 * torch.arange(100, dtype=torch.float64).reshape(10, 10)
    return (path + albedo * factor)[..., None, None] + cloud


@pytest.mark.parametrize("albedo", [0.06, 0.1, 0.2])
def test_the_clear_surface_becomes_that_of_the_network(views, albedo):
    changed = above_surface(images(views, albedo), views, 0.05)
    expected = images(views, 0.05)
    assert torch.allclose(changed[..., 0, :], expected[..., 0, :], atol=1e-12)
    brightest = changed[0, 0, 13, 14], expected[0, 0, 13, 14], images(views, albedo)[0, 0, 13, 14]
    assert min(brightest[1:]) < brightest[0] < max(brightest[1:])


@pytest.mark.parametrize("albedo", [0.0, 0.03, 0.6])
def test_images_of_darker_surfaces_and_of_clouds_only_are_unchanged(views, albedo):
    unchanged = images(views, albedo)
    assert torch.equal(above_surface(unchanged, views, 0.05), unchanged)


def test_the_clear_radiance_is_that_of_deepct(views):
    deepct = pytest.importorskip("deepct_py")
    grid = deepct.Grid((4, 4, 4), (0.05, 0.05, 0.04), (-0.1, -0.1, 0.5))
    target = (0.0, 0.0, 0.58)
    cameras = [
        deepct.View.perspective(tuple(np.array(target) + 600.0 * to), target, 8e-5, (4, 4))
        for to in views.towards[0].numpy()
    ]
    for albedo in (0.0, 0.05, 0.2):
        light = deepct.Light(
            sun_zenith_deg=SUN_DEG[0], sun_azimuth_deg=SUN_DEG[1], air=True, surface_albedo=albedo
        )
        thin = np.zeros((4, 4, 4), np.float32)
        thin[1, 1, 1] = 1e-6
        found = deepct.render(thin, grid, cameras, light, solver="ordinates").radiance.mean((1, 2))
        path, factor = clear_radiance(views)
        # Light that molecules scatter several times is neglected.
        assert np.allclose((path + albedo * factor)[0], found, atol=0.0012), albedo


def test_deepct_changes_the_images_in_the_same_way(views, tmp_path):
    deepct = pytest.importorskip("deepct_py")
    network = random_network(SMALL, seed=3)
    description = GeneralDescription(
        surface_albedo=0.05,
        training={"data": "none", "identity": "none", "samples": 0, "seed": 1},
        scores={"epsilon": 0.5, "delta": 0.0},
    )
    path = tmp_path / "general.safetensors"
    write_general_weights(path, GeneralWeights(network, description))
    bright = images(views, 0.21)
    scaled = above_surface(bright, views, 0.05) * description.input_scale
    planes = on_planes(scaled, views, SMALL.heights)
    with torch.no_grad():
        outputs = network.double()(planes, views)[0] * description.output_scale
    middle = 0.5 * SMALL.levels * SMALL.level_height * VOXEL_KM
    target = (0.0, 0.0, 1.0 + middle)
    zenith, azimuth = (torch.tensor(each).double().deg2rad() for each in (ZENITH_DEG, AZIMUTH_DEG))
    cameras = [
        deepct.View.perspective(
            tuple(np.array(target) + 600.0 * to), target, VOXEL_KM / 600.0, (SIZE, SIZE)
        )
        for to in direction(zenith, azimuth).numpy()
    ]
    light = deepct.Light(sun_zenith_deg=SUN_DEG[0], sun_azimuth_deg=SUN_DEG[1])
    radiance = bright[0].float().numpy()
    estimate = deepct.Network.load(path).infer(radiance, cameras, light)
    expected = outputs[: SMALL.levels].numpy()
    assert math.isclose(estimate.max(), expected.max(), rel_tol=1e-4)
    assert np.abs(estimate - expected).max() < 2e-4 * expected.max()
