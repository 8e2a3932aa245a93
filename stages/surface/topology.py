"""Topology of a mesh: connected components, borders and manifold defects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._kernels import find_irregular_elements
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.codes import MESH_COORDINATES_TOO_LARGE, MESH_NO_SURFACE
from scanloom.stages.surface.edges import (
    Edges,
    Ids,
    build_edges,
    label_fans,
    pair_halfedges,
)
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh

# Maximum ratio of height to longest edge of a degenerate triangle, whose normal is unusable: with positions
# of metres and edges of millimetres, rounding alone moves a vertex by that much.
MAX_FLATNESS = 1e-10


# Triangles measured at a time, which takes about 200 bytes per triangle.
_BATCH_TRIANGLES = 1 << 18

# Metres. Products of four lengths stay finite; the kernels have the same limit.
_MAX_COORDINATE = 1e60
# In image widths, that is repetitions of the image.
_MAX_UV = 1e30


@dataclass(frozen=True)
class Topology:
    """Topological counts of a mesh.

    Attributes
    ----------
    vertices, triangles : sizes of the arrays.
    edges : distinct edges of the triangles that repeat no vertex.
    euler : vertices − edges + triangles, counting only vertices in use.
    boundary_edges : edges with one triangle.
    boundary_loops : closed chains of boundary edges.
    components : connected components; triangles with a common vertex are connected.
    nonmanifold_edges : edges with three or more triangles.
    nonmanifold_vertices : vertices whose triangles form more than one fan.
    inconsistent_edges : edges whose two triangles traverse them in the same direction.
    degenerate : triangles that repeat a vertex or have no area.
    duplicate : triangles with the same three vertices as an earlier one.
    unreferenced : vertices without a triangle.
    repeating : degenerate triangles that repeat a vertex; they are excluded from all edge counts.
    """

    vertices: int
    triangles: int
    edges: int
    euler: int
    boundary_edges: int
    boundary_loops: int
    components: int
    nonmanifold_edges: int
    nonmanifold_vertices: int
    inconsistent_edges: int
    degenerate: int
    duplicate: int
    unreferenced: int
    repeating: int

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def is_manifold(self) -> bool:
        """True if every edge has at most two triangles, every vertex one fan."""
        return self.nonmanifold_edges == self.nonmanifold_vertices == self.repeating == 0

    @property
    def is_oriented(self) -> bool:
        """True if adjacent triangles have consistent orientation."""
        return self.inconsistent_edges == 0

    @property
    def is_closed(self) -> bool:
        """True if there are triangles and every edge has exactly two."""
        return self.triangles > 0 and self.boundary_edges == self.nonmanifold_edges == 0

    def to_dict(self) -> dict[str, Any]:
        """Return all counts and properties as JSON-compatible values."""
        return asdict(self) | {
            "is_manifold": self.is_manifold,
            "is_oriented": self.is_oriented,
            "is_closed": self.is_closed,
        }


def topology(mesh: MeshLike) -> Topology:
    """Analyse the topology of a mesh.

    It takes about one second per million triangles.

    Raises
    ------
    MeshError
        If the mesh is invalid.
    """
    mesh = as_mesh(mesh)
    places, counts = find_irregular_elements(
        mesh.vertices, mesh.triangles, corner_deg=0.0, fold_deg=0.0, spike_deg=0.0, wanted_threads=0
    )
    return make_topology(len(mesh.vertices), len(mesh.triangles), places, counts)


def make_topology(
    vertices: int, triangles: int, places: Mapping[str, Ids], counts: Mapping[str, int]
) -> Topology:
    """Make the topology from the results of the kernel `find_irregular_elements`.

    Parameters
    ----------
    vertices, triangles : sizes of the mesh; `vertices` may exclude duplicates that no triangle uses.
    places, counts : irregular elements and counts of the mesh.
    """
    return Topology(
        vertices=vertices,
        triangles=triangles,
        edges=counts["edges"],
        euler=counts["used"] - counts["edges"] + triangles - counts["repeating"],
        boundary_edges=len(places["border_edges"]),
        boundary_loops=counts["boundary_loops"],
        components=counts["components"],
        nonmanifold_edges=len(places["nonmanifold_edges"]),
        nonmanifold_vertices=len(places["singular_vertices"]),
        inconsistent_edges=len(places["inconsistent_edges"]),
        degenerate=len(places["degenerate_triangles"]),
        duplicate=len(places["duplicate_triangles"]),
        unreferenced=vertices - counts["referenced"],
        repeating=counts["repeating"],
    )


def require_manifold(mesh: MeshLike, where: str = "mesh") -> Mesh:
    """Return the mesh if it is an oriented manifold, with or without border.

    Raises
    ------
    MeshError
        If it is not; names the first offending triangles, edges or vertices.
    """
    mesh = as_mesh(mesh, where)
    repeating = has_repeated_vertex(mesh.triangles)
    if repeating.any():
        _refuse(where, "triangles that repeat a vertex", np.flatnonzero(repeating))
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    for offending, name in (
        (edges.triangle_count > 2, "edges with more than two triangles"),
        (is_inconsistent(edges), "inconsistently oriented edges"),
    ):
        if offending.any():
            _refuse(where, name, edges.ends[offending])
    pairs = pair_halfedges(edges, edges.triangle_count > 1)
    del edges
    singular = find_pinched_vertices(mesh.triangles, label_fans(mesh.triangles, *pairs))
    if len(singular):
        _refuse(where, "pinched vertices, whose triangles form more than one fan", singular)
    return mesh


def require_measurable(mesh: Mesh, where: str) -> None:
    """Refuse a mesh whose areas and volumes could overflow.

    Raises
    ------
    MeshError
        If a vertex or texture coordinate exceeds the limit of the kernels; `where` starts the message.
    """
    if mesh.texture is not None:
        (beyond,) = np.nonzero((np.abs(mesh.texture.uvs) > _MAX_UV).any(axis=(1, 2)))
        if len(beyond):
            raise MeshError(
                MESH_COORDINATES_TOO_LARGE,
                (
                    "texture coordinates of triangle {beyond} are beyond ±{farthest_uv:g} "
                    "({beyond_count:,} such)"
                ),
                where,
                remedy="create a new texture, or remove it.",
                beyond=beyond[0],
                farthest_uv=_MAX_UV,
                beyond_count=len(beyond),
            )
    (beyond,) = np.nonzero((np.abs(mesh.vertices) > _MAX_COORDINATE).any(axis=1))
    if len(beyond):
        place = ", ".join(f"{value:g}" for value in mesh.vertices[beyond[0]])
        raise MeshError(
            MESH_COORDINATES_TOO_LARGE,
            (
                "vertex {beyond} is at ({place}), beyond ±{farthest:g} m ({beyond_count:,} "
                "such): its coordinates are too large"
            ),
            where,
            remedy="remove it, or scale the mesh.",
            beyond=beyond[0],
            place=place,
            farthest=_MAX_COORDINATE,
            beyond_count=len(beyond),
        )


def require_area(mesh: Mesh, where: str) -> None:
    """Refuse a mesh without surface area.

    Raises
    ------
    MeshError
        If the mesh has no triangles, no area, or an infinite area; `where` starts the message.
    """
    if len(mesh.triangles) == 0:
        raise MeshError(MESH_NO_SURFACE, "it has no triangles; there is no surface.", where)
    require_measurable(mesh, where)
    with np.errstate(over="ignore", invalid="ignore"):
        total = compute_areas(mesh.vertices, mesh.triangles).sum()
    if total == 0:
        raise MeshError(MESH_NO_SURFACE, "all its triangles have zero area; there is no surface.", where)
    if not np.isfinite(total):
        raise MeshError(
            MESH_COORDINATES_TOO_LARGE,
            "its coordinates are too large; check that their unit is metres.",
            where,
        )


def _refuse(where: str, defect_name: str, offenders: NDArray[Any]) -> None:
    first = ", ".join("–".join(map(str, np.atleast_1d(row))) for row in offenders[:3])
    more = ", …" if len(offenders) > 3 else ""
    raise MeshError(
        MESH_NO_SURFACE,
        "has {offenders_count:,} {what} ({first}{more})",
        where,
        remedy="clean it first.",
        offenders_count=len(offenders),
        what=defect_name,
        first=first,
        more=more,
    )


def has_repeated_vertex(triangles: Triangles | Ids) -> NDArray[np.bool_]:
    """Return a mask (m,) of the triangles that repeat a vertex."""
    a, b, c = triangles.T
    return np.asarray((a == b) | (b == c) | (c == a))


def is_degenerate(vertices: Vertices, triangles: Triangles) -> NDArray[np.bool_]:
    """Return a mask (m,) of degenerate triangles.

    They repeat a vertex or have no area (see FLAT).
    """
    longest, doubled_area = _measure_triangles(vertices, triangles)
    return np.asarray(doubled_area <= MAX_FLATNESS * longest)


def compute_areas(vertices: Vertices, triangles: Triangles) -> NDArray[np.float64]:
    """Compute the area (m,) of each triangle, m²."""
    return _measure_triangles(vertices, triangles)[1] / 2


def _measure_triangles(
    vertices: Vertices, triangles: Triangles
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute each triangle's squared longest edge and doubled area, m²."""
    longest, doubled_area = np.empty(len(triangles)), np.empty(len(triangles))
    for first in range(0, len(triangles), _BATCH_TRIANGLES):
        rows = slice(first, first + _BATCH_TRIANGLES)
        longest[rows], doubled_area[rows] = _measure_batch(vertices, triangles[rows])
    return longest, doubled_area


