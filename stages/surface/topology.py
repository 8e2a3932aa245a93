"""What kind of surface a mesh is: pieces, borders, and where it is no oriented manifold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.codes import MESH_COORDINATES_TOO_LARGE, MESH_NO_SURFACE
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.edges import Edges, Ids, components, edges_of, fans, neighbours, next_corner
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices

# A triangle whose height is less than this share of its longest edge has no usable normal: with positions
# of metres and edges of millimetres, rounding alone moves a vertex by that much.
FLAT = 1e-10


# As the kernels: products of four lengths are still numbers.
_FARTHEST = 1e60
# Times that an image is repeated.
_FARTHEST_UV = 1e30


@dataclass(frozen=True)
class Topology:
    """Counts that describe a mesh.

    Attributes
    ----------
    euler : vertices − edges + triangles, of the vertices in use.
    boundary_edges : edges of one triangle.
    boundary_loops : closed chains of them.
    components : pieces not joined by any vertex.
    nonmanifold_edges : edges of three or more triangles.
    nonmanifold_vertices : pinched ones, whose triangles form more than one fan.
    inconsistent_edges : edges of two triangles that run along them in the same direction.
    degenerate : triangles that repeat a vertex or have no area.
    duplicate : triangles of the same three vertices as an earlier one.
    unreferenced : vertices no triangle uses.
    repeating : the degenerate triangles that repeat a vertex; they have no part in the counts of edges.
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

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def is_manifold(self) -> bool:
        """Whether every edge has one or two triangles and every vertex one fan of them."""
        return self.nonmanifold_edges == self.nonmanifold_vertices == self.repeating == 0

    @property
    def is_oriented(self) -> bool:
        """Whether neighbouring triangles agree on which side is outside."""
        return self.inconsistent_edges == 0

    @property
    def is_closed(self) -> bool:
        """Whether there is a surface and each of its edges has two triangles."""
        return self.triangles > 0 and self.boundary_edges == self.nonmanifold_edges == 0

    def figures(self) -> dict[str, Any]:
        """Return all counts and properties by name."""
        return asdict(self) | {
            "is_manifold": self.is_manifold,
            "is_oriented": self.is_oriented,
            "is_closed": self.is_closed,
        }


def topology(mesh: MeshLike) -> Topology:
    """Count what describes the surface; about a second for a million triangles.

    Raises
    ------
    MeshError
        If it is no valid mesh.
    """
    mesh = as_mesh(mesh)
    repeating = repeats_vertex(mesh.triangles)
    proper = mesh.triangles[~repeating]
    edges = edges_of(proper, len(mesh.vertices))
    labels = fans(proper, *neighbours(edges, edges.count > 1))
    used = np.zeros(len(mesh.vertices), bool)
    used[proper] = True
    unused = int(np.count_nonzero(~used))
    pieces, _ = components(len(mesh.vertices), edges.ends[:, 0], edges.ends[:, 1])
    referenced = np.zeros(len(mesh.vertices), bool)
    referenced[mesh.triangles] = True
    return Topology(
        vertices=len(mesh.vertices),
        triangles=len(mesh.triangles),
        edges=len(edges.count),
        euler=len(mesh.vertices) - unused - len(edges.count) + len(proper),
        boundary_edges=int(np.count_nonzero(edges.count == 1)),
        boundary_loops=_loop_count(edges, labels),
        components=pieces - unused,
        nonmanifold_edges=int(np.count_nonzero(edges.count > 2)),
        nonmanifold_vertices=len(pinched(proper, labels)),
        inconsistent_edges=int(np.count_nonzero(inconsistent(edges))),
        degenerate=int(np.count_nonzero(is_degenerate(mesh.vertices, mesh.triangles))),
        duplicate=int(np.count_nonzero(is_duplicate(edges))),
        unreferenced=int(np.count_nonzero(~referenced)),
        repeating=int(np.count_nonzero(repeating)),
    )


def require_manifold(mesh: MeshLike, where: str = "mesh") -> Mesh:
    """Return the mesh if it is an oriented manifold, border allowed.

    Raises
    ------
    MeshError
        Naming the first triangles, edges or vertices that break the rule.
    """
    mesh = as_mesh(mesh, where)
    repeating = repeats_vertex(mesh.triangles)
    if repeating.any():
        _refuse(where, "triangles that repeat a vertex", np.flatnonzero(repeating))
    edges = edges_of(mesh.triangles, len(mesh.vertices))
    for offending, name in (
        (edges.count > 2, "edges of more than two triangles"),
        (inconsistent(edges), "edges whose two triangles are oriented against each other"),
    ):
        if offending.any():
            _refuse(where, name, edges.ends[offending])
    singular = pinched(mesh.triangles, fans(mesh.triangles, *neighbours(edges, edges.count > 1)))
    if len(singular):
        _refuse(where, "pinched vertices, whose triangles form more than one fan", singular)
    return mesh


