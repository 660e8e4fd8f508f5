"""Each stage compared with the result of NumPy for the same arrays."""

import warnings

import numpy as np
import pytest

import deepct_py


def test_scores_are_those_of_numpy():
    random = np.random.default_rng(3)
    truth = random.gamma(0.5, 20.0, (6, 7, 8)).astype(np.float32)
    estimate = (truth * random.uniform(0.5, 1.4, truth.shape)).astype(np.float32)
    scores = deepct_py.score(truth, estimate)
    a, b = truth.astype(np.float64), estimate.astype(np.float64)
    assert scores.relative_error == pytest.approx(np.abs(a - b).sum() / a.sum(), rel=1e-12)
    assert scores.mass_error == pytest.approx((a.sum() - b.sum()) / a.sum(), rel=1e-12)
    rmse = np.sqrt(np.mean((a - b) ** 2))
    assert scores.root_mean_square_error == pytest.approx(rmse, rel=1e-12)
    correlation = np.corrcoef(a.ravel(), b.ravel())[0, 1]
    assert scores.correlation == pytest.approx(correlation, rel=1e-12)
    np.testing.assert_allclose(scores.truth_by_level, a.mean(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(scores.estimate_by_level, b.mean(axis=(1, 2)), rtol=1e-12)
    by_level = np.abs(a - b).sum(axis=(1, 2)) / a.sum(axis=(1, 2))
    np.testing.assert_allclose(scores.relative_error_by_level, by_level, rtol=1e-12)


def test_an_empty_level_has_no_relative_error():
    truth = np.zeros((2, 3, 3), np.float32)
    truth[1] = 4.0
    scores = deepct_py.score(truth, np.ones_like(truth))
    np.testing.assert_array_equal(np.isnan(scores.relative_error_by_level), [True, False])
    assert scores.correlation is None


def test_clear_air_shows_the_surface(grid, views):
    """Without cloud, the radiance of every pixel is albedo x cos(solar zenith) / pi."""
    clear = np.zeros(grid.shape, np.float32)
    light = deepct_py.Light(sun_zenith_deg=40.0, sun_azimuth_deg=10.0, surface_albedo=0.3)
    rendering = deepct_py.render(clear, grid, views, light, samples=4)
    assert rendering.radiance.shape == (10, 16, 16)
    assert rendering.radiance.dtype == rendering.standard_error.dtype == np.float32
    expected = 0.3 * np.cos(np.radians(40.0)) / np.pi
    np.testing.assert_allclose(rendering.radiance, expected, rtol=1e-5)


def test_an_absorbing_slab_dims_the_surface(grid):
    """A purely absorbing periodic layer attenuates both paths by the Beer-Lambert law."""
    optical_depth, zenith = 0.5, 30.0
    extinction = np.full(grid.shape, optical_depth / 0.8, np.float32)
    view = deepct_py.View.orthographic(60.0, 90.0, grid.center, 0.05, size=(4, 4))
    radiance = deepct_py.render(
        extinction, grid, [view],
        deepct_py.Light(
            sun_zenith_deg=zenith, surface_albedo=1.0, periodic=True, single_scattering_albedo=0.0
        ),
        samples=4096, seed=5,
    )
    mu0, mu = np.cos(np.radians([zenith, 60.0]))
    expected = mu0 / np.pi * np.exp(-optical_depth * (1.0 / mu0 + 1.0 / mu))
    error = np.sqrt(np.mean(radiance.standard_error.astype(np.float64) ** 2) / 16)
    assert abs(radiance.radiance.mean() - expected) < 4.0 * error + 1e-6


@pytest.mark.parametrize("asymmetry", [1e-17, 1e-16, 0.1 + 0.2 - 0.3, -1e-12])
def test_tiny_asymmetries_are_isotropic(grid, asymmetry):
    extinction = np.full(grid.shape, 5.0, np.float32)
    view = deepct_py.View.orthographic(0.0, 0.0, grid.center, 0.05, size=(2, 2))
    images = [
        deepct_py.render(
            extinction, grid, [view], deepct_py.Light(asymmetry=value, periodic=True), samples=64
        )
        for value in (asymmetry, 0.0)
    ]
    np.testing.assert_array_equal(images[0].radiance, images[1].radiance)


def test_a_cloud_outside_of_the_grid_spoils_nothing(grid, extinction):
    """A second ball of the same brightness, whose pixels no voxel of the grid explains."""
    east = deepct_py.Grid((8, 16, 32), grid.spacing, grid.origin)
    pair = np.concatenate([extinction, extinction], axis=2)
    alone = np.concatenate([extinction, np.zeros_like(extinction)], axis=2)
    views = [
        deepct_py.View.orthographic(zenith, azimuth, east.center, 0.05, (16, 48))
        for zenith, azimuth in ((45, 0), (0, 0), (45, 180), (20, 90), (20, 270))
    ]
    errors = []
    for cloud in (alone, pair):
        images = deepct_py.render(cloud, east, views, solver="ordinates").radiance
        found = deepct_py.invert(images, views, grid, iterations=15)
        errors.append(deepct_py.score(extinction, found.extinction).relative_error)
    assert errors[1] < errors[0] + 0.05, errors


def test_a_wanted_noise_is_reached(grid, extinction, views):
    rendering = deepct_py.render(extinction, grid, views, noise=0.05)
    squares = []
    for radiance, error in zip(rendering.radiance, rendering.standard_error):
        bright = radiance >= 0.5 * radiance.max()
        squares.append((error[bright] / radiance[bright]) ** 2)
    assert 0.03 < np.sqrt(np.concatenate(squares).mean()) <= 0.0501
    again = deepct_py.render(
        extinction, grid, views, samples=rendering.samples_per_pixel
    )
    np.testing.assert_allclose(again.radiance.mean(), rendering.radiance.mean(), rtol=0.02)


def test_droplets_have_a_glory(grid, extinction):
    """Mie droplets are brighter at the antisolar point than beside it, and one effective radius
    for the whole scene is equivalent to a field that has this radius everywhere."""
    views = [
        deepct_py.View.orthographic(zenith, 45.0, grid.center, 0.05, size=(16, 16))
        for zenith in (30.0, 18.0)
    ]
    options = {"solver": "ordinates"}
    light = deepct_py.Light(surface_albedo=0.0, wavelength=0.86)
    mie = light.replace(phase="mie")
    rendering = deepct_py.render(
        extinction, grid, views, mie.replace(effective_radius=10.0), **options
    )
    one = rendering.radiance
    radii = np.where(extinction > 0.0, np.float32(10.0), np.float32(0.0))
    everywhere = deepct_py.render(
        extinction, grid, views, mie, effective_radius=radii, **options
    )
    # Between the nodes of the table the droplets are a mixture of two sizes: 0.6 % brighter here.
    np.testing.assert_allclose(one.mean(), everywhere.radiance.mean(), rtol=0.01)
    assert everywhere.light.effective_radius == pytest.approx(10.0, rel=1e-6)
    assert rendering.light == mie.replace(effective_radius=10.0)
    with pytest.raises(ValueError, match="mie"):
        deepct_py.render(extinction, grid, views, light, effective_radius=radii, **options)
    smooth = deepct_py.render(extinction, grid, views, light, **options).radiance
    contrast = (one[0].mean() / one[1].mean()) / (smooth[0].mean() / smooth[1].mean())
    assert contrast > 1.1


def test_air_and_waves_add_light(grid, views):
    clear = np.zeros(grid.shape, np.float32)
    def mean(**more):
        light = deepct_py.Light(surface_albedo=0.0, **more)
        return deepct_py.render(clear, grid, views, light, samples=64).radiance.mean()

    assert mean() == 0.0
    assert mean(wind_speed=7.0) > 0.0
    assert mean(air=True, wavelength=0.45) > 4.0 * mean(air=True, wavelength=0.7)


def test_noise_has_the_variance_of_the_sensor():
    """V = N + dark charge + read noise^2 + (step of the converter)^2 / 12, in electrons."""
    sensor = deepct_py.Sensor.preset("cmv4000")
    electrons, per_radiance = 4000.0, 10_000.0
    radiance = np.full((3, 200, 200), electrons / per_radiance, np.float32)
    sensed = deepct_py.sense(radiance, sensor, electrons_per_radiance=per_radiance, seed=2)
    assert sensed.radiance.dtype == np.float32 and sensed.radiance.shape == radiance.shape
    read = sensed.radiance.astype(np.float64) * per_radiance
    step = sensor.full_well / 2**sensor.bits
    dark = sensor.dark_current * sensor.exposure
    variance = electrons + dark + sensor.read_noise**2 + step**2 / 12.0
    assert abs(read.mean() - electrons) < 4.0 * np.sqrt(variance / read.size)
    assert abs(read.var() / variance - 1.0) < 4.0 * np.sqrt(2.0 / read.size)
    levels = (read + dark) / step
    np.testing.assert_allclose(levels, np.round(levels), atol=2e-3)


def test_the_brightest_pixel_fills_its_well():
    radiance = np.array([[[0.1, 0.2]], [[0.4, 0.05]]], np.float32)
    sensed = deepct_py.sense(radiance, "cmv4000")
    assert sensed.electrons_per_radiance == pytest.approx(13_500.0 / np.float32(0.4), rel=1e-12)
    assert np.array_equal(deepct_py.sense(radiance).radiance, sensed.radiance)
    assert not np.array_equal(deepct_py.sense(radiance, seed=2).radiance, sensed.radiance)


def test_a_mask_holds_the_ball_it_was_carved_from(grid, extinction, views):
    """A pixel is bright if its line of sight passes through or close to the ball: the mask
    contains every voxel of the ball and none of a column at a corner of the grid."""
    radiance = np.zeros((len(views), 16, 16), np.float32)
    x, y, z = np.meshgrid(grid.x, grid.y, grid.z, indexing="ij")
    centre = np.array(grid.center)
    for image, view in zip(radiance, views):
        for row in range(16):
            for col in range(16):
                origin, direction = map(np.array, view.ray(row + 0.5, col + 0.5))
                closest = np.linalg.norm(np.cross(centre - origin, direction))
                image[row, col] = float(closest < 0.25 + 0.05)
    carved = deepct_py.carve(radiance, views, grid, threshold=0.5, agreement=1.0)
    assert carved.mask.dtype == np.bool_ and carved.mask.shape == grid.shape
    assert carved.mask[extinction > 0.0].all()
    assert not carved.mask[:, 0, 0].any() and carved.mask.mean() < 0.6
    assert (carved.thresholds == 0.5).all()
    found = deepct_py.carve(radiance + np.float32(0.01), views, grid)
    assert ((0.01 < found.thresholds) & (found.thresholds < 1.01)).all()


def test_every_view_has_its_own_threshold():
    """Slanted views look through more air: with one threshold for all views, a fifth of the cloud
    was carved away."""
    cloud = deepct_py.generate_cloud(seed=3)
    views = deepct_py.Views.load("pearls-32", cloud.grid.center)
    light = deepct_py.Light(air=True, wavelength=0.555)
    images = deepct_py.render(cloud.extinction, cloud.grid, views, light, solver="ordinates")
    carved = deepct_py.carve(images.radiance, views, cloud.grid)
    missed = cloud.extinction[~carved.mask].sum() / cloud.extinction.sum()
    assert missed < 0.005 and carved.mask.mean() < 0.15
    assert carved.thresholds.max() > 1.5 * carved.thresholds.min()


def test_bright_ground_gives_a_warning(grid, extinction):
    views = [
        deepct_py.View.orthographic(abs(zenith), 90 - 90 * np.sign(zenith), grid.center, 0.05, (24, 24))
        for zenith in (-50, -25, 0, 25, 50)
    ]
    light = deepct_py.Light(sun_zenith_deg=45.0, surface_albedo=0.8)
    images = deepct_py.render(extinction, grid, views, light, solver="ordinates").radiance
    with pytest.warns(UserWarning, match="the clear surface is as bright as the clouds"):
        assert deepct_py.carve(images, views, grid).mask.all()


def test_shaded_sides_of_clouds_above_bright_ground():
    """Between an albedo of 0.15 and 0.5, up to a third of this cloud is darker than the ground."""
    cloud = deepct_py.generate_cloud(seed=3)
    for albedo, zenith, warns in ((0.15, 40.0, False), (0.25, 40.0, True), (0.5, 60.0, True)):
        light = deepct_py.Light(sun=(zenith, 200.0), surface_albedo=albedo)
        images = deepct_py.render(cloud, views="cloudct-10", light=light, samples=200)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mask = deepct_py.carve(images, grid=cloud.grid).mask
        told = any("nearly as bright as the clouds" in str(warning.message) for warning in caught)
        assert told == warns
        assert cloud.extinction[~mask].sum() < 0.03 * cloud.extinction.sum()
        assert mask.mean() < 0.3


def test_pixels_that_are_saturated_or_defective(grid, extinction):
    """Saturated pixels are lower bounds, and an infinite standard error leaves pixels out."""
    views = [
        deepct_py.View.orthographic(abs(zenith), 90 - 90 * np.sign(zenith), grid.center, 0.05, (24, 24))
        for zenith in (-45, -25, 0, 25, 45)
    ]
    images = deepct_py.render(extinction, grid, views, solver="ordinates").radiance

    def error(radiance, **arguments):
        found = deepct_py.invert(radiance, views, grid, iterations=40, **arguments)
        return deepct_py.score(extinction, found.extinction).relative_error

    clean = deepct_py.sense(images, seed=3)
    whole = error(clean.radiance, standard_error=clean.noise, saturated=clean.saturated)
    bright = deepct_py.sense(images, electrons_per_radiance=2 * clean.electrons_per_radiance, seed=3)
    assert 0.01 < bright.saturated.mean() < 0.2
    bound = error(bright.radiance, standard_error=bright.noise, saturated=bright.saturated)
    taken = error(bright.radiance, standard_error=bright.noise)
    assert whole < 0.25 and bound < 0.3 and taken > 0.8
    dead, noise = clean.radiance.copy(), clean.noise.copy()
    dead[2, 10:14, 10:14], noise[2, 10:14, 10:14] = 0.0, np.inf
    left_out = error(dead, standard_error=noise)
    noise[2, 10:14, 10:14] = clean.noise.min()
    taken_dead = error(dead, standard_error=noise)
    assert left_out < 0.25 and taken_dead > 1.0


def test_what_no_image_shows_is_not_retrieved(grid, extinction):
    """Images of the eastern half only; a warning says that a result does not explain the images."""
    x, y, z = grid.center
    views = [
        deepct_py.View.orthographic(zenith, azimuth, (x + 0.2, y, z), 0.05, (24, 8))
        for zenith, azimuth in ((45, 0), (0, 0), (45, 180))
    ]
    images = deepct_py.render(extinction, grid, views, solver="ordinates").radiance
    mask = np.ones(grid.shape, bool)
    with pytest.warns(UserWarning, match="no image shows 1024 of 2048 voxels"):
        found = deepct_py.invert(images, views, grid, mask=mask, iterations=5)
    assert not found.extinction[:, :, :8].any() and found.extinction[:, :, 8:].any()
    with pytest.warns(UserWarning, match="the result does not explain the images"):
        deepct_py.invert(100 * images, views, grid, mask=extinction > 0, iterations=2,
                         light=deepct_py.Light(solar_irradiance=2.0))


def test_ordinates_tell_what_they_neglect(grid, extinction, views):
    light = deepct_py.Light(air=True, periodic=True)
    with pytest.warns(UserWarning, match="the air scatters back"):
        deepct_py.render(extinction, grid, list(views)[5:6], light, solver="ordinates")


def test_an_inversion_finds_a_thin_ball(grid, extinction, views):
    thin = (extinction / 15).astype(np.float32)
    light = deepct_py.Light(surface_albedo=0.0)
    images = deepct_py.render(thin, grid, views, light, samples=20000)
    options = {
        "light": light,
        "standard_error": images.standard_error,
        "iterations": 12,
        "coarse": [],
        "mask": np.ones(grid.shape, bool),
    }
    found = deepct_py.invert(images.radiance, views, grid, truth=thin, **options)
    assert found.extinction.shape == grid.shape and found.mask.all()
    errors = [step["relative_error"] for step in found.history]
    assert errors[-1] == pytest.approx(
        deepct_py.score(thin, found.extinction).relative_error, rel=1e-5
    )
    assert found.history[-1]["misfit"] < 3.0
    assert errors[-1] < 0.3 and found.ending in ("noise", "iterations", "stalled")
    other = deepct_py.invert(images.radiance, views, grid, init=found.extinction, **options)
    assert other.history[0]["misfit"] < 1.1 * found.history[-1]["misfit"]
    with pytest.raises(TypeError, match="iteratons"):
        deepct_py.invert(images.radiance, views, grid, iteratons=3)


def test_an_inversion_knows_droplets_and_air(grid, extinction, views):
    light = deepct_py.Light(
        phase="mie", effective_radius=8.0, effective_variance=0.05, air=True, wind_speed=6.0,
        periodic=True,
    )
    with pytest.warns(UserWarning, match="ocean waves"):
        images = deepct_py.render(extinction, grid, views, light, solver="ordinates")
    options = {"init": extinction, "iterations": 0, "mask": extinction > 0.0}

    def misfit(**other):
        found = deepct_py.invert(
            images.radiance, views, grid, images.light.replace(**other), **options
        )
        return found.history[0]["misfit"]

    # The true extinction reproduces the images with the light they were rendered with only.
    assert misfit() < 0.1
    assert misfit(air=False) > 1.0
    assert misfit(phase="hg", effective_variance=None) > 1.0
    assert misfit(periodic=False) > 1.0
    assert misfit(wavelength=0.45) > 1.0


def test_a_light_is_a_table_of_values():
    light = deepct_py.Light(phase="mie", wind_speed=5, air=True)
    assert light.wind_speed == 5.0 and light.air is True and light.effective_radius is None
    assert deepct_py.Light(**light.to_dict()) == light
    assert light.replace(air=False) != light
    assert light.replace(wind_speed=None).wind_speed is None
    assert eval(repr(light), {"Light": deepct_py.Light}) == light
    for error, values in [
        (TypeError, {"sun_zenith": 3.0}),
        (ValueError, {"sun_zenith_deg": "noon"}),
        (ValueError, {"solar_irradiance": -1.0}),
        (ValueError, {"phase": "rayleigh"}),
        (ValueError, {"air": 3.0}),
        (TypeError, {"wavelength": [0.5]}),
    ]:
        with pytest.raises(error, match=next(iter(values))):
            deepct_py.Light(**values)
    with pytest.raises(AttributeError):
        light.sun_zenith


def test_a_hybrid_starts_from_the_network(views):
    network = deepct_py.Network.load("cloudct-10")
    near = deepct_py.Views.load("cloudct-10", target=views[0].target, size=(12, 12))
    levels, target = network.metadata["levels"], network.metadata["target_altitude_km"]
    near = deepct_py.Views.load("cloudct-10", target=(0.3, 0.3, target), size=(12, 12))
    grid = network.grid(near)
    assert grid.shape[0] == levels["count"]
    z, y, x = np.meshgrid(grid.z, grid.y, grid.x, indexing="ij")
    ball = (x - 0.3) ** 2 + (y - 0.3) ** 2 + (z - target) ** 2 < 0.2**2
    images = deepct_py.render(np.where(ball, 10.0, 0.0), grid, near, samples=64)
    options = {"standard_error": images.standard_error, "scale_start": False}
    found = deepct_py.hybrid(images.radiance, near, network, iterations=0, **options)
    guess = network.infer(images.radiance, near, mask=found.mask)
    assert np.allclose(found.extinction, guess, rtol=1e-4, atol=1e-4)
    better = deepct_py.hybrid(images.radiance, near, network, iterations=3, **options)
    assert better.history[-1]["misfit"] < found.history[-1]["misfit"]


def test_ordinates_are_as_accurate_as_requested():
    grid = deepct_py.Grid((4, 4, 4), (0.05, 0.05, 0.04), (0.0, 0.0, 0.5))
    extinction = np.full(grid.shape, 60.0, np.float32)
    views = deepct_py.Views.load("cloudct-10", grid.center, (4, 4))

    def images(accuracy):
        how = {"solver": "ordinates", "estimate_error": False, "accuracy": accuracy}
        return deepct_py.render(extinction, grid, views, **how).radiance

    usual, coarse = images(None), images(0.05)
    assert np.array_equal(usual, images(0.01))
    difference = np.abs(coarse / usual - 1.0).max()
    assert 1e-4 < difference < 0.1
    with pytest.raises(ValueError, match="noise is given, but must be omitted"):
        deepct_py.render(extinction, grid, views, solver="ordinates", noise=0.05)
    with pytest.raises(ValueError, match="accuracy is given, but must be omitted"):
        deepct_py.render(extinction, grid, views, accuracy=0.05)
