"""The network compared with the same layers computed by NumPy in double precision."""

import json
import struct

import numpy as np
import pytest

import deepct_py

CHANNELS = [10, 12, 9, 8]
INPUT_SCALE, OUTPUT_SCALE = 10.0, 3.0


def save(path, views, light, layers, drop=()):
    """Write a weights file in the safetensors format without the safetensors package."""
    metadata = {
        "format_version": 1,
        "formation": "cloudct-10",
        "architecture": {"channels": CHANNELS, "last_relu": True},
        "view_geometry": {
            "sun_zenith_deg": light.sun_zenith_deg,
            "sun_azimuth_deg": light.sun_azimuth_deg,
            "view_zenith_deg": views.zenith_deg.tolist(),
            "view_azimuth_deg": views.azimuth_deg.tolist(),
            "pixel_km": views.pixel_km.tolist(),
        },
        "target_altitude_km": views[0].target[2],
        "wavelength_um": 0.672,
        "image_layout": "camera",
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.5, "count": CHANNELS[-1], "spacing_km": 0.1},
        "input_scale": INPUT_SCALE,
        "output_scale": OUTPUT_SCALE,
        "training": {"data": "none", "identity": "", "samples": 0, "seed": 1},
        "scores": {"epsilon": 0.5},
        "program": "test",
        "configuration": {},
    }
    tensors, data = {}, b""
    for number, layer in enumerate(layers):
        for kind, values in zip(("weight", "bias"), layer):
            if f"layers.{number}.{kind}" in drop:
                continue
            end = len(data) + values.nbytes
            tensors[f"layers.{number}.{kind}"] = {
                "dtype": "F32", "shape": values.shape, "data_offsets": [len(data), end],
            }
            data += values.tobytes()
    header = json.dumps({"__metadata__": {"deepct": json.dumps(metadata)}, **tensors}).encode()
    header += b" " * (-len(header) % 8)
    path.write_bytes(struct.pack("<Q", len(header)) + header + data)
    return path


def convolve(values, weight, bias):
    """A 3x3 convolution with zero padding, followed by a ReLU."""
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))
    result = np.einsum("oiab,irsab->ors", weight.astype(np.float64), windows)
    return np.maximum(result + bias[:, None, None], 0.0)


@pytest.fixture
def layers():
    random = np.random.default_rng(11)
    return [
        (
            random.normal(0.0, np.sqrt(2.0 / (9 * into)), (out, into, 3, 3)).astype(np.float32),
            random.normal(0.0, 0.1, out).astype(np.float32),
        )
        for into, out in zip(CHANNELS, CHANNELS[1:])
    ]


@pytest.fixture
def light():
    return deepct_py.Light()


@pytest.fixture
def radiance():
    return np.random.default_rng(12).gamma(2.0, 0.05, (10, 16, 16)).astype(np.float32)


@pytest.fixture
def network(tmp_path, views, light, layers):
    return deepct_py.Network.load(save(tmp_path / "w.safetensors", views, light, layers))


def test_inference_is_that_of_numpy(network, layers, radiance, views, light, grid):
    extinction = network.infer(radiance, views, light)
    values = radiance.astype(np.float64) * INPUT_SCALE
    for weight, bias in layers:
        values = convolve(values, weight, bias)
    expected = values * OUTPUT_SCALE
    assert extinction.shape == grid.shape and extinction.dtype == np.float32
    assert np.abs(extinction - expected).max() < 1e-5 * expected.max()
    found = network.grid(views)
    assert found.shape == grid.shape and found.spacing == pytest.approx(grid.spacing)
    assert found.origin == pytest.approx(grid.origin)


def test_an_estimate_tells_its_uncertainty(network, radiance, views, grid):
    estimate = network.estimate(radiance, views)
    np.testing.assert_array_equal(estimate.extinction, network.infer(radiance, views))
    assert estimate.uncertainty is None
    # The built-in network estimates its uncertainty, which is largest within the cloud.
    built_in = deepct_py.Network.load("cloudct-10")
    cloud = deepct_py.generate_cloud(seed=3)
    views = deepct_py.Views.load("cloudct-10", cloud.grid.center)
    images = deepct_py.render(
        cloud.extinction, cloud.grid, views,
        deepct_py.Light(phase="mie", effective_radius=10.0, air=True), solver="ordinates",
    ).radiance
    estimate = built_in.estimate(images, views)
    extinction, uncertainty = estimate.extinction, estimate.uncertainty
    assert uncertainty.shape == extinction.shape and uncertainty.min() >= 0.0
    error = np.abs(extinction - cloud.extinction)
    assert 0.5 < uncertainty.mean() / error.mean() < 2.0
    assert np.corrcoef(uncertainty.ravel(), error.ravel())[0, 1] > 0.5
    mask = cloud.extinction > 0.0
    masked = built_in.estimate(images, views, mask=mask).uncertainty
    np.testing.assert_array_equal(masked, np.where(mask, uncertainty, 0.0))


def test_a_mask_sets_what_is_outside_to_zero(network, radiance, views, grid):
    mask = np.zeros(grid.shape, bool)
    mask[2:5, 3:12, 4:9] = True
    whole, masked = network.infer(radiance, views), network.infer(radiance, views, mask=mask)
    np.testing.assert_array_equal(masked, np.where(mask, whole, 0.0))
    with pytest.raises(ValueError, match="mask"):
        network.infer(radiance, views, mask=mask[1:])
    for same in (mask.astype(int), mask.astype(float), mask.tolist(), deepct_py.Carved(grid, mask)):
        np.testing.assert_array_equal(network.infer(radiance, views, mask=same), masked)
    with pytest.raises(ValueError, match="mask holds 2"):
        network.infer(radiance, views, mask=2 * mask.astype(int))


def test_images_of_another_geometry_are_refused(network, radiance, views, grid):
    others = deepct_py.Views.string_of_pearls(grid.center, first=-5, last=4, size=(16, 16))
    elsewhere = deepct_py.Views.load("cloudct-10", (2.4, 0.4, 0.9), size=(16, 16))
    higher = deepct_py.Views.load("cloudct-10", (0.4, 0.4, 1.5), size=(16, 16))
    for message, wrong in [
        ("zenith", lambda: network.infer(radiance, others)),
        ("solar zenith", lambda: network.infer(radiance, views, deepct_py.Light(sun_zenith_deg=50.0))),
        ("altitude", lambda: network.infer(radiance, higher)),
        ("wavelength", lambda: network.infer(radiance, views, deepct_py.Light(wavelength=0.5))),
        ("number of views", lambda: network.infer(radiance[1:], views)),
        ("target of view", lambda: network.grid([*list(views)[:9], elsewhere[9]])),
    ]:
        with pytest.raises(ValueError, match=message):
            wrong()


def test_a_file_without_a_layer_is_refused(tmp_path, views, light, layers):
    path = save(tmp_path / "w.safetensors", views, light, layers, drop=("layers.1.bias",))
    with pytest.raises(deepct_py.DeepctError, match=r"w.safetensors: layers.1.bias"):
        deepct_py.Network.load(path)
    with pytest.raises(deepct_py.DeepctError, match="no such file"):
        deepct_py.Network.load("no-such-weights")


def test_the_metadata_are_a_dictionary(network):
    assert network.metadata["architecture"]["channels"] == CHANNELS
    assert network.metadata["formation"] == "cloudct-10"
    assert all(isinstance(name, str) for name in deepct_py.Network.built_in())
