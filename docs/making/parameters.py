"""Parameter reference as definition lists, from the parameter classes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import groupby
from typing import Any

from making.markdown import escape_markdown, format_definitions
from scanloom.pipeline.config import Config
from scanloom.pipeline.quality_presets import QUALITIES
from scanloom.pipeline.sections import describe_parameter
from scanloom.stages.params import ParameterInfo, describe_all, flatten, get_group, get_hint, get_value


def list_section(section: str) -> str:
    """List the parameters of a configuration section, named like `scan.first`."""
    return _format_groups(getattr(Config(), section), lambda name: f"`{section}.{name}`")


def list_all_sections() -> str:
    """List all configuration sections with headings and an anchor per parameter."""
    written = []
    for section, cls in Config.get_types().items():
        params = getattr(Config(), section)
        summary = (cls.__doc__ or "").strip().split("\n")[0]
        listed = _format_groups(params, partial(_format_anchor, section))
        written.append(f"## `[{section}]`\n\n{escape_markdown(summary)}\n\n{listed}")
    return "\n\n".join(written)


def write_quality_table() -> str:
    """Write a table of the parameters that each quality sets."""
    rows = ["| quality | sets |", "|---|---|"]
    for quality, sections in QUALITIES.items():
        words = [
            f"`{section}.{name}={_format_value(value)}` "
            f"({_format_value(get_value(getattr(Config(), section), name))})"
            for section, params in sections.items()
            for name, value in flatten(params).items()
        ]
        rows.append(f"| `{quality}` | {', '.join(words) or 'nothing'} |")
    return "\n".join([*rows, "", "In parentheses: the values of `standard`."])


def _format_value(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)


def list_entries(params: Any) -> Iterator[tuple[str, ParameterInfo, str]]:
    """Yield name, description and facts of each parameter of an object.

    Facts are type, unit, range and default.
    """
    cls = type(params)
    for name, about in describe_all(cls).items():
        # The default is taken from the object, because sections can have other defaults than their class.
        yield name, about, describe_parameter(about, get_value(params, name), get_hint(cls, name))


def _format_groups(params: Any, format_name: Callable[[str], str]) -> str:
    written = []
    cls = type(params)
    for group, entries in groupby(list_entries(params), key=lambda entry: get_group(cls, entry[0])):
        if group:
            written.append(f"**{escape_markdown(group)}**\n")
        written.append(
            format_definitions(
                (format_name(name), escape_markdown(_end_sentence(about.text)), escape_markdown(facts))
                for name, about, facts in entries
            )
        )
    return "\n".join(written)


def _format_anchor(section: str, name: str) -> str:
    return f'<span id="{section}.{name}"></span>`{section}.{name}`'


def _end_sentence(text: str) -> str:
    return f"{text.strip().removesuffix('.')}."
