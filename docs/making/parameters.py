"""Parameter reference as definition lists, from the parameter classes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import groupby
from typing import Any

from making.markdown import definitions, escaped
from scanloom.pipeline.config import Config
from scanloom.pipeline.quality import QUALITIES
from scanloom.pipeline.sections import facts_of
from scanloom.stages.params import Described, describe_all, flatten, get_group, get_hint, get_value


def of_section(section: str) -> str:
    """List the parameters of a configuration section, named like `scan.first`."""
    return _grouped(getattr(Config(), section), lambda name: f"`{section}.{name}`")


def of_all() -> str:
    """List all configuration sections with headings and an anchor per parameter."""
    written = []
    for section, cls in Config.types().items():
        params = getattr(Config(), section)
        summary = (cls.__doc__ or "").strip().split("\n")[0]
        listed = _grouped(params, partial(_anchored, section))
        written.append(f"## `[{section}]`\n\n{escaped(summary)}\n\n{listed}")
    return "\n\n".join(written)


def of_qualities() -> str:
    """Write a table of the parameters that each quality sets."""
    rows = ["| quality | sets |", "|---|---|"]
    for quality, sections in QUALITIES.items():
        words = [
            f"`{section}.{name}={_value(value)}` ({_value(get_value(getattr(Config(), section), name))})"
            for section, params in sections.items()
            for name, value in flatten(params).items()
        ]
        rows.append(f"| `{quality}` | {', '.join(words) or 'nothing'} |")
    return "\n".join([*rows, "", "In parentheses: the values of `standard`."])


def _value(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)


def entries_of(params: Any) -> Iterator[tuple[str, Described, str]]:
    """Yield name, description and facts of each parameter of an object.

    Facts are type, unit, range and default.
    """
    cls = type(params)
    for name, about in describe_all(cls).items():
        # The default is taken from the object, because sections can have other defaults than their class.
        yield name, about, facts_of(about, get_value(params, name), get_hint(cls, name))


def _grouped(params: Any, shown: Callable[[str], str]) -> str:
    written = []
    cls = type(params)
    for group, entries in groupby(entries_of(params), key=lambda entry: get_group(cls, entry[0])):
        if group:
            written.append(f"**{escaped(group)}**\n")
        written.append(
            definitions(
                (shown(name), escaped(_sentence(about.text)), escaped(facts))
                for name, about, facts in entries
            )
        )
    return "\n".join(written)


def _anchored(section: str, name: str) -> str:
    return f'<span id="{section}.{name}"></span>`{section}.{name}`'


def _sentence(text: str) -> str:
    return f"{text.strip().removesuffix('.')}."
