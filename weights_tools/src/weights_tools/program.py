"""Execution of the program ``deepct``."""

from __future__ import annotations

import subprocess

from weights_tools.errors import InputError

GET_PROGRAM = "build it with `cargo build --release` and name it with --deepct"
"""Remedy if the program is not found."""


def run_program(command: list[str], about: str = "") -> None:
    """Run ``deepct VERB ...`` and wait for its end; ``about`` names its input in error messages.

    Raises :class:`InputError` if it cannot be run or fails.
    """
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as problem:
        raise InputError(command[0], problem.strerror or "cannot be run", GET_PROGRAM) from None
    if result.returncode != 0:
        problem = f"{command[1]} failed{about}: {result.stderr.strip()}"
        raise InputError(command[0], problem, "see its message")
