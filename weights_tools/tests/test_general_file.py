import json

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from weights_tools.__main__ import main
from weights_tools.errors import InputError
from weights_tools.fixture import DETAILED, GEOMETRIES, SMALL, random_network, write_fixture
from weights_tools.general import GeneralArchitecture, fold
from weights_tools.general_file import (
    GeneralDescription,
    GeneralWeights,
    load_general,
    read_general_weights,
    write_general_weights,
)
from weights_tools.views import views_of


@pytest.fixture
def weights():
    description = GeneralDescription(
        calibration=[(0.2, 0.25), (0.6, 0.62)],
        typical={"brightest": (0.1, 0.4)},
        training={"data": "none", "identity": "none", "samples": 3, "seed": 1},
        scores={"epsilon": 0.5, "delta": 0.1},
        configuration={"kind": "general"},
    )
    return GeneralWeights(random_network(SMALL, seed=1), description)


@pytest.fixture
def path(tmp_path, weights):
    path = tmp_path / "general.safetensors"
    write_general_weights(path, weights)
    return path


def header_of(path):
    with safe_open(str(path), "pt") as file:
        return json.loads(file.metadata()["deepct"])


def changed(path, change=None, tensors=None):
    header, values = header_of(path), load_file(path)
    if change is not None:
        change(header)
    save_file({**values, **(tensors or {})}, path, {"deepct": json.dumps(header)})
    return path


def test_a_file_contains_the_network_and_its_description(path, weights):
    found = read_general_weights(path)
    assert found.description == weights.description
    assert found.network.architecture == weights.network.architecture
    assert not found.network.training
    expected = weights.network.state_dict()
    for name, values in found.network.state_dict().items():
        if not name.endswith("num_batches_tracked"):
            assert torch.equal(values, expected[name]), name


def test_the_file_has_the_documented_keys_and_tensors(path):
    header = header_of(path)
    assert header["format_version"] == 4
    assert header["network"] == "general"
    assert header["architecture"] == {
        "virtual_views": 3,
        "planes": 2,
        "extremes": True,
        "width": 4,
        "layers": 3,
        "last_relu": True,
    }
    assert header["levels"] == {"count": 4, "height": 0.8}
    shapes = {name: list(values.shape) for name, values in load_file(path).items()}
    assert shapes["layers.0.weight"] == [4, 10, 3, 3]
    assert shapes["layers.2.batch_norm.running_var"] == [8]
    assert shapes["mixing.2.weight"] == [3, 96]
    assert shapes["modulation.1.bias"] == [16]
    assert len(shapes) == 3 * 6 + 2 * 5


def set_to(*keys):
    *parents, key, value = keys

    def change(header):
        for parent in parents:
            header = header[parent]
        header[key] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_to("format_version", 5), "is of version 5"),
        (set_to("network", "fixed"), "network 'fixed'"),
        (set_to("extra", 1), "unknown metadata extra"),
        (lambda header: header.pop("voxel_km"), "no metadata voxel_km"),
        (set_to("architecture", "width", 5), "has shape"),
        (set_to("architecture", "layers", 1), "layers is 1"),
        (set_to("architecture", "planes", 2.5), "architecture.planes is 2.5"),
        (set_to("architecture", "last_relu", False), "last_relu is False"),
        (set_to("levels", "height", -0.8), "levels.height is -0.8"),
        (set_to("ranges", "views", [9, 3]), "ranges.views is [9, 3], not in ascending order"),
        (set_to("calibration", [[0.5, 0.5], [0.4, 0.4]]), "calibration is not positive"),
        (set_to("outputs", ["extinction"]), "outputs are"),
        (set_to("output_scale", "50"), "output_scale is '50'"),
    ],
)
def test_wrong_metadata_are_refused_in_one_line(path, change, message):
    with pytest.raises(InputError) as error:
        read_general_weights(changed(path, change))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"mixing.0.bias": torch.zeros(3)}, "mixing.0.bias has shape [3], not [96]"),
        ({"mixing.0.bias": torch.full((96,), torch.nan)}, "not finite"),
        ({"layers.0.batch_norm.running_var": torch.full((4,), -1.0)}, "negative variance"),
        ({"layers.0.bias": torch.zeros(4, dtype=torch.float16)}, "not float32"),
        ({"layers.9.bias": torch.zeros(4)}, "unknown tensor layers.9.bias"),
    ],
)
def test_wrong_tensors_are_refused_in_one_line(path, tensors, message):
    with pytest.raises(InputError) as error:
        read_general_weights(changed(path, tensors=tensors))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_damaged_and_missing_files_are_refused_in_one_line(path, tmp_path, capsys):
    path.write_bytes(path.read_bytes()[:1000])
    for file in (path, tmp_path / "none.safetensors"):
        with pytest.raises(InputError) as error:
            read_general_weights(file)
        assert "\n" not in str(error.value)
    torch.save({"general": {"width": 3}}, tmp_path / "broken.pt")
    with pytest.raises(InputError, match="holds no general network"):
        load_general(tmp_path / "broken.pt")


