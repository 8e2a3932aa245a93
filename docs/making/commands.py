"""Reference of all commands with arguments and options, from the typer app."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from typer.main import get_command

from making.markdown import escape_markdown, format_code, format_definitions
from scanloom.cli.app import app
from scanloom.cli.command_table import GROUPS
from scanloom.cli.help import panel_of, panel_order


def write_reference() -> str:
    """Write a section for each command and group, in the order of the help."""
    written = []
    for name, command in get_command(app()).commands.items():  # type: ignore[attr-defined]
        if name in GROUPS:
            written.append(f"## {name}\n\n{escape_markdown(GROUPS[name].summary)}.")
            written += [_write_section(f"{name} {own}", below, 3) for own, below in command.commands.items()]
        else:
            written.append(_write_section(name, command, 2))
    return "\n\n".join(written)


def list_commands() -> Iterator[tuple[str, Any]]:
    """Yield every command with the words that call it: `lod tiles`."""
    for name, command in get_command(app()).commands.items():  # type: ignore[attr-defined]
        if hasattr(command, "commands"):
            for own, below in command.commands.items():
                yield f"{name} {own}", below
        else:
            yield name, command


def _write_section(name: str, command: Any, level: int) -> str:
    shown = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    arguments = [parameter for parameter in shown if parameter.param_type_name == "argument"]
    options = [parameter for parameter in shown if parameter.param_type_name != "argument"]
    words = " ".join([name, *(_format_argument(argument) for argument in arguments), "[OPTIONS]"])
    written = [f"{'#' * level} {name}", f"```text\nscanloom {words}\n```", _format_text(command.help)]
    if arguments:
        entries = (
            (format_code(_format_argument(argument)), _format_help(argument), "") for argument in arguments
        )
        written.append(format_definitions(entries))
    context = command.context_class(command)
    for panel, group in groupby(sorted(options, key=panel_order), key=panel_of):
        written.append(f"**{escape_markdown(panel)}**")
        # Names of an option and its value type, as in the help.
        entries = (
            (format_code(option.get_help_record(context)[0]), _format_help(option), "") for option in group
        )
        written.append(format_definitions(entries))
    if command.hint:
        words, _, line = command.hint.partition(": ")
        written.append(f"{words}: {format_code(line)}")
    return "\n\n".join(written)


def _format_argument(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _format_help(parameter: Any) -> str:
    return escape_markdown((parameter.help or "").strip())


def _format_text(text: str | None) -> str:
    """Convert a command's help to Markdown, with examples as code."""
    written = []
    for paragraph in re.split(r"\n\s*\n", (text or "").strip()):
        example = re.fullmatch(r"Example:\s*(scanloom .*)", paragraph.strip(), flags=re.DOTALL)
        written.append(f"```text\n{example[1]}\n```" if example else escape_markdown(paragraph))
    return "\n\n".join(written)
