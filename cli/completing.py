"""What a shell offers for words of `run`: parameters and their values, and names of stages.

Nothing is imported for it before somebody asks.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

# Of a text beside a word: where it were wrapped, shells would take its second line for another word.
_LONGEST = 70


def stage_names() -> list[str]:
    """Return the names of all stages."""
    from scanloom.pipeline.graph import STAGES

    return [stage.name for stage in STAGES]


def settings(incomplete: str) -> list[tuple[str, str]]:
    """Return what `--set` may go on with, each with what it means.

    That is a section; then its parameters; then values: all there are, or else the default.
    """
    from scanloom.pipeline.config import Config
    from scanloom.stages.params import describe_all, get_hint, get_value

    section, dot, key = incomplete.partition(".")
    types = Config.types()
    sections = [name for name in types if name.startswith(section)]
    if not dot and len(sections) != 1:
        # Without the dot they would look complete.
        return [(f"{name}.", _shortened((types[name].__doc__ or "").split("\n")[0])) for name in sections]
    section = sections[0] if not dot else section
    if section not in types:
        return []
    usual, cls = getattr(Config(), section), types[section]
    key = key.partition("=")[0]
    near = {name: about for name, about in describe_all(cls).items() if name.startswith(key)}
    found = []
    for name, about in near.items():
        word, text = f"{section}.{name}=", _shortened(about.text)
        found.append((word, text))
        # One alone would be taken as it is, with a space behind.
        if len(near) == 1 or name == key:
            values = about.choices or _values(get_hint(cls, name), get_value(usual, name))
            found += [(word + value, text) for value in values]
    return found


def _shortened(text: str) -> str:
    return textwrap.shorten(text, _LONGEST, placeholder="…")


def _values(hint: Any, default: Any) -> Iterator[str]:
    if hint is bool or bool in getattr(hint, "__args__", ()):
        yield from ("true", "false")
    elif default is None:
        yield "none"
    else:
        yield str(default)
