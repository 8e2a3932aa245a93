"""Removal of self-intersections of a closed surface: the boundary of the space that it winds around.

Components that overlap are united exactly. Triangles that still intersect others are cut out, and the holes
are filled; all other triangles stay. If intersections remain, the complete surface is rebuilt on a grid.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._kernels import find_intersecting_triangles
from scanloom.stages.cleaning.manifold import make_manifold
from scanloom.stages.cleaning.regularity import NO_INTERSECTION
from scanloom.stages.cleaning.solids.booleans import from_manifold, require_manifold3d, to_manifold
from scanloom.stages.cleaning.solids.border_closing import make_caps
from scanloom.stages.cleaning.solids.level_set import (
    WindingNumbers,
    extract_boundary,
    list_cells,
    sample_surface,
)
from scanloom.stages.cleaning.solids.orientation import find_inside_out
from scanloom.stages.cleaning.solids.shell import Shell, compute_volumes
from scanloom.stages.progress import ignore_progress
from scanloom.stages.surface.edges import (
    build_edges,
    label_components,
    label_fans,
    pair_halfedges,
)
from scanloom.stages.surface.hole_filling import trace_border_loops
from scanloom.stages.surface.mesh import Mesh, Triangles
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.topology import compute_areas, find_pinched_vertices, is_degenerate
from scanloom.stages.surface.tracked_mesh import TrackedMesh

# Shorter edges, as a ratio of the surface's diagonal, count as intersections: programs that merge near
# vertices would tear the surface there.
_MIN_EDGE_RATIO = 1e-6
# Maximum number of rounds of refilling, and maximum ratio of triangles that it cuts out.
_MAX_ROUNDS, _MAX_UNSOUND_RATIO = 8, 0.1
# Maximum ratio of the surface that may be lost.
MAX_LOST_RATIO = 0.02
# Minimum number of triangles of an open component that is left after cutting.
_MIN_TRIANGLES = 12


def find_unsound(shell: Shell) -> NDArray[np.bool_]:
    """Return a mask (m,) of triangles that intersect or touch others, or have a tiny edge.

    Vertices at equal positions count as one, because other programs merge them. The same is required
    of positions in single precision, as in STL and glTF files.
    """
    rounded = shell.vertices.astype(np.float32).astype(np.float64)
    found = np.zeros(len(shell.triangles), bool)
    for vertices in (shell.vertices, rounded):
        found |= _find_unsound_exactly(Shell(vertices, shell.triangles, shell.source).weld())
    return found


def _find_unsound_exactly(welded: Shell) -> NDArray[np.bool_]:
    triangles = welded.triangles
    other = find_intersecting_triangles(
        welded.vertices, triangles, wanted_threads=0, progress=ignore_progress
    )
    found = (other != NO_INTERSECTION) | is_degenerate(welded.vertices, triangles)
    extent = float(np.linalg.norm(np.ptp(welded.vertices, axis=0)))
    corners = welded.vertices[triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    found |= (lengths <= _MIN_EDGE_RATIO * extent).any(axis=1)
    edges = build_edges(triangles, len(welded.vertices))
    fans = label_fans(triangles, *pair_halfedges(edges, edges.triangle_count > 1))
    touching = np.zeros(len(welded.vertices), bool)
    touching[find_pinched_vertices(triangles, fans)] = True
    touching[edges.ends[(edges.triangle_count != 2) | (edges.forward_count != 1)]] = True
    return np.asarray(found | touching[triangles].any(axis=1))


def orient_components(shell: Shell) -> Shell:
    """Turn components outwards that are inside out, unless these bound a cavity of another one."""
    _, labels = label_components(
        len(shell.vertices), shell.triangles[:, :2].reshape(-1), shell.triangles[:, 1:].reshape(-1)
    )
    component = labels[shell.triangles[:, 0]]
    vertices = shell.vertices - shell.vertices.mean(axis=0)
    volumes = np.bincount(component, compute_volumes(vertices, shell.triangles)).astype(np.float64)
    flipped = find_inside_out(shell.mesh, component, volumes)[component]
    return Shell(
        shell.vertices,
        np.where(flipped[:, None], shell.triangles[:, ::-1], shell.triangles).astype(np.int32),
        shell.source,
    )


def resolve_intersections(shell: Shell, edge_length: float, cell_size: float) -> tuple[Shell, str]:
    """Return the boundary of the space that a closed shell winds around, and the method that found it.

    Parameters
    ----------
    shell : closed oriented manifold that can intersect itself.
    edge_length : edge length of refilled holes, metres.
    cell_size : edge length of the grid on which the surface is rebuilt if need be, metres.
    """
    united = _unite_components(shell)
    refilled = refill(united, edge_length)
    if refilled is not None and refilled is not united:
        # Cutting can separate the sides of a thin wall, which caps then close wrongly.
        given = shell.select(shell.source >= 0).mesh
        if measure_lost_ratio(given, refilled, edge_length) > MAX_LOST_RATIO:
            refilled = None
    if refilled is None:
        return _rebuild(shell, cell_size), "rebuilt"
    if refilled is not united:
        return refilled, "refilled"
    return united, "none" if united is shell else "united"


def measure_lost_ratio(given: Mesh, shell: Shell, distance: float) -> float:
    """Measure the ratio of a surface's area that is outside of a solid, farther away than a distance."""
    if len(shell.triangles) == 0:
        return 1.0
    centers = given.vertices[given.triangles].mean(axis=1)
    far = RaycastingSurface(shell.mesh).find_closest_points(centers).distances > distance
    far[far] = ~WindingNumbers(shell.mesh).is_inside(centers[far])
    areas = compute_areas(given.vertices, given.triangles)
    return float(areas[far].sum() / areas.sum())


