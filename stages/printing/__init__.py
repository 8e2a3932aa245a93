"""Text and notebook representation of results.

Results print as one line of key values. In a notebook they show a table and a thumbnail. Arrays are never
printed. A class uses `format_by_metrics` or `format_by_fields` as `__repr__`, and `render_table` as
`_repr_html_`.
"""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from scanloom.stages.printing.rounding import PRINTED_DIGITS, round_down, round_up

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Unit suffixes of metric names, longest first, and the unit as displayed.
_UNIT_SUFFIXES = {
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
_MAX_LINE_LENGTH, _MAX_ROWS, _MAX_LISTED_ITEMS = 240, 40, 4
_MAX_CELL_LENGTH = 120
# Metres; larger coordinates are printed to the millimetre.
_FAR_M = 10.0


def format_metric(key: str, value: Any) -> tuple[str, str]:
    """Format a metric as name and value.

    The unit suffix of the name becomes the unit of the value; a `_share` or `_ratio` becomes a percentage.
    """
    end = next((end for end in _UNIT_SUFFIXES if key.endswith(end)), "")
    name = key.removesuffix(end).replace("_", " ")
    if value is None or not end:
        return name, format_value(value)
    if end in ("_share", "_ratio") and isinstance(value, float):
        value = 100 * value
    text = format_value(value)
    if isinstance(value, float) and name.endswith((" bound", " attained")):
        text = format_upper_bound(value) if name.endswith(" bound") else format_lower_bound(value)
    return name, f"{text} {_UNIT_SUFFIXES[end]}"


def format_value(value: Any) -> str:
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
        return ", ".join(map(format_value, value)) or "–"
    return str(value)


def format_position(point: Iterable[float]) -> str:
    """Format coordinates in metres.

    Four significant digits, or millimetres from 10 m on.
    """
    return ", ".join(f"{x:.4g}" if abs(x) < _FAR_M else f"{x:.3f}" for x in point)


def format_upper_bound(value: float) -> str:
    """Format an upper bound, rounded up so that it remains valid."""
    return f"{round_up(value):.{PRINTED_DIGITS}g}"


def format_lower_bound(value: float) -> str:
    """Format an attained value, rounded down so that it is not overstated."""
    return f"{round_down(value):.{PRINTED_DIGITS}g}"


def format_count(count: int, noun: str, plural: str = "") -> str:
    """Format a count with its noun: `1 triangle`, `57,755 triangles`.

    The result is empty for 0.
    """
    return f"{count:,} {noun if count == 1 else plural or noun + 's'}" if count else ""


def format_line(value: object, parts: Iterable[str]) -> str:
    """Format an object as `Name(fact, fact)`.

    Empty facts are dropped. Facts beyond 240 characters are replaced by `…`.
    """
    shown, left = [], _MAX_LINE_LENGTH
    for fact in parts:
        text = " ".join(fact.split())
        left -= len(text) + 2
        if left < 0:
            shown.append("…")
            break
        if text:
            shown.append(text)
    return f"{type(value).__name__}({', '.join(shown)})"


def format_by_metrics(self: Any) -> str:
    """Format a result for `__repr__`: facts of its mesh, metrics and diagnostic count.

    Nested tables are omitted.
    """
    diagnostics = format_count(len(getattr(self, "diagnostics", ())), "diagnostic")
    return format_line(
        self,
        [*_get_mesh_facts(getattr(self, "mesh", None)), *format_facts(_get_own_metrics(self)), diagnostics],
    )


def format_by_fields(self: Any) -> str:
    """Format a dataclass without `metrics()` for `__repr__`; arrays are shown by shape."""
    return format_line(self, format_facts(_get_fields(self)))


def render_table(self: Any) -> str:
    """Format a result for `_repr_html_`: metrics or fields, diagnostics, mesh thumbnail."""
    mesh = getattr(self, "mesh", self)
    mesh_facts = ", ".join(filter(None, _get_mesh_facts(mesh)))
    rows = [("mesh", mesh_facts)] if mesh_facts else []
    if not hasattr(self, "_facts"):
        rows += _iterate_rows(_get_own_metrics(self) if hasattr(self, "to_dict") else _get_fields(self))
    rows += [(one.severity.value, str(one)) for one in getattr(self, "diagnostics", ())]
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(_truncate_cell(value))}</td></tr>"
        for name, value in rows[:_MAX_ROWS]
    )
    if len(rows) > _MAX_ROWS:
        cells += f"<tr><td>and {len(rows) - _MAX_ROWS} more</td></tr>"
    name = escape(type(self).__name__)
    content = f"{_render_image(mesh)}<table>{cells}</table>"
    return f"<div><b>{name}</b><div style='display:flex;gap:1em;align-items:start'>{content}</div></div>"


