"""The chain images -> network -> extinction -> images."""

import copy
from pathlib import Path

import deepct_py
import deepct_py.torch
import numpy as np
import pytest
import torch

from weights_tools.chain import Estimator
from weights_tools.general_file import read_general_weights

WEIGHTS = Path(__file__).parents[2] / "crates/deepct-core/weights/general.safetensors"


@pytest.fixture(scope="module")
def scene():
    views = deepct_py.Views.load("cloudct-10", (0.0, 0.0, 1.2), (16, 16))
    light = deepct_py.Light(sun=(40, 120))
    estimator = Estimator(read_general_weights(WEIGHTS), views, light)
    cloud = deepct_py.generate_cloud(estimator.grid, seed=3, width_km=0.4)
    images = deepct_py.render(
        cloud, views=views, light=light, solver="ordinates", accuracy=0.03, estimate_error=False
    )
    return estimator, cloud, images


def test_the_estimator_is_the_network_of_deepct(scene):
    estimator, _, images = scene
    network = deepct_py.Network.load("general")
    for name in ("shape", "spacing", "origin"):
        expected = getattr(network.grid(images.views), name)
        np.testing.assert_allclose(getattr(estimator.grid, name), expected, atol=1e-9)
    expected = network.infer(images)
    with torch.no_grad():
        found = estimator(torch.from_numpy(images.radiance)[None])[0].numpy()
    assert np.abs(found - expected).max() < 2e-4 * expected.max()


def test_gradients_flow_from_images_to_images(scene):
    estimator, cloud, images = scene
    views, light, mask = images.views, images.light, cloud.extinction > 0
    renderer = deepct_py.Renderer(
        estimator.grid, views, light, mask=mask, expected=cloud, accuracy=0.03, tolerance=1e-6,
        warm_start=False,
    )
    again = deepct_py.torch.Images(renderer)
    measured = torch.from_numpy(images.radiance)

    def loss(network, radiance):
        extinction = network(radiance[None])[0] * torch.from_numpy(mask)
        return (again(extinction) - measured).square().sum().double()

    radiance = measured.clone().requires_grad_()
    value = loss(estimator, radiance)
    value.backward()
    scale = estimator.network.layers[-1].batch_norm.weight
    assert radiance.grad.abs().sum() > 0 and scale.grad.abs().sum() > 0

    # Directional derivatives by central differences: of the images, and of parameters.
    direction = 0.02 * measured
    up, down = (loss(estimator, measured + sign * direction).item() for sign in (1, -1))
    found = (radiance.grad * direction).sum().item()
    assert abs(found - (up - down) / 2) < 0.02 * abs(found)
    moved = []
    for sign in (1, -1):
        other = copy.deepcopy(estimator)
        with torch.no_grad():
            other.network.layers[-1].batch_norm.weight.mul_(1 + 0.01 * sign)
        moved.append(loss(other, measured).item())
    found = 0.01 * (scale.grad * scale.detach()).sum().item()
    assert abs(found - (moved[0] - moved[1]) / 2) < 0.02 * abs(found)
