#!/usr/bin/env python3
"""Build the user guide as HTML.

    build.py PROGRAM [--out FOLDER]

PROGRAM is the path of ``deepct``. The interpreter needs mkdocs and deepct_py. Pages are copied to
a temporary folder; there the command line is described by the help texts of PROGRAM, the Python
module by its docstrings, and the reports of docs/ are added. Nothing is downloaded.
"""

from __future__ import annotations

import argparse
import inspect
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Iterator

GUIDE = Path(__file__).resolve().parent
ROOT = GUIDE.parents[1]
DOCS = ROOT / "docs" / "notes"
REPORTS = "reports"
"""Folder of the reports in the built guide."""
OTHER_REPORTS = {"weights_tools.md": ROOT / "weights_tools" / "README.md"}
"""Reports that are not in docs/, by their names in the built guide."""
FINDINGS = ROOT / "findings"
"""Scripts that pages refer to."""
PLACEHOLDER = "<!-- The reference is generated from the docstrings by build.py. -->"
RUNS = "# runs"
"""First line of a Python block that run_commands.py runs; readers do not see it."""


def output_of(program: Path, *arguments: str) -> str:
    """What the program prints."""
    environment = {**os.environ, "COLUMNS": "96", "NO_COLOR": "1"}
    finished = subprocess.run(
        [str(program), *arguments], capture_output=True, text=True, check=True, env=environment
    )
    return finished.stdout.rstrip()


# The command line.


def verbs_of(text: str) -> Iterator[str]:
    """The verbs that a help text lists."""
    listed = re.search(r"^Commands:\n((?: +.*\n)+)", text, flags=re.MULTILINE)
    if listed:
        names = re.findall(r"^  (\S+)", listed.group(1), flags=re.MULTILINE)
        yield from (name for name in names if name != "help")


