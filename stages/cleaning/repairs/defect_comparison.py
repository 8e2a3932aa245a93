"""Comparison of the defects before and after repairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages._kernels import find_intersecting_triangles
from scanloom.stages.cleaning.check import CLASSES
from scanloom.stages.cleaning.regularity import NO_INTERSECTION, AngleLimits, find_local_irregular
from scanloom.stages.cleaning.repairs.defect_indices import find_missing, is_triangle_class
from scanloom.stages.cleaning.repairs.editable_mesh import EditableMesh
from scanloom.stages.cleaning.repairs.neighbourhood import grow_rings
from scanloom.stages.progress import ignore_progress
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Vertices

# A changed triangle affects the class only of elements within two rings.
_RINGS = 2
_EMPTY_SHAPES = {"vertex": (0,), "edge": (0, 2), "triangle": (0,)}


@dataclass(frozen=True, eq=False)
class DefectChanges:
    """Defects that repairs removed, and triangles of repairs that created defects.

    Attributes
    ----------
    resolved : per class, the elements that are no longer irregular.
    responsible : changed triangles that caused new defects.
    """

    resolved: dict[str, Ids]
    responsible: Ids


def compare_defects(
    edited: EditableMesh, limits: AngleLimits, intersecting: Ids, threads: int
) -> DefectChanges:
    """Compare the defects of the edited mesh and of the input.

    Parameters
    ----------
    edited : mesh under repair.
    limits : angle thresholds.
    intersecting : triangles of the input that intersect others.
    threads : 0 for one per core.
    """
    changed = edited.find_changed()
    if len(changed) == 0:
        return DefectChanges(
            {name: np.zeros(_EMPTY_SHAPES[kind], np.int64) for name, (kind, *_) in CLASSES.items()}, changed
        )
    given = edited.get_input_triangles()
    rows = grow_rings(given, len(edited.first_vertex), changed, _RINGS)
    there = rows[edited.is_present(rows)]
    vertices = np.unique(given[rows])
    defects_before, defects_after = (
        _to_mesh_indices(
            find_local_irregular(
                places[vertices], np.searchsorted(vertices, triangles[some]).astype(np.int32), limits
            ),
            vertices,
            some,
        )
        for places, triangles, some in (
            (edited.mesh.vertices, given, rows),
            (edited.positions, edited.triangles, there),
        )
    )
    gone = {name: find_missing(defects_before[name], defects_after[name]) for name in defects_before}
    guilty = [
        _find_written_at(edited, changed, find_missing(defects_after[name], defects_before[name]), name)
        for name in defects_after
    ]
    # Closing a border changes the topology, and is rejected like opening one.
    guilty.append(_find_written_at(edited, changed, gone["border_edges"], "border_edges"))
    new_intersections, resolved_intersections = _compare_intersections(edited, changed, intersecting, threads)
    guilty.append(new_intersections)
    gone["intersecting_triangles"] = resolved_intersections
    return DefectChanges(gone, np.unique(np.concatenate(guilty)))


def _to_mesh_indices(found: dict[str, Ids], vertices: Ids, rows: Ids) -> dict[str, Ids]:
    """Translate local indices of defects to indices of the mesh."""
    return {name: (rows if is_triangle_class(name) else vertices)[ids] for name, ids in found.items()}


def _find_written_at(edited: EditableMesh, changed: Ids, places: Ids, name: str) -> Ids:
    """Return the changed triangles that contain some defects."""
    if is_triangle_class(name):
        return np.intersect1d(changed, places)
    marked = np.zeros(len(edited.first_vertex) + 1, bool)
    marked[places] = True
    marked[-1] = False
    corners = np.concatenate([edited.triangles[changed], edited.get_input_triangles()[changed]], axis=1)
    wanted = 1 if places.ndim == 1 else 2
    hit = marked[corners].reshape(-1, 2, 3).sum(axis=2).max(axis=1, initial=0) >= wanted
    return np.asarray(changed[hit])


def _compare_intersections(
    edited: EditableMesh, changed: Ids, intersecting: Ids, threads: int
) -> tuple[Ids, Ids]:
    """Compare intersections before and after the repairs.

    Returns
    -------
    guilty : changed triangles with new intersections.
    gone : triangles of the input that intersect no longer.
    """
    near, other = _find_intersections(edited, changed[edited.is_present(changed)], threads)
    meets = other >= 0
    new = meets & ~np.isin(near, intersecting)
    guilty = np.intersect1d(changed, np.concatenate([near[new], other[new]]))
    # A triangle near changed ones may still intersect an unchanged one.
    in_doubt = np.intersect1d(intersecting, near[~meets])
    beyond, other = _find_intersections(edited, in_doubt, threads)
    gone = intersecting[~edited.is_present(intersecting)]
    return guilty, np.union1d(gone, np.setdiff1d(in_doubt, beyond[other >= 0]))


def _find_intersections(edited: EditableMesh, rows: Ids, threads: int) -> tuple[Ids, Ids]:
    """Find intersections of some triangles with all others.

    Returns
    -------
    near : `rows` and all triangles that may intersect them.
    other : for each of `near`, another triangle of `near` that it intersects, or −1.
    """
    from scipy.spatial import cKDTree

    if len(rows) == 0:
        return rows, rows
    (there,) = np.nonzero(edited.is_present(np.arange(len(edited.input_corners))))
    centres, reach = _compute_bounding_spheres(edited.positions, edited.triangles[there])
    is_one = np.isin(there, rows)
    # Upper bound of the distance between the centres of intersecting triangles.
    apart, _ = cKDTree(centres[is_one]).query(centres)
    near = there[apart <= (reach + reach[is_one].max()) * (1 + 1e-9)]
    vertices, index = np.unique(edited.triangles[near], return_inverse=True)
    other = find_intersecting_triangles(
        edited.positions[vertices],
        index.reshape(-1, 3).astype(np.int32),
        wanted_threads=threads,
        progress=ignore_progress,
    )
    meets = other != NO_INTERSECTION
    return near, np.where(meets, near[np.where(meets, other, 0)], -1)


def _compute_bounding_spheres(positions: Vertices, triangles: Ids) -> tuple[Vertices, Vertices]:
    """Compute bounding spheres of triangles: centres (k, 3) and radii (k,)."""
    corners = positions[triangles]
    centres = corners.mean(axis=1)
    return centres, np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=2).max(axis=1))
