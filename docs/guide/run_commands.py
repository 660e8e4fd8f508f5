#!/usr/bin/env python3
"""Run the commands of the user guide.

    run_commands.py PROGRAMS [PAGE ...]

PROGRAMS is the folder of the program ``deepct``; it comes first on the PATH, before the folder of
this Python interpreter. PAGE is a name such as ``tour`` or ``tour.md``; all pages are run where
none is given.

The blocks of a page run in their order, in one temporary folder for each page:

- every command of a block that is marked ``sh`` (a line, its continuation after a backslash, and
  its here-documents), by bash;
- a block that is marked ``python`` and begins with the line ``# runs``, by this interpreter.

Blocks marked otherwise are not run. After a command, each file or folder that it names after
``--out`` must exist. The first failure ends the run; it is reported with its page and line.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Iterator

PAGES = Path(__file__).resolve().parent / "pages"
RUNS = "# runs"
"""First line of a Python block that is run."""
HERE_DOCUMENT = re.compile(r"<<-?\s*['\"]?(\w+)['\"]?")
COMMAND_LIMIT_S = 300


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    line: int
    """Number of its first line, counted from 1."""
    lines: list[str]


@dataclass(frozen=True)
class Command:
    """What is run at once."""

    text: str
    line: int
    language: str


class Failure(Exception):
    """A command that failed, or a page that cannot be read."""


def blocks(path: Path) -> Iterator[Block]:
    """The fenced blocks of a page."""
    language, first, inside = "", 0, []
    fenced = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.startswith("```"):
            if fenced:
                inside.append(line)
            continue
        if fenced:
            yield Block(language, first, inside)
        language, first, inside = line[3:].strip(), number + 1, []
        fenced = not fenced
    if fenced:
        raise Failure(f"{path.name}:{first - 1}: a fenced block is not closed")


def shell_commands(block: Block, page: str) -> Iterator[Command]:
    """The commands of a shell block."""
    pending: list[str] = []
    terminators: list[str] = []
    for number, line in enumerate(block.lines, start=block.line):
        if not pending and (not line.strip() or line.lstrip().startswith("#")):
            continue
        pending.append(line)
        if terminators:
            if line.strip() == terminators[0]:
                del terminators[0]
        else:
            terminators = HERE_DOCUMENT.findall(line)
        if not terminators and not line.endswith("\\"):
            yield Command("\n".join(pending), number - len(pending) + 1, "sh")
            pending = []
    if pending:
        raise Failure(f"{page}:{block.line}: a command is incomplete at the end of its block")


def commands(path: Path) -> list[Command]:
    """What a page runs, in its order."""
    found: list[Command] = []
    for block in blocks(path):
        if block.language == "sh":
            found += shell_commands(block, path.name)
        elif block.language == "python" and block.lines[:1] == [RUNS]:
            found.append(Command("\n".join(block.lines), block.line, "python"))
    return found


def outputs(command: Command) -> Iterator[str]:
    """What a shell command names after ``--out``."""
    if command.language != "sh":
        return
    line = command.text.splitlines()[0] if "<<" in command.text else command.text
    words = shlex.split(line, comments=True)
    for word, following in zip(words, [*words[1:], ""]):
        if word == "--out":
            yield following
        elif word.startswith("--out="):
            yield word[len("--out=") :]


def run(command: Command, page: str, folder: Path, environment: dict[str, str]) -> None:
    """Run a command in a folder."""
    for number, line in enumerate(command.text.splitlines()):
        print(f"{'  ' if number else '$ ' if command.language == 'sh' else '> '}{line}", flush=True)
    if command.language == "sh":
        arguments = ["bash", "-e", "-u", "-o", "pipefail", "-c", command.text]
    else:
        # As many empty lines as precede the block: tracebacks then have the lines of the page.
        text = "\n" * (command.line - 1) + command.text
        arguments = [sys.executable, "-c", f"exec(compile({text!r}, {page!r}, 'exec'))"]
    place = f"{page}:{command.line}"
    try:
        status = subprocess.run(
            arguments, cwd=folder, env=environment, timeout=COMMAND_LIMIT_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        raise Failure(f"{place}: took longer than {COMMAND_LIMIT_S} s") from None
    if status != 0:
        raise Failure(f"{place}: failed with exit status {status}")
    for name in outputs(command):
        if not (folder / name).exists():
            raise Failure(f"{place}: did not write {name}")


def run_page(path: Path, environment: dict[str, str]) -> None:
    """Run everything of a page in a new folder."""
    found = commands(path)
    if not found:
        return
    print(f"== {path.name}", flush=True)
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix=f"deepct-guide-{path.stem}-") as folder:
        for command in found:
            run(command, path.name, Path(folder), environment)
    seconds = time.monotonic() - start
    print(f"== {path.name}: {len(found)} commands in {seconds:.0f} s", flush=True)


def chosen_pages(names: list[str]) -> list[Path]:
    """The files of the pages named, or of all."""
    if not names:
        return sorted(PAGES.glob("*.md"))
    paths = [PAGES / f"{Path(name).name.removesuffix('.md')}.md" for name in names]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        raise Failure(f"there is no page {', '.join(missing)} in {PAGES}")
    return paths


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description="Run the commands of the user guide.")
    parser.add_argument("programs", type=Path, help="folder of the program deepct")
    parser.add_argument("pages", nargs="*", help="names of pages; all where none is given")
    arguments = parser.parse_args()
    folders = [str(arguments.programs.resolve()), str(Path(sys.executable).parent)]
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([*folders, os.environ.get("PATH", "")]),
        "MPLBACKEND": "Agg",
    }
    try:
        if not (arguments.programs / "deepct").exists():
            raise Failure(f"there is no program deepct in {arguments.programs}")
        for path in chosen_pages(arguments.pages):
            run_page(path, environment)
    except Failure as problem:
        print(f"run_commands.py: {problem}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
