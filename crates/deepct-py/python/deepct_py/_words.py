"""Messages of the library in the words of Python: arguments in the place of options and settings."""

import re

# Parts of messages that name options without a counterpart in Python.
_WITHOUT_ARGUMENT = re.compile(r"`--max-memory`, |, or use --allow-external if you trust the file")
# Keys of the light in files of settings, whose keywords have no group.
_LIGHT = re.compile(
    r"(?<![\w./])optics\.(extinction|phase|asymmetry|single_scattering_albedo|distribution|bandwidth"
    r"|effective_variance|effective_radius)\b"
)
_IMPORT = re.compile(r"`(?:deepct )?cloud import(?: ([^`]*))?`")
_FLAGS = ("allow-implausible", "force")

_VALUE = r"""[^\s=]+=(?:"[^"]*"|[^\s;,)`]*[^\s;,)`.])|[\w.]+(?:,[\w.]+){2}|[A-Z]+:[A-Z]+|[0-9.]+(?![\w.])"""
_OPTION = re.compile(rf"(?<![\w-])--([a-z]+(?:-[a-z]+)*)(?: ({_VALUE}))?")
# Commands of the program are left as they are; options that follow each other become one list.
_PART = re.compile(rf"`deepct [^`]*`|{_OPTION.pattern}(?: {_OPTION.pattern})*")


def in_python(text: str) -> str:
    """The text with arguments of Python, such as ``units={"ql": "g/kg"}`` for ``--units ql="g/kg"``."""
    text = _LIGHT.sub(r"\1", _WITHOUT_ARGUMENT.sub("", text))
    return _PART.sub(lambda part: _arguments(part[0]), _IMPORT.sub(_call, text))


def _call(command: "re.Match[str]") -> str:
    options = command[1]
    return f"`import_cloud(..., {_arguments(options, bare='{}=...')})`" if options else "`import_cloud`"


def _arguments(options: str, bare: str = "{}") -> str:
    if options.startswith("`"):
        return options
    arguments: dict[str, str] = {}
    for option, value in _OPTION.findall(options):
        name = option.replace("-", "_")
        if option in _FLAGS:
            value = "True"
        elif option == "units" and "=" in value:
            variable, _, unit = value.partition("=")
            unit = unit.strip('"')
            before = arguments.get(name, "{")[:-1] + ", " if name in arguments else "{"
            value = f'{before}"{variable}": "{unit}"}}'
        elif option == "spacing" and value:
            value = f"({', '.join(value.split(','))})"
        elif option in ("axes", "air-density") and value:
            value = f'"{value}"'
        arguments[name] = value
    return ", ".join(f"{name}={value}" if value else bare.format(name) for name, value in arguments.items())
