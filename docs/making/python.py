"""Reference of public names: signatures and docstrings.

Covers `scanloom` and `scanloom.stages.lod`, grouped by package.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import is_dataclass
from itertools import groupby
from types import FunctionType, ModuleType
from typing import Any

import scanloom
from making import parameters
from making.docstrings import as_markdown
from making.markdown import code, definitions, escaped
from scanloom.stages import lod
from scanloom.stages.params import describe_all

# Packages in the order of the pipeline, with their headings.
ROOMS = {
    "scans": "Scans",
    "inspecting": "Inspection",
    "stereo": "Depth",
    "registration": "Registration",
    "adjusting": "Adjustment",
    "fusion": "Fusion",
    "cleaning": "Cleaning and checking",
    "simplification": "Simplification",
    "texturing": "Texture",
    "normal_meshes": "Normal meshes",
    "lod": "Levels of detail",
    "exporting": "Export",
    "comparing": "Comparison",
    "picturing": "Pictures",
    "report": "Pages",
    "surface": "Meshes",
    "diagnostics": "Diagnostics and errors",
}
_WIDTH = 88


def reference() -> str:
    """Write a section for each package, functions first."""
    written = []
    for room, entries in groupby(sorted(named(), key=_place), key=lambda entry: _room(entry[1])):
        written.append(f"## {ROOMS[room]}")
        written += [f"### {code(name)}\n\n{_text(name, thing)}" for name, thing in entries]
    return "\n\n".join(written)


def named() -> Iterator[tuple[str, Any]]:
    """Yield every public name with its object: `simplify`, `lod.build`."""
    for prefix, package in (("", scanloom), ("lod.", lod)):
        for name in package.__all__:
            thing = getattr(package, name)
            if not isinstance(thing, (str, ModuleType)):
                yield f"{prefix}{name}", thing


def _place(entry: tuple[str, Any]) -> tuple[int, bool, str]:
    name, thing = entry
    return list(ROOMS).index(_room(thing)), inspect.isclass(thing), name


def _room(thing: Any) -> str:
    package, *below = thing.__module__.removeprefix("scanloom.").split(".")
    # The only type alias is the union of mesh types, whose `__module__` is typing; it belongs to `surface`.
    return str(below[0]) if package in ("stages", "pipeline") else "surface"


def _text(name: str, thing: Any) -> str:
    if inspect.isfunction(thing):
        return f"{_signature(name, thing)}\n\n{as_markdown(thing.__doc__)}"
    if not inspect.isclass(thing):
        kinds = ", ".join(
            kind.__forward_arg__ if hasattr(kind, "__forward_arg__") else str(kind) for kind in thing.__args__
        )
        return f"One of {escaped(kinds)}."
    written = [as_markdown(thing.__doc__)]
    if is_dataclass(thing) and describe_all(thing):
        about = parameters.entries_of(thing())
        written.append(
            definitions((code(own), escaped(told.text), escaped(facts)) for own, told, facts in about)
        )
    for own, member in vars(thing).items():
        if not own.startswith("_"):
            written.append(_member(own, member))
    return "\n\n".join(part for part in written if part)


def _member(name: str, member: Any) -> str:
    if isinstance(member, property):
        return f"{code(name)}\n: {_set_in(as_markdown(member.__doc__))}"
    function = getattr(member, "__func__", member)
    if isinstance(function, FunctionType) and function.__doc__:
        return f"{code(_words(name, function))}\n: {_set_in(as_markdown(function.__doc__))}"
    return ""


def _set_in(text: str) -> str:
    return text.replace("\n", "\n  ")


def _signature(name: str, function: Any) -> str:
    words = _words(name, function)
    if len(words) > _WIDTH:
        *_, returned = words.rpartition(")")
        given = "".join(f"    {part},\n" for part in _arguments(function))
        words = f"{name}(\n{given}){returned}"
    return f"```python\n{words}\n```"


def _words(name: str, function: Any) -> str:
    returned = inspect.signature(function).return_annotation
    arrow = "" if returned is inspect.Signature.empty else f" -> {returned}"
    return f"{name}({', '.join(part for part in _arguments(function) if part != 'self')}){arrow}"


def _arguments(function: Any) -> list[str]:
    """List the arguments as written in a signature.

    Defaults that are functions are shown by name.
    """
    written, named_only = [], False
    for argument in inspect.signature(function).parameters.values():
        if argument.kind is argument.KEYWORD_ONLY and not named_only:
            written.append("*")
            named_only = True
        stars = {"VAR_POSITIONAL": "*", "VAR_KEYWORD": "**"}.get(argument.kind.name, "")
        named_only = named_only or stars == "*"
        hint = "" if argument.annotation is argument.empty else f": {argument.annotation}"
        default = argument.default
        shown = getattr(default, "__name__", None) or repr(default)
        written.append(f"{stars}{argument.name}{hint}{'' if default is argument.empty else f' = {shown}'}")
    return written
