"""Images resampled onto planes, compared with the projection of each voxel."""

import math

import numpy as np
import pytest
import torch
from conftest import planes_metadata

from weights_tools.errors import InputError
from weights_tools.export import export
from weights_tools.lift import Lift, lift_of
from weights_tools.model import Network
from weights_tools.recipe import NetworkRecipe

SIZE = (20, 24)
ALTITUDES_KM = [0.6, 1.12, 1.61]


def seen_at(metadata: dict, view: int, point: np.ndarray) -> tuple[float, float]:
    """The row and column at which a view shows a point (km from the target), from its ray."""
    geometry = metadata["view_geometry"]
    zenith = math.radians(geometry["view_zenith_deg"][view])
    azimuth = math.radians(geometry["view_azimuth_deg"][view])
    towards = np.array(
        [math.sin(zenith) * math.sin(azimuth), math.sin(zenith) * math.cos(azimuth)]
        + [math.cos(zenith)]
    )
    pixel, distance = geometry["pixel_km"][view], geometry["camera_distance_km"][view]
    if distance is None:
        foot = point - point[2] / towards[2] * towards
        return foot[1] / pixel + SIZE[0] / 2, foot[0] / pixel + SIZE[1] / 2
    ray = point - distance * towards
    ray *= distance / -(ray @ towards)
    # The column axis is the projection of the east vector perpendicular to the line of sight.
    east = np.array([1.0, 0.0, 0.0]) - towards[0] * towards
    east /= np.linalg.norm(east)
    north = np.cross(towards, east)
    return ray @ north / pixel + SIZE[0] / 2, ray @ east / pixel + SIZE[1] / 2


def test_a_voxel_reads_the_pixel_that_shows_it():
    metadata = planes_metadata(ALTITUDES_KM, 32)
    lift = Lift(metadata)
    row, col = torch.meshgrid(*(torch.arange(n) + 0.5 for n in SIZE), indexing="ij")
    shown = [
        lift(image.double().expand(1, 4, *SIZE))[0].unflatten(0, (3, 4)).numpy()
        for image in (row, col)
    ]
    dx, dy = metadata["horizontal_spacing_km"]
    inside = 0
    for plane, view, y, x in np.ndindex(3, 4, *SIZE):
        # As the parallax is rounded to voxels, the value read is that of the line of sight through
        # the centre of a voxel on the plane of the target.
        north, east = lift.parallax[plane][view]
        place = [dx * (x + east + 0.5 - SIZE[1] / 2), dy * (y + north + 0.5 - SIZE[0] / 2), 0.0]
        expected = seen_at(metadata, view, np.array(place))
        if all(1.0 < at < lines - 1.0 for at, lines in zip(expected, SIZE)):
            inside += 1
            found = [values[plane, view, y, x] for values in shown]
            assert np.allclose(found, expected, atol=1e-9)
        climb = ALTITUDES_KM[plane] - metadata["target_altitude_km"]
        point = np.array([place[0] - dx * east, place[1] - dy * north, climb])
        there = seen_at(metadata, view, point)
        # The tolerance is half a voxel along each axis plus the effect of the perspective.
        assert all(abs(a - b) < 0.75 for a, b in zip(there, expected))
    assert inside > 3 * 4 * SIZE[0] * SIZE[1] / 2


def test_an_image_goes_on_beyond_its_edge():
    lift = Lift(planes_metadata(ALTITUDES_KM, 32))
    images = torch.arange(4.0)[None, :, None, None].expand(2, 4, 5, 3)
    channels = lift(images)
    assert channels.shape == (2, 12, 5, 3)
    expected = torch.arange(4.0).repeat(3)[None, :, None, None]
    assert torch.allclose(channels, expected.expand(2, 12, 5, 3))


def test_a_recipe_spreads_its_planes_over_the_levels():
    levels = {"bottom_km": 0.5, "count": 32, "spacing_km": 0.05}
    assert NetworkRecipe().image_layout(levels) == "camera"
    layout = NetworkRecipe(planes=2).image_layout(levels)
    assert layout == {"planes": {"altitudes_km": pytest.approx([0.9, 1.7])}}
    assert NetworkRecipe(layers=3, width=9, planes=2).channels(10, 32) == [20, 9, 9, 32]
    assert lift_of({"image_layout": "camera"}) is None


def test_a_network_of_other_channels_is_refused(tmp_path):
    lift = Lift(planes_metadata(ALTITUDES_KM, 32))
    with pytest.raises(ValueError, match="has 4 input channels, the images on planes are 12"):
        Network([4, 32], lift)
    torch.save(Network([4, 32]).state_dict(), tmp_path / "network.pt")
    metadata = planes_metadata(ALTITUDES_KM, 32)
    with pytest.raises(InputError, match="network.pt"):
        export(tmp_path / "network.pt", tmp_path / "w.safetensors", metadata)
    del metadata["view_geometry"]["camera_distance_km"]
    with pytest.raises(InputError, match="camera_distance_km"):
        export(tmp_path / "network.pt", tmp_path / "w.safetensors", metadata)
