"""The network as an ONNX graph."""

import json
import sys

import numpy as np
import pytest
import torch
from conftest import planes_metadata, saved, seasoned_network, weights_metadata

from weights_tools.__main__ import main
from weights_tools.check import answer
from weights_tools.check import weights_metadata as metadata_of
from weights_tools.errors import InputError
from weights_tools.export import export, load_network

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


def exported(folder, channels, metadata):
    checkpoint = saved(folder / "network.pt", seasoned_network(channels), True)
    export(checkpoint, folder / "network.onnx", metadata)
    return checkpoint, folder / "network.onnx"


def run(path, images):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(None, {"radiance": images})))


def test_clouds_of_a_batch_are_as_each_alone(tmp_path):
    metadata = planes_metadata([0.6, 1.12, 1.61], 6)
    _, path = exported(tmp_path, [12, 16, 6], metadata)
    images = torch.rand(3, 4, 11, 17).numpy()
    together = run(path, images)["extinction"]
    assert together.shape == (3, 6, 11, 17)
    for cloud in range(3):
        alone = run(path, images[cloud : cloud + 1])["extinction"]
        assert np.allclose(together[cloud], alone[0], rtol=0.0, atol=1e-6 * alone.max())


def test_places_are_exact_in_wide_images(tmp_path):
    """Images of white noise reveal a position error of a hundred-thousandth of a pixel."""
    metadata = planes_metadata([0.6, 1.12, 1.61], 2)
    checkpoint, path = exported(tmp_path, [12, 2], metadata)
    network, _ = load_network(checkpoint, metadata)
    images = torch.rand(4, 6, 900).numpy()
    expected = answer(network, images, metadata)
    found = run(path, images[None])["extinction"][0]
    assert abs(found - expected).max() < 2e-6 * expected.max()


def test_pixels_are_numbered_in_integers(tmp_path):
    """Runtimes that compute in single precision cannot represent all numbers above 2^24: a number
    that was real may be that of a row or a column, but not that of a pixel of all images."""
    _, path = exported(tmp_path, [12, 2], planes_metadata([0.6, 1.12, 1.61], 2))
    graph = onnx.shape_inference.infer_shapes(onnx.load(path)).graph
    makers = {name: node for node in graph.node for name in node.output}
    kinds = {value.name: value.type.tensor_type.elem_type for value in graph.value_info}
    kinds |= {value.name: value.data_type for value in graph.initializer}
    numbers = [node.input[1] for node in graph.node if node.op_type == "Gather"]
    assert len(numbers) == 2
    once_real = set()
    while numbers:
        name = numbers.pop()
        assert kinds[name] == onnx.TensorProto.INT64, name
        node = makers.get(name)
        if node is not None and node.op_type == "Cast":
            once_real |= set(node.input)
        elif node is not None:
            numbers += node.input
    assert once_real == {
        *("row_within", "rows", "ground_rows", "row_upright"),
        *("col_within", "cols", "ground_cols", "col_line"),
    }


def test_an_uncertainty_is_an_output_of_its_own(tmp_path):
    metadata = {**weights_metadata(3, 4), "outputs": ["extinction", "uncertainty"]}
    checkpoint, path = exported(tmp_path, [3, 6, 8], metadata)
    network, _ = load_network(checkpoint, metadata)
    images = torch.rand(3, 9, 7).numpy()
    found, expected = run(path, images[None]), answer(network, images, metadata)
    assert list(found) == ["extinction", "uncertainty"]
    for part, name in enumerate(found):
        assert found[name].shape == (1, 4, 9, 7)
        theirs = expected[4 * part : 4 * part + 4]
        assert np.allclose(found[name][0], theirs, rtol=0.0, atol=1e-5 * expected.max())


def test_a_graph_says_what_it_is(tmp_path):
    metadata = planes_metadata([0.6, 1.12, 1.61], 6)
    checkpoint, path = exported(tmp_path, [12, 16, 6], metadata)
    export(checkpoint, tmp_path / "w.safetensors", metadata)
    assert metadata_of(path) == metadata_of(tmp_path / "w.safetensors")
    model = onnx.load(path)
    (radiance,), (extinction,) = model.graph.input, model.graph.output
    assert "made-up at 0.672 um" in model.doc_string and "1/sr" in radiance.doc_string
    assert "[cloud, z, y, x] in 1/km" in extinction.doc_string
    for value, axes, views in ((radiance, "cloud view row col", 4), (extinction, "cloud z y x", 6)):
        dimensions = value.type.tensor_type.shape.dim
        assert [axis.denotation for axis in dimensions] == axes.split()
        lengths = [axis.dim_param or axis.dim_value for axis in dimensions]
        assert lengths == ["cloud", views, "row", "col"]


def test_convolutions_have_all_attributes(tmp_path):
    _, path = exported(tmp_path, [3, 6, 4], weights_metadata(3, 4))
    layers = [node for node in onnx.load(path).graph.node if node.op_type == "Conv"]
    assert len(layers) == 2
    for layer in layers:
        attributes = {each.name: onnx.helper.get_attribute_value(each) for each in layer.attribute}
        assert attributes == {
            "kernel_shape": [3, 3],
            "strides": [1, 1],
            "dilations": [1, 1],
            "pads": [1, 1, 1, 1],
        }


def test_the_command_line_writes_and_checks_it(tmp_path, capsys):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 6, 4]), False)
    other = saved(tmp_path / "other.pt", seasoned_network([3, 6, 4], 1), False)
    (tmp_path / "metadata.json").write_text(json.dumps(weights_metadata(3, 4)))
    path = str(tmp_path / "network.onnx")
    command = ["export", str(checkpoint), "--out", path]
    assert main([*command, "--metadata", str(tmp_path / "metadata.json")]) == 0
    assert main(["check", str(checkpoint), "--weights", path]) == 0
    assert "onnxruntime" in capsys.readouterr().out
    assert main(["check", str(other), "--weights", path]) == 1


def test_levels_that_are_not_the_networks_are_refused(tmp_path):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 6, 4]), False)
    for name in ("w.onnx", "w.safetensors"):
        with pytest.raises(InputError, match="gives 4 channels, its metadata 5"):
            export(checkpoint, tmp_path / name, weights_metadata(3, 5))


@pytest.mark.parametrize("content", [b"", b"not a graph", b"\x08\x08"])
def test_a_file_that_is_no_graph_is_refused(tmp_path, content):
    (tmp_path / "network.onnx").write_bytes(content)
    with pytest.raises(InputError, match="network.onnx"):
        metadata_of(tmp_path / "network.onnx")


def test_who_has_no_onnx_is_told_how_to_get_it(tmp_path, monkeypatch):
    checkpoint = saved(tmp_path / "network.pt", seasoned_network([3, 4]), False)
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.delitem(sys.modules, "weights_tools.graph", raising=False)
    with pytest.raises(InputError, match=r"weights_tools\[onnx\]"):
        export(checkpoint, tmp_path / "w.onnx", weights_metadata(3, 4))
    export(checkpoint, tmp_path / "w.safetensors", weights_metadata(3, 4))
