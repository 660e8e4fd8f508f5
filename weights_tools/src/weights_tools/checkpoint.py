"""Checkpoints on disk: they are written atomically and read without executing code."""

from __future__ import annotations

import os
import pickle
import re
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from weights_tools.errors import InputError
from weights_tools.files import regular_file

_REMEDY = "give a state dict or a training checkpoint written by torch.save"

_STATES = ("model_state_dict", "state_dict")
"""The names of the state dict in checkpoints: those of this program and of Lightning."""

_FIRST = "net.body.0.body.0.weight"
"""The name of the first parameter of a network."""

_SHARDS = (
    "holds the shards of a distributed training",
    "consolidate them (full_tensor() of each parameter, or dcp_to_torch_save for a folder) and "
    "give a state dict written by torch.save",
)
"""Problem and remedy for parameters that are distributed over processes."""

_ARCHIVES = {
    "constants.pkl": ("is a TorchScript file", "torch.jit.load(FILE).state_dict()"),
    "archive_format": ("is an archive of torch.export", "torch.export.load(FILE).state_dict"),
    "serialized_exported_program.json": (
        "is an archive of torch.export",
        "torch.export.load(FILE).state_dict",
    ),
}
"""Members by which a ZIP file is recognised, what it is, and its state dict in Python."""


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: under a temporary name in its folder, which is then renamed."""
    _write(path, lambda file: file.write(content))


def save_checkpoint(path: Path, checkpoint: dict[str, Any]) -> None:
    """Write a checkpoint of tensors and plain values atomically."""
    _write(path, lambda file: torch.save(checkpoint, file))


def _write(path: Path, contents: Callable[[BinaryIO], object]) -> None:
    if not path.parent.is_dir():
        problem = f"is to be in the folder {path.parent}, which does not exist"
        raise InputError(path, problem, "create the folder")
    # A new file with a random name: nobody else can have prepared a link of this name.
    try:
        number, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(path)) from None
    temporary = Path(name)
    try:
        with os.fdopen(number, "wb") as file:
            contents(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_mask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _mask() -> int:
    """The bits of the permissions that this process removes from new files."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Load a file of ``torch.save`` that contains a dict of tensors and plain values.

    A pickle that contains code is refused and not executed. A file ``NAME.safetensors`` contains a
    bare state dict.

    Raises :class:`InputError` for a file that is missing, damaged, or has other contents.
    """
    path = Path(path)
    if path.suffix == ".distcp" or (path / ".metadata").is_file():
        raise InputError(path, *_SHARDS)
    regular_file(path, _REMEDY)
    if path.suffix.lower() == ".safetensors":
        return _load_safetensors(path)
    if _is_damaged(path):
        raise InputError(path, "is damaged: a checksum in it is wrong", "copy or save it again")
    try:
        with warnings.catch_warnings():
            # The warnings are about formats that are refused below in one line.
            warnings.simplefilter("ignore")
            checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as problem:
        raise InputError(path, problem.strerror or "cannot be read", _REMEDY) from None
    except pickle.UnpicklingError as problem:
        raise InputError(path, *_refusal(path, str(problem))) from None
    except (RuntimeError, EOFError, KeyError, ValueError, TypeError, AttributeError, IndexError):
        raise InputError(path, *_refusal(path, "")) from None
    if not isinstance(checkpoint, dict):
        raise InputError(path, f"holds a {type(checkpoint).__name__}, not a dict", _REMEDY)
    return checkpoint


def _is_damaged(path: Path) -> bool:
    """Whether a ZIP file, as ``torch.save`` writes, has other contents than its checksums tell.

    ``torch.load`` does not compare them and would return other weights.
    """
    try:
        if not zipfile.is_zipfile(path):
            return False
        with zipfile.ZipFile(path) as archive:
            return archive.testzip() is not None
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, EOFError):
        return True


def _load_safetensors(path: Path) -> dict[str, Tensor]:
    # On demand, as a machine for training may not have the package.
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (OSError, SafetensorError, KeyError, ValueError, AttributeError) as problem:
        reason = " ".join(str(problem).split())
        remedy = "give a whole file, and name a file of torch.save NAME.pt"
        raise InputError(path, f"is damaged or not safetensors ({reason})", remedy) from None


def _refusal(path: Path, message: str) -> tuple[str, str]:
    """The problem and the remedy for a file that ``torch.load`` refuses with a message."""
    if "DTensor" in message or "ShardedTensor" in message:
        return _SHARDS
    kind = re.search(r"GLOBAL ([\w.]+)", message)
    if kind is not None:
        problem = f"holds more than tensors and plain values, such as {kind[1]}"
        return problem, "save model.state_dict() with torch.save and give that file"
    members = _members(path)
    for member, (problem, state) in _ARCHIVES.items():
        if member in members:
            return problem, f"give the file of torch.save({state}, NAME)"
    with path.open("rb") as file:
        # The header of a safetensors file follows its length, a number of eight bytes.
        if file.read(9)[8:] == b"{":
            return "is a safetensors file", "name it NAME.safetensors"
    return "is damaged or not a file of torch.save", _REMEDY


def _members(path: Path) -> set[str]:
    """The names of the members of a ZIP file, without folders; none for any other file."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.rpartition("/")[2] for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError):
        return set()


def state_dict_of(checkpoint: dict[str, Any], path: str | Path) -> dict[str, Tensor]:
    """The network's parameters in a training checkpoint, of Lightning for example, or a bare state
    dict. Their names lose what a wrapper of the network puts before all of them.

    Raises :class:`InputError` if there are none, and for shards of a distributed training.
    """
    state = next((checkpoint[name] for name in _STATES if name in checkpoint), checkpoint)
    if not isinstance(state, dict) or not all(
        isinstance(name, str) and isinstance(values, Tensor) for name, values in state.items()
    ):
        remedy = f"give a state dict, or a checkpoint with one under {' or '.join(_STATES)}"
        raise InputError(path, "holds no state dict", remedy)
    if any(hasattr(values, "full_tensor") for values in state.values()):
        raise InputError(path, *_SHARDS)
    first = next((name for name in state if name.endswith(_FIRST)), _FIRST)
    wrapper = first[: -len(_FIRST)]
    if not all(name.startswith(wrapper) for name in state):
        return dict(state)
    return {name[len(wrapper) :]: values for name, values in state.items()}
