"""Text and notebook representation of results.

Results print as one line of key values. In a notebook they show a table and a thumbnail. Arrays are never
printed. A class uses `by_figures` or `by_fields` as `__repr__`, and `table` as `_repr_html_`.
"""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from scanloom.stages.printing.rounding import DIGITS, rounded_down, rounded_up

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Unit suffixes of metric names, longest first, and the unit as displayed.
_UNITS = {
    "_m_per_level": "m per level",
    "_per_m": "per m",
    "_percent": "%",
    "_levels": "levels of 255",
    "_frames": "frames",
    "_bytes": "bytes",
    "_share": "%",
    "_ratio": "%",
    "_deg": "°",
    "_mb": "MB",
    "_db": "dB",
    "_px": "px",
    "_mm": "mm",
    "_m2": "m²",
    "_m": "m",
    "_s": "s",
}
# Maximum characters of a repr, rows of a table, and items of a list that are printed individually.
_LONGEST, _MOST_ROWS, _NAMED = 240, 40, 4
_LONGEST_CELL = 120
# Metres; larger coordinates are printed to the millimetre.
_FAR = 10.0


def name_and_value(key: str, value: Any) -> tuple[str, str]:
    """Format a metric as name and value.

    The unit suffix of the name becomes the unit of the value; a `_share` or `_ratio` becomes a percentage.
    """
    end = next((end for end in _UNITS if key.endswith(end)), "")
    name = key.removesuffix(end).replace("_", " ")
    if value is None or not end:
        return name, value_in_words(value)
    if end in ("_share", "_ratio") and isinstance(value, float):
        value = 100 * value
    text = value_in_words(value)
    if isinstance(value, float) and name.endswith((" bound", " attained")):
        text = at_most(value) if name.endswith(" bound") else at_least(value)
    return name, f"{text} {_UNITS[end]}"


def value_in_words(value: Any) -> str:
    """Format a value: integers with thousands separators, floats with four significant digits."""
    if value is None or value == {}:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(value_in_words, value)) or "–"
    return str(value)


def place_in_words(point: Iterable[float]) -> str:
    """Format coordinates in metres.

    Four significant digits, or millimetres from 10 m on.
    """
    return ", ".join(f"{x:.4g}" if abs(x) < _FAR else f"{x:.3f}" for x in point)


def at_most(value: float) -> str:
    """Format an upper bound, rounded up so that it remains valid."""
    return f"{rounded_up(value):.{DIGITS}g}"


def at_least(value: float) -> str:
    """Format an attained value, rounded down so that it is not overstated."""
    return f"{rounded_down(value):.{DIGITS}g}"


def counted(count: int, what: str, plural: str = "") -> str:
    """Format a count with its noun: `1 triangle`, `57,755 triangles`.

    The result is empty for 0.
    """
    return f"{count:,} {what if count == 1 else plural or what + 's'}" if count else ""


def line(thing: object, said: Iterable[str]) -> str:
    """Format an object as `Name(fact, fact)`.

    Empty facts are dropped. Facts beyond 240 characters are replaced by `…`.
    """
    shown, left = [], _LONGEST
    for fact in said:
        text = " ".join(fact.split())
        left -= len(text) + 2
        if left < 0:
            shown.append("…")
            break
        if text:
            shown.append(text)
    return f"{type(thing).__name__}({', '.join(shown)})"


def by_figures(self: Any) -> str:
    """Format a result for `__repr__`: facts of its mesh, metrics and diagnostic count.

    Nested tables are omitted.
    """
    diagnostics = counted(len(getattr(self, "diagnostics", ())), "diagnostic")
    return line(self, [*_mesh_facts(getattr(self, "mesh", None)), *facts(_own_figures(self)), diagnostics])


def by_fields(self: Any) -> str:
    """Format a dataclass without `figures()` for `__repr__`; arrays are shown by shape."""
    return line(self, facts(_fields(self)))


def table(self: Any) -> str:
    """Format a result for `_repr_html_`: metrics or fields, diagnostics, mesh thumbnail."""
    mesh = getattr(self, "mesh", self)
    told = ", ".join(filter(None, _mesh_facts(mesh)))
    rows = [("mesh", told)] if told else []
    if not hasattr(self, "_facts"):
        rows += _rows(_own_figures(self) if hasattr(self, "figures") else _fields(self))
    rows += [(one.severity.value, str(one)) for one in getattr(self, "diagnostics", ())]
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(_cut(value))}</td></tr>"
        for name, value in rows[:_MOST_ROWS]
    )
    if len(rows) > _MOST_ROWS:
        cells += f"<tr><td>and {len(rows) - _MOST_ROWS} more</td></tr>"
    name = escape(type(self).__name__)
    content = f"{_picture(mesh)}<table>{cells}</table>"
    return f"<div><b>{name}</b><div style='display:flex;gap:1em;align-items:start'>{content}</div></div>"


