"""Shifts of clouds together with their images."""

import math

import torch

from weights_tools.dataset import ViewGeometry
from weights_tools.shift import Shifter, interpolation


def test_whole_pixels_move_exactly_and_the_edge_goes_on():
    line = torch.rand(9)
    moved = interpolation(torch.tensor(2.0), 9) @ line
    assert torch.equal(moved[2:], line[:-2])
    assert torch.equal(moved[:2], line[0].expand(2))


def test_fractions_of_a_pixel_move_smooth_lines():
    pixels = torch.arange(40.0)
    line = torch.sin(0.4 * pixels)
    moved = interpolation(torch.tensor(-1.3), 40) @ line
    assert (moved - torch.sin(0.4 * (pixels + 1.3)))[4:-4].abs().max() < 1e-3


def test_the_image_moves_with_the_cloud():
    """Images of a blob at its projected position, before and after a shift of the cloud."""
    zenith = 40.0
    angles = (0.0, zenith, zenith)
    geometry = ViewGeometry(30.0, 45.0, angles, (0.0, 180.0, 0.0), (0.05, 0.0625, 0.0625))
    shifter = Shifter(geometry, (0.05, 0.05, 0.04), 3, 2)

    def scene(up_km: float, north_km: float, east_km: float):
        extinction = torch.zeros(1, 6, 16, 16)
        place = (3 + up_km / 0.04, 8 + north_km / 0.05, 8 + east_km / 0.05)
        extinction[0][tuple(round(index) for index in place)] = 1.0
        images = []
        for slant, pixel in ((0.0, 0.05), (zenith, 0.0625), (-zenith, 0.0625)):
            # In a view from the south, a higher point appears farther to the north.
            angle = math.radians(slant)
            row = (north_km * math.cos(angle) + up_km * math.sin(angle)) / pixel + 8
            col = east_km / pixel + 8
            line = torch.arange(16.0)
            images.append(torch.exp(-((line - row)[:, None] ** 2 + (line - col)[None, :] ** 2) / 8))
        return extinction, torch.stack(images)[None]

    extinction, images = scene(0.0, 0.0, 0.0)
    generator = torch.Generator().manual_seed(5)
    seen = set()
    for _ in range(20):
        moved, moved_images = shifter.draw(extinction, images, generator)
        level, row, col = (int(place) for place in torch.nonzero(moved[0])[0])
        seen.add((level, row, col))
        expected_cloud, expected_images = scene(
            (level - 3) * 0.04, (row - 8) * 0.05, (col - 8) * 0.05
        )
        assert torch.equal(moved, expected_cloud)
        assert (moved_images - expected_images).abs().max() < 0.02
    assert len(seen) > 10
    assert all(5 <= place <= 11 for places in seen for place in places[1:])
    assert {level for level, _, _ in seen} == {1, 2, 3, 4, 5}


def test_a_camera_that_points_elsewhere_moves_its_image_alone():
    geometry = ViewGeometry(30.0, 45.0, (0.0, 30.0), (0.0, 0.0), (0.05, 0.05))
    shifter = Shifter(geometry, (0.05, 0.05, 0.04), 0, 0, 0.4)
    clouds, lines = 200, torch.arange(16.0)
    # The values of a ramp, except at its ends, give the distance by which it was moved.
    ramps = (3.0 * lines[:, None] + 5.0 * lines).expand(clouds, 2, 16, 16)
    extinction = torch.ones(clouds, 1, 4, 4)
    moved, images = shifter.draw(extinction, ramps, torch.Generator().manual_seed(6))
    assert torch.equal(moved, extinction)
    offsets = (ramps - images)[:, :, 3:-3, 3:-3]
    assert (offsets - offsets.mean((2, 3), keepdim=True)).abs().max() < 1e-4
    expected = 0.4 * math.hypot(3.0, 5.0)
    assert abs(offsets[..., 0, 0].std().item() / expected - 1.0) < 0.15
    assert abs(torch.corrcoef(offsets[..., 0, 0].T)[0, 1]) < 0.2


def test_no_cloud_leaves_its_domain():
    geometry = ViewGeometry(30.0, 45.0, (0.0,), (0.0,), (0.05,))
    extinction = torch.zeros(64, 1, 10, 10)
    extinction[:, :, 1:9, 0:3] = 1.0
    moved, _ = Shifter(geometry, (0.05, 0.05, 0.04), 6).draw(
        extinction, torch.ones(64, 1, 10, 10), torch.Generator().manual_seed(1)
    )
    assert torch.equal(moved.sum((1, 2, 3)), extinction.sum((1, 2, 3)))
