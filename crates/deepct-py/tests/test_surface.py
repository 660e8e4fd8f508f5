"""Argument conversion, errors and documentation of all functions of the module."""

import ast
import inspect
import pathlib
import threading
import time

import numpy as np
import pytest

import deepct_py


def test_any_layout_and_number_type_gives_the_same(extinction):
    reference = deepct_py.score(extinction, extinction * np.float32(0.5)).relative_error
    for same in [
        np.asfortranarray(extinction),
        extinction.astype(np.float64),
        extinction.astype(np.int32),
        extinction[::-1][::-1],
        extinction.tolist(),
    ]:
        assert deepct_py.score(same, extinction * np.float32(0.5)).relative_error == reference


def test_xarray_objects_are_arrays(extinction):
    xarray = pytest.importorskip("xarray")
    field = xarray.DataArray(extinction, dims=("z", "y", "x"))
    assert deepct_py.score(field, field).relative_error == 0.0
    turned = field.transpose("x", "y", "z")
    assert deepct_py.score(turned, field).relative_error == 0.0
    assert deepct_py.score(turned.expand_dims(time=1), field).relative_error == 0.0
    with pytest.raises(ValueError, match=r"isel\(time=0\)"):
        deepct_py.score(xarray.concat([turned, turned], "time"), field)


def test_fortran_order_reaches_the_stages(grid, extinction, views):
    options = {"samples": 2}
    straight = deepct_py.render(extinction, grid, views, **options).radiance
    fortran = deepct_py.render(np.asfortranarray(extinction), grid, views, **options).radiance
    assert np.array_equal(straight, fortran) and straight.flags.c_contiguous
    sensed = deepct_py.sense(np.asfortranarray(straight)).radiance
    assert np.array_equal(sensed, deepct_py.sense(straight).radiance)


def test_wrong_arguments_are_refused(grid, extinction, views):
    images = np.full((10, 16, 16), 0.1, np.float32)
    nan = np.where(extinction > 0.0, np.nan, extinction)
    for error, message, wrong in [
        (ValueError, "3: \\[z, y, x\\]", lambda: deepct_py.score(extinction[0], extinction[0])),
        (ValueError, "shape", lambda: deepct_py.score(extinction, extinction[:-1])),
        (ValueError, "finite", lambda: deepct_py.score(extinction, nan)),
        (ValueError, "positive somewhere", lambda: deepct_py.score(0 * extinction, extinction)),
        (TypeError, "real numbers", lambda: deepct_py.score(extinction * 1j, extinction)),
        (TypeError, "real numbers", lambda: deepct_py.score(None, extinction)),
        (ValueError, "extinction", lambda: deepct_py.render(-extinction, grid, views)),
        (ValueError, "extinction", lambda: deepct_py.render(nan, grid, views)),
        (ValueError, "shape", lambda: deepct_py.render(extinction[1:], grid, views)),
        (TypeError, "sequence of View", lambda: deepct_py.render(extinction, grid, [1, 2])),
        (ValueError, "samples", lambda: deepct_py.render(
            extinction, grid, views, samples=0)),
        (ValueError, "cmv9", lambda: deepct_py.sense(images, "cmv9")),
        (ValueError, "radiance", lambda: deepct_py.sense(-images)),
        (ValueError, "number of views", lambda: deepct_py.carve(images[:3], views, grid)),
        (ValueError, "image size", lambda: deepct_py.carve(images[:, 1:], views, grid)),
        (ValueError, "agreement", lambda: deepct_py.carve(images, views, grid, agreement=2.0)),
    ]:
        with pytest.raises(error, match=message):
            wrong()


def test_a_missing_file_and_a_wrong_one_differ(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        deepct_py.Sensor.from_file(tmp_path / "none.toml")
    assert caught.value.filename == str(tmp_path / "none.toml")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("bits = 10\n")
    with pytest.raises(deepct_py.DeepctError, match="wrong.toml"):
        deepct_py.Sensor.from_file(wrong)


def test_other_threads_go_on_while_a_stage_works(grid, extinction, views):
    """A second thread counts during a rendering, which requires that the GIL is released."""
    ticks, stop = [0], threading.Event()

    def tick():
        while not stop.wait(0.001):
            ticks[0] += 1

    ticking = threading.Thread(target=tick)
    ticking.start()
    before = ticks[0]
    start = time.perf_counter()
    deepct_py.render(extinction, grid, views, samples=256)
    took, counted = time.perf_counter() - start, ticks[0] - before
    stop.set()
    ticking.join()
    assert took > 0.1, "the rendering was too short for this test"
    assert counted >= 10, f"{counted} ticks in {took:.3f} s"


def test_the_stub_names_what_the_module_has():
    stub = pathlib.Path(deepct_py.__file__).with_name("__init__.pyi")
    stubs = [stub, stub.with_name("_fields.pyi")]
    nodes = [node for path in stubs for node in ast.parse(path.read_text()).body]
    public = [node for node in nodes if not getattr(node, "name", "_").startswith("_")]
    declared = {node.name: node for node in public}
    assert set(declared) == set(deepct_py.__all__)
    assert stub.with_name("py.typed").exists()
    for name, node in declared.items():
        found = getattr(deepct_py, name)
        assert found.__doc__, f"{name} has no docstring"
        if isinstance(node, ast.ClassDef) and name != "DeepctError":
            public = {member for member in vars(found) if not member.startswith("_")}
            methods = [part for part in node.body if isinstance(part, ast.FunctionDef)]
            assert {part.name for part in methods if not part.name.startswith("_")} == public
        elif isinstance(node, ast.FunctionDef):
            part = node.args
            names = [argument.arg for argument in part.args + part.kwonlyargs]
            names += [part.kwarg.arg] if part.kwarg else []
            assert list(inspect.signature(found).parameters) == names