def require_measurable(mesh: Mesh, where: str) -> None:
    """Refuse a mesh whose areas and volumes may be beyond floating point.

    Raises
    ------
    MeshError
        If a vertex or a texture coordinate is farther out than kernels take it; `where` starts the message.
    """
    if mesh.texture is not None:
        (beyond,) = np.nonzero((np.abs(mesh.texture.uvs) > _FARTHEST_UV).any(axis=(1, 2)))
        if len(beyond):
            raise MeshError(
                MESH_COORDINATES_TOO_LARGE,
                (
                    "texture coordinates of triangle {beyond} are beyond ±{farthest_uv:g} "
                    "({beyond_count:,} such)"
                ),
                where,
                remedy="make a new texture, or leave it out.",
                beyond=beyond[0],
                farthest_uv=_FARTHEST_UV,
                beyond_count=len(beyond),
            )
    (beyond,) = np.nonzero((np.abs(mesh.vertices) > _FARTHEST).any(axis=1))
    if len(beyond):
        place = ", ".join(f"{value:g}" for value in mesh.vertices[beyond[0]])
        raise MeshError(
            MESH_COORDINATES_TOO_LARGE,
            (
                "vertex {beyond} is at ({place}), beyond ±{farthest:g} m ({beyond_count:,} "
                "such): its coordinates are too large"
            ),
            where,
            remedy="take it out, or scale the mesh.",
            beyond=beyond[0],
            place=place,
            farthest=_FARTHEST,
            beyond_count=len(beyond),
        )


def require_area(mesh: Mesh, where: str) -> None:
    """Refuse a mesh that has no surface to work on.

    Raises
    ------
    MeshError
        If it has no triangles, no area, or an area beyond floating point; `where` starts the message.
    """
    if len(mesh.triangles) == 0:
        raise MeshError(MESH_NO_SURFACE, "it has no triangles; there is no surface.", where)
    require_measurable(mesh, where)
    with np.errstate(over="ignore", invalid="ignore"):
        total = areas(mesh.vertices, mesh.triangles).sum()
    if total == 0:
        raise MeshError(MESH_NO_SURFACE, "all its triangles have zero area; there is no surface.", where)
    if not np.isfinite(total):
        raise MeshError(
            MESH_COORDINATES_TOO_LARGE, "its coordinates are too large; is their unit really metres?", where
        )


def _refuse(where: str, what: str, offenders: NDArray[Any]) -> None:
    first = ", ".join("–".join(map(str, np.atleast_1d(row))) for row in offenders[:3])
    more = ", …" if len(offenders) > 3 else ""
    raise MeshError(
        MESH_NO_SURFACE,
        "has {offenders_count:,} {what} ({first}{more})",
        where,
        remedy="clean it first.",
        offenders_count=len(offenders),
        what=what,
        first=first,
        more=more,
    )


def repeats_vertex(triangles: Triangles | Ids) -> NDArray[np.bool_]:
    """Return which triangles name a vertex twice."""
    a, b, c = triangles.T
    return np.asarray((a == b) | (b == c) | (c == a))


def is_degenerate(vertices: Vertices, triangles: Triangles) -> NDArray[np.bool_]:
    """Return which triangles repeat a vertex or are flat to rounding (see FLAT)."""
    longest, doubled_area = _sizes(vertices, triangles)
    return np.asarray(doubled_area <= FLAT * longest)


def areas(vertices: Vertices, triangles: Triangles) -> NDArray[np.float64]:
    """Return the area of each triangle, m²."""
    return _sizes(vertices, triangles)[1] / 2


def _sizes(vertices: Vertices, triangles: Triangles) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each triangle's longest edge, squared, and twice its area."""
    # One coordinate at a time: three times as fast as rows of three, and this runs over all triangles.
    a, b, c = triangles.T
    ab, ac, bc = ([x[q] - x[p] for x in vertices.T] for p, q in ((a, b), (a, c), (b, c)))
    longest = np.max([u * u + v * v + w * w for u, v, w in (ab, ac, bc)], axis=0)
    cross = [ab[i] * ac[j] - ab[j] * ac[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return longest, np.sqrt(cross[0] ** 2 + cross[1] ** 2 + cross[2] ** 2)


def is_duplicate(edges: Edges) -> NDArray[np.bool_]:
    """Return which triangles have the vertices of an earlier one."""
    # Two edges of a triangle name all its vertices.
    first, second, _ = np.sort(edges.of_halfedge.reshape(-1, 3), axis=1).T
    key = first * len(edges.count) + second
    ordered = np.sort(key)
    if (ordered[1:] != ordered[:-1]).all():
        return np.zeros(len(key), bool)
    order = np.argsort(key, kind="stable")
    again = np.zeros(len(key), bool)
    again[order[1:]] = key[order[1:]] == key[order[:-1]]
    return again


def inconsistent(edges: Edges) -> NDArray[np.bool_]:
    """Return which edges have two triangles that run along them in the same direction."""
    return np.asarray((edges.count == 2) & (edges.forward != 1))


def pinched(triangles: Triangles, labels: Ids) -> Ids:
    """Return the vertices whose corners carry more than one label."""
    corners = triangles.reshape(-1)
    vertex_of_fan = np.empty(labels.max(initial=-1) + 1, np.int64)
    vertex_of_fan[labels] = corners
    number_of_fans = np.bincount(vertex_of_fan)
    return np.flatnonzero(number_of_fans > 1)


def _loop_count(edges: Edges, labels: Ids) -> int:
    """Count border loops; at a pinched vertex a loop goes on along its own fan."""
    border = edges.halfedges[edges.start[edges.count == 1]]
    ends, index = np.unique(labels[np.concatenate((border, next_corner(border)))], return_inverse=True)
    number, _ = components(len(ends), index[: len(border)], index[len(border) :])
    return number
