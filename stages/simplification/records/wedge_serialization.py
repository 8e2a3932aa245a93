"""Serialisation of wedges to named arrays and JSON values, and back."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from scanloom.stages.simplification.corner_attributes import CornerAttributes
from scanloom.stages.simplification.records.archive import Arrays
from scanloom.stages.simplification.records.wedges import Wedges

_WEDGE_ARRAYS = tuple(field.name for field in fields(Wedges) if field.name != "attributes")
_ATTRIBUTE_ARRAYS = ("origin", "positions", "columns")
_SCALE_FIELDS = ("uv_scale", "color_scale", "normal_scale")
_FLAG_FIELDS = ("has_uvs", "has_colors", "has_normals")


def serialize_wedges(wedges: Wedges) -> tuple[Arrays, dict[str, Any]]:
    """Convert wedges to named arrays and JSON metadata."""
    attributes = wedges.attributes
    arrays = {name: getattr(wedges, name) for name in _WEDGE_ARRAYS}
    arrays |= {name: getattr(attributes, name) for name in _ATTRIBUTE_ARRAYS}
    return arrays, {name: getattr(attributes, name) for name in (*_SCALE_FIELDS, *_FLAG_FIELDS)}


def deserialize_wedges(arrays: Arrays, metadata: dict[str, Any]) -> Wedges:
    """Build the wedges that `serialize_wedges` converted.

    The caller must run `validate_record` on the record.

    Raises
    ------
    ValueError, KeyError, TypeError, OverflowError
        For arrays or metadata that `serialize_wedges` cannot produce.
    """
    attributes = CornerAttributes(
        arrays["origin"],
        arrays["positions"],
        arrays["columns"],
        uv_scale=float(metadata["uv_scale"]),
        color_scale=float(metadata["color_scale"]),
        normal_scale=float(metadata["normal_scale"]),
        has_uvs=bool(metadata["has_uvs"]),
        has_colors=bool(metadata["has_colors"]),
        has_normals=bool(metadata["has_normals"]),
    )
    return Wedges(attributes, **{name: arrays[name] for name in _WEDGE_ARRAYS})
