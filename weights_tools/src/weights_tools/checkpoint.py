"""Checkpoints on disk: they are written atomically and read without executing code."""

from __future__ import annotations

import os
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from weights_tools.errors import InputError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: under a temporary name in its folder, which is then renamed."""
    _write(path, lambda file: file.write(content))


def save_checkpoint(path: Path, checkpoint: dict[str, Any]) -> None:
    """Write a checkpoint of tensors and plain values atomically."""
    _write(path, lambda file: torch.save(checkpoint, file))


def _write(path: Path, contents: Callable[[BinaryIO], object]) -> None:
    # A new file with a random name: nobody else can have prepared a link of this name.
    number, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
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

    A pickle that contains code is refused and not executed.

    Raises :class:`InputError` for a file that is missing, damaged, or has other contents.
    """
    path = Path(path)
    remedy = "give a state dict or a training checkpoint written by torch.save"
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as problem:
        raise InputError(path, problem.strerror or "cannot be read", remedy) from None
    except pickle.UnpicklingError as problem:
        reason = str(problem).strip().splitlines()[-1] if str(problem).strip() else "damaged"
        problem_text = f"holds more than tensors and plain values, or is damaged ({reason})"
        raise InputError(path, problem_text, remedy) from None
    except (RuntimeError, EOFError, KeyError, ValueError, TypeError, AttributeError, IndexError):
        raise InputError(path, "is damaged or not a file of torch.save", remedy) from None
    if not isinstance(checkpoint, dict):
        raise InputError(path, f"holds a {type(checkpoint).__name__}, not a dict", remedy)
    return checkpoint


def state_dict_of(checkpoint: dict[str, Any], path: str | Path) -> dict[str, Tensor]:
    """The network's parameters in a training checkpoint or a bare state dict."""
    state = checkpoint.get("model_state_dict", checkpoint)
    if not isinstance(state, dict) or not all(
        isinstance(name, str) and isinstance(values, Tensor) for name, values in state.items()
    ):
        remedy = "give a state dict, or a checkpoint with one under model_state_dict"
        raise InputError(path, "holds no state dict", remedy)
    return dict(state)
