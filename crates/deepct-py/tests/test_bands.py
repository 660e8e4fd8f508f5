"""Images of several bands: several observations, or one file with a dimension of the wavelength."""

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
