"""The same seed and the same input give the same bits from Python and the command line."""

import json

import h5py
import numpy as np
import pytest

import deepct_py


@pytest.fixture(scope="module")
def files(tmp_path_factory, command_line):
    """What the command line makes of a small cloud, stage by stage."""
    folder = tmp_path_factory.mktemp("command_line")
    paths = {name: folder / f"{name}.nc" for name in ("cloud", "images", "noisy", "mask", "half")}
    small = ["--set", "shape=[24, 20, 20]", "--set", "width_km=0.6", "--set", "depth_km=0.6"]
    command_line("cloud", "generate", "--seed", 4, *small, "--out", paths["cloud"])
    command_line(
        "render", paths["cloud"], "--views", "cloudct-10", "--samples", 4, "--seed", 5,
        "--sun-zenith", 50, "--sun-azimuth", 200, "--out", paths["images"],
    )
    command_line("sense", paths["images"], "--seed", 6, "--out", paths["noisy"])
    command_line("carve", paths["noisy"], "--grid", paths["cloud"], "--out", paths["mask"])
    return paths


def read(path, name):
    with h5py.File(path) as file:
        return file[name][...]


@pytest.fixture(scope="module")
def cloud():
    return deepct_py.generate_cloud(seed=4, shape=(24, 20, 20), width_km=0.6, depth_km=0.6)


@pytest.fixture(scope="module")
def cloud_views(cloud):
    return deepct_py.Views.load("cloudct-10", target=cloud.grid.center, size=(20, 20))


def test_clouds(files, cloud):
    assert np.array_equal(cloud.liquid_water_content, read(files["cloud"], "lwc"))
    assert np.array_equal(cloud.effective_radius, read(files["cloud"], "reff"))
    assert np.array_equal(cloud.effective_variance, read(files["cloud"], "veff"))
    for axis in "xyz":
        stored = read(files["cloud"], axis)
        np.testing.assert_allclose(getattr(cloud.grid, axis), stored, rtol=1e-12)


def test_images(files, cloud, cloud_views):
    rendering = deepct_py.render(
        cloud.extinction, cloud.grid, cloud_views, deepct_py.Sun(50.0, 200.0),
        samples_per_pixel=4, seed=5,
    )
    assert rendering.radiance.max() > 0.05
    assert np.array_equal(rendering.radiance, read(files["images"], "radiance"))


def test_noise(files):
    sensed = deepct_py.sense(read(files["images"], "radiance"), "cmv4000", seed=6)
    assert np.array_equal(sensed.radiance, read(files["noisy"], "radiance"))


def test_masks(files, cloud, cloud_views):
    carved = deepct_py.carve(read(files["noisy"], "radiance"), cloud_views, cloud.grid)
    assert 0.0 < carved.mask.mean() < 1.0
    assert np.array_equal(carved.mask, read(files["mask"], "mask").astype(bool))


def test_scores(files, cloud, command_line):
    """The command line scores the cloud against itself without its lower half."""
    with h5py.File(files["cloud"]) as whole, h5py.File(files["half"], "w") as half:
        for name in whole:
            whole.copy(name, half)
        half.attrs.update(whole.attrs)
        for name in ("lwc", "reff", "veff"):
            half[name][:12] = 0.0
    answer = command_line("score", "--truth", files["cloud"], files["half"], "--json")
    estimate = cloud.extinction.copy()
    estimate[:12] = 0.0
    scores = deepct_py.score(cloud.extinction, estimate)
    row = json.loads(answer)[0]
    for name in ("relative_error", "mass_error", "root_mean_square_error", "correlation"):
        assert row[name] == getattr(scores, name) != 0.0
    assert [level["truth"] for level in row["profile"]] == scores.truth_by_level.tolist()
