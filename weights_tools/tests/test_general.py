import copy
import math

import pytest
import torch

from weights_tools.fixture import random_geometries, random_network
from weights_tools.general import (
    GeneralArchitecture,
    fold,
    folded_input,
    run_folded,
    with_extremes,
)
from weights_tools.lift import Lift
from weights_tools.planes import on_planes
from weights_tools.stream import mirrored
from weights_tools.views import Views, scene_features, view_features, views_of

SMALL = GeneralArchitecture(virtual_views=3, planes=4, width=6, layers=3, levels=5)


@pytest.fixture(scope="module", params=[False, True], ids=["sums", "extremes"])
def network(request):
    return random_network(GeneralArchitecture(**{**vars(SMALL), "extremes": request.param}), seed=4)


def geometries(count):
    for geometry in random_geometries(count, seed=9):
        yield views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])


def pictures(views, seed, size=12):
    generator = torch.Generator().manual_seed(seed)
    shape = (*views.pixel.shape, SMALL.planes, size, size)
    return torch.rand(shape, generator=generator, dtype=torch.float64)


def test_folded_layers_give_the_output_of_the_network(network):
    double = copy.deepcopy(network).double()
    worst = {torch.float64: 0.0, torch.float32: 0.0}
    for index, views in enumerate(geometries(50)):
        planes = pictures(views, index)
        layers = fold(network, views)
        for kind, module in ((torch.float64, double), (torch.float32, network)):
            inputs = folded_input(planes, network.architecture.extremes).to(kind)
            folded = run_folded({name: each.to(kind) for name, each in layers.items()}, inputs)
            with torch.no_grad():
                expected = module(planes.to(kind), views.to(kind))
            largest = expected.abs().max()
            assert largest > 0.05
            error = ((folded - expected).abs().max() / largest).item()
            worst[kind] = max(worst[kind], error)
    assert worst[torch.float64] < 1e-9
    assert worst[torch.float32] < 5e-5


def test_the_order_of_the_views_does_not_matter(network):
    double = copy.deepcopy(network).double()
    for index, views in enumerate(geometries(6)):
        planes = pictures(views, index)
        order = torch.randperm(planes.shape[1], generator=torch.Generator().manual_seed(index))
        with torch.no_grad():
            answer = double(planes, views)
            other = double(planes[:, order], views.select(order[None]))
        torch.testing.assert_close(answer, other, rtol=1e-9, atol=1e-12)


def test_unused_places_have_no_effect(network):
    double = copy.deepcopy(network).double()
    views = next(geometries(1))
    planes = pictures(views, 3)
    more = Views(
        views.sun,
        torch.cat([views.towards, views.towards[:, :2].flip(-2)], 1),
        torch.cat([views.distance, views.distance[:, :2] * 2.0], 1),
        torch.cat([views.pixel, views.pixel[:, :2] * 2.0], 1),
        torch.cat([views.present, torch.zeros(1, 2, dtype=torch.float64)], 1),
    )
    with torch.no_grad():
        answer = double(planes, views)
        other = double(torch.cat([planes, 7.0 * planes[:, :2]], 1), more)
    torch.testing.assert_close(answer, other, rtol=1e-9, atol=1e-12)


def test_extremes_that_are_added_change_nothing_at_first():
    network = random_network(GeneralArchitecture(**{**vars(SMALL), "extremes": False}), seed=2)
    extended = with_extremes(network)
    assert extended.architecture.extremes
    views = next(geometries(1)).to(torch.float32)
    planes = pictures(views, 1).float()
    with torch.no_grad():
        torch.testing.assert_close(extended(planes, views), network(planes, views))


