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
from making.docstrings import convert_docstring
from making.markdown import escape_markdown, format_code, format_definitions
from scanloom.stages import lod
from scanloom.stages.params import describe_all

# Packages in the order of the pipeline, with their headings.
PACKAGE_HEADINGS = {
    "scans": "Scans",
    "inspecting": "Inspection",
    "stereo": "Depth",
    "registration": "Registration",
    "adjusting": "Adjustment",
    "fusion": "Fusion",
    "cleaning": "Cleaning and checking",
    "refinement": "Refinement",
    "simplification": "Simplification",
    "texturing": "Texture",
    "normal_meshes": "Normal meshes",
    "lod": "Levels of detail",
    "exporting": "Export",
    "comparing": "Comparison",
    "rendering": "Pictures",
    "report": "Pages",
    "surface": "Meshes",
    "diagnostics": "Diagnostics and errors",
}
_WIDTH = 88


def write_reference() -> str:
    """Write a section for each package, functions first."""
    written = []
    for room, entries in groupby(
        sorted(list_public_names(), key=_get_sort_key), key=lambda entry: _get_package(entry[1])
    ):
        written.append(f"## {PACKAGE_HEADINGS[room]}")
        written += [f"### {format_code(name)}\n\n{_describe_object(name, thing)}" for name, thing in entries]
    return "\n\n".join(written)


def list_public_names() -> Iterator[tuple[str, Any]]:
    """Yield every public name with its object: `simplify`, `lod.build`."""
    for prefix, package in (("", scanloom), ("lod.", lod)):
        for name in package.__all__:
            thing = getattr(package, name)
            if not isinstance(thing, (str, ModuleType)):
                yield f"{prefix}{name}", thing


def _get_sort_key(entry: tuple[str, Any]) -> tuple[int, bool, str]:
    name, thing = entry
    return list(PACKAGE_HEADINGS).index(_get_package(thing)), inspect.isclass(thing), name


def _get_package(thing: Any) -> str:
    package, *below = thing.__module__.removeprefix("scanloom.").split(".")
    # The only type alias is the union of mesh types, whose `__module__` is typing; it belongs to `surface`.
    return str(below[0]) if package in ("stages", "pipeline") else "surface"


def _describe_object(name: str, thing: Any) -> str:
    if inspect.isfunction(thing):
        return f"{_format_signature(name, thing)}\n\n{convert_docstring(thing.__doc__)}"
    if not inspect.isclass(thing):
        kinds = ", ".join(
            kind.__forward_arg__ if hasattr(kind, "__forward_arg__") else str(kind) for kind in thing.__args__
        )
        return f"One of {escape_markdown(kinds)}."
    written = [convert_docstring(thing.__doc__)]
    if is_dataclass(thing) and describe_all(thing):
        about = parameters.list_entries(thing())
        written.append(
            format_definitions(
                (format_code(own), escape_markdown(description.text), escape_markdown(facts))
                for own, description, facts in about
            )
        )
    for own, member in vars(thing).items():
        if not own.startswith("_"):
            written.append(_describe_member(own, member))
    return "\n\n".join(part for part in written if part)


def _describe_member(name: str, member: Any) -> str:
    if isinstance(member, property):
        return f"{format_code(name)}\n: {_indent_text(convert_docstring(member.__doc__))}"
    function = getattr(member, "__func__", member)
    if isinstance(function, FunctionType) and function.__doc__:
        return (
            f"{format_code(_format_call(name, function))}\n: "
            f"{_indent_text(convert_docstring(function.__doc__))}"
        )
    return ""


def _indent_text(text: str) -> str:
    return text.replace("\n", "\n  ")


def _format_signature(name: str, function: Any) -> str:
    words = _format_call(name, function)
    if len(words) > _WIDTH:
        *_, returned = words.rpartition(")")
        given = "".join(f"    {part},\n" for part in _format_arguments(function))
        words = f"{name}(\n{given}){returned}"
    return f"```python\n{words}\n```"


def _format_call(name: str, function: Any) -> str:
    returned = inspect.signature(function).return_annotation
    arrow = "" if returned is inspect.Signature.empty else f" -> {returned}"
    return f"{name}({', '.join(part for part in _format_arguments(function) if part != 'self')}){arrow}"


def _format_arguments(function: Any) -> list[str]:
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
