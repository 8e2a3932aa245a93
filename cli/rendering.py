"""Formatting of diagnostics with parameters as options of the command line.

Messages name parameters by their keys, such as `fuse.voxel_size`, with or without a value. `name_as_typed`
decides how the user of the running command types each: as an option, or with `--set`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from scanloom.stages.diagnostics.codes import CONFIG_PARAMETER_UNKNOWN, CONFIG_UNREADABLE
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.params import describe_all, get_allowed_types, get_hint

# A key of a parameter, optionally with a value, but not as part of a path or longer word. A "set" before the
# key is part of the match, because `--set` replaces it.
_KEY = re.compile(
    r"(?<![\w./-])(?:--set |\b(?P<set>[Ss]et ))?(?P<key>[a-z]\w*(?:\.[a-z]\w*)+)"
    r"(?:(?P<equals>=)(?P<switch>true\b|false\b)?)?(?![\w/])"
)
# Errors about keys keep the key: the user typed it, possibly in a file.
_OF_KEYS = (CONFIG_PARAMETER_UNKNOWN.name, CONFIG_UNREADABLE.name)


@dataclass(frozen=True)
class CommandParameters:
    """Parameters of a command and how they are typed.

    Attributes
    ----------
    sections : parameter class of each section.
    options : option of each common parameter, by key.
    assigned : keys that the user has set with `--set`.
    """

    sections: Mapping[str, type] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    assigned: frozenset[str] = frozenset()

    def find_section(self, name: str) -> str | None:
        """Return the section that has a parameter of this name; None if no section has."""
        return next((key for key, cls in self.sections.items() if name in describe_all(cls)), None)


# Parameters of the running command. Failures are formatted after it returns, and from any thread.
_running = CommandParameters()


@contextmanager
def command_line() -> Iterator[None]:
    """Forget the parameters of the command when the block ends."""
    global _running
    try:
        yield
    finally:
        _running = CommandParameters()


def use_parameters(parameters: CommandParameters) -> None:
    """Render parameters as the user of this command types them."""
    global _running
    _running = parameters


def option_name(field_name: str) -> str:
    """Return the option of a common parameter, such as `ratio`."""
    return "--" + field_name.rpartition(".")[2].replace("_", "-")


def name_as_typed(key: str) -> str:
    """Return a parameter as the user types it: `--voxel-size`, or `--set fuse.voxel_size`."""
    option = None if key in _running.assigned else _running.options.get(key)
    return f"--set {key}" if option is None else option


def as_typed(text: str) -> str:
    """Write the parameters that a text names, such as `scan.depth_scale=1000`, as the user types them."""
    return _KEY.sub(_replace_key, text)


def _replace_key(found: re.Match[str]) -> str:
    key, switch = found["key"], found["switch"] or ""
    cls = _class_of(key)
    if cls is None:
        return found[0]
    typed = name_as_typed(key)
    give = {"S": "Give ", "s": "give "}[found["set"][0]] if found["set"] else ""
    if (
        switch
        and not typed.startswith("--set")
        and bool in get_allowed_types(get_hint(cls, key.partition(".")[2]))
    ):
        return give + (typed if switch == "true" else option_name(f"no_{typed[2:]}"))
    return f"{give}{typed}{found['equals'] or ''}{switch}"


def _class_of(key: str) -> type | None:
    """Return the class that has a parameter; None if there is no such class, for example for a file name."""
    from scanloom.pipeline.config import Config

    section, _, name = key.partition(".")
    cls = _running.sections.get(section) or Config.get_types().get(section)
    return cls if cls is not None and name in describe_all(cls) else None


def render(diagnostic: Diagnostic) -> str:
    """Return a diagnostic as one sentence that names parameters as the user types them."""
    sentence = str(diagnostic.replace_location(None))
    if diagnostic.code not in _OF_KEYS:
        sentence = as_typed(sentence)
    return sentence if diagnostic.where is None else _location(diagnostic.where) + sentence


def _location(where: DiagnosticLocation) -> str:
    """Return a location, with the parameter as typed on the command line, or as key in a file."""
    if where.parameter is None or (where.file is not None and where.section is not None):
        return str(where)
    section = where.section or _running.find_section(where.parameter)
    key = where.parameter if section is None else f"{section}.{where.parameter}"
    typed = option_name(key) if section is None else name_as_typed(key)
    return str(replace(where, section=None, parameter=typed))