def test_features_of_a_known_geometry():
    geometry = {
        "sun_zenith_deg": 60.0,
        "sun_azimuth_deg": 90.0,
        "view_zenith_deg": [0.0, 45.0],
        "view_azimuth_deg": [0.0, 180.0],
        "pixel_km": [0.05, 0.1],
        "camera_distance_km": [600.0, None],
    }
    views = views_of(geometry, 0.05)
    scene = scene_features(views)
    sine = 3.0**0.5 / 2.0
    # The tangents are (0, 0) and (0, -1), and half of them are the features.
    expected = [1.5 * sine, 0.0, -0.4, 0.0, -0.25, 0.0, 0.125, 0.0, math.log(2.0) - 2.3]
    torch.testing.assert_close(scene[0], torch.tensor(expected, dtype=torch.float64))
    first, second = view_features(views, scene)[0]
    cosine = 0.5
    half = (1.5 / (sine**2 + 1.5**2) ** 0.5,)
    expected = [0, 0, 0, 0, 0.5, 1.5 * sine, 0, 1.0, cosine, -0.5, *half, 0.0, *expected[3:]]
    torch.testing.assert_close(first, torch.tensor(expected, dtype=torch.float64))
    root = 0.5**0.5
    found = second[[0, 1, 2, 3, 4, 11]]
    expected = torch.tensor([0, -1.5 * root, 0, -0.5, 2.0 * root - 1.5, 1.0], dtype=torch.float64)
    torch.testing.assert_close(found, expected)


def test_images_on_planes_are_those_of_the_fixed_formations():
    heights = SMALL.heights
    for geometry in random_geometries(8, seed=3):
        spacing, target = geometry["horizontal_spacing_km"], geometry["target_altitude_km"]
        views = views_of(geometry["view_geometry"], spacing)
        images = torch.rand(1, views.pixel.shape[1], 20, 16, dtype=torch.float64)
        altitudes = (heights * spacing + target).tolist()
        lift = Lift(
            {
                **geometry,
                "wavelength_um": 0.672,
                "image_layout": {"planes": {"altitudes_km": altitudes}},
                "horizontal_spacing_km": [spacing, spacing],
            }
        )
        found = on_planes(images, views, heights)
        # The angles of `Lift` are rounded to float32.
        torch.testing.assert_close(folded_input(found, False), lift(images), rtol=0, atol=3e-5)
        corner = torch.tensor([[3, 5]])
        part = on_planes(images, views, heights, (6, 7), corner)
        torch.testing.assert_close(part, found[..., 3:9, 5:12], rtol=0, atol=1e-12)


@pytest.mark.parametrize("turns", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1)])
def test_symmetries_turn_images_on_planes_with_geometry_and_cloud(turns):
    """The images of a turned scene, made with the cameras of deepct, give turned planes."""
    deepct = pytest.importorskip("deepct_py")
    turns = torch.tensor([turns], dtype=torch.bool)
    directions = torch.tensor([[0.3, -0.5, 0.8], [0.0, 0.0, 1.0], [-0.7, 0.1, 0.7]]).double()
    towards = torch.nn.functional.normalize(directions, dim=-1)[None]
    full = torch.full((1, 3), 1.0, dtype=torch.float64)
    sun = torch.tensor([[0.5, 0.2, 0.8]], dtype=torch.float64)
    views = Views(sun, towards, 400.0 * full, 1.3 * full, full)
    turned = views.mirrored(*turns.T)

    def pattern(x, y, other):
        east, north, swapped = turns[0].tolist() if other else (False, False, False)
        if swapped:
            x, y = y, x
        x, y = (-x if east else x), (-y if north else y)
        return torch.sin(0.25 * x + 0.4) * torch.cos(0.2 * y - 0.3)

    def images(geometry, other):
        result = torch.zeros(1, 3, 32, 32, dtype=torch.float64)
        for view in range(3):
            position = (400.0 * geometry.towards[0, view]).tolist()
            camera = deepct.View.perspective(tuple(position), (0.0, 0.0, 0.0), 1.3 / 400.0)
            for row in range(32):
                for col in range(32):
                    origin, ray = camera.ray(row + 0.5, col + 0.5)
                    far = -origin[2] / ray[2]
                    x, y = (torch.tensor(origin[a] + far * ray[a]) for a in (0, 1))
                    result[0, view, row, col] = pattern(x, y, other)
        return result

    heights = torch.tensor([-6.0, 0.0, 9.0], dtype=torch.float64)
    planes = on_planes(images(views, False), views, heights)
    found = on_planes(images(turned, True), turned, heights)
    inner = (..., slice(10, 22), slice(10, 22))
    expected = mirrored(planes, turns)
    assert expected[inner].std() > 0.2
    torch.testing.assert_close(found[inner], expected[inner], rtol=0, atol=0.03)
