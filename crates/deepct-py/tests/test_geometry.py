"""Grids, views and the Sun compared with the same computations in NumPy."""

import numpy as np
import pytest

import deepct_py
from deepct_py import Grid, Light, View, Views

EARTH_RADIUS = 6371.0


def test_a_grid_has_its_voxel_centres():
    grid = Grid(shape=(3, 4, 5), spacing=(0.1, 0.2, 0.3), origin=(1.0, 2.0, 3.0))
    assert grid.shape == (3, 4, 5)
    np.testing.assert_allclose(grid.x, 1.0 + 0.1 * (np.arange(5) + 0.5), rtol=1e-15)
    np.testing.assert_allclose(grid.y, 2.0 + 0.2 * (np.arange(4) + 0.5), rtol=1e-15)
    np.testing.assert_allclose(grid.z, 3.0 + 0.3 * (np.arange(3) + 0.5), rtol=1e-15)
    np.testing.assert_allclose(grid.center, (1.25, 2.4, 3.45), rtol=1e-15)
    assert grid == Grid((3, 4, 5), (0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    assert grid != Grid((3, 4, 5), (0.1, 0.2, 0.3))


def test_an_orbit_gives_a_camera():
    """The angles and the distance are those of skyfield 1.55 and pymap3d 3.2.0."""
    ecef = (5060.686587, 3417.321727, 3364.022757)
    camera = deepct_py.camera_from_ecef(ecef, 32.0, 35.0)
    np.testing.assert_allclose(camera, (-103.3845, -363.3982, 588.3358), atol=1e-6)
    view = View.perspective(camera, (0.0, 0.0, 0.0), 1e-4)
    np.testing.assert_allclose(view.zenith_deg, 32.70781, atol=1e-5)
    np.testing.assert_allclose(view.azimuth_deg, 195.88072, atol=1e-5)
    np.testing.assert_allclose(view.pixel_km, 0.06992036, atol=1e-8)
    with pytest.raises(ValueError, match="in km"):
        deepct_py.camera_from_ecef(tuple(1e3 * km for km in ecef), 32.0, 35.0)


def test_the_paper_lists_the_angles_of_the_presets():
    views = Views.load("cloudct-10", target=(0.8, 0.8, 1.0))
    np.testing.assert_allclose(views.zenith_deg, [46, 34, 26, 18, 9, 0, 9, 18, 26, 34], atol=1e-9)
    np.testing.assert_allclose(views.azimuth_deg[:5], 180.0, atol=1e-9)
    assert len(Views.load("pearls-32", target=(0.8, 0.8, 1.0))) == 32


def test_a_string_of_pearls_stands_on_its_orbit():
    altitude, arc, track = 500.0, 150.0, np.radians(30.0)
    views = Views.string_of_pearls(
        (0.0, 0.0, 0.0), altitude, arc, -3, 4, track_azimuth_deg=30.0, size=(4, 6)
    )
    assert len(views) == 8
    orbit = EARTH_RADIUS + altitude
    for view, number in zip(views, range(-3, 5)):
        gamma = number * arc / orbit
        along, up = orbit * np.sin(gamma), orbit * np.cos(gamma) - EARTH_RADIUS
        expected = (along * np.sin(track), along * np.cos(track), up)
        np.testing.assert_allclose(view.position, expected, atol=1e-6)
        assert view.size == (4, 6)
        distance = np.linalg.norm(expected)
        np.testing.assert_allclose(view.pixel_km, 0.05 / altitude * distance, rtol=1e-12)


def test_a_camera_projects_as_a_pinhole():
    target, position = np.array([0.5, 0.4, 1.0]), np.array([120.0, -340.0, 520.0])
    view = View.perspective(tuple(position), tuple(target), 1e-4, size=(20, 30))
    towards = (position - target) / np.linalg.norm(position - target)
    east = np.array([1.0, 0.0, 0.0])
    col_axis = east - east.dot(towards) * towards
    col_axis /= np.linalg.norm(col_axis)
    row_axis = np.cross(towards, col_axis)
    for point in np.random.default_rng(1).uniform(-1.0, 2.0, (20, 3)):
        offset = point - position
        depth = -offset.dot(towards)
        row = offset.dot(row_axis) / depth / 1e-4 + 10.0
        col = offset.dot(col_axis) / depth / 1e-4 + 15.0
        np.testing.assert_allclose(view.project(tuple(point)), (row, col), atol=1e-6)
        origin, direction = view.ray(row, col)
        along = (point - np.array(origin)) / np.linalg.norm(point - np.array(origin))
        np.testing.assert_allclose(along, direction, atol=1e-12)


def test_a_file_of_views_is_that_of_the_command_line(tmp_path):
    path = tmp_path / "views.toml"
    path.write_text(
        "[string_of_pearls]\nsatellites = 5\narc_km = 120.0\noverhead = 2\n"
        "altitude_km = 550.0\npixel_km = 0.04\n"
    )
    views = Views.load(path, target=(0.5, 0.5, 1.0), size=(20, 24))
    expected = Views.string_of_pearls(
        (0.5, 0.5, 1.0), 550.0, 120.0, -2, 2, pixel_km=0.04, size=(20, 24)
    )
    assert views == expected
    path.write_text("[string_of_pearls]\nsatelites = 5\n")
    with pytest.raises(deepct_py.DeepctError, match="views.toml"):
        Views.load(path, target=(0.5, 0.5, 1.0))


def test_views_are_a_sequence(grid):
    views = Views.load("cloudct-10", target=grid.center)
    assert views[-1] == views[9] and len(list(views)) == 10
    assert Views(list(views)) == views
    with pytest.raises(IndexError):
        views[10]
    with pytest.raises(ValueError, match="number of views"):
        Views([])


def test_impossible_geometry_is_refused():
    for wrong in [
        lambda: Grid((0, 1, 1), (1.0, 1.0, 1.0)),
        lambda: Grid((1, 1, 1), (1.0, -1.0, 1.0)),
        lambda: Grid((1 << 20, 1 << 20, 1 << 20), (1.0, 1.0, 1.0)),
        lambda: Light(sun_zenith_deg=90.0),
        lambda: Light(sun_azimuth_deg=float("nan")),
        lambda: View.orthographic(100.0, 0.0, (0.0, 0.0, 0.0), 0.05),
        lambda: Views.load("cloudct-11", target=(0.0, 0.0, 0.0)),
        lambda: Views.string_of_pearls((0.0, 0.0, 0.0), 600.0, 100.0, 0, 40),
    ]:
        with pytest.raises(ValueError):
            wrong()
    assert Light() == Light(sun_zenith_deg=30.0, sun_azimuth_deg=45.0)
    assert issubclass(deepct_py.DeepctError, Exception)