def help_texts(program: Path, *verbs: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """The verbs below some verbs, each with its help text."""
    text = output_of(program, *verbs, "--help")
    yield verbs, text
    for verb in verbs_of(text + "\n"):
        yield from help_texts(program, *verbs, verb)


def command_line_page(program: Path) -> str:
    """The page of the command line."""
    parts = [
        "# Command line",
        "Each verb with its options, as `deepct VERB --help` prints them. `deepct man --out FOLDER` "
        "writes the same as manual pages, and `deepct completions SHELL` prints a completion script.",
    ]
    for verbs, text in help_texts(program):
        level = "##" if len(verbs) < 2 else "###"
        parts += [f"{level} {' '.join(['deepct', *verbs])}", f"```text\n{text}\n```"]
    parts += ["## Settings", "What `deepct config NAME` prints: all settings with their defaults."]
    help_text = " ".join(output_of(program, "config", "--help").split())
    for name in re.search(r"possible values: ([^\]]+)", help_text).group(1).split(", "):
        parts += [f"### deepct config {name}", f"```toml\n{output_of(program, 'config', name)}\n```"]
    return "\n\n".join(parts) + "\n"


# The Python module.


def prose(lines: list[str]) -> list[str]:
    """Lines of a docstring as Markdown: a literal block after `::` becomes a fenced one."""
    result: list[str] = []
    literal = False
    for line in lines:
        if literal and line.strip() and not line.startswith(" "):
            result += ["```", ""]
            literal = False
        if line.endswith("::"):
            result += [line[:-1], "", "```python"]
            literal = True
        elif literal:
            if line.strip() or result[-1] != "```python":
                result.append(line[4:])
        else:
            result.append(line.replace("``", "`"))
    return [*result, "```"] if literal else result


def documented(text: str) -> str:
    """A docstring in the layout of NumPy as Markdown."""
    lines = inspect.cleandoc(text).splitlines()
    is_heading = [
        number + 1 < len(lines) and bool(re.fullmatch(r"-{3,}", lines[number + 1]))
        for number in range(len(lines))
    ]
    starts = [number for number, heading in enumerate(is_heading) if heading]
    result = prose(lines[: starts[0] if starts else len(lines)])
    for start, end in zip(starts, [*starts[1:], len(lines)]):
        result += ["", f"**{lines[start]}**", ""]
        for line in lines[start + 2 : end]:
            if not line.strip():
                continue
            if line.startswith(" "):
                result.append(f"    {line.strip()}")
                continue
            name, separator, kind = line.partition(" : ")
            result.append(f"- `{name}`" + (f" ({kind})" if separator else ""))
            result.append("")
    return "\n".join(result).strip()


def signature_of(member: Any) -> str:
    """The signature of a function, as far as it is known."""
    try:
        signature = inspect.signature(member)
    except (TypeError, ValueError):
        return ""
    parameters = [value for name, value in signature.parameters.items() if name != "self"]
    return str(signature.replace(parameters=parameters))


def class_page(name: str, kind: type) -> Iterator[str]:
    """A class with its members."""
    yield f"### {name}"
    signature = getattr(kind, "__text_signature__", None)
    if signature:
        yield f"```python\n{name}{signature}\n```"
    if kind.__doc__:
        yield documented(kind.__doc__)
    attributes = re.search(r"^Attributes\n-+\n", inspect.getdoc(kind) or "", flags=re.MULTILINE)
    for member_name, member in vars(kind).items():
        text = inspect.getdoc(member)
        if member_name.startswith("_") or not text:
            continue
        if inspect.isgetsetdescriptor(member):
            if not attributes:
                yield f"**`{name}.{member_name}`**: {documented(text)}"
            continue
        yield f"#### {name}.{member_name}"
        yield f"```python\n{name}.{member_name}{signature_of(getattr(kind, member_name))}\n```"
        yield documented(text)


def python_reference() -> str:
    """The reference of the Python module."""
    import deepct_py

    parts = [documented(deepct_py.__doc__ or "")]
    members = {name: getattr(deepct_py, name) for name in deepct_py.__all__}
    classes = {name: member for name, member in members.items() if inspect.isclass(member)}
    parts.append("## Functions")
    for name, member in members.items():
        if name not in classes:
            parts += [f"### {name}", f"```python\n{name}{signature_of(member)}\n```"]
            parts.append(documented(inspect.getdoc(member) or ""))
    parts.append("## Classes")
    for name, kind in classes.items():
        parts += class_page(name, kind)
    return "\n\n".join(parts)


# The whole.


def reports() -> dict[str, Path]:
    """The reports by their names in the built guide."""
    return {path.name: path for path in sorted(DOCS.glob("*.md"))} | OTHER_REPORTS


def title_of(path: Path) -> str:
    """The first heading of a page."""
    return re.search(r"^# (.+)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE).group(1)


def copy_pages(folder: Path) -> None:
    """Copy pages and reports, with links that fit their new places."""
    pages = folder / "pages"
    shutil.copytree(GUIDE / "pages", pages)
    for path in pages.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        text = text.replace("](../../../weights_tools/README.md", f"]({REPORTS}/weights_tools.md")
        text = text.replace("](../../../findings/", "](findings/")
        text = text.replace("](../../notes/", f"]({REPORTS}/")
        path.write_text(text.replace(f"```python\n{RUNS}\n", "```python\n"), encoding="utf-8")
    scripts = pages / FINDINGS.name
    scripts.mkdir()
    for path in FINDINGS.glob("*.sh"):
        shutil.copyfile(path, scripts / path.name)
    for name, path in reports().items():
        (pages / REPORTS).mkdir(exist_ok=True)
        shutil.copyfile(path, pages / REPORTS / name)
    for path in DOCS.rglob("*.png"):
        if GUIDE not in path.parents:
            target = pages / REPORTS / path.relative_to(DOCS)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    configuration = (GUIDE / "mkdocs.yml").read_text(encoding="utf-8").rstrip() + "\n"
    configuration += "  - Reports:\n"
    for name, path in reports().items():
        configuration += f'    - "{title_of(path)}": {REPORTS}/{name}\n'
    (folder / "mkdocs.yml").write_text(configuration, encoding="utf-8")


def build(program: Path, out: Path) -> int:
    """Write the guide to a folder; gives the exit status of mkdocs."""
    with tempfile.TemporaryDirectory(prefix="deepct-guide-") as name:
        folder = Path(name)
        copy_pages(folder)
        page = folder / "pages" / "command_line.md"
        page.write_text(command_line_page(program), encoding="utf-8")
        page = folder / "pages" / "python.md"
        text = page.read_text(encoding="utf-8")
        if PLACEHOLDER not in text:
            raise SystemExit(f"build.py: python.md lacks the line {PLACEHOLDER}")
        page.write_text(text.replace(PLACEHOLDER, python_reference()), encoding="utf-8")
        mkdocs = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean"]
        configuration = ["--config-file", str(folder / "mkdocs.yml"), "--site-dir", str(out)]
        return subprocess.run([*mkdocs, *configuration], check=False).returncode


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description="Build the user guide as HTML.")
    parser.add_argument("program", type=Path, help="path of the program deepct")
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "guide"
    parser.add_argument("--out", type=Path, default=target, help="folder to write [%(default)s]")
    arguments = parser.parse_args()
    return build(arguments.program.resolve(), arguments.out.resolve())


if __name__ == "__main__":
    sys.exit(main())
