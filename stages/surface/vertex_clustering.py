"""Vertex clustering of a mesh file that exceeds memory, for display.

Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.
Vertices of a grid cell are replaced by their mean. The error is not bounded, so the result is only used for
pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED, MESH_NOT_FINITE
from scanloom.stages.surface.formats.ply_format import (
    CORNERS_FIELD,
    LENGTH_FIELD,
    BinaryRows,
    locate_triangle_rows,
)
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

Keys = NDArray[np.int64]

# Rows read at a time, about 100 bytes each.
_ROWS_PER_CHUNK = 1_000_000
# The finest grid has 2^11 cells along the longest side; a cell key has 11 bits per coordinate.
_BITS_PER_AXIS = 11
# Maximum vertex count, so that three vertex indices fit in one 64-bit key.
_MAX_VERTICES = 1 << 20
_AXES, _COLORS = ("x", "y", "z"), ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class ClusteredMesh:
    """A mesh simplified by vertex clustering.

    Attributes
    ----------
    mesh : triangles between three different cells, without duplicates; with colours if the file has them.
    cell_size : side length of a cell, metres.
    triangle_count : number of triangles in the file.
    """

    mesh: Mesh
    cell_size: float
    triangle_count: int


def read_clustered_mesh(path: Path, max_vertices: int) -> ClusteredMesh:
    """Read a binary triangle PLY file, simplified to at most `max_vertices` vertices.

    It takes 4 bytes of memory per vertex of the file and about 200 bytes per vertex of the result.

    Parameters
    ----------
    path : PLY file.
    max_vertices : maximum vertex count, up to 1,048,576. The cell size is 1/2048 of the longest side of the
        bounding box, doubled until the count is reached.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or does not consist of binary triangles.
    """
    vertices, faces = locate_triangle_rows(path)
    low, side = _compute_extent(vertices)
    cell = max(side, np.finfo(np.float64).tiny) / (1 << _BITS_PER_AXIS)
    keys, halvings = np.zeros(0, np.int64), 0
    for rows in vertices.read_chunks(_ROWS_PER_CHUNK):
        keys = np.union1d(keys, _coarsen_keys(_compute_cell_keys(rows, low, cell), halvings))
        while len(keys) > min(max_vertices, _MAX_VERTICES):
            halvings += 1
            keys = np.unique(_coarsen_keys(keys, 1))
    positions, colors, cell_of_vertex = _compute_cell_means(vertices, low, cell, keys, halvings)
    triangles = _collect_triangles(faces, cell_of_vertex, path)
    used, rows = np.unique(triangles, return_inverse=True)
    mesh = Mesh(
        positions[used],
        rows.reshape(-1, 3).astype(np.int32),
        None if colors is None else np.rint(colors[used]).astype(np.uint8),
    )
    return ClusteredMesh(mesh, cell * (1 << halvings), faces.count)


def _stack_positions(rows: NDArray[Any]) -> Floats:
    return np.stack([rows[axis].astype(np.float64) for axis in _AXES])


def _compute_extent(vertices: BinaryRows) -> tuple[Floats, float]:
    """Return the minimum corner (3,) and the longest side of the bounding box, metres."""
    lows, highs = [], []
    for rows in vertices.read_chunks(_ROWS_PER_CHUNK):
        places = _stack_positions(rows)
        lows.append(places.min(axis=1))
        highs.append(places.max(axis=1))
    if not lows:
        return np.zeros(3), 0.0
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    if not np.isfinite([low, high]).all():
        raise InputError(MESH_NOT_FINITE, "a vertex is not finite; the file is damaged.", vertices.path)
    return low, float((high - low).max())


def _compute_cell_keys(rows: NDArray[Any], low: Floats, cell: float) -> Keys:
    """Return each vertex's grid cell as one key with _BITS bits per coordinate."""
    x, y, z = (
        ((_stack_positions(rows) - low[:, None]) / cell).astype(np.int64).clip(0, (1 << _BITS_PER_AXIS) - 1)
    )
    return np.asarray((x << 2 * _BITS_PER_AXIS) | (y << _BITS_PER_AXIS) | z)


def _coarsen_keys(keys: Keys, halvings: int) -> Keys:
    """Map cell keys to a grid with 2^halvings times larger cells."""
    mask = (1 << _BITS_PER_AXIS) - 1
    x, y, z = (((keys >> shift) & mask) >> halvings for shift in (2 * _BITS_PER_AXIS, _BITS_PER_AXIS, 0))
    return np.asarray((x << 2 * _BITS_PER_AXIS) | (y << _BITS_PER_AXIS) | z)


def _compute_cell_means(
    vertices: BinaryRows, low: Floats, cell: float, keys: Keys, halvings: int
) -> tuple[Floats, Floats | None, NDArray[np.int32]]:
    """Compute the mean position (k, 3) and colour (k, 3) of each cell.

    The third result is the cell index (n,) of each vertex.
    """
    has_colors = set(_COLORS) <= set(vertices.dtype.names or ())
    sums = np.zeros((3 + 3 * has_colors, len(keys)))
    counts = np.zeros(len(keys))
    cell_of_vertex = np.empty(vertices.count, np.int32)
    end = 0
    for rows in vertices.read_chunks(_ROWS_PER_CHUNK):
        at = np.searchsorted(keys, _coarsen_keys(_compute_cell_keys(rows, low, cell), halvings))
        cell_of_vertex[end : end + len(rows)] = at
        end += len(rows)
        counts += np.bincount(at, minlength=len(keys))
        for total, name in zip(sums, (*_AXES, *_COLORS), strict=False):
            total += np.bincount(at, rows[name].astype(np.float64), len(keys))
    means = (sums / counts).T
    return np.ascontiguousarray(means[:, :3]), means[:, 3:] if has_colors else None, cell_of_vertex


def _collect_triangles(faces: BinaryRows, cell_of_vertex: NDArray[np.int32], path: Path) -> NDArray[np.int64]:
    """Map triangles to grid cells; drop degenerate and duplicate triangles.

    Each triangle starts at its smallest cell index.
    """
    found = [np.zeros(0, np.int64)]
    for rows in faces.read_chunks(_ROWS_PER_CHUNK):
        corners = rows[CORNERS_FIELD]
        if (rows[LENGTH_FIELD] != 3).any():
            raise InputError(MESH_FILE_DAMAGED, "it has faces that are not triangles.", path)
        if corners.min() < 0 or corners.max() >= len(cell_of_vertex):
            raise InputError(
                MESH_FILE_DAMAGED,
                "the file is damaged: a triangle references a vertex that does not exist.",
                path,
            )
        a, b, c = (cell_of_vertex[corners[:, i]].astype(np.int64) for i in range(3))
        is_one = (a != b) & (b != c) & (c != a)
        a, b, c = a[is_one], b[is_one], c[is_one]
        # A cyclic rotation keeps the orientation.
        first = np.where((a < b) & (a < c), 0, np.where(b < c, 1, 2))
        a, b, c = (np.choose(first, turned) for turned in ((a, b, c), (b, c, a), (c, a, b)))
        found.append(np.unique((a << 40) | (b << 20) | c))
    codes = np.unique(np.concatenate(found))
    return np.stack([codes >> 40, (codes >> 20) & (_MAX_VERTICES - 1), codes & (_MAX_VERTICES - 1)], axis=1)
