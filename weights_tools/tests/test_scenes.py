import numpy as np
import pytest

from weights_tools.clouds import Placement, connected, extent_of, placed, snapshot_of
from weights_tools.droplets import droplet_table, effective_radius, extinction, table_index
from weights_tools.errors import InputError
from weights_tools.general_recipe import is_general_recipe, load_general_recipe
from weights_tools.scenes import CLOUDCT_10, PEARLS_32_DEG, SceneGenerator


@pytest.fixture(scope="module")
def recipe(simulations):
    return load_general_recipe(simulations / "recipe.toml")


def generator(recipe, simulations, split="train"):
    return SceneGenerator(recipe.scenes, recipe.split(split), simulations, split)


def test_touching_columns_are_one_cloud_across_the_periodic_sides():
    cloudy = np.array(
        [
            [1, 0, 0, 1, 0, 1],
            [0, 0, 1, 1, 0, 0],
            [0, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [1, 0, 0, 1, 0, 1],
        ],
        bool,
    )
    labels = connected(cloudy)
    assert (labels > 0).tolist() == cloudy.tolist()
    # The corners touch across the sides, as do the first and last row.
    assert len({labels[0, 0], labels[0, 5], labels[4, 5], labels[4, 0]}) == 1
    assert len({labels[0, 3], labels[1, 3], labels[1, 2], labels[4, 3]}) == 1
    assert len(np.unique(labels)) == 1 + 3


def test_an_isolated_cloud_is_placed_at_the_centre_with_its_water():
    water = np.zeros((20, 80, 80), np.float32)
    rows = np.arange(-3, 3) % 80
    water[np.ix_(range(5, 11), rows, range(10, 14))] = 0.5
    water[5:9, 10:14, 10:14] = 0.5
    snapshot = snapshot_of(water, 0.5, 0.04)
    label = snapshot.labels[0, 10]
    extent = extent_of(snapshot, label)
    assert (extent.first, extent.last, extent.columns) == (5, 10, 6)
    place = Placement(1.0, 1.0, 1.0, (0.0, 0.0), 3.0, (0.0, 0.0))
    cloud = placed(snapshot, label, True, place)
    expected = np.zeros((32, 32, 32), np.float32)
    expected[3:9, 13:19, 14:18] = 0.5
    np.testing.assert_allclose(cloud, expected, atol=1e-6)
    # Voxels of twice the size contain the averages.
    half = placed(snapshot, label, True, Placement(2.0, 1.0, 1.0, (0.0, 0.0), 3.0, (0.0, 0.0)))
    assert half.sum() == pytest.approx(cloud.sum() / 8.0, rel=0.05)


def test_a_scene_depends_on_its_number_only(recipe, simulations):
    first, second = (generator(recipe, simulations) for _ in range(2))
    second.scene(0)
    for number in (3, 1):
        one, other = first.scene(number), second.scene(number)
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)
    assert not np.array_equal(first.scene(1).extinction, first.scene(3).extinction)
    validation = generator(recipe, simulations, "validation").scene(1)
    assert not np.array_equal(first.scene(1).extinction, validation.extinction)


def test_scenes_are_within_their_ranges(recipe, simulations):
    source = generator(recipe, simulations)
    scenes = [source.scene(number) for number in range(40)]
    assert 4 <= sum(scene.paper for scene in scenes) <= 24
    for scene in scenes:
        cloudy = scene.extinction > 0.0
        assert cloudy.sum() >= 12 and 0.0 < scene.extinction.max() <= 400.0
        assert scene.effective_radius.min() > 1.0 and scene.effective_radius.max() <= 20.0
        assert scene.bottom_km >= 0.05
        np.testing.assert_allclose(np.linalg.norm(scene.towards, axis=1), 1.0)
        assert np.degrees(np.arccos(scene.sun[2])) <= 70.0 + 1e-9
        zenith = np.degrees(np.arccos(scene.towards[:, 2]))
        assert len(zenith) == 48 and zenith.max() <= 75.3 + 1e-9
        assert np.all(scene.distance_km > 90.0)
        if scene.paper:
            np.testing.assert_allclose(zenith[:32], np.abs(PEARLS_32_DEG), atol=1e-6)
            assert scene.pixel_km[16] == pytest.approx(0.05)


