"""Mesh coloured by coverage: weakly observed surface, and caps over its holes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.kinds import KINDS, THIN, WELL
from scanloom.stages.inspecting.coverage.probes import Ids, Probes
from scanloom.stages.inspecting.coverage.views import Floats
from scanloom.stages.surface.piecewise import OnePiece, Piecewise

# Ambient ratio and light direction of shading baked into the colours, for viewers without lighting.
_AMBIENT, _LIGHT = 0.6, np.array((0.35, 0.55, 0.75)) / np.linalg.norm((0.35, 0.55, 0.75))


@dataclass(frozen=True, eq=False)
class Painted:
    """Batch of painted triangles.

    Attributes
    ----------
    vertices : (n, 3) float64, metres; vertices that belong to this batch, numbered after earlier batches.
    colors : (n, 3) uint8.
    triangles : (m, 3) int64, vertex indices in the whole mesh.
    probes : (n,) index of the probe that represents each vertex; −1 for caps.
    """

    vertices: Floats
    colors: NDArray[np.uint8]
    triangles: Ids
    probes: Ids


def painted(
    surface: Piecewise | OnePiece,
    probes: Probes,
    kinds: NDArray[np.int8],
    caps: Sequence[tuple[str, Floats]],
) -> Iterator[Painted]:
    """Yield the surface in batches, then its hole caps, coloured by kind.

    Parameters
    ----------
    surface : mesh in batches.
    probes : vertices that represent their neighbourhoods.
    kinds : (k + 1,) index in `THIN` of each probe, −1 if well observed; the last is for vertices without a
        probe.
    caps : defect kind and corners (k, 3, 3) in metres of the triangles that would close holes.
    """
    palette = np.array([*(KINDS[kind].color for kind in THIN), WELL], np.float64)
    for part in surface.parts():
        normals = surface.normals(part)[: part.own]
        vertices = part.mesh.vertices[: part.own]
        of = probes.of(vertices, normals, part.numbers[: part.own])
        shade = _AMBIENT + (1 - _AMBIENT) * np.abs(normals @ _LIGHT)
        colors = _levels(palette[kinds[of]] * shade[:, None])
        yield Painted(vertices, colors, part.numbers[part.mesh.triangles], of)
    count = surface.vertex_count
    for kind, corners in caps:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        shade = _AMBIENT + (1 - _AMBIENT) * np.abs(across @ _LIGHT)
        colors = _levels(np.repeat(np.array(KINDS[kind].color) * shade[:, None], 3, axis=0))
        numbers = count + np.arange(3 * len(corners))
        yield Painted(corners.reshape(-1, 3), colors, numbers.reshape(-1, 3), np.full(len(numbers), -1))
        count += len(numbers)


def _levels(colors: Floats) -> NDArray[np.uint8]:
    return np.rint(colors).astype(np.uint8)
