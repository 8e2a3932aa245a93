"""Comparison of the defects before and after repairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages._kernels import intersecting_triangles
from scanloom.stages.cleaning.regularity import NO_OTHER, Limits, irregular_neighbourhoods
from scanloom.stages.cleaning.repairs.edited import Edited
from scanloom.stages.cleaning.repairs.neighbourhood import grown
from scanloom.stages.cleaning.repairs.places import is_of_triangles, missing_in
from scanloom.stages.progress import silent
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Vertices

# A changed triangle affects the class only of elements within two rings.
_RINGS = 2


@dataclass(frozen=True, eq=False)
class Difference:
    """Defects that repairs removed, and triangles of repairs that created defects.

    Attributes
    ----------
    gone : per class, the elements that are no longer irregular.
    guilty : changed triangles that caused new defects.
    """

    gone: dict[str, Ids]
    guilty: Ids


def difference(edited: Edited, limits: Limits, intersecting: Ids, threads: int) -> Difference:
    """Compare the defects of the edited mesh and of the input.

    Parameters
    ----------
    edited : mesh under repair.
    limits : angle thresholds.
    intersecting : triangles of the input that intersect others.
    threads : 0 for one per core.
    """
    changed = edited.changed()
    given = edited.given_triangles()
    rows = grown(given, len(edited.first), changed, _RINGS)
    there = rows[edited.is_there(rows)]
    vertices = np.unique(given[rows])
    was, now = (
        _named(
            irregular_neighbourhoods(
                places[vertices], np.searchsorted(vertices, triangles[some]).astype(np.int32), limits
            ),
            vertices,
            some,
        )
        for places, triangles, some in (
            (edited.mesh.vertices, given, rows),
            (edited.places, edited.triangles, there),
        )
    )
    gone = {name: missing_in(was[name], now[name]) for name in was}
    guilty = [_written_at(edited, changed, missing_in(now[name], was[name]), name) for name in now]
    # Closing a border changes the topology, and is rejected like opening one.
    guilty.append(_written_at(edited, changed, gone["border_edges"], "border_edges"))
    met, free = _intersections(edited, changed, intersecting, threads)
    guilty.append(met)
    gone["intersecting_triangles"] = free
    return Difference(gone, np.unique(np.concatenate(guilty)))


def _named(found: dict[str, Ids], vertices: Ids, rows: Ids) -> dict[str, Ids]:
    """Translate local indices of defects to indices of the mesh."""
    return {name: (rows if is_of_triangles(name) else vertices)[ids] for name, ids in found.items()}


def _written_at(edited: Edited, changed: Ids, places: Ids, name: str) -> Ids:
    """Return the changed triangles that contain some defects."""
    if is_of_triangles(name):
        return np.intersect1d(changed, places)
    marked = np.zeros(len(edited.first) + 1, bool)
    marked[places] = True
    marked[-1] = False
    corners = np.concatenate([edited.triangles[changed], edited.given_triangles()[changed]], axis=1)
    wanted = 1 if places.ndim == 1 else 2
    hit = marked[corners].reshape(-1, 2, 3).sum(axis=2).max(axis=1, initial=0) >= wanted
    return np.asarray(changed[hit])


def _intersections(edited: Edited, changed: Ids, intersecting: Ids, threads: int) -> tuple[Ids, Ids]:
    """Compare intersections before and after the repairs.

    Returns
    -------
    guilty : changed triangles with new intersections.
    gone : triangles of the input that intersect no longer.
    """
    near, other = _meeting(edited, changed[edited.is_there(changed)], threads)
    meets = other >= 0
    new = meets & ~np.isin(near, intersecting)
    guilty = np.intersect1d(changed, np.concatenate([near[new], other[new]]))
    # A triangle near changed ones may still intersect an unchanged one.
    in_doubt = np.intersect1d(intersecting, near[~meets])
    beyond, other = _meeting(edited, in_doubt, threads)
    gone = intersecting[~edited.is_there(intersecting)]
    return guilty, np.union1d(gone, np.setdiff1d(in_doubt, beyond[other >= 0]))


def _meeting(edited: Edited, rows: Ids, threads: int) -> tuple[Ids, Ids]:
    """Find intersections of some triangles with all others.

    Returns
    -------
    near : `rows` and all triangles that may intersect them.
    other : for each of `near`, another triangle of `near` that it intersects, or −1.
    """
    from scipy.spatial import cKDTree

    if len(rows) == 0:
        return rows, rows
    (there,) = np.nonzero(edited.is_there(np.arange(len(edited.corner))))
    centres, reach = _spheres(edited.places, edited.triangles[there])
    is_one = np.isin(there, rows)
    # Upper bound of the distance between the centres of intersecting triangles.
    apart, _ = cKDTree(centres[is_one]).query(centres)
    near = there[apart <= (reach + reach[is_one].max()) * (1 + 1e-9)]
    vertices, index = np.unique(edited.triangles[near], return_inverse=True)
    other = intersecting_triangles(
        edited.places[vertices],
        index.reshape(-1, 3).astype(np.int32),
        wanted_threads=threads,
        progress=silent,
    )
    meets = other != NO_OTHER
    return near, np.where(meets, near[np.where(meets, other, 0)], -1)


def _spheres(places: Vertices, triangles: Ids) -> tuple[Vertices, Vertices]:
    """Compute bounding spheres of triangles: centres (k, 3) and radii (k,)."""
    corners = places[triangles]
    centres = corners.mean(axis=1)
    return centres, np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=2).max(axis=1))
