r"""Repair operations: flip, collapse, smooth, delete.

An operation lists the triangles it writes, with their new corners.

    flip            collapse v to u               smooth

      c         c         x---y
     / \       /|\       / \ / \                    v moves to the
    a---b  →  a | b     w---v   z  →  the ring      mean of its
     \ /       \|/       \ / \ /      around u      neighbours
      d         d         u---…
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.regularity import compute_corner_angles
from scanloom.stages.cleaning.repairs.editable_mesh import GONE
from scanloom.stages.cleaning.repairs.neighbourhood import Neighbourhood
from scanloom.stages.cleaning.repairs.ragged_array import find_distinct_pairs
from scanloom.stages.surface.edges import Ids, step_to_next_corner
from scanloom.stages.surface.mesh import Mesh, Vertices

# Reasons for not repairing a defect, by code; 0 means no objection.
REASONS = (
    "",
    "at a border",
    "where the texture, the material, the part or the colour changes",
    "where the surface is not a manifold",
    "where a triangle would flip",
    "where the repair would create another defect",
    "where the distance is not proven to be within max_shape",
    "without an applicable repair",
)
BORDER, SEAM, NON_MANIFOLD, FLIPPED, NEW_DEFECT, TOO_FAR, NO_OPERATION = range(1, len(REASONS))
# Codes without a text. RIM: the neighbourhood must grow before the operation can be validated.
ACCEPTED, OUTSIDE_NEIGHBOURHOOD = 0, -1


class CornerEquality:
    """Comparison of attributes between corners, and between triangles, of the input.

    Corners at one vertex with equal attributes are interchangeable.
    """

    def __init__(self, mesh: Mesh) -> None:
        texture, normals = mesh.texture, mesh.corner_normals
        self._of_corners: list[NDArray[Any]] = [mesh.triangles.reshape(-1, 1)]
        if texture is not None:
            self._of_corners.append(texture.uvs.reshape(-1, 2))
        if normals is not None:
            self._of_corners.append(normals.reshape(-1, 3))
        self._of_triangles: list[NDArray[Any]] = (
            [] if texture is None else [texture.material_ids, texture.has_uvs()]
        )
        if mesh.part_ids is not None:
            self._of_triangles.append(mesh.part_ids)

    def compare_corners(self, one: Ids, other: Ids) -> NDArray[np.bool_]:
        """Return a mask of corner pairs with equal vertex and attributes."""
        found = np.ones(len(one), bool)
        for values in self._of_corners:
            found &= (values[one] == values[other]).all(axis=1)
        return found

    def compare_triangles(self, one: Ids, other: Ids) -> NDArray[np.bool_]:
        """Return a mask of the triangle pairs with equal material and part."""
        found = np.ones(len(one), bool)
        for values in self._of_triangles:
            found &= values[one] == values[other]
        return found


@dataclass(frozen=True, eq=False)
class Operations:
    """Batch of k operations on a neighbourhood, with its local indices.

    Attributes
    ----------
    kind : (k,) index of the repaired class in REPAIRABLE.
    place : (k,) defect to repair: triangle, halfedge or vertex.
    refused : (k,) reason of rejection, FINE if none is known.
    owner, row, corner : (w,) operation, (w,) triangle it writes, and (w, 3) its new input corners, or GONE.
    moved, target : (k,) moved vertex, or −1, and (k, 3) its new position in metres.
    """

    kind: Ids
    place: Ids
    refused: Ids
    owner: Ids
    row: Ids
    corner: Ids
    moved: Ids
    target: Vertices

    def __len__(self) -> int:
        return len(self.kind)

    def select(self, chosen: NDArray[np.bool_]) -> Operations:
        """Return the selected operations."""
        number = np.cumsum(chosen) - 1
        written = chosen[self.owner]
        return Operations(
            self.kind[chosen],
            self.place[chosen],
            self.refused[chosen],
            number[self.owner[written]],
            self.row[written],
            self.corner[written],
            self.moved[chosen],
            self.target[chosen],
        )


def concatenate_operations(batches: list[Operations]) -> Operations:
    """Concatenate batches of operations."""
    starts = np.cumsum([0, *map(len, batches)])
    names = ("kind", "place", "refused", "row", "corner", "moved", "target")
    joined = {name: np.concatenate([getattr(one, name) for one in batches]) for name in names}
    owner = np.concatenate([one.owner + start for one, start in zip(batches, starts, strict=False)])
    return Operations(owner=owner, **joined)


def create_deletions(kind: int, rows: Ids) -> Operations:
    """Create operations that delete triangles."""
    corner = np.full((len(rows), 3), GONE)
    return _create_without_moves(
        kind, rows, np.zeros(len(rows), np.int64), np.arange(len(rows)), rows, corner
    )


def create_flips(
    kind: int, around: Neighbourhood, equality: CornerEquality, place: Ids, halfedges: Ids
) -> Operations:
    """Create operations that flip the edges of halfedges.

    The thinner of the two new triangles takes the index of the halfedge's triangle.
    """
    edges = around.edges
    edge = edges.of_halfedge[halfedges]
    refused = np.where(
        edges.triangle_count[edge] == 2,
        ACCEPTED,
        np.where(edges.triangle_count[edge] == 1, BORDER, NON_MANIFOLD),
    )
    refused[(refused == ACCEPTED) & (edges.forward_count[edge] != 1)] = NON_MANIFOLD
    done = np.flatnonzero(refused == ACCEPTED)
    a0, other = halfedges[done], _get_opposite(around, halfedges[done])
    b0, a1 = step_to_next_corner(a0), step_to_next_corner(other)
    c, d = step_to_next_corner(b0), step_to_next_corner(a1)
    corner = around.input_corners.reshape(-1)
    is_interchangeable = equality.compare_corners(corner[a0], corner[a1]) & equality.compare_corners(
        corner[b0], corner[other]
    )
    is_interchangeable &= equality.compare_triangles(
        around.triangle_indices[a0 // 3], around.triangle_indices[other // 3]
    )
    refused[done[~is_interchangeable]] = SEAM
    new = np.stack([corner[[a0, d, c]].T, corner[[other, c, d]].T], axis=1)
    vertices = around.triangles.reshape(-1)
    shape = np.stack([vertices[[a0, d, c]].T, vertices[[other, c, d]].T], axis=1)
    min_angles = (
        compute_corner_angles(around.positions, shape.reshape(-1, 3)).min(axis=1, initial=180).reshape(-1, 2)
    )
    new[min_angles[:, 1] < min_angles[:, 0]] = new[min_angles[:, 1] < min_angles[:, 0], ::-1]
    rows = np.stack([a0 // 3, other // 3], axis=1)
    return _create_without_moves(
        kind, place, refused, np.repeat(done, 2), rows.reshape(-1), new.reshape(-1, 3)
    )


def create_collapses(
    kind: int, around: Neighbourhood, equality: CornerEquality, place: Ids, halfedges: Ids, *, to_head: bool
) -> Operations:
    """Create operations that collapse halfedges: tail to head, or head to tail.

    The remaining vertex keeps its position.
    """
    edges = around.edges
    edge = edges.of_halfedge[halfedges]
    vertices = around.triangles.reshape(-1)
    goes = halfedges if to_head else step_to_next_corner(halfedges)
    refused = np.where(
        edges.triangle_count[edge] == 2,
        ACCEPTED,
        np.where(edges.triangle_count[edge] == 1, BORDER, NON_MANIFOLD),
    )
    refused[(refused == ACCEPTED) & (edges.forward_count[edge] != 1)] = NON_MANIFOLD
    refused[(refused == ACCEPTED) & around.mark_edge_ends(edges.triangle_count == 1)[vertices[goes]]] = BORDER
    done = np.flatnonzero(refused == ACCEPTED)
    here, there = halfedges[done], _get_opposite(around, halfedges[done])
    goes, stays = goes[done], step_to_next_corner(here) if to_head else here
    stays_there = there if to_head else step_to_next_corner(there)
    corner = around.input_corners.reshape(-1)
    torn = _find_seam_vertices(around, equality, vertices[goes])
    torn |= ~equality.compare_corners(corner[stays], corner[stays_there])
    refused[done[torn]] = SEAM
    owner, at = around.find_corners(vertices[goes])
    row = at // 3
    new = around.input_corners[row].copy()
    new[np.arange(len(row)), at % 3] = corner[stays][owner]
    new[(row == here[owner] // 3) | (row == there[owner] // 3)] = GONE
    return _create_without_moves(kind, place, refused, done[owner], row, new)


def create_smoothings(
    kind: int, around: Neighbourhood, equality: CornerEquality, vertices: Ids
) -> Operations:
    """Create operations that move vertices to the mean of their neighbours.

    This is one step of umbrella-operator Laplacian smoothing.
    """
    owner, at = around.find_corners(vertices)
    triangles = around.triangles[at // 3]
    of_pairs, near = find_distinct_pairs(
        np.repeat(owner, 3), triangles.reshape(-1), len(around.vertex_indices)
    )
    ring = near != vertices[of_pairs]
    of_pairs, near = of_pairs[ring], near[ring]
    count = np.maximum(np.bincount(of_pairs, minlength=len(vertices)), 1)
    sums = [np.bincount(of_pairs, axis, len(vertices)) for axis in around.positions[near].T]
    return Operations(
        kind=np.full(len(vertices), kind),
        place=vertices,
        refused=np.where(_find_seam_vertices(around, equality, vertices), SEAM, ACCEPTED),
        owner=owner,
        row=at // 3,
        corner=around.input_corners[at // 3],
        moved=vertices,
        target=np.stack(sums, axis=1) / count[:, None],
    )


def _get_opposite(around: Neighbourhood, halfedges: Ids) -> Ids:
    """Return the opposite halfedges; each edge must have two triangles."""
    edges = around.edges
    start = edges.start[edges.of_halfedge[halfedges]]
    return np.asarray(edges.halfedges[start] + edges.halfedges[start + 1] - halfedges)


def _find_seam_vertices(around: Neighbourhood, equality: CornerEquality, vertices: Ids) -> NDArray[np.bool_]:
    """Return a mask of vertices whose corners or triangles differ."""
    corner = around.input_corners.reshape(-1)
    owner, at = around.find_corners(vertices)
    one = at[np.searchsorted(owner, np.arange(len(vertices)))[owner]]
    alike = equality.compare_corners(corner[at], corner[one])
    alike &= equality.compare_triangles(around.triangle_indices[at // 3], around.triangle_indices[one // 3])
    return np.asarray(np.bincount(owner, ~alike, len(vertices)) > 0)


def _create_without_moves(
    kind: int, place: Ids, refused: Ids, owner: Ids, row: Ids, corner: Ids
) -> Operations:
    """Create operations that move no vertex."""
    count = len(place)
    return Operations(
        kind=np.full(count, kind),
        place=place,
        refused=refused,
        owner=owner,
        row=row,
        corner=corner,
        moved=np.full(count, -1),
        target=np.zeros((count, 3)),
    )
