"""The documentation of the module: examples of docstrings, type annotations, example programs."""

import doctest
import inspect
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

import deepct_py

ROOT = pathlib.Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

PUBLIC = {name: getattr(deepct_py, name) for name in deepct_py.__all__}
WITH_EXAMPLE = [
    "Cloud", "Figure", "Grid", "Light", "Network", "Observation", "Sensor", "View", "Views", "carve",
    "generate_cloud", "hybrid", "invert", "plot", "render", "Renderer", "score", "sense",
]


def documented():
    """All public functions, classes and members that have a docstring, by their names."""
    for name, one in PUBLIC.items():
        yield name, one
        if isinstance(one, type):
            members = {key: part for key, part in vars(one).items() if not key.startswith("_")}
            yield from ((f"{name}.{key}", part) for key, part in members.items())


def test_examples_of_docstrings_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    with_example = set()
    for name, one in documented():
        text = inspect.getdoc(one) or ""
        globs = {"deepct_py": deepct_py, "np": np}
        test = doctest.DocTestParser().get_doctest(text, globs, name, None, 0)
        if test.examples:
            with_example.add(name.split(".")[0])
            result = runner.run(test)
            assert result.attempted == len(test.examples) and result.failed == 0, name
    assert with_example >= set(WITH_EXAMPLE) - {"Figure"}


def test_everything_has_a_docstring():
    for name, one in documented():
        assert inspect.getdoc(one), name
    assert "1/km" in deepct_py.Cloud.extinction.__doc__
    assert "um" in deepct_py.Light.wavelength.__doc__


def test_the_version_is_that_of_the_distribution():
    import importlib.metadata

    assert deepct_py.__version__ == importlib.metadata.version("deepct_py")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("mypy")


def checked(folder, *arguments):
    """Run a module of mypy in an empty folder."""
    command = [sys.executable, "-m", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_annotations_are_those_of_the_module(folder):
    # The method by which objects are pickled is not for users.
    allowed = folder / "allowed"
    allowed.write_text("deepct_py\\..*\\.__getnewargs_ex__\n")
    checked(folder, "mypy.stubtest", "deepct_py", "--allowlist", str(allowed))


def test_the_annotations_are_strict(folder):
    """The stub itself, programs that use it, and one that uses it wrongly."""
    checked(folder, "mypy", "--strict", "-p", "deepct_py", *[])
    checked(folder, "mypy", "--strict", *map(str, EXAMPLES))
    wrong = folder / "wrong.py"
    wrong.write_text(
        "import deepct_py\n"
        "cloud = deepct_py.generate_cloud(seed=1)\n"
        "deepct_py.render(cloud, views='cloudct-10', samples='many')\n"
        "deepct_py.sense(deepct_py.read_images('a.nc')).noise\n"
        "deepct_py.sense([[[0.1]]]).noise\n"
        "reveal_type(deepct_py.Views.load('pearls-32', (0, 0, 1))[:3])\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", str(wrong)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert 'wrong.py:3: error: Argument "samples"' in done.stdout
    assert 'wrong.py:4: error: "Exposure" has no attribute "noise"' in done.stdout
    assert 'wrong.py:6: note: Revealed type is "deepct_py.Views"' in done.stdout
    assert "Found 2 errors" in done.stdout


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_programs_run(path, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning", str(path), str(tmp_path)],
        capture_output=True, text=True, env={**os.environ, "PYTHONHASHSEED": "0"},
    )
    assert done.returncode == 0, done.stderr
    figures = list(tmp_path.glob("*.png"))
    assert figures and all(figure.read_bytes().startswith(b"\x89PNG") for figure in figures)
