"""Networks for several bands that also estimate the effective radius."""

import hashlib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from conftest import LEVELS, SIZE, change_manifest, planes_metadata, saved, seasoned_network
from safetensors.torch import load_file
from test_check import DEEPCT, needs_deepct
from test_neighbours import GEOMETRY, cloud
from test_training import CPU, RECIPE, silent

from weights_tools.check import check, engines, weights_metadata
from weights_tools.checkpoint import load_checkpoint
from weights_tools.dataset import Samples, load_dataset
from weights_tools.errors import InputError
from weights_tools.export import export
from weights_tools.lift import Lift
from weights_tools.neighbours import Neighbours
from weights_tools.recipe import LossRecipe, load_recipe
from weights_tools.sensor import Sensor
from weights_tools.shift import Shifter
from weights_tools.training import BEST, Training, loss_of, radius_error, sensed

BANDS = [0.672, 2.13]
TWO_BANDS = replace(
    RECIPE,
    network=replace(RECIPE.network, layers=3, width=12, uncertainty=True, effective_radius=True),
    scaling=replace(RECIPE.scaling, effective_radius_scale=8.0),
)


@pytest.fixture
def bands_folder(dataset_folder):
    """The synthetic data set in two bands; larger droplets are darker in the second one."""

    def add_bands(manifest):
        manifest["configuration"] = {"bands": BANDS}
        for number, sample in enumerate(manifest["samples"]):
            path = dataset_folder / sample["file"]
            radius = 6.0 + number
            with h5py.File(path, "r+") as file:
                radiance, extinction = file["radiance"][...], file["extinction"][...]
                del file["radiance"], file["wavelength"]
                file["wavelength"] = BANDS
                file["radiance"] = np.stack([radiance, radiance / radius])
                file["reff"] = np.where(extinction > 0.0, radius, 0.0)
            sample["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()

    change_manifest(dataset_folder, add_bands)
    return dataset_folder


@pytest.fixture
def data(bands_folder):
    return load_dataset(bands_folder, "cloudct-10", effective_radius=True)


def test_the_images_of_all_bands_and_the_radius_are_read(data, bands_folder):
    assert data.wavelengths_um == (0.672, 2.13)
    assert data.train.volumes.shape == (6, 2, LEVELS, SIZE, SIZE)
    assert data.train.radiance.shape == (6, 20, SIZE, SIZE)
    assert len(data.geometry) == 10 and len(data.image_geometry) == 20
    assert data.image_geometry.pixel_km == 2 * data.geometry.pixel_km
    for number in range(6):
        visible, infrared = data.train.radiance[number].split(10)
        torch.testing.assert_close(infrared, visible / (6.0 + number))
        extinction, product = data.train.volumes[number]
        torch.testing.assert_close(product, (6.0 + number) * extinction)
    alone = load_dataset(bands_folder, "cloudct-10")
    assert torch.equal(alone.train.volumes, data.train.extinction)
    change_manifest(bands_folder, lambda manifest: manifest.pop("configuration"))
    with pytest.raises(InputError, match=r"radiance has shape \(2, 12, 8, 8\)"):
        load_dataset(bands_folder)


def test_the_radius_moves_with_the_extinction(data):
    shifter = Shifter(data.image_geometry, (0.05, 0.05, 0.04), 1, 1)
    generator = torch.Generator().manual_seed(2)
    volumes, _ = shifter.draw(data.train.volumes, data.train.radiance, generator)
    assert not torch.equal(volumes, data.train.volumes)
    for number, (extinction, product) in enumerate(volumes):
        torch.testing.assert_close(product, (6.0 + number) * extinction)


def test_a_neighbour_has_its_own_radius():
    clouds, images = zip(*(cloud(y, x) for y, x in ((11, 11), (10, 12), (12, 11), (11, 12))))
    radii = torch.tensor([6.0, 7.0, 8.0, 9.0])
    extinction = torch.stack(clouds)
    volumes = torch.stack([extinction, radii[:, None, None, None] * extinction], 1)
    samples = Samples(volumes, torch.stack(images))
    neighbours = Neighbours(samples, Shifter(GEOMETRY, (0.05, 0.05, 0.04), 1), 1.0)
    generator, seen = torch.Generator().manual_seed(4), set()
    for _ in range(5):
        both, _ = neighbours.draw(volumes, samples.radiance, generator)
        extinction, product = (both - volumes).sum((2, 3, 4)).unbind(1)
        seen |= set((product / extinction)[extinction > 0.0].tolist())
    assert seen == set(radii.tolist())



def test_each_band_has_a_sensor_of_its_own(data):
    sensor = Sensor()
    bright = data.train.radiance.clone()
    bright[:, 10:] *= 1e-3
    noisy = sensed(bright, data, sensor, torch.Generator().manual_seed(3))
    for part, largest in ((slice(0, 10), bright[:, :10]), (slice(10, 20), bright[:, 10:])):
        step = sensor.electrons_per_count / sensor.full_well * largest.amax((1, 2, 3))
        error = (noisy - bright)[:, part].abs().amax((1, 2, 3))
        assert (error > step).all() and (error < 50.0 * step).all()


def test_the_loss_of_the_radius_by_hand():
    extinction = torch.tensor([1.0, 3.0, 0.0]).reshape(1, 3, 1, 1)
    truth = torch.stack([extinction, 2.0 * extinction], 1)
    # Errors of 1 and 0.5 where the extinction is 1 and 3; elsewhere the radius does not matter.
    radius = torch.tensor([3.0, 1.5, 9.0]).reshape(1, 3, 1, 1)
    outputs = torch.cat([extinction, torch.zeros(1, 3, 1, 1), radius], 1)
    recipe = LossRecipe(effective_radius=2.0)
    assert loss_of(recipe, truth, outputs).item() == pytest.approx(2.0 * (1.0 + 1.5) / 4.0)
    samples = Samples(truth, torch.zeros(1, 2, 1, 1))
    assert radius_error(radius, samples) == pytest.approx(2.5 / 4.0)


def test_planes_have_the_views_of_each_band():
    metadata = planes_metadata([0.6, 1.12, 1.61], 4)
    images = torch.rand(2, 8, 9, 11)
    both = Lift({**metadata, "wavelength_um": BANDS})(images)
    for band, part in enumerate(images.split(4, 1)):
        alone = Lift(metadata)(part).unflatten(1, (3, 4))
        assert torch.equal(both.unflatten(1, (3, 2, 4))[:, :, band], alone)


def test_a_network_for_two_bands_learns_the_radius(data, tmp_path):
    training = replace(RECIPE.training, epochs=40, learning_rate=0.01, neighbours=0.0)
    run = Training(replace(TWO_BANDS, training=training), data, tmp_path, CPU)
    assert run.network.channels == [20, 12, 12, 3 * LEVELS]
    run.run(None, silent)
    first, last = run.history[0], run.history[-1]
    # The radii of the validation clouds, 12 to 14 um, are beyond those of the training.
    assert last["validation_radius_error"] < 0.6 * first["validation_radius_error"]
    metadata = load_checkpoint(tmp_path / BEST)["metadata"]
    assert metadata["wavelength_um"] == BANDS
    assert metadata["outputs"] == ["extinction", "uncertainty", "effective_radius"]
    assert metadata["effective_radius_scale"] == 8.0
    assert metadata["scores"]["radius_error"] > 0.0
    export(tmp_path / BEST, tmp_path / "w.safetensors", {})
    assert weights_metadata(tmp_path / "w.safetensors")["wavelength_um"] == BANDS


@pytest.fixture
def one_band(dataset_folder, tmp_path):
    """A weights file for one band, in other scales."""
    network = replace(TWO_BANDS.network, effective_radius=False)
    scaling = replace(TWO_BANDS.scaling, input_scale=20.0, output_scale=40.0)
    recipe = replace(TWO_BANDS, network=network, scaling=scaling)
    data = load_dataset(dataset_folder, "cloudct-10")
    run = Training(recipe, data, tmp_path / "one", CPU)
    run.run(None, silent)
    export(tmp_path / "one" / BEST, tmp_path / "one.safetensors", {})
    return run, tmp_path / "one.safetensors"


def test_a_network_begins_with_the_estimates_of_one_for_fewer_bands(one_band, data, tmp_path):
    smaller, path = one_band
    larger = Training(TWO_BANDS, data, tmp_path / "two", CPU, path)
    images = data.validation.radiance
    found = larger.estimate(images)
    best = load_checkpoint(tmp_path / "one" / BEST)
    smaller.network.load_state_dict(best["model_state_dict"])
    expected = smaller.estimate(images[:, :10])
    for name in ("extinction", "uncertainty"):
        assert expected[name].amax() > 0.1
        torch.testing.assert_close(found[name], expected[name], rtol=1e-4, atol=1e-3)
    assert larger.started_from == best["metadata"]["training"]
    # In the training too, whose normalisation is that of each batch, the estimates are similar.
    with torch.no_grad():
        batch, _ = larger._batch(torch.arange(6), torch.Generator().manual_seed(1))
        trained = larger.network.layers(batch)
        larger.network.eval()
        tested = larger.network.layers(batch)
    assert (trained - tested)[:, :LEVELS].abs().mean() < 0.2 * tested[:, :LEVELS].abs().mean()


def test_weights_of_another_network_are_no_start(one_band, data, tmp_path):
    _, path = one_band
    wider = replace(TWO_BANDS, network=replace(TWO_BANDS.network, width=13))
    with pytest.raises(InputError, match="one.safetensors: has another architecture"):
        Training(wider, data, tmp_path / "two", CPU, path)
    other = replace(TWO_BANDS, network=replace(TWO_BANDS.network, planes=1))
    with pytest.raises(InputError, match="one.safetensors: has another image_layout"):
        Training(other, data, tmp_path / "three", CPU, path)


def bands_metadata():
    return {
        **planes_metadata([0.6, 1.12, 1.61], 6),
        "wavelength_um": BANDS,
        "outputs": ["extinction", "uncertainty", "effective_radius"],
        "effective_radius_scale": 12.0,
    }


@needs_deepct
def test_deepct_gives_the_radius_of_pytorch(tmp_path):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3 * 8, 20, 18]), True)
    export(checkpoint, tmp_path / "w.safetensors", bands_metadata())
    assert len(load_file(tmp_path / "w.safetensors")) == 4
    for engine in engines(tmp_path / "w.safetensors", DEEPCT):
        found = check(checkpoint, tmp_path / "w.safetensors", engine)
        assert max(found) <= engine.tolerance, engine.name


def test_onnx_runtimes_give_the_radius_of_pytorch(tmp_path):
    pytest.importorskip("onnxruntime")
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3 * 8, 20, 18]), True)
    export(checkpoint, tmp_path / "w.onnx", bands_metadata())
    for engine in engines(tmp_path / "w.onnx", "no program"):
        assert max(check(checkpoint, tmp_path / "w.onnx", engine)) <= engine.tolerance, engine.name


def test_the_recipe_is_that_of_the_weights_it_starts_from():
    folder = Path(__file__).parents[1] / "recipes"
    one, two = (load_recipe(folder / f"cloudct-10{end}.toml") for end in ("", "-two-bands"))
    assert replace(two.network, effective_radius=False) == one.network
