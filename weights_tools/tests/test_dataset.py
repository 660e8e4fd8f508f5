"""Reading of valid and invalid data sets."""

import pytest
import torch
from conftest import LEVELS, SIZE, change_manifest

from weights_tools.dataset import CLOUDCT_10_DEG, load_dataset
from weights_tools.errors import InputError


def test_all_views_in_the_order_of_the_folder(dataset_folder):
    data = load_dataset(dataset_folder)
    assert data.formation == "twelve" and data.name == "made_up"
    assert data.train.radiance.shape == (6, 12, SIZE, SIZE)
    assert data.validation.extinction.shape == (3, LEVELS, SIZE, SIZE)
    assert data.geometry.view_zenith_deg[:2] == (60.0, 34.0)
    assert data.geometry.camera_distance_km[:2] == pytest.approx((660.0, 634.0))
    assert data.wavelengths_um == (0.672,)


def test_the_ten_views_are_found_by_their_directions(dataset_folder):
    data = load_dataset(dataset_folder, "cloudct-10")
    signed = [
        -zenith if azimuth == 180.0 else zenith
        for zenith, azimuth in zip(data.geometry.view_zenith_deg, data.geometry.view_azimuth_deg)
    ]
    assert signed == list(CLOUDCT_10_DEG)
    assert data.geometry.camera_distance_km == pytest.approx([600.0 + abs(at) for at in signed])
    # The clear pixel identifies the view in the folder, where the order is reversed.
    clear = data.train.radiance[0, :, 0, 0]
    assert torch.allclose(clear, 0.01 + 0.001 * torch.arange(10, 0, -1))


def test_test_samples_are_left_alone(dataset_folder):
    def hide(manifest):
        manifest["samples"][0].update(split="test", sha256="not looked at")

    change_manifest(dataset_folder, hide)
    assert len(load_dataset(dataset_folder).train) == 5


def test_a_folder_to_measure_by_has_no_training_samples(dataset_folder):
    def learn_nothing(manifest):
        manifest["samples"] = manifest["samples"][6:]

    change_manifest(dataset_folder, learn_nothing)
    data = load_dataset(dataset_folder, "cloudct-10", required=["validation"])
    assert (len(data.train), len(data.validation), data.levels) == (0, 3, LEVELS)
    assert data.train.radiance.shape == (0, 10, SIZE, SIZE)
    with pytest.raises(InputError, match="no train sample"):
        load_dataset(dataset_folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("levels"), '"levels" is missing'),
        (lambda m: m["geometry"].pop("pixel_km"), '"geometry.pixel_km" is missing'),
        (lambda m: m.update(format="deepct-dataset 9"), '"format" is not'),
        (lambda m: m["geometry"]["pixel_km"].pop(), "different lengths"),
        (lambda m: m["geometry"]["view_zenith_deg"].__setitem__(3, 17.0), "no view at zenith 18"),
        (lambda m: m["samples"][0].update(split="dev"), "sample 0 has split 'dev'"),
        (lambda m: m["samples"][1].pop("sha256"), "sample 1 has no 'sha256'"),
        (lambda m: m.update(samples=m["samples"][:6]), "no validation sample"),
        (lambda m: m["samples"][0].update(file="samples/none.nc"), "none.nc: No such file"),
        (lambda m: m.update(image_shape=[SIZE, SIZE + 1]), "extinction has shape"),
    ],
)
def test_a_wrong_manifest_is_refused(dataset_folder, change, message):
    change_manifest(dataset_folder, change)
    with pytest.raises(InputError, match=".") as error:
        load_dataset(dataset_folder, "cloudct-10")
    assert message in str(error.value) and str(dataset_folder) in str(error.value)


def test_a_missing_manifest_is_refused(tmp_path):
    with pytest.raises(InputError, match="manifest.json: No such file"):
        load_dataset(tmp_path)


def test_a_manifest_that_is_no_json_is_refused(dataset_folder):
    (dataset_folder / "manifest.json").write_text('{"format": ')
    with pytest.raises(InputError, match="is not JSON"):
        load_dataset(dataset_folder)


def rewrite(folder, content: bytes) -> None:
    """Replace the first sample and update its checksum in the manifest."""
    import hashlib

    (folder / "samples/000000.nc").write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    change_manifest(folder, lambda manifest: manifest["samples"][0].update(sha256=digest))


def test_a_truncated_sample_is_refused(dataset_folder):
    path = dataset_folder / "samples/000000.nc"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="000000.nc.*SHA-256 differs"):
        load_dataset(dataset_folder)
    rewrite(dataset_folder, content[: len(content) // 2])
    with pytest.raises(InputError, match="000000.nc: is not a readable HDF5 file"):
        load_dataset(dataset_folder)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("extinction", float("nan"), "extinction has a value that is negative or not finite"),
        ("radiance", -1.0, "radiance has a value that is negative or not finite"),
        ("radiance", None, "has no variable radiance"),
    ],
)
def test_impossible_values_are_refused(dataset_folder, name, value, message):
    import h5py

    path = dataset_folder / "samples/000000.nc"
    with h5py.File(path, "r+") as file:
        if value is None:
            del file[name]
        else:
            file[name][0, 1, 1] = value
    rewrite(dataset_folder, path.read_bytes())
    with pytest.raises(InputError, match=message):
        load_dataset(dataset_folder)
