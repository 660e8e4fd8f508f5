"""Fields and views shared by several tests."""

import shutil
import subprocess

import numpy as np
import pytest

import deepct_py


@pytest.fixture
def grid():
    return deepct_py.Grid(shape=(8, 16, 16), spacing=(0.05, 0.05, 0.1), origin=(0.0, 0.0, 0.5))


@pytest.fixture
def extinction(grid):
    """A ball with an extinction of 30 per km in clear sky."""
    z, y, x = np.meshgrid(grid.z, grid.y, grid.x, indexing="ij")
    cx, cy, cz = grid.center
    inside = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < 0.25**2
    return np.where(inside, 30.0, 0.0).astype(np.float32)


@pytest.fixture
def views(grid):
    return deepct_py.Views.load("cloudct-10", target=grid.center, size=(16, 16))


@pytest.fixture(scope="session")
def command_line_run():
    """Run the command line and return the completed process with its captured output."""
    program = shutil.which("deepct")
    if program is None:
        pytest.fail("`deepct` is not on the PATH: build it, or run the tests by run_tests.sh")

    def run(*arguments):
        arguments = [program, *map(str, arguments)]
        return subprocess.run(arguments, check=True, capture_output=True, text=True)

    return run


@pytest.fixture(scope="session")
def command_line(command_line_run):
    """Run the command line and return its standard output."""
    return lambda *arguments: command_line_run(*arguments).stdout
