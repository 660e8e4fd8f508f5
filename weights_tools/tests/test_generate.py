"""A data set made by a cluster is the one that a single call makes."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from weights_tools.__main__ import main
from weights_tools.dataset import load_dataset

DEEPCT = os.environ.get("DEEPCT") or shutil.which("deepct")

SOURCE = """
[[sources]]
file = "field.nc"
split = "{split}"
first = 0
last = 0
every = 1
clouds = 2
"""

RECIPE = """
formation = "cloudct-10"
columns = 24
droplets_per_cm3 = [50.0, 600.0]
[solver]
zenith_angles = 4
tolerance = 1e-2
""" + "".join(SOURCE.format(split=split) for split in ("train", "train", "validation"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A made-up simulation, and the recipe of three snapshots of it."""
    assert DEEPCT, "deepct is not on the PATH and DEEPCT does not name it"
    command = f"{DEEPCT} cloud generate --kind field --seed 3 --quiet --out field.nc"
    subprocess.run(command.split(), cwd=tmp_path, check=True)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    return tmp_path


def arguments(folder: Path, out: str, *flags: str) -> list[str]:
    words = [folder / "recipe.toml", "--simulations", folder, "--out", folder / out, *flags]
    return [str(word) for word in words]


def files(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def test_two_workers_make_what_one_call_makes(folder: Path, capsys: pytest.CaptureFixture):
    single = [DEEPCT, "dataset", "generate", *arguments(folder, "single", "--quiet")]
    subprocess.run(single, check=True)
    flags = ("--workers", "2", "--shares", "2", "--deepct", DEEPCT)
    assert main(["generate", *arguments(folder, "shared", *flags)]) == 0
    assert files(folder / "shared") == files(folder / "single")

    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "4 train, 2 validation and 0 test samples"
    assert lines[1].startswith("share 1 of 2, 0:00:") and lines[1].endswith(" left")
    assert lines[3].startswith("6 samples, 0 of them made now")
    assert lines[4].startswith("6 made by the cluster, ") and lines[4].endswith(" per hour")
    assert len(load_dataset(folder / "shared").train) == 4


def test_a_share_that_fails_is_tried_again(folder: Path):
    # A program that fails the first time that a share is asked for.
    program = folder / "unreliable"
    program.write_text(
        "#!/bin/sh\n"
        f"tried={folder}/tried\n"
        'case "$*" in *--share*) [ -e $tried ] || { touch $tried; exit 3; }; esac\n'
        f'exec "{DEEPCT}" "$@"\n'
    )
    program.chmod(0o755)
    flags = ("--workers", "1", "--shares", "1", "--deepct", str(program))
    assert main(["generate", *arguments(folder, "set", *flags)]) == 0
    assert (folder / "tried").exists()
    assert len(json.loads((folder / "set" / "manifest.json").read_text())["samples"]) == 6


def test_what_the_program_refuses_is_told(folder: Path, capsys: pytest.CaptureFixture):
    (folder / "recipe.toml").write_text(RECIPE.replace("field.nc", "absent.nc"))
    flags = ("--workers", "1", "--deepct", DEEPCT)
    assert main(["generate", *arguments(folder, "set", *flags)]) == 2
    assert "absent.nc" in capsys.readouterr().err
    assert not (folder / "set").exists()

    assert main(["generate", *arguments(folder, "set", "--deepct", "/nowhere/deepct")]) == 2
    assert "/nowhere/deepct" in capsys.readouterr().err
