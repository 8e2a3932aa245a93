"""Removal of small components and holes before simplification.

Everything removed is counted and reported.

Methods preserve the topology of their input. At 1 % of the triangles, hundreds of small components and holes
take triangles that the large surfaces need. Removal is optional, because no bound covers removed surface.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.printing import format_by_fields
from scanloom.stages.simplification.codes import SIMPLIFY_COMPONENTS_REMOVED
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.hole_filling import fill_holes
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.small_components import find_small_components
from scanloom.stages.surface.topology import compute_areas, has_repeated_vertex
from scanloom.stages.surface.tracked_mesh import TrackedMesh
from scanloom.stages.surface.welding import find_first_equal_rows


@dataclass(frozen=True)
class RemovalCounts:
    """Components and holes that were removed before simplification.

    Attributes
    ----------
    size_m : limit on the bounding box's diagonal, metres.
    components, component_triangles, component_area_m2 : connected components removed.
    holes, hole_triangles, hole_area_m2 : holes filled, and the triangles added for it.
    """

    size_m: float
    components: int
    component_triangles: int
    component_area_m2: float
    holes: int
    hole_triangles: int
    hole_area_m2: float

    __repr__ = format_by_fields

    def to_dict(self) -> dict[str, Any]:
        """Return all counts and areas, ready for JSON."""
        return asdict(self)

    def report(self) -> None:
        """Emit a warning if anything was removed."""
        if self.components or self.holes:
            emit(
                SIMPLIFY_COMPONENTS_REMOVED.warning(
                    "drop_below removed {components:,} connected components smaller than {size_m:g} m "
                    "({component_triangles:,} triangles, {component_area_m2:.3g} m²) and filled "
                    "{holes:,} holes ({hole_area_m2:.3g} m²); no bound covers these.",
                    **self.to_dict(),
                )
            )


@dataclass(frozen=True, eq=False)
class RemainingMesh:
    """Mesh without its small components and holes.

    Attributes
    ----------
    mesh : Mesh
    vertex_source, triangle_source : indices into the input. A triangle that fills a hole has the index of a
        triangle next to the hole.
    removal_counts : counts of removed components and holes.
    """

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    removal_counts: RemovalCounts


def remove_small_features(mesh: Mesh, size: float, lock: NDArray[np.bool_]) -> RemainingMesh:
    """Remove connected components and fill holes smaller than a size.

    Parameters
    ----------
    mesh : the input.
    size : metres, diagonal of the bounding box of a component or of the border of a hole.
    lock : (n,) bool, vertices whose components stay.

    Raises
    ------
    UsageError
        If every component is smaller.
    """
    is_small, components = find_small_components(mesh, size, lock)
    if len(is_small) and is_small.all():
        raise UsageError(
            SIMPLIFY_COMPONENTS_REMOVED,
            "is {size:g} m, and every connected component is smaller: nothing would be left.",
            DiagnosticLocation(parameter="drop_below"),
            size=size,
        )
    component_area = float(compute_areas(mesh.vertices, mesh.triangles[is_small]).sum())
    remaining = TrackedMesh.start(mesh).keep(~is_small).drop_unused_vertices()
    filled, neighbours, holes = _fill_small_holes(remaining, size)
    added = len(filled.mesh.triangles) - len(remaining.mesh.triangles)
    caps = filled.mesh.triangles[len(remaining.mesh.triangles) :]
    triangle_source = filled.triangle_source.copy()
    triangle_source[len(triangle_source) - added :] = remaining.triangle_source[neighbours]
    return RemainingMesh(
        mesh=filled.mesh,
        vertex_source=filled.vertex_source.astype(np.int32),
        triangle_source=triangle_source.astype(np.int32),
        removal_counts=RemovalCounts(
            size_m=size,
            components=components,
            component_triangles=int(is_small.sum()),
            component_area_m2=component_area,
            holes=holes,
            hole_triangles=added,
            hole_area_m2=float(compute_areas(filled.mesh.vertices, caps).sum()),
        ),
    )


def _fill_small_holes(kept: TrackedMesh, size: float) -> tuple[TrackedMesh, Ids, int]:
    """Fill small holes.

    Vertices at equal positions count as one. Otherwise each texture seam would be a border.

    Returns
    -------
    traced : the mesh with fill triangles at the end.
    neighbours : a triangle next to each fill triangle.
    holes : number of filled holes.
    """
    mesh = kept.mesh
    position = find_first_equal_rows(list(mesh.vertices.T))
    corners = position[mesh.triangles].astype(np.int32)
    is_proper = ~has_repeated_vertex(corners)
    welded = TrackedMesh.start(Mesh(mesh.vertices, corners[is_proper]))
    found, holes = fill_holes(welded, max_extent=size)
    caps = found.mesh.triangles[np.count_nonzero(is_proper) :]
    if not holes:
        return kept, np.zeros(0, np.int64), 0
    owner = np.zeros(len(mesh.vertices), np.int64)
    owner[corners.reshape(-1)] = np.repeat(np.arange(len(corners)), 3)
    return kept.append_triangles(caps), owner[caps[:, 0]], holes
