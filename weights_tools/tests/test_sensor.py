"""The noise compared with the paper's equation for its variance."""

import math

import pytest
import torch

from weights_tools.sensor import Sensor


def images(electrons: float, pixels: int = 400) -> torch.Tensor:
    """The radiance of a uniform image with the given charge and one bright pixel. The full well
    corresponds to 0.3 / sr."""
    radiance = torch.full((1, 2, pixels, pixels), electrons / 13_500 * 0.3)
    radiance[0, 1, 0, 0] = 0.3
    return radiance


@pytest.mark.parametrize(
    ("electrons", "ratio"),
    [(6750.0, "81"), (1350.0, "34"), (210.0, "11"), (190.0, "9.8"), (135.0, "7.6")],
)
def test_mean_and_variance_are_those_of_the_equation(electrons, ratio):
    sensor = Sensor()
    sensed = sensor.sense(images(electrons), torch.Generator().manual_seed(1))
    charge = sensed[0, 0].double() / 0.3 * 13_500
    expected = sensor.variance(electrons)
    # The relative standard error of a variance from n values is sqrt(2 / n).
    assert charge.var().item() == pytest.approx(expected, rel=4 * math.sqrt(2 / charge.numel()))
    error = math.sqrt(expected / charge.numel())
    assert charge.mean().item() == pytest.approx(electrons, abs=4 * error)
    assert f"{electrons / math.sqrt(expected):.2g}" == ratio


def test_grey_levels_are_whole_and_saturate():
    sensor = Sensor()
    sensed = sensor.sense(images(13_400.0), torch.Generator().manual_seed(1))
    counts = (sensed.double() / 0.3 * 13_500 + sensor.dark_charge) / sensor.electrons_per_count
    assert (counts - counts.round()).abs().max() < 1e-3
    assert counts.round().max() == 1023


def test_the_scale_is_that_of_each_scene():
    radiance = images(1350.0, 64)
    scenes = torch.cat([radiance, 10 * radiance])
    sensed = Sensor(read_noise=0.0, bits=24).sense(scenes, torch.Generator().manual_seed(1))
    assert sensed[1, 0].std() / sensed[0, 0].std() == pytest.approx(10.0, rel=0.1)


def test_a_part_of_a_scene_is_sensed_by_the_brightest_pixel_of_all():
    radiance = images(1350.0, 64)
    sensor = Sensor(read_noise=0.0, bits=24)
    part = sensor.sense(
        radiance[:, :1], torch.Generator().manual_seed(1), radiance.amax((1, 2, 3), keepdim=True)
    )
    expected = math.sqrt(1350.0) / 13_500 * 0.3
    assert part.std().item() == pytest.approx(expected, rel=0.1)


def test_the_seed_decides():
    first, again, other = (
        Sensor().sense(images(500.0, 16), torch.Generator().manual_seed(seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_impossible_sensors_are_refused():
    for numbers in ({"full_well": 0.0}, {"bits": 0}, {"read_noise": -1.0}):
        with pytest.raises(ValueError):
            Sensor(**numbers)
