"""The one error that users see."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """An input that cannot be used: what it is, what is wrong, what to do."""

    def __init__(self, where: str | Path, problem: str, remedy: str) -> None:
        super().__init__(f"{where}: {problem}; {remedy}")
