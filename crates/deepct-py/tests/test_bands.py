"""Images of several bands: several observations, or one file with a dimension of the wavelength."""

import json
import pickle
import subprocess

import deepct_py
import numpy as np
import pytest
import xarray as xr

QUICK = {"iterations": 2, "coarse": [], "corrections": 1, "radius": "uniform"}


@pytest.fixture(scope="module")
def bands():
    cloud = deepct_py.generate_cloud(seed=3, width_km=0.4)
    lights = [deepct_py.Light(wavelength=um, phase="mie", extinction="mie") for um in (0.672, 2.13)]
    views = deepct_py.Views.load("cloudct-10", cloud.grid.center, cloud.grid.shape[1:])[::3]
    images = [deepct_py.render(cloud, views=views, light=light, solver="ordinates", accuracy=0.1)
              for light in lights]
    return cloud.grid, [deepct_py.sense(one, seed=1) for one in images]


@pytest.fixture(scope="module")
def file(bands, tmp_path_factory):
    """Both bands in one file, as xarray joins them; the last view has no infrared camera."""
    path = tmp_path_factory.mktemp("bands") / "bands.nc"
    joined = xr.concat([band.to_xarray() for band in bands[1]], "wavelength", data_vars="different",
                       compat="equals")
    joined["radiance"][1, -1] = np.nan
    joined["radiance"] = joined["radiance"].transpose("view", "row", "wavelength", "col")
    joined.to_netcdf(path, engine="h5netcdf")
    return path


def test_one_file_is_as_two(bands, file):
    grid, (visible, infrared) = bands
    radiance = infrared.radiance.copy()
    radiance[-1] = np.nan
    partly = deepct_py.Observation(
        radiance, infrared.views, infrared.light, standard_error=infrared.standard_error)
    expected = deepct_py.invert([visible, partly], grid=grid, init="auto", **QUICK)
    found = deepct_py.invert(file, grid=grid, init="auto", **QUICK)
    np.testing.assert_array_equal(found.extinction, expected.extinction)
    np.testing.assert_array_equal(found.effective_radius, expected.effective_radius)
    assert found.light.wavelength == 0.672
    with pytest.raises(ValueError, match="belong to the images of each band"):
        deepct_py.invert(file, light=visible.light, grid=grid, **QUICK)


def test_hybrid_starts_from_the_first_band(bands, file, tmp_path):
    grid, _ = bands
    grid_file, out = tmp_path / "grid.nc", tmp_path / "out.nc"
    deepct_py.Cloud(grid, extinction=np.zeros(grid.shape, np.float32)).to_netcdf(grid_file)
    command = ["deepct", "hybrid", file, "--grid", grid_file, "--radius", "uniform", "--quick",
               "--iterations", "1"]
    command = [part for part in command if part != "--quick"] + ["--members", "2", "--out", out]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    result = xr.open_dataset(out, engine="h5netcdf")
    for name in ("extinction", "reff", "lwc"):
        errors = result[f"{name}_standard_error"].values
        assert errors.shape == grid.shape and errors.max() > 0
        assert (errors[result["mask"].values == 0] == 0).all()


