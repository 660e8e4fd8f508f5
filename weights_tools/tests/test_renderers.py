import shutil
from dataclasses import replace

import numpy as np
import pytest

from weights_tools.renderers import COMPILERS, DeepctRenderer, PhotonRenderer
from weights_tools.scenes import Scene

if not any(map(shutil.which, COMPILERS)):
    pytest.skip("no C++ compiler was found", allow_module_level=True)

SIGNAL = 0.03
"""Tolerance of the cloud signal of a view. The noise of the signals is about 1 %, and the error of
the discrete ordinates 1 to 2 %."""

BRIGHT = 0.10
"""Tolerance of the root mean square difference of the bright pixels, most of which is the
noise of 1024 paths, 5 to 8 %."""


def scene(seed, sun_zenith_deg, thickness):
    """An ellipsoidal cloud with random structure, and three views of it."""
    random = np.random.default_rng(seed)
    z, y, x = np.meshgrid(*[np.arange(32) - 15.5] * 3, indexing="ij")
    shape = 1.0 - (x / 9.0) ** 2 - (y / 8.0) ** 2 - ((z + 4.0) / 7.0) ** 2
    extinction = thickness * np.clip(shape, 0.0, 1.0) * random.uniform(0.5, 1.5, shape.shape)
    zenith, azimuth = np.radians([0.0, 40.0, 55.0]), np.radians([0.0, 200.0, 70.0])
    sine = np.sin(zenith)
    towards = np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(zenith)], 1)
    sun = np.radians(sun_zenith_deg)
    return Scene(
        extinction.astype(np.float32),
        np.full((32, 32, 32), 9.0, np.float32),
        bottom_km=0.5,
        sun=np.array([0.6 * np.sin(sun), 0.8 * np.sin(sun), np.cos(sun)]),
        albedo=0.05,
        towards=towards,
        distance_km=np.array([600.0, 760.0, 300.0]),
        pixel_km=np.array([0.05, 0.06, 0.07]),
        paper=False,
        factor=1.0,
        seed=seed,
    )


def test_the_program_agrees_with_deepct():
    pytest.importorskip("deepct_py")
    scenes = [scene(1, 30.0, 60.0), scene(2, 60.0, 40.0)]
    clear = [replace(each, extinction=0.0 * each.extinction) for each in scenes]
    own = PhotonRenderer("cpu", few=256, many=1024)
    other = DeepctRenderer("ordinates", noise=0.02)
    found, expected = own.render(scenes), other.render(scenes)
    background, expected_background = own.render(clear), other.render(clear)
    np.testing.assert_allclose(background.mean((2, 3)), expected_background.mean((2, 3)), rtol=0.01)
    signal = (found - background).sum((2, 3))
    expected_signal = (expected - expected_background).sum((2, 3))
    ratio = signal / expected_signal
    print("cloud signal divided by that of deepct", ratio)
    np.testing.assert_allclose(ratio, 1.0, atol=SIGNAL)
    for image, truth in zip(found.reshape(6, 32, 32), expected.reshape(6, 32, 32)):
        bright = truth > 0.5 * truth.max()
        difference = np.sqrt(np.mean((image[bright] / truth[bright] - 1.0) ** 2))
        print("relative difference of bright pixels", difference)
        assert difference < BRIGHT


def test_images_of_a_scene_do_not_depend_on_the_other_scenes():
    own = PhotonRenderer("cpu", few=8, many=8)
    scenes = [scene(1, 30.0, 60.0), scene(2, 60.0, 20.0)]
    together = own.render(scenes)
    np.testing.assert_array_equal(own.render(scenes[1:])[0], together[1])
    np.testing.assert_array_equal(own.render(scenes), together)


def test_light_is_conserved_between_white_clouds_and_a_white_surface():
    """Without air, with an albedo of 1 and a Sun at the zenith, a plane-parallel scene would have
    the radiance 1 / pi everywhere; an isolated cloud only redistributes the light."""
    each = scene(3, 0.0, 1e-4)
    found = PhotonRenderer("cpu", few=512, many=512).render([replace(each, albedo=1.0)])
    # The molecular atmosphere changes the radiance by its small optical depth only.
    np.testing.assert_allclose(found.mean((0, 2, 3)), 1.0 / np.pi, rtol=0.05)
