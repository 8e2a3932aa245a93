"""Shell completion of parameters, their values, and stage names.

Modules are imported only when the shell requests completions.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

# Maximum characters of a description. Shells break the list if a description exceeds a line.
_MAX_TEXT = 70


def complete_stages() -> list[str]:
    """Return the names of all stages."""
    from scanloom.pipeline.graph import STAGES

    return [stage.name for stage in STAGES]


def complete_assignment(incomplete: str, sections: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the completions of a word of `--set`, each with its description.

    Completes the section, then the parameter, then one of its choices or its default.

    Parameters
    ----------
    sections : parameters of each section, with their defaults.
    """
    from scanloom.stages.params import describe_all, get_hint, get_value

    section, dot, name = incomplete.partition(".")
    near = [one for one in sections if one.startswith(section)]
    if not dot and len(near) != 1:
        # Without the dot, shells append a space to a section.
        return [(f"{one}.", summarize(type(sections[one]))) for one in near]
    section = section if dot else near[0]
    if section not in sections:
        return []
    params = sections[section]
    name = name.partition("=")[0]
    matches = {key: about for key, about in describe_all(type(params)).items() if key.startswith(name)}
    words = []
    for key, about in matches.items():
        word, text = f"{section}.{key}=", _shorten(about.text)
        words.append((word, text))
        # Shells append a space to a single completion.
        if len(matches) == 1 or key == name:
            values = about.choices or _example_values(get_hint(type(params), key), get_value(params, key))
            words += [(word + value, text) for value in values]
    return words


def summarize(cls: type) -> str:
    """Return the first docstring line of a parameter class, shortened."""
    return _shorten((cls.__doc__ or "").split("\n")[0])


def _shorten(text: str) -> str:
    return textwrap.shorten(text, _MAX_TEXT, placeholder="…")


def _example_values(hint: Any, default: Any) -> Iterator[str]:
    if hint is bool or bool in getattr(hint, "__args__", ()):
        yield from ("true", "false")
    elif default is None:
        yield "none"
    else:
        yield str(default)
