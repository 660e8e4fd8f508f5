"""Python and the command line give bit-identical results for the same seed and input."""

import json
import subprocess

import h5py
import numpy as np
import pytest
import xarray

import deepct_py


NAMES = ("cloud", "images", "evening", "noisy", "mask", "volume")


@pytest.fixture(scope="module")
def files(tmp_path_factory, command_line):
    """The output files of each stage of the command line for one cloud."""
    folder = tmp_path_factory.mktemp("command_line")
    paths = {name: folder / f"{name}.nc" for name in NAMES}
    command_line("cloud", "generate", "--seed", 4, "--set", "width_km=0.6", "--out", paths["cloud"])
    render = ("render", paths["cloud"], "--views", "cloudct-10", "--seed", 5)
    command_line(*render, "--samples", 4, "--out", paths["images"])
    evening = ("--sun-zenith", 70, "--sun-azimuth", 260, "--surface-albedo", 0.3)
    command_line(*render, "--samples", 2, *evening, "--out", paths["evening"])
    command_line("sense", paths["images"], "--seed", 6, "--out", paths["noisy"])
    command_line("carve", paths["noisy"], "--grid", paths["cloud"], "--out", paths["mask"])
    weights = ("--weights", "cloudct-10", "--mask", paths["mask"])
    command_line("infer", paths["noisy"], *weights, "--out", paths["volume"])
    return paths


def read(path, name):
    with h5py.File(path) as file:
        return file[name][...]


@pytest.fixture(scope="module")
def cloud():
    return deepct_py.generate_cloud(seed=4, width_km=0.6)


@pytest.fixture(scope="module")
def cloud_views(cloud):
    return deepct_py.Views.load("cloudct-10", target=cloud.grid.center)


def test_clouds(files, cloud):
    assert np.array_equal(cloud.liquid_water_content, read(files["cloud"], "lwc"))
    assert np.array_equal(cloud.effective_radius, read(files["cloud"], "reff"))
    assert np.array_equal(cloud.effective_variance, read(files["cloud"], "veff"))
    for axis in "xyz":
        stored = read(files["cloud"], axis)
        np.testing.assert_allclose(getattr(cloud.grid, axis), stored, rtol=1e-12)


def test_images(files, cloud, cloud_views):
    scene = (cloud.extinction, cloud.grid, cloud_views)
    images = deepct_py.render(*scene, samples=4, seed=5).radiance
    assert images.max() > 0.05
    assert np.array_equal(images, read(files["images"], "radiance"))
    light = deepct_py.Light(sun_zenith_deg=70.0, sun_azimuth_deg=260.0, surface_albedo=0.3)
    evening = deepct_py.render(*scene, light, samples=2, seed=5)
    assert np.array_equal(evening.radiance, read(files["evening"], "radiance"))
    stored = read(files["evening"], "radiance_standard_error")
    assert np.array_equal(evening.standard_error, stored)


def test_noise(files):
    images = (read(files["images"], name) for name in ("radiance", "radiance_standard_error"))
    radiance, error = images
    sensed = deepct_py.sense(radiance, "cmv4000", standard_error=error, seed=6)
    assert np.array_equal(sensed.radiance, read(files["noisy"], "radiance"))


def test_masks(files, cloud, cloud_views):
    names = ("radiance", "radiance_standard_error")
    noisy, noise = (read(files["noisy"], name) for name in names)
    with h5py.File(files["noisy"]) as file:
        saturated = file["saturated"][...] if "saturated" in file else noisy < 0
    carved = deepct_py.carve(
        noisy, cloud_views, cloud.grid, standard_error=noise, saturated=saturated.astype(bool)
    )
    assert 0.0 < carved.mask.mean() < 1.0
    assert np.array_equal(carved.mask, read(files["mask"], "mask").astype(bool))


def test_volumes_and_their_scores(files, cloud, cloud_views, command_line):
    radiance, mask = read(files["noisy"], "radiance"), read(files["mask"], "mask").astype(bool)
    network = deepct_py.Network.load("cloudct-10")
    extinction = network.infer(radiance, cloud_views, mask=mask)
    assert extinction.max() > 1.0
    assert np.array_equal(extinction, read(files["volume"], "extinction"))
    grid = network.grid(cloud_views)
    for axis in "xyz":
        np.testing.assert_allclose(getattr(grid, axis), read(files["volume"], axis), rtol=1e-9)
    answer = command_line("score", "--truth", files["cloud"], files["volume"], "--json")
    row = json.loads(answer)[0]
    scores = deepct_py.score(cloud.extinction, extinction)
    for name in ("relative_error", "mass_error", "root_mean_square_error", "correlation"):
        assert row[name] == getattr(scores, name) != 0.0
    assert [level["truth"] for level in row["profile"]] == scores.truth_by_level.tolist()


