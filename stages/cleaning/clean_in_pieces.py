"""Out-of-core island removal for chunked PLY files.

Islands are connected across all chunks before their area is judged. Fusion output is already an oriented
manifold without degenerate triangles, so no other cleaning step is needed. The result is byte-identical to
`clean` on the complete mesh.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.clean import CleanParams, is_large
from scanloom.stages.cleaning.codes import CLEAN_NOTHING_LEFT
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.edges import components
from scanloom.stages.surface.pieces import Extent, Pieces, Written, write_pieces
from scanloom.stages.surface.topology import areas

Ids = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Islands:
    """Connected components of all chunks, and the islands they merge into.

    A component is local to a chunk; an island may span several chunks.

    Attributes
    ----------
    of_vertex : (n,) component of each vertex, memory-mapped.
    first : index of the first component of each chunk, plus the total count at the end.
    island : (k,) island of each component.
    in_part : (k,) triangle count of each component.
    area, triangles : area in m² and triangle count of each island.
    """

    of_vertex: Ids
    first: list[int]
    island: NDArray[np.int64]
    in_part: NDArray[np.int64]
    area: NDArray[np.float64]
    triangles: NDArray[np.int64]


def clean_in_pieces(
    fused: Path, result: Path, params: CleanParams, *, progress: Progress = silent
) -> dict[str, Any]:
    """Remove small islands from a chunked PLY file.

    Parameters
    ----------
    fused, result : input and output PLY file, each next to its chunk table.
    params : only `min_island_area` and `keep_largest` apply.
    progress : called with (chunks done, all chunks); each chunk counts twice, once per pass.

    Returns
    -------
    Statistics, as `Cleaned.figures` returns them.

    Raises
    ------
    InputError
        If a file is damaged.
    MeshError
        If no triangle is left.
    StageError
        If a file cannot be written.
    UsageError
        For parameters that need the complete mesh in memory.
    """
    whole_only = [name for name in ("repair", "fill_holes", "weld_distance") if getattr(params, name)]
    if whole_only:
        raise UsageError(
            FUSE_TOO_LARGE,
            "{whole_only} of clean needs the complete mesh in memory, but the mesh is too large",
            remedy="leave it out, or give a larger fuse.voxel_size.",
            whole_only=" and ".join(whole_only),
        )
    pieces = Pieces(fused)
    steps = 2 * len(pieces)
    with tempfile.TemporaryDirectory(dir=result.parent) as scratch:
        labels, numbers = (
            np.memmap(Path(scratch) / name, np.int32, "w+", shape=(max(pieces.vertex_count, 1),))
            for name in ("labels", "numbers")
        )
        islands = _islands(pieces, labels, lambda done: progress(done, steps))
        is_kept, min_area = is_large(islands.area, params)
        sizes = _numbered(pieces, islands, is_kept, numbers)
        if not sizes or not sizes[-1].triangles[1]:
            raise MeshError(
                CLEAN_NOTHING_LEFT,
                "has only degenerate triangles and small islands, so nothing is left of it.",
                "mesh",
            )

        def kept() -> Iterator[Written]:
            for number in range(len(pieces)):
                part = pieces.part(number)
                chosen = is_kept[islands.island[labels[part.numbers[part.mesh.triangles[:, 0]]]]]
                own = numbers[slice(*pieces.extents[number].vertices)] >= 0
                colors = None if part.mesh.colors is None else part.mesh.colors[: part.own][own]
                triangles = numbers[part.numbers[part.mesh.triangles[chosen]]]
                yield Written(part.mesh.vertices[: part.own][own], colors, triangles)
                progress(len(pieces) + number + 1, steps)

        write_pieces(result, sizes, kept(), has_colors=pieces.has_colors, spacing=pieces.spacing)
    vertices, triangles = sizes[-1].vertices[1], sizes[-1].triangles[1]
    return {
        "vertices": vertices,
        "triangles": triangles,
        "min_island_area_m2": min_area,
        "islands": int(np.count_nonzero(~is_kept & (islands.triangles > 0))),
        "island_triangles": pieces.triangle_count - triangles,
        "unused_vertices": pieces.vertex_count - vertices,
    }


def _islands(pieces: Pieces, labels: Ids, told: Any) -> _Islands:
    """Label connected components per chunk, and merge them across chunks."""
    first, area, count, meetings = [0], [], [], []
    for number in range(len(pieces)):
        part = pieces.part(number)
        triangles = part.mesh.triangles
        tails, heads = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
        found, label = components(len(part.mesh.vertices), tails, heads)
        of_triangle = label[triangles[:, 0]]
        area.append(np.bincount(of_triangle, areas(part.mesh.vertices, triangles), found))
        count.append(np.bincount(of_triangle, minlength=found))
        labels[slice(*pieces.extents[number].vertices)] = first[-1] + label[: part.own]
        # Labels of vertices of other chunks are final only after all chunks are labelled.
        meetings.append((part.numbers[part.own :], first[-1] + label[part.own :]))
        first.append(first[-1] + found)
        told(number + 1)
    there = np.concatenate([labels[numbers] for numbers, _ in meetings] or [np.zeros(0, np.int32)])
    here = np.concatenate([own for _, own in meetings] or [np.zeros(0, np.int64)])
    islands, island = components(first[-1], here, there)
    in_part = np.concatenate([np.zeros(0, np.int64), *count])
    return _Islands(
        labels,
        first,
        island.astype(np.int64),
        in_part,
        np.bincount(island, np.concatenate([np.zeros(0), *area]), islands).astype(np.float64),
        np.bincount(island, in_part, islands).astype(np.int64),
    )


def _numbered(pieces: Pieces, islands: _Islands, is_kept: NDArray[np.bool_], numbers: Ids) -> list[Extent]:
    """Write the new index of each vertex to `numbers`; −1 if removed.

    Returns
    -------
    Extents of the chunks of the result.
    """
    stays_in = is_kept[islands.island]
    at = (0, 0)
    sizes = []
    for number, extent in enumerate(pieces.extents):
        own = slice(*extent.vertices)
        stays = stays_in[islands.of_vertex[own]]
        numbers[own] = np.where(stays, at[0] + np.cumsum(stays) - 1, -1)
        parts = slice(islands.first[number], islands.first[number + 1])
        end = at[0] + int(stays.sum()), at[1] + int(islands.in_part[parts][stays_in[parts]].sum())
        sizes.append(Extent((at[0], end[0]), (at[1], end[1]), extent.low, extent.high))
        at = end
    return sizes