def rows_table(rows: Sequence[Sequence[str]]) -> str:
    """Format rows of cells for `_repr_html_`; the first row is the heading."""
    right = "style='text-align:right'"
    head = "".join(f"<th {right}>{escape(word)}</th>" for word in rows[0])
    body = ("".join(f"<td {right}>{escape(word)}</td>" for word in row) for row in rows[1:])
    lines = "".join(f"<tr>{cells}</tr>" for cells in (head, *body))
    return f"<table>{lines}</table>"


def extent_in_words(points: NDArray[np.float64]) -> str:
    """Format the extent of points (n, 3) in metres: `6.2 × 4.1 × 2.4 m`.

    The result is empty without points.

    Extents below 0.1 m are given in millimetres.
    """
    if not len(points):
        return ""
    sides = [float(side) for side in points.max(axis=0) - points.min(axis=0)]
    unit, factor = ("m", 1.0) if max(sides) >= 0.1 else ("mm", 1e3)
    return (
        " × ".join(f"{side:,.0f}" if side >= 100 else f"{side:.2g}" for side in (factor * s for s in sides))
        + f" {unit}"
    )


def _mesh_facts(thing: Any) -> list[str]:
    """Return the facts of a mesh; an empty list for other objects."""
    return list(thing._facts()) if hasattr(thing, "_facts") else []


def _own_figures(thing: Any) -> dict[str, Any]:
    """Return the metrics without those that the mesh facts already contain."""
    told = {"vertices", "triangles"} if _mesh_facts(getattr(thing, "mesh", None)) else set()
    return {name: value for name, value in thing.figures().items() if name not in told}


def _fields(thing: Any) -> dict[str, Any]:
    fields = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}
    return {name.lstrip("_"): value for name, value in fields.items()}


def facts(figures: Mapping[str, Any]) -> Iterator[str]:
    """Format metrics as facts for `line`; empty values give empty facts."""
    return (_fact(name, value) for name, value in figures.items())


def _fact(key: str, value: Any) -> str:
    """Format one metric as a fact.

    The result is empty for None, False, 0 and mappings.
    """
    if value is None or value is False or isinstance(value, Mapping) or (type(value) is int and value == 0):
        return ""
    if hasattr(value, "shape"):
        return f"{key.replace('_', ' ')} {' × '.join(f'{n:,}' for n in value.shape)}"
    if value is True:
        return key.replace("_", " ")
    if isinstance(value, (list, tuple)):
        return _listed(key, value)
    if isinstance(value, bytes):
        return f"{key} {len(value):,} bytes"
    if hasattr(value, "_facts"):
        return ", ".join(filter(None, _mesh_facts(value)))
    if dataclasses.is_dataclass(value):
        return repr(value)
    return " ".join(name_and_value(key, value))


def _listed(key: str, items: list[Any] | tuple[Any, ...]) -> str:
    if _is_short(items):
        return " ".join(name_and_value(key, items)) if items else ""
    return counted(len(items), key.replace("_", " "), key.replace("_", " "))


def _is_short(value: Any) -> bool:
    """Return True for a list of at most four words or numbers."""
    is_list = isinstance(value, (list, tuple))
    return is_list and len(value) <= _NAMED and all(isinstance(item, (str, int, float)) for item in value)


def _rows(figures: Mapping[str, Any], of: str = "") -> Iterator[tuple[str, str]]:
    for key, value in figures.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{of}{key} · ".replace("_", " "))
        elif not _is_short(value) and (
            isinstance(value, (list, tuple)) or hasattr(value, "shape") or dataclasses.is_dataclass(value)
        ):
            name = key.replace("_", " ")
            yield f"{of}{name}", _fact(key, value).removeprefix(f"{name} ").removesuffix(f" {name}") or "–"
        else:
            name, text = name_and_value(key, value)
            yield f"{of}{name}", text


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST_CELL else text[: _LONGEST_CELL - 1] + "…"


def _picture(mesh: Any) -> str:
    try:
        png = mesh._thumbnail()
    except Exception:  # a damaged mesh must not prevent the table
        png = None
    if png is None:
        return ""
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(png).decode()}'>"
