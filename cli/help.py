"""Help texts: plain lines as wide as the terminal, up to 100 columns."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from typer.core import TyperCommand, TyperGroup

from scanloom.cli import exit_codes
from scanloom.cli.command_table import COMMANDS, GROUPS
from scanloom.cli.options import COMMON_PANEL, SCAN_PANEL
from scanloom.stages.params import describe_all

_MAX_WIDTH = 100
# Width of the column of names; the text of a longer name is below the name.
_MAX_NAME = 28
_OPTIONS_PANEL = "Options"


class HelpCommand(TyperCommand):
    """A command with help in plain lines."""

    # Last line: how to list the parameters for `--set`.
    hint = ""
    # Returns the parameter class of each section that `--set` takes.
    load_sections: Callable[[], Mapping[str, type]] = dict

    def find_keys(self, option: str) -> list[str]:
        """Return the parameters with the name of an unknown option, such as `fuse.truncation`."""
        name = option.lstrip("-").replace("-", "_")
        return [
            f"{section}.{key}"
            for section, cls in type(self).load_sections().items()
            for key in describe_all(cls)
            if key.rpartition(".")[2] in (name, name.removeprefix("no_"))
        ]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        formatter.write("\n".join(_command_lines(self, ctx)) + "\n")


class HelpGroup(TyperGroup):
    """A group of commands with help in plain lines."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the named command; for a command of a group, raise an error that names the group."""
        name = args[0]
        group = next((one for one, about in GROUPS.items() if name in about.files), None)
        if ctx.parent is None and group is not None and name not in self.commands:
            ctx.fail(f"No such command {name!r}; use scanloom {group} {name}.")
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        lines = _group_lines(self, ctx) if ctx.parent else _root_lines(self, ctx)
        formatter.write("\n".join(lines) + "\n")


def _root_lines(group: Any, ctx: Any) -> Iterator[str]:
    yield from (line for one in paragraphs_of(group.help) for line in _wrapped(one, "  "))
    summaries = {name: _summary(command) for name, command in group.commands.items()}
    width = max(map(len, summaries))
    for heading, names in COMMANDS.items():
        yield from ["", f"{heading}:"]
        yield from (f"  {name:<{width}}  {summaries[name]}" for name in names if name in summaries)
    yield ""
    yield "Help of a command: scanloom COMMAND --help"
    options = [record[0] for one in group.get_params(ctx) if (record := one.get_help_record(ctx))]
    yield from _wrapped(f"Options: {', '.join(options)}", "  ")
    yield from _wrapped(f"Exit codes: {exit_codes.summarize()}", "  ")


def _group_lines(group: Any, ctx: Any) -> Iterator[str]:
    yield f"Usage: {ctx.command_path} COMMAND ..."
    yield ""
    yield from _wrapped(f"{group.help}.", "")
    yield from ["", "Commands:"]
    yield from _table((name, _summary(command)) for name, command in group.commands.items())
    yield from ["", f"Help of a command: {ctx.command_path} COMMAND --help"]


def _command_lines(command: Any, ctx: Any) -> Iterator[str]:
    params = [one for one in command.get_params(ctx) if not getattr(one, "hidden", False)]
    arguments = [one for one in params if one.param_type_name == "argument"]
    words = [_argument_name(one) for one in arguments]
    words += [f"{one.opts[-1]} {one.metavar}" for one in params if one.required and one not in arguments]
    yield f"Usage: {' '.join([ctx.command_path, '[OPTIONS]', *words])}"
    examples = []
    for paragraph in paragraphs_of(command.help):
        if paragraph.startswith("Example:"):
            examples.append(paragraph.removeprefix("Example:").strip())
        else:
            is_item = paragraph.startswith("- ")
            yield from [] if is_item else [""]
            yield from _wrapped(paragraph, "  " if is_item else "")
    if arguments:
        yield from ["", "Arguments:"]
        yield from _table((_argument_name(one), one.help or "") for one in arguments)
    options = [one for one in params if one.param_type_name != "argument"]
    for panel, some in groupby(sorted(options, key=panel_order), key=panel_of):
        yield from ["", f"{panel}:"]
        yield from _table((record[0], record[1]) for one in some if (record := one.get_help_record(ctx)))
    if examples:
        yield from ["", "Examples:" if len(examples) > 1 else "Example:"]
        yield from (f"  {example}" for example in examples)
    if command.hint:
        yield from ["", command.hint]


def paragraphs_of(text: str | None) -> list[str]:
    """Return the paragraphs and list items of a help text, each in one line."""
    parts = re.split(r"\n\s*\n|\n\s*(?=- )", (text or "").strip())
    return [" ".join(part.split()) for part in parts if part.strip()]


def panel_of(option: Any) -> str:
    """Return the heading of an option."""
    if option.name == "help":
        return COMMON_PANEL
    return getattr(option, "rich_help_panel", None) or _OPTIONS_PANEL


def panel_order(option: Any) -> int:
    """Return the sort key of an option's heading; the command's own options are first."""
    return (_OPTIONS_PANEL, SCAN_PANEL, COMMON_PANEL).index(panel_of(option))


def _argument_name(argument: Any) -> str:
    name = str(argument.metavar or argument.name.upper())
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _summary(command: Any) -> str:
    return next(iter(paragraphs_of(command.help)), "").rstrip(".")


def _table(rows: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield a table of names and texts."""
    rows = list(rows)
    width = max((len(name) for name, _ in rows if len(name) <= _MAX_NAME), default=_MAX_NAME)
    indent = " " * (width + 4)
    for name, text in rows:
        lines = textwrap.wrap(text, _width() - len(indent), break_on_hyphens=False) or [""]
        if len(name) > width:
            yield f"  {name}"
            yield from (f"{indent}{line}" for line in lines)
        else:
            yield f"  {name:<{width}}  {lines[0]}".rstrip()
            yield from (f"{indent}{line}" for line in lines[1:])


def _wrapped(text: str, indent: str) -> Sequence[str]:
    return textwrap.wrap(text, _width(), subsequent_indent=indent, break_on_hyphens=False)


def _width() -> int:
    return min(shutil.get_terminal_size().columns, _MAX_WIDTH)
