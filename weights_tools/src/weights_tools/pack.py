"""A folder with everything that a training of a general network needs on another machine.

The machine needs Python 3.11 or later, PyTorch, NumPy and h5py, and no network. On a machine with a
GPU, the images are computed there.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import weights_tools
from weights_tools.checkpoint import save_checkpoint
from weights_tools.clouds import Generated
from weights_tools.errors import InputError
from weights_tools.general_file import load_general
from weights_tools.general_recipe import GeneralRecipe

LARGEST_MB = 60.0
"""Largest size of a pack."""

SCRIPT = "run.sh"

_TEXT = """#!/bin/bash
# Train a general network for some minutes:
#
#     bash run.sh MINUTES [OUT [OPTIONS OF `weights_tools train`]]
#
# The folder OUT (default: run) then contains best.pt, last.pt and curves.csv. The same command
# continues the training for further minutes. The environment variable POOL names a folder for the
# scenes (default: OUT/pool), PYTHON an interpreter other than python3.
set -euo pipefail
here="$(cd "$(dirname "${{BASH_SOURCE[0]}}")" && pwd)"
minutes="${{1:?usage: bash run.sh MINUTES [OUT [OPTIONS]]}}"
out="${{2:-run}}"
shift "$(( $# < 2 ? $# : 2 ))"
export PYTHONPATH="$here" PYTHONUNBUFFERED=1
exec "${{PYTHON:-python3}}" -m weights_tools train "$here/recipe.toml" \\
    --simulations "$here/data" --out "$out" --pool "${{POOL:-$out/pool}}" \\
    --further "$minutes" {start}"$@"
"""


def pack(
    recipe: GeneralRecipe,
    recipe_path: Path,
    simulations: Path,
    folder: Path,
    start: Path | None = None,
) -> Iterator[str]:
    """Write a pack into a new folder; each step yields a line that reports it.

    ``start`` is a checkpoint or weights file of a general network from which the training starts.

    Raises :class:`InputError` if the folder exists, a file is missing, or the pack is too large.
    """
    if folder.exists():
        raise InputError(folder, "exists already", "name a new folder")
    began = time.monotonic()
    data = folder / "data"
    data.mkdir(parents=True)
    source = Path(weights_tools.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
    shutil.copytree(source, folder / "weights_tools", ignore=ignored)
    shutil.copyfile(recipe_path, folder / "recipe.toml")
    for file in sorted({each.file for each in recipe.simulations}):
        target = data / file
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(simulations / file, target)
        yield f"simulation {file}: {_megabytes(target):.1f} MB"
    if recipe.scenes.generated > 0.0:
        clouds = Generated(simulations, recipe.scenes.generated_clouds).write(data)
        yield f"clouds of the generator: {_megabytes(clouds):.1f} MB"
    if start is not None:
        _write_start(folder / "start.pt", start)
    option = '--start "$here/start.pt" ' if start is not None else ""
    script = folder / SCRIPT
    script.write_text(_TEXT.format(start=option), encoding="utf-8")
    script.chmod(0o755)
    size = sum(_megabytes(path) for path in folder.rglob("*") if path.is_file())
    if size > LARGEST_MB:
        problem = f"is a pack of {size:.0f} MB, more than {LARGEST_MB:.0f} MB"
        raise InputError(folder, problem, "use fewer simulations")
    yield f"{folder}: {size:.1f} MB in {time.monotonic() - began:.0f} s; bash {SCRIPT} MINUTES OUT"


def _write_start(path: Path, start: Path) -> None:
    weights = load_general(start)
    checkpoint = {
        "general": vars(weights.network.architecture),
        "description": vars(weights.description),
        "model_state_dict": weights.network.state_dict(),
    }
    save_checkpoint(path, checkpoint)


def _megabytes(path: Path) -> float:
    return path.stat().st_size / 1e6
