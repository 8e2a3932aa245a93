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

from scanloom.stages.cleaning.clean import CleanParams, select_large_components
from scanloom.stages.cleaning.codes import CLEAN_NOTHING_LEFT
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.chunked_ply import ChunkedPly, ChunkExtent, WrittenChunk, write_chunked_ply
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.edges import label_components
from scanloom.stages.surface.topology import compute_areas

Ids = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _IslandLabels:
    """Connected components of all chunks, and the islands they merge into.

    A component is local to a chunk; an island may span several chunks.

    Attributes
    ----------
    component_of_vertex : (n,) component of each vertex, memory-mapped.
    first_component : index of the first component of each chunk, plus the total count at the end.
    island_of_component : (k,) island of each component.
    component_triangles : (k,) triangle count of each component.
    island_area, island_triangles : area in m² and triangle count of each island.
    """

    component_of_vertex: Ids
    first_component: list[int]
    island_of_component: NDArray[np.int64]
    component_triangles: NDArray[np.int64]
    island_area: NDArray[np.float64]
    island_triangles: NDArray[np.int64]


def clean_chunked(
    source: Path, target: Path, params: CleanParams, *, progress: Progress = ignore_progress
) -> dict[str, Any]:
    """Remove small islands from a chunked PLY file.

    Parameters
    ----------
    source, target : input and output PLY file, each next to its chunk table.
    params : only `min_island_area` and `keep_largest` apply.
    progress : called with (chunks done, all chunks); each chunk counts twice, once per pass.

    Returns
    -------
    Statistics, as `CleaningResult.to_dict` returns them.

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
    unsupported = [
        name for name in ("repair", "fill_holes", "weld_distance", "solid") if getattr(params, name)
    ]
    if unsupported:
        raise UsageError(
            FUSE_TOO_LARGE,
            "{whole_only} of clean needs the complete mesh in memory, but the mesh is too large",
            remedy="leave it out, or give a larger fuse.voxel_size.",
            whole_only=" and ".join(unsupported),
        )
    pieces = ChunkedPly(source)
    steps = 2 * len(pieces)
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        labels, numbers = (
            np.memmap(Path(scratch) / name, np.int32, "w+", shape=(max(pieces.vertex_count, 1),))
            for name in ("labels", "numbers")
        )
        islands = _label_islands(pieces, labels, lambda done: progress(done, steps))
        is_kept, min_area = select_large_components(islands.island_area, params)
        sizes = _assign_indices(pieces, islands, is_kept, numbers)
        if not sizes or not sizes[-1].triangles[1]:
            raise MeshError(
                CLEAN_NOTHING_LEFT,
                "has only degenerate triangles and small islands, so nothing is left of it.",
                "mesh",
            )

        def iterate_kept() -> Iterator[WrittenChunk]:
            for number in range(len(pieces)):
                part = pieces.read_chunk(number)
                chosen = is_kept[
                    islands.island_of_component[labels[part.global_indices[part.mesh.triangles[:, 0]]]]
                ]
                own = numbers[slice(*pieces.extents[number].vertices)] >= 0
                colors = None if part.mesh.colors is None else part.mesh.colors[: part.own_count][own]
                triangles = numbers[part.global_indices[part.mesh.triangles[chosen]]]
                yield WrittenChunk(part.mesh.vertices[: part.own_count][own], colors, triangles)
                progress(len(pieces) + number + 1, steps)

        write_chunked_ply(target, sizes, iterate_kept(), has_colors=pieces.has_colors, spacing=pieces.spacing)
    vertices, triangles = sizes[-1].vertices[1], sizes[-1].triangles[1]
    return {
        "vertices": vertices,
        "triangles": triangles,
        "min_island_area_m2": min_area,
        "islands": int(np.count_nonzero(~is_kept & (islands.island_triangles > 0))),
        "island_triangles": pieces.triangle_count - triangles,
        "unused_vertices": pieces.vertex_count - vertices,
    }


def _label_islands(pieces: ChunkedPly, labels: Ids, report: Any) -> _IslandLabels:
    """Label connected components per chunk, and merge them across chunks."""
    first, area, count, shared_vertices = [0], [], [], []
    for number in range(len(pieces)):
        part = pieces.read_chunk(number)
        triangles = part.mesh.triangles
        tails, heads = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
        component_count, label = label_components(len(part.mesh.vertices), tails, heads)
        of_triangle = label[triangles[:, 0]]
        area.append(np.bincount(of_triangle, compute_areas(part.mesh.vertices, triangles), component_count))
        count.append(np.bincount(of_triangle, minlength=component_count))
        labels[slice(*pieces.extents[number].vertices)] = first[-1] + label[: part.own_count]
        # Labels of vertices of other chunks are final only after all chunks are labelled.
        shared_vertices.append((part.global_indices[part.own_count :], first[-1] + label[part.own_count :]))
        first.append(first[-1] + component_count)
        report(number + 1)
    other_labels = np.concatenate(
        [labels[numbers] for numbers, _ in shared_vertices] or [np.zeros(0, np.int32)]
    )
    own_labels = np.concatenate([own for _, own in shared_vertices] or [np.zeros(0, np.int64)])
    islands, island = label_components(first[-1], own_labels, other_labels)
    in_part = np.concatenate([np.zeros(0, np.int64), *count])
    return _IslandLabels(
        labels,
        first,
        island.astype(np.int64),
        in_part,
        np.bincount(island, np.concatenate([np.zeros(0), *area]), islands).astype(np.float64),
        np.bincount(island, in_part, islands).astype(np.int64),
    )


def _assign_indices(
    pieces: ChunkedPly, islands: _IslandLabels, is_kept: NDArray[np.bool_], numbers: Ids
) -> list[ChunkExtent]:
    """Write the new index of each vertex to `numbers`; −1 if removed.

    Returns
    -------
    Extents of the chunks of the result.
    """
    stays_in = is_kept[islands.island_of_component]
    at = (0, 0)
    sizes = []
    for number, extent in enumerate(pieces.extents):
        own = slice(*extent.vertices)
        stays = stays_in[islands.component_of_vertex[own]]
        numbers[own] = np.where(stays, at[0] + np.cumsum(stays) - 1, -1)
        parts = slice(islands.first_component[number], islands.first_component[number + 1])
        end = at[0] + int(stays.sum()), at[1] + int(islands.component_triangles[parts][stays_in[parts]].sum())
        sizes.append(ChunkExtent((at[0], end[0]), (at[1], end[1]), extent.low, extent.high))
        at = end
    return sizes
