"""Sections of parameters: of the configuration of a run, and of commands only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from scanloom.cli.command_table import iterate_commands, load_command
from scanloom.cli.completion import summarize
from scanloom.cli.options import parameter_groups
from scanloom.stages.params import describe_all


@dataclass(frozen=True)
class CommandSection:
    """Parameters of a command's section that the configuration lacks.

    Attributes
    ----------
    command : words of the command, such as "lod tiles".
    names : parameters that the configuration does not have.
    """

    command: str
    name: str
    cls: type
    names: frozenset[str]


def all_sections() -> dict[str, type]:
    """Return the class of every section; the configuration comes before commands."""
    from scanloom.pipeline.config import Config

    commands = {one.name: one.cls for one in command_sections()}
    return {
        **Config.get_types(),
        **{name: cls for name, cls in commands.items() if name not in Config.get_types()},
    }


def complete_sections(incomplete: str) -> list[tuple[str, str]]:
    """Return the sections with a prefix and their summaries, for shell completion."""
    types = all_sections()
    return [(name, summarize(cls)) for name, cls in types.items() if name.startswith(incomplete)]


def command_sections(name: str | None = None) -> Iterator[CommandSection]:
    """Yield the sections of commands with parameters beyond the configuration, each class once.

    Parameters
    ----------
    name : only sections of this name.
    """
    from scanloom.pipeline.config import Config

    types: dict[str, Any] = dict(Config.get_types())
    seen = set()
    for words in iterate_commands():
        for group in parameter_groups(load_command(words)):
            known = describe_all(types[group.section]) if group.section in types else {}
            names = frozenset(describe_all(group.cls)) - set(known)
            if names and name in (None, group.section) and (group.section, group.cls) not in seen:
                seen.add((group.section, group.cls))
                yield CommandSection(" ".join(words), group.section, group.cls, names)