def test_a_network_that_is_not_finite_is_not_written(tmp_path, weights):
    weights.network.layers[0].bias.data[0] = torch.inf
    with pytest.raises(InputError, match="not finite"):
        write_general_weights(tmp_path / "bad.safetensors", weights)
    assert not list(tmp_path.iterdir())


def study_checkpoint(network):
    """A checkpoint with the names of the study that preceded this program."""
    names = {"mixing": "mix", "modulation": "film"}
    state = {}
    for name, values in network.state_dict().items():
        module, number, *rest = name.split(".")
        if module in names:
            state[".".join([names[module], str(2 * int(number)), *rest])] = values
        elif rest[0] == "batch_norm":
            state[f"norm.{number}.{rest[1]}"] = values
        else:
            state[f"conv.{number}.{rest[0]}"] = values
    sizes = network.architecture
    shape = {"virtual": sizes.virtual_views, "width": sizes.width, "layers": sizes.layers}
    return {"state": state, "shape": {**shape, "extremes": sizes.extremes}, "steps": 7}


def test_checkpoints_of_the_study_are_converted_and_extended(tmp_path):
    architecture = GeneralArchitecture(virtual_views=2, extremes=False, width=3, layers=2)
    network = random_network(architecture, seed=3)
    torch.save(study_checkpoint(network), tmp_path / "study.pt")
    out = tmp_path / "general.safetensors"
    assert main(["export", str(tmp_path / "study.pt"), "--out", str(out)]) == 0
    found = read_general_weights(out).network
    assert found.architecture == architecture
    assert torch.equal(found.layers[1].weight, network.layers[1].weight)
    assert torch.equal(found.modulation[1].weight, network.modulation[1].weight)
    command = ["export", str(out), "--out", str(tmp_path / "more.safetensors"), "--extremes"]
    assert main(command) == 0
    assert read_general_weights(tmp_path / "more.safetensors").network.architecture.extremes


def test_export_removes_the_mean_error(path, tmp_path, capsys):
    out = tmp_path / "unbiased.safetensors"
    assert main(["export", str(path), "--out", str(out), "--unbiased"]) == 0
    assert "the scores of this scale are not measured" in capsys.readouterr().out
    description = read_general_weights(out).description
    assert description.output_scale == pytest.approx(50.0 / 0.9)
    assert description.scores == {"epsilon_biased": 0.5, "delta_biased": 0.1}
    assert main(["export", str(out), "--out", str(out), "--unbiased"]) == 2
    assert "its scores have a delta of None" in capsys.readouterr().err


def test_fixtures_contain_what_they_document(tmp_path):
    write_fixture(tmp_path)
    network = read_general_weights(tmp_path / "general.safetensors").network
    answers = load_file(tmp_path / "general.answers.safetensors")
    geometries = json.loads((tmp_path / "general.json").read_text())
    assert len(geometries) == GEOMETRIES
    outputs = [answers[f"{index}.output"] for index in range(GEOMETRIES)]
    assert all(output.abs().max() > 0.1 for output in outputs)
    for index in (0, DETAILED - 1):
        geometry = geometries[index]
        views = views_of(geometry["view_geometry"], geometry["horizontal_spacing_km"])
        layers = fold(network, views)
        torch.testing.assert_close(
            layers["layers.0.weight"].float(), answers[f"{index}.layers.0.weight"]
        )
