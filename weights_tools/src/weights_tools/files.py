"""Files given by the user, which are opened only if they are regular files."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from weights_tools.errors import InputError


def regular_file(path: str | Path, remedy: str) -> Path:
    """The path of a file that may be opened. The opening of a named pipe would never end.

    Raises :class:`InputError` with ``remedy`` for a file that is missing and for anything but a
    regular file.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
    except OSError as problem:
        raise InputError(path, problem.strerror or "cannot be read", remedy) from None
    if not stat.S_ISREG(mode):
        raise InputError(path, "is not a regular file", remedy)
    return path


def read_file(path: str | Path, remedy: str) -> bytes:
    """The content of a regular file.

    Raises :class:`InputError` with ``remedy`` if it cannot be read.
    """
    try:
        return regular_file(path, remedy).read_bytes()
    except OSError as problem:
        raise InputError(path, problem.strerror or "cannot be read", remedy) from None


def weights_header(contents: bytes, path: str | Path, remedy: str) -> dict[str, Any]:
    """The metadata of deepct in the contents of a weights file (safetensors).

    Raises :class:`InputError` with ``remedy`` if there are none.
    """
    try:
        # The length of the header precedes it.
        length = int.from_bytes(contents[:8], "little")
        entries = json.loads(contents[8 : 8 + length])
        header = json.loads((entries.get("__metadata__") or {})["deepct"])
        if not isinstance(header, dict):
            raise ValueError("its metadata are not an object")
    except (KeyError, ValueError, AttributeError, TypeError) as problem:
        reason = " ".join(str(problem).split())
        raise InputError(path, f"is not a weights file ({reason})", remedy) from None
    return header