def test_the_light_of_a_file(files, cloud, cloud_views):
    """The light stored in an image file equals the one constructed in Python."""
    light = deepct_py.Light(sun_zenith_deg=70.0, sun_azimuth_deg=260.0, surface_albedo=0.3)
    with xarray.open_dataset(files["evening"]) as dataset:
        assert deepct_py.Light.from_dataset(dataset) == light
        with pytest.warns(UserWarning, match="does not state air, surface_albedo"):
            sun_only = deepct_py.Light.from_dataset(dataset.drop_vars("light"))
    assert sun_only.to_dict() == light.replace(surface_albedo=0.05).to_dict()
    assert "surface_albedo" in sun_only.assumed and "wavelength" not in sun_only.assumed


def test_parts_and_averages_of_images(files, tmp_path, cloud, cloud_views, command_line):
    """The pixel numbers tell what xarray left of the images: no shift of the mask or the cloud."""
    with xarray.open_dataset(files["images"]) as dataset:
        part = dataset.isel(row=slice(4, 28), col=slice(6, 32))
        part.to_netcdf(tmp_path / "part.nc")
        dataset.isel(row=slice(None, None, -1)).to_netcdf(tmp_path / "reversed.nc")
        dataset.coarsen(row=2, col=2).mean().to_netcdf(tmp_path / "averaged.nc")
        part.drop_vars("target_row").to_netcdf(tmp_path / "unknown.nc")
    whole = read(files["images"], "radiance")

    def mask_of(name):
        out = tmp_path / "mask.nc"
        command_line("carve", tmp_path / name, "--grid", files["cloud"], "--threshold", 0.03,
                     "--out", out)
        return read(out, "mask").astype(bool)

    def carve(images, views):
        return deepct_py.carve(images, views, cloud.grid, threshold=0.03).mask

    assert np.array_equal(mask_of("reversed.nc"), carve(whole, cloud_views))
    parts = [view.part((4, 6), (24, 26)) for view in cloud_views]
    assert np.array_equal(mask_of("part.nc"), carve(whole[:, 4:28, 6:32], parts))
    averaged = whole.reshape(10, 16, 2, 16, 2).mean(axis=(2, 4))

    def wide(view):
        distance = np.linalg.norm(np.subtract(view.position, view.target))
        tangent = 2 * view.pixel_km / distance
        return deepct_py.View.perspective(view.position, view.target, tangent, (16, 16))

    assert np.array_equal(mask_of("averaged.nc"), carve(averaged, list(map(wide, cloud_views))))

    command_line("infer", tmp_path / "part.nc", "--out", tmp_path / "volume.nc")
    found = read(tmp_path / "volume.nc", "extinction")
    network = deepct_py.Network.load()
    grid = network.grid(parts)
    x, y, _ = cloud.grid.center
    np.testing.assert_allclose(grid.center[:2], (x + 3 * 0.05, y), atol=1e-9)
    expected = network.infer(whole, cloud_views, deepct_py.Light(), grid=grid)
    assert found.shape == expected.shape == (32, 24, 26)
    # Away from the sides, which whole images show and their parts do not.
    inside = (slice(None), slice(8, -8), slice(8, -8))
    assert np.abs(found - expected)[inside].max() < 0.05 * expected.max()
    with pytest.raises(subprocess.CalledProcessError) as refusal:
        command_line("carve", tmp_path / "unknown.nc", "--grid", files["cloud"],
                     "--out", tmp_path / "mask.nc")
    assert "add target_row(view)" in refusal.value.stderr


def test_images_that_state_sun_and_wavelength_only(files, tmp_path, command_line_run):
    """The inversion reports the values that it assumes and those that contradict the file."""
    images = tmp_path / "instrument.nc"
    images.write_bytes(files["noisy"].read_bytes())
    with h5py.File(images, "a") as file:
        del file["light"]
    invert = ("invert", images, "--grid", files["cloud"], "--iterations", 0, "--init", 5.0,
              "--set", "inversion.coarse=[]", "--out", tmp_path / "V.nc")
    said = command_line_run(*invert).stderr
    assert "does not specify the whole scene illumination; assumed: air = false" in said
    assert "--light" in said
    assert "warning" not in said
    said = command_line_run(*invert, "--air", "--sun-zenith", 20).stderr
    assert "air =" not in said and "sun_zenith_deg is 30.0 in" in said