def _measure_batch(
    vertices: Vertices, triangles: Triangles
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # One coordinate at a time is three times faster than rows of three, and this runs over all triangles.
    a, b, c = triangles.T
    ab, ac, bc = ([x[q] - x[p] for x in vertices.T] for p, q in ((a, b), (a, c), (b, c)))
    longest = np.max([u * u + v * v + w * w for u, v, w in (ab, ac, bc)], axis=0)
    cross = [ab[i] * ac[j] - ab[j] * ac[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return longest, np.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2)


def is_duplicate(edges: Edges) -> NDArray[np.bool_]:
    """Return a mask (m,) of triangles that duplicate an earlier one."""
    # Two edges of a triangle determine its vertices.
    first, second, _ = np.sort(edges.of_halfedge.reshape(-1, 3), axis=1).T
    key = first * len(edges.triangle_count) + second
    ordered = np.sort(key)
    if (ordered[1:] != ordered[:-1]).all():
        return np.zeros(len(key), bool)
    order = np.argsort(key, kind="stable")
    again = np.zeros(len(key), bool)
    again[order[1:]] = key[order[1:]] == key[order[:-1]]
    return again


def is_inconsistent(edges: Edges) -> NDArray[np.bool_]:
    """Return a mask (e,) of the inconsistently oriented edges.

    Both triangles traverse such an edge in the same direction.
    """
    return np.asarray((edges.triangle_count == 2) & (edges.forward_count != 1))


def find_pinched_vertices(triangles: Triangles, labels: Ids) -> Ids:
    """Return the vertices whose corners have more than one fan label."""
    corners = triangles.reshape(-1)
    vertex_of_fan = np.empty(labels.max(initial=-1) + 1, np.int64)
    vertex_of_fan[labels] = corners
    number_of_fans = np.bincount(vertex_of_fan)
    return np.flatnonzero(number_of_fans > 1)