def weights(views, bands, levels):
    """The contents of a weights file for the bands, of one layer with random kernels, with the effective
    radius as the second output."""
    geometry = bands[0].views
    shape = (2 * levels, len(bands) * len(views), 3, 3)
    random = np.random.default_rng(1)
    layers = {"layers.0.weight": random.normal(0.0, 0.1, shape), "layers.0.bias": np.full(shape[0], 0.3)}
    metadata = {
        "format_version": 5,
        "formation": "three of cloudct-10",
        "architecture": {"channels": [shape[1], shape[0]], "last_relu": True},
        "view_geometry": {
            "sun_zenith_deg": bands[0].light.sun[0],
            "sun_azimuth_deg": bands[0].light.sun[1],
            "view_zenith_deg": [view.zenith_deg for view in geometry],
            "view_azimuth_deg": [view.azimuth_deg for view in geometry],
            "pixel_km": [view.pixel_km for view in geometry],
            "camera_distance_km": [float(np.linalg.norm(np.subtract(view.position, view.target)))
                                   for view in geometry],
        },
        "target_altitude_km": geometry[0].target[2],
        "wavelength_um": [band.light.wavelength for band in bands],
        "image_layout": "camera",
        "horizontal_spacing_km": [0.05, 0.05],
        "levels": {"bottom_km": 0.5, "count": levels, "spacing_km": 0.04},
        "outputs": ["extinction", "effective_radius"],
        "input_scale": 10.0, "output_scale": 20.0, "effective_radius_scale": 15.0,
        "training": {"data": "none", "identity": "none", "samples": 0, "seed": 0},
        "scores": {}, "program": "a test", "configuration": None,
    }
    header, data = {"__metadata__": {"deepct": json.dumps(metadata)}}, b""
    for name, values in layers.items():
        start, data = len(data), data + values.astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": values.shape, "data_offsets": [start, len(data)]}
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def test_a_network_estimates_the_effective_radius_from_a_list(bands):
    _, images = bands
    network = deepct_py.Network(weights(images[0].views, images, 4))
    estimate = network.estimate(images)
    cloudy = estimate.extinction > 0
    assert 0 < cloudy.sum() < cloudy.size
    assert ((estimate.effective_radius > 0) == cloudy).all()
    assert 1 <= estimate.effective_radius[cloudy].min() < estimate.effective_radius.max() <= 25
    np.testing.assert_array_equal(network.infer(images), estimate.extinction)
    again = deepct_py.Estimate.from_dataset(estimate.to_xarray())
    np.testing.assert_array_equal(again.effective_radius, estimate.effective_radius)
    masked = network.estimate(images, mask=cloudy & (np.indices(cloudy.shape)[1] < 2))
    assert (masked.effective_radius[:, 2:] == 0).all() and masked.effective_radius.any()
    result = deepct_py.hybrid(images, network=network, iterations=1, corrections=1, radius="field")
    assert result.effective_radius.shape == estimate.effective_radius.shape
    with pytest.raises(ValueError, match=r"expected 2 \(0.672 and 2.13 um\), found 1 \(0.672 um\)"):
        network.estimate(images[0])
    with pytest.raises(ValueError, match="number of bands: expected 1"):
        deepct_py.Network.load("general").estimate(images)


def test_other_commands_need_one_band(file):
    with pytest.raises(deepct_py.DeepctError, match="wavelength: has 2 values.*isel"):
        deepct_py.read_images(file)


def test_unknown_gains_are_told(bands):
    grid, (visible, _) = bands
    brighter = visible.radiance.copy()
    brighter[1] *= 1.03
    light = visible.light.replace(effective_radius=10.0)
    wrong = deepct_py.Observation(
        brighter, visible.views, light, standard_error=visible.standard_error)
    found = deepct_py.invert(wrong, grid=grid, init="auto", iterations=10, coarse=[],
                             corrections=1, camera_gain_error=0.02)
    gains = [camera["gain"] for camera in found.calibrations[0]]
    others = np.delete(gains, 1).mean()
    assert gains[1] / others == pytest.approx(1.03, abs=0.015)
    assert all(camera["offset"] == [0.0, 0.0] for camera in found.calibrations[0])
    assert found.standard_errors == {}


def test_standard_errors(bands):
    grid, (visible, _) = bands
    light = visible.light.replace(effective_radius=10.0)
    images = deepct_py.Observation(
        visible.radiance, visible.views, light, standard_error=visible.standard_error)
    found = deepct_py.invert(images, grid=grid, init="auto", iterations=3, coarse=[],
                             corrections=1, members=3)
    errors = found.standard_errors["extinction"]
    assert list(found.standard_errors) == ["extinction"]
    assert errors.shape == grid.shape and (errors[~found.mask] == 0).all()
    assert pickle.loads(pickle.dumps(found)) == found
    again = found.to_xarray()["extinction_standard_error"]
    assert again.attrs["units"] == "km-1"
    np.testing.assert_array_equal(again.values, errors)
    with pytest.raises(ValueError, match="standard_errors has density"):
        deepct_py.Reconstruction(
            grid, found.extinction, found.mask, found.history, found.ending, found.light,
            standard_errors={"density": errors})