def render_rows(rows: Sequence[Sequence[str]]) -> str:
    """Format rows of cells for `_repr_html_`; the first row is the heading."""
    right = "style='text-align:right'"
    head = "".join(f"<th {right}>{escape(word)}</th>" for word in rows[0])
    body = ("".join(f"<td {right}>{escape(word)}</td>" for word in row) for row in rows[1:])
    lines = "".join(f"<tr>{cells}</tr>" for cells in (head, *body))
    return f"<table>{lines}</table>"


def format_extent(points: NDArray[np.float64]) -> str:
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


def _get_mesh_facts(candidate: Any) -> list[str]:
    """Return the texts that describe a mesh, such as its size; an empty list for other objects."""
    return list(candidate._facts()) if hasattr(candidate, "_facts") else []


def _get_own_metrics(result: Any) -> dict[str, Any]:
    """Return the metrics without those that `_get_mesh_facts` already contains."""
    known_names = {"vertices", "triangles"} if _get_mesh_facts(getattr(result, "mesh", None)) else set()
    return {name: value for name, value in result.to_dict().items() if name not in known_names}


def _get_fields(result: Any) -> dict[str, Any]:
    fields = {field.name: getattr(result, field.name) for field in dataclasses.fields(result)}
    return {name.lstrip("_"): value for name, value in fields.items()}


def format_facts(metrics: Mapping[str, Any]) -> Iterator[str]:
    """Format metrics as facts for `format_line`; empty values give empty facts."""
    return (_format_fact(name, value) for name, value in metrics.items())


def _format_fact(key: str, value: Any) -> str:
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
        return _format_list(key, value)
    if isinstance(value, bytes):
        return f"{key} {len(value):,} bytes"
    if hasattr(value, "_facts"):
        return ", ".join(filter(None, _get_mesh_facts(value)))
    if dataclasses.is_dataclass(value):
        return repr(value)
    return " ".join(format_metric(key, value))


def _format_list(key: str, items: list[Any] | tuple[Any, ...]) -> str:
    if _is_short(items):
        return " ".join(format_metric(key, items)) if items else ""
    return format_count(len(items), key.replace("_", " "), key.replace("_", " "))


def _is_short(value: Any) -> bool:
    """Return True for a list of at most four words or numbers."""
    is_list = isinstance(value, (list, tuple))
    return (
        is_list
        and len(value) <= _MAX_LISTED_ITEMS
        and all(isinstance(item, (str, int, float)) for item in value)
    )


def _iterate_rows(metrics: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in metrics.items():
        if isinstance(value, Mapping):
            yield from _iterate_rows(value, f"{prefix}{key} · ".replace("_", " "))
        elif not _is_short(value) and (
            isinstance(value, (list, tuple)) or hasattr(value, "shape") or dataclasses.is_dataclass(value)
        ):
            name = key.replace("_", " ")
            yield (
                f"{prefix}{name}",
                _format_fact(key, value).removeprefix(f"{name} ").removesuffix(f" {name}") or "–",
            )
        else:
            name, text = format_metric(key, value)
            yield f"{prefix}{name}", text


def _truncate_cell(text: str) -> str:
    return text if len(text) <= _MAX_CELL_LENGTH else text[: _MAX_CELL_LENGTH - 1] + "…"


def _render_image(mesh: Any) -> str:
    try:
        png = mesh._thumbnail()
    except Exception:  # a damaged mesh must not prevent the table
        png = None
    if png is None:
        return ""
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(png).decode()}'>"