def refill(shell: Shell, edge_length: float) -> Shell | None:
    """Cut out triangles that intersect others and fill the holes, in rounds; None if intersections remain."""
    for number in range(_MAX_ROUNDS):
        shell = _unite_components(shell)
        unsound = find_unsound(shell)
        if not unsound.any():
            return shell
        if unsound.mean() > _MAX_UNSOUND_RATIO:
            return None
        # Later rounds cut out more, because a hole can be impossible to fill without intersections.
        kept = ~_grow_triangles(shell.triangles, unsound, 1 + number // 2)
        traced = make_manifold(TrackedMesh.start(shell.mesh).keep(kept)).traced
        traced = traced.keep(_find_large_components(traced.mesh)).drop_unused_vertices()
        if len(traced.mesh.triangles) == 0:
            return None
        loops, _ = trace_border_loops(
            traced.mesh, build_edges(traced.mesh.triangles, len(traced.mesh.vertices))
        )
        source = shell.source[traced.triangle_source]
        # All components with intersections were scraps.
        if not loops:
            shell = Shell(traced.mesh.vertices, traced.mesh.triangles, source)
            continue
        points, triangles = make_caps(traced.mesh, loops, edge_length)
        shell = Shell(
            np.concatenate([traced.mesh.vertices, points]),
            np.concatenate([traced.mesh.triangles, triangles]),
            np.concatenate([source, np.full(len(triangles), -1)]),
        )
    return None


def _grow_triangles(triangles: Triangles, chosen: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
    """Return a mask (m,) of the chosen triangles and rings of triangles around them."""
    touched = np.zeros(int(triangles.max(initial=-1)) + 1, bool)
    touched[triangles[chosen]] = True
    for _ in range(rings):
        touched[triangles[touched[triangles].any(axis=1)]] = True
    return np.asarray(touched[triangles].all(axis=1))


def _find_large_components(mesh: Mesh) -> NDArray[np.bool_]:
    """Return a mask (m,) of the triangles of components that are closed, or not just a scrap."""
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    _, labels = label_components(len(mesh.vertices), edges.ends[:, 0], edges.ends[:, 1])
    component = labels[mesh.triangles[:, 0]]
    is_large = np.bincount(component) >= _MIN_TRIANGLES
    is_closed = np.ones(len(is_large), bool)
    is_closed[labels[edges.ends[edges.triangle_count == 1, 0]]] = False
    return np.asarray((is_large | is_closed)[component])


def _unite_components(shell: Shell) -> Shell:
    """Unite components that overlap, and subtract cavities; return the same shell if none do."""
    parts = to_manifold(shell).decompose()
    if len(parts) <= 1:
        return shell
    library = require_manifold3d()
    solids = [part for part in parts if part.volume() > 0]
    cavities = [_turn(part) for part in parts if part.volume() < 0]
    united = library.Manifold.batch_boolean(solids, library.OpType.Add)
    if cavities:
        united -= library.Manifold.batch_boolean(cavities, library.OpType.Add)
    # Disjoint components stay as they are, in their order.
    return shell if united.num_tri() == len(shell.triangles) else from_manifold(united)


def _turn(part: Any) -> Any:
    shell = from_manifold(part)
    return to_manifold(Shell(shell.vertices, shell.triangles[:, ::-1], shell.source))


def _rebuild(shell: Shell, size: float) -> Shell:
    """Rebuild the boundary of the space that the surface winds around on a grid."""
    # Samples are half a cell apart, so a crossed cell without a sample has a neighbour with one.
    cells = list_cells(sample_surface(shell.vertices, shell.triangles, size / 2), size, 1)
    mesh = extract_boundary(WindingNumbers(shell.mesh), cells, size)
    return Shell(mesh.vertices, mesh.triangles, np.full(len(mesh.triangles), -1))
