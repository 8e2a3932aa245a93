"""Reference of all commands with arguments and options, from the typer app."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from typer.main import get_command

from making.markdown import code, definitions, escaped
from scanloom.cli.app import app


def reference() -> str:
    """Write a section for each command, in the order of the help."""
    return "\n\n".join(_section(name, command) for name, command in named())


def named() -> Iterator[tuple[str, Any]]:
    """Yield every command with the words that call it: `lod tiles`."""
    for name, command in get_command(app()).commands.items():  # type: ignore[attr-defined]
        if hasattr(command, "commands"):
            for own, below in command.commands.items():
                yield f"{name} {own}", below
        else:
            yield name, command


def _section(name: str, command: Any) -> str:
    shown = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    arguments = [parameter for parameter in shown if parameter.param_type_name == "argument"]
    options = [parameter for parameter in shown if parameter.param_type_name != "argument"]
    words = " ".join([name, *(_argument(argument) for argument in arguments), "[OPTIONS]"])
    written = [f"## {name}", f"```text\nscanloom {words}\n```", _text(command.help)]
    if arguments:
        entries = ((code(_argument(argument)), _help(argument), "") for argument in arguments)
        written.append(definitions(entries))
    context = command.context_class(command)
    for panel, group in groupby(sorted(options, key=_is_common), key=_panel):
        written.append(f"**{escaped(panel)}**")
        # As typer's help shows an option: its names and its value type.
        entries = ((code(option.get_help_record(context)[0]), _help(option), "") for option in group)
        written.append(definitions(entries))
    return "\n\n".join(written)


def _panel(option: Any) -> str:
    return getattr(option, "rich_help_panel", None) or "Options"


def _is_common(option: Any) -> bool:
    """Check if an option is common to all commands.

    As sort key, it moves common options to the end and keeps the order of the help otherwise.
    """
    return _panel(option) == "Output"


def _argument(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    return name if argument.required else f"[{name.strip('[]')}]"


def _help(parameter: Any) -> str:
    return escaped(_plain(parameter.help or ""))


def _plain(text: str) -> str:
    # Option texts are escaped for rich markup.
    return text.replace(r"\[", "[").strip()


def _text(text: str | None) -> str:
    """Convert a command's help to Markdown, with examples as code."""
    written = []
    for paragraph in re.split(r"\n\s*\n", (text or "").strip()):
        example = re.fullmatch(r"Example:\s*(scanloom .*)", paragraph.strip(), flags=re.DOTALL)
        written.append(f"```text\n{example[1]}\n```" if example else escaped(_plain(paragraph)))
    return "\n\n".join(written)
