"""Validation of collapse records from files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID
from scanloom.stages.simplification.kernel_input import Ids
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.records.wedges import Wedges
from scanloom.stages.surface.surface_color import get_vertex_attributes

Shape = tuple[int, ...]


def validate_record(record: CollapseRecord, path: Path) -> None:
    """Reject a record whose collapses are impossible on its mesh.

    Parameters
    ----------
    record : record to validate.
    path : its file, for error messages.

    Raises
    ------
    InputError
        Naming the array that is wrong.
    """
    wedges, mesh = record.wedges, record.mesh
    count, triangles = len(mesh.vertices), len(mesh.triangles)
    collapses = record.removed.size
    columns = 3 if wedges is not None else 3 + get_vertex_attributes(mesh).shape[1]
    _require_arrays(
        {
            "removed": (record.removed, np.int32, (collapses,)),
            "survivor": (record.survivor, np.int32, (collapses,)),
            "path": (record.path, np.float64, (collapses, columns)),
            "lock": (record.lock, np.bool_, (count,)),
            "vertex_source": (record.vertex_source, np.int32, (count,)),
            "triangle_source": (record.triangle_source, np.int32, (triangles,)),
        },
        path,
    )
    for name, source in (
        ("vertex_source", record.vertex_source),
        ("triangle_source", record.triangle_source),
    ):
        if source is not None and (source < 0).any():
            raise InputError(
                SIMPLIFY_RECORD_INVALID, "is damaged: {name} has negative indices.", path, name=name
            )
    if not np.isfinite(record.path).all():
        raise InputError(
            SIMPLIFY_RECORD_INVALID, "is damaged: path has positions or colours that are not finite.", path
        )
    vertices = count
    if wedges is not None:
        _validate_wedges(wedges, count, 3 * triangles, collapses, path)
        vertices = wedges.vertex_count
    _require_index_range("removed", record.removed, 0, vertices, "a vertex", path)
    _require_index_range("survivor", record.survivor, 0, vertices, "a vertex", path)
    _require_valid_order("collapse", record.removed, record.survivor, vertices, "a vertex", path)


def _validate_wedges(wedges: Wedges, vertices: int, corners: int, collapses: int, path: Path) -> None:
    attributes = wedges.attributes
    width = 2 + 3 * attributes.has_colors + 3 * attributes.has_normals
    merged, changed = wedges.removed.size, wedges.changed.size
    arrays: dict[str, tuple[NDArray[Any] | None, type, Shape]] = {
        "origin": (attributes.origin, np.float64, (3,)),
        "positions": (attributes.positions, np.float64, (vertices, 3)),
        "columns": (attributes.columns, np.float64, (corners, width)),
        "corner_vertex": (wedges.corner_vertex, np.int32, (corners,)),
        "corner_wedge": (wedges.corner_wedge, np.int32, (corners,)),
        "removed": (wedges.removed, np.int32, (merged,)),
        "survivor": (wedges.survivor, np.int32, (merged,)),
        "when": (wedges.when, np.int32, (merged,)),
        "changed": (wedges.changed, np.int32, (changed,)),
        "changed_to": (wedges.changed_to, np.float64, (changed, width)),
        "changed_source": (wedges.changed_source, np.int32, (changed,)),
        "changed_when": (wedges.changed_when, np.int32, (changed,)),
    }
    _require_arrays({f"wedges/{name}": expected for name, expected in arrays.items()}, path)
    for name, (array, _, _) in arrays.items():
        if array is not None and not np.isfinite(array).all():
            raise InputError(
                SIMPLIFY_RECORD_INVALID,
                "is damaged: wedges/{name} has numbers that are not finite.",
                path,
                name=name,
            )
    scales = (
        (attributes.has_uvs, attributes.uv_scale),
        (attributes.has_colors, attributes.color_scale),
        (attributes.has_normals, attributes.normal_scale),
    )
    if any(is_there and not 0 < scale < math.inf for is_there, scale in scales):
        raise InputError(
            SIMPLIFY_RECORD_INVALID, "is damaged: an attribute scale is not positive and finite.", path
        )
    # Array sizes follow from the largest index; limit it to prevent huge allocations.
    for name, ids in (("corner_vertex", wedges.corner_vertex), ("corner_wedge", wedges.corner_wedge)):
        _require_index_range(f"wedges/{name}", ids, -1, corners, "an index", path)
    count = int(wedges.corner_wedge.max(initial=-1)) + 1
    _require_index_range("wedges/removed", wedges.removed, 0, count, "a wedge", path)
    _require_index_range("wedges/survivor", wedges.survivor, 0, count, "a wedge", path)
    _require_index_range("wedges/changed", wedges.changed, 0, count, "a wedge", path)
    _require_index_range("wedges/changed_source", wedges.changed_source, -1, corners, "a corner", path)
    for name, when in (("when", wedges.when), ("changed_when", wedges.changed_when)):
        if (np.diff(when) < 0).any():
            raise InputError(
                SIMPLIFY_RECORD_INVALID, "is damaged: wedges/{name} is not sorted.", path, name=name
            )
        _require_index_range(f"wedges/{name}", when, 0, collapses, "a collapse", path)
    left_out = wedges.corner_vertex.reshape(-1, 3) < 0
    kept = ~left_out.reshape(-1)
    if (left_out != left_out[:, :1]).any() or (wedges.corner_wedge[kept] < 0).any():
        raise InputError(
            SIMPLIFY_RECORD_INVALID, "is damaged: a triangle has corners without vertices or wedges.", path
        )
    _require_valid_order("wedge merge", wedges.removed, wedges.survivor, count, "a wedge", path)


def _require_arrays(expected: dict[str, tuple[NDArray[Any] | None, type, Shape]], path: Path) -> None:
    for name, (array, kind, shape) in expected.items():
        if array is not None and (array.dtype != kind or array.shape != shape):
            raise InputError(
                SIMPLIFY_RECORD_INVALID,
                "is damaged: {name} has type {array_dtype} and shape {array_shape}.",
                path,
                name=name,
                array_dtype=array.dtype,
                array_shape=array.shape,
            )


def _require_index_range(name: str, ids: Ids, low: int, end: int, element: str, path: Path) -> None:
    if len(ids) and not (ids.min() >= low and ids.max() < end):
        raise InputError(
            SIMPLIFY_RECORD_INVALID,
            "is damaged: {name} refers to {thing} that does not exist.",
            path,
            name=name,
            thing=element,
        )


def _require_valid_order(
    step: str, removed: Ids, survivor: Ids, count: int, element: str, path: Path
) -> None:
    """Reject impossible merges of elements.

    An element must not be removed twice, nor merged into itself or into a removed element.
    """
    steps = np.arange(len(removed))
    when = np.full(count, len(removed))
    when[removed] = steps
    # `when` holds the last removal of each element, so repeated removals and self-merges are out of order.
    in_order = (when[removed] == steps) & (when[survivor] > steps)
    if not in_order.all():
        wrong = int(np.flatnonzero(~in_order)[0])
        raise InputError(
            SIMPLIFY_RECORD_INVALID,
            "is damaged: {step} {wrong} refers to {thing} that was already removed.",
            path,
            step=step,
            wrong=wrong,
            thing=element,
        )
