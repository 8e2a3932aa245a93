"""Mesh coloured by coverage: weakly observed surface, and caps over its holes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS, WEAK_KINDS, WELL_OBSERVED_COLOR
from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.probes import Ids, Probes
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh

# Ambient ratio and light direction of shading baked into the colours, for viewers without lighting.
_AMBIENT_RATIO, _LIGHT_DIRECTION = 0.6, np.array((0.35, 0.55, 0.75)) / np.linalg.norm((0.35, 0.55, 0.75))


@dataclass(frozen=True, eq=False)
class PaintedBatch:
    """Batch of painted triangles.

    Attributes
    ----------
    vertices : (n, 3) float64, metres; vertices that belong to this batch, numbered after earlier batches.
    colors : (n, 3) uint8.
    triangles : (m, 3) int64, vertex indices in the whole mesh.
    probe_indices : (n,) index of the probe that represents each vertex; −1 for caps.
    """

    vertices: Floats
    colors: NDArray[np.uint8]
    triangles: Ids
    probe_indices: Ids


def paint_coverage(
    surface: ChunkedMesh | SingleChunkMesh,
    probes: Probes,
    kinds: NDArray[np.int8],
    caps: Sequence[tuple[str, Floats]],
) -> Iterator[PaintedBatch]:
    """Yield the surface in batches, then its hole caps, coloured by kind.

    Parameters
    ----------
    surface : mesh in batches.
    probes : vertices that represent their neighbourhoods.
    kinds : (k + 1,) index in `WEAK_KINDS` of each probe, −1 if well observed; the last is for vertices
        without a
        probe.
    caps : defect kind and corners (k, 3, 3) in metres of the triangles that would close holes.
    """
    palette = np.array([*(DEFECT_KINDS[kind].color for kind in WEAK_KINDS), WELL_OBSERVED_COLOR], np.float64)
    for part in surface.iterate_chunks():
        normals = surface.compute_normals(part)[: part.own_count]
        vertices = part.mesh.vertices[: part.own_count]
        of = probes.find_probes(vertices, normals, part.global_indices[: part.own_count])
        shade = _AMBIENT_RATIO + (1 - _AMBIENT_RATIO) * np.abs(normals @ _LIGHT_DIRECTION)
        colors = _to_uint8(palette[kinds[of]] * shade[:, None])
        yield PaintedBatch(vertices, colors, part.global_indices[part.mesh.triangles], of)
    count = surface.vertex_count
    for kind, corners in caps:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        shade = _AMBIENT_RATIO + (1 - _AMBIENT_RATIO) * np.abs(across @ _LIGHT_DIRECTION)
        colors = _to_uint8(np.repeat(np.array(DEFECT_KINDS[kind].color) * shade[:, None], 3, axis=0))
        numbers = count + np.arange(3 * len(corners))
        yield PaintedBatch(corners.reshape(-1, 3), colors, numbers.reshape(-1, 3), np.full(len(numbers), -1))
        count += len(numbers)


def _to_uint8(colors: Floats) -> NDArray[np.uint8]:
    return np.rint(colors).astype(np.uint8)
