"""Serialisation of wedges to named arrays and JSON values, and back."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from scanloom.stages.simplification.corner_attributes import CornerAttributes
from scanloom.stages.simplification.records.archive import Arrays
from scanloom.stages.simplification.records.wedges import Wedges

_OF_WEDGES = tuple(field.name for field in fields(Wedges) if field.name != "attributes")
_OF_ATTRIBUTES = ("origin", "positions", "columns")
_SCALES = ("uv_scale", "color_scale", "normal_scale")
_HAS = ("has_uvs", "has_colors", "has_normals")


def stored_wedges(wedges: Wedges) -> tuple[Arrays, dict[str, Any]]:
    """Convert wedges to named arrays and JSON metadata."""
    attributes = wedges.attributes
    arrays = {name: getattr(wedges, name) for name in _OF_WEDGES}
    arrays |= {name: getattr(attributes, name) for name in _OF_ATTRIBUTES}
    return arrays, {name: getattr(attributes, name) for name in (*_SCALES, *_HAS)}


def wedges_of(arrays: Arrays, words: dict[str, Any]) -> Wedges:
    """Build the wedges that `stored_wedges` converted.

    The caller must run `require_sound` on the record.

    Raises
    ------
    ValueError, KeyError, TypeError, OverflowError
        For arrays or metadata that `stored_wedges` cannot produce.
    """
    attributes = CornerAttributes(
        arrays["origin"],
        arrays["positions"],
        arrays["columns"],
        uv_scale=float(words["uv_scale"]),
        color_scale=float(words["color_scale"]),
        normal_scale=float(words["normal_scale"]),
        has_uvs=bool(words["has_uvs"]),
        has_colors=bool(words["has_colors"]),
        has_normals=bool(words["has_normals"]),
    )
    return Wedges(attributes, **{name: arrays[name] for name in _OF_WEDGES})