def test_the_formation_of_the_paper_is_that_of_deepct():
    deepct = pytest.importorskip("deepct_py")
    views = deepct.Views.load("pearls-32", (0.0, 0.0, 1.12))
    np.testing.assert_allclose(views.zenith_deg, np.abs(PEARLS_32_DEG), atol=1e-9)
    ten = deepct.Views.load("cloudct-10", (0.0, 0.0, 1.12))
    chosen = np.abs(PEARLS_32_DEG)[list(CLOUDCT_10)]
    np.testing.assert_allclose(ten.zenith_deg, chosen, atol=1e-9)


def test_clouds_of_the_generator_are_read_from_their_file(recipe, simulations, tmp_path):
    pytest.importorskip("deepct_py")
    from weights_tools.clouds import Generated

    direct = Generated(tmp_path, 3)
    direct.write(tmp_path)
    stored = Generated(tmp_path, 3)
    for source in (direct, stored):
        snapshot, label = source.draw(np.random.default_rng(1))
        assert (snapshot.labels == label).sum() > 10
    water = [source.draw(np.random.default_rng(1))[0].water for source in (direct, stored)]
    np.testing.assert_array_equal(*water)


def test_a_missing_simulation_is_named(recipe, tmp_path):
    with pytest.raises(InputError, match=r"clouds\.nc: No such file"):
        generator(recipe, tmp_path)


def test_droplets_scatter_as_large_spheres_with_a_forward_peak():
    table = droplet_table()
    assert table.phase.shape[0] == len(table.removed)
    theta = np.linspace(0.0, np.pi, table.phase.shape[1])

    def integral(values):
        values = 2.0 * np.pi * values * np.sin(theta)
        return 0.5 * ((values[:, 1:] + values[:, :-1]) * np.diff(theta)).sum(1)

    np.testing.assert_allclose(integral(table.phase), 1.0, rtol=1e-4)
    assert np.all((table.removed > 0.1) & (table.removed < 0.6))
    # The drawn cosines have the mean cosine of the phase function.
    means = integral(table.phase * np.cos(theta))
    np.testing.assert_allclose(table.cosine.mean(1), means, rtol=2e-3)
    # The asymmetry parameter of droplets of 10 um is 0.86 to 0.87 including the peak.
    index = round(float(table_index(np.array([10.0]))[0]))
    peak = table.removed[index]
    assert 0.84 < means[index] * (1.0 - peak) + peak < 0.885


def test_effective_radius_and_extinction_follow_the_water():
    radius = effective_radius(np.array([0.0, 0.3, 30.0]), 100.0)
    np.testing.assert_allclose(radius, [0.0, 9.638, 20.0], rtol=1e-3)
    # 3 Q LWC / (4 rho r) with an efficiency slightly above 2.
    assert extinction(np.array([0.3]), np.array([10.0]))[0] == pytest.approx(22.5 * 2.13, rel=0.02)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("share = 1.0", "share = 0.0", "simulations[0].share is out of range"),
        ("first = 0", 'first = "0"', "simulations[0].first is '0'"),
        ("first = 0\n", "", "no key simulations[0].first"),
        ("generated = 0.0", "generated = 2.0", "scenes.generated is out of range"),
        ('split = "validation"', 'split = "test"', "simulations[1].split is out of range"),
        ("planes = 2", "planes = 0", "planes is 0"),
        ("[scenes]", "[scenes]\nsize = 3", "unknown key scenes.size"),
        ("[scenes]", "[training]\nturn = [0.7]\n[scenes]", "training.turn is not a list of 2"),
    ],
)
def test_wrong_recipes_are_refused(simulations, tmp_path, old, new, message):
    text = (simulations / "recipe.toml").read_text()
    assert old in text
    path = tmp_path / "recipe.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_general_recipe(path)
    assert message in str(error.value)


def test_the_recipes_that_ship_are_valid():
    from pathlib import Path

    folder = Path(__file__).parents[1] / "recipes"
    general = [path for path in folder.glob("*.toml") if is_general_recipe(path)]
    assert {path.stem for path in general} == {"general", "general-gpu"}
    recipes = [load_general_recipe(path) for path in general]
    assert recipes[0].simulations == recipes[1].simulations
    assert recipes[0].network == recipes[1].network
    # RICO is reserved for tests.
    assert not any("rico" in each.file for each in recipes[0].simulations)
