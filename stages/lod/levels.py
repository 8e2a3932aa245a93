"""Levels of a mesh in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.lod.node_vertices import NodeVertices
from scanloom.stages.lod.source_mesh import decode_glb
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Mesh

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels of a mesh.

    The structure follows Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
    hierarchies" (2012, section 2.1), with fitted collapses.

    Nodes are numbered from the root, 0, downwards: a parent has a smaller index than its children. A node's
    mesh is coarse while none of its vertices is split. With all splits done, it equals the union of its
    children's coarse meshes; at a leaf, it equals the base mesh. Splits are numbered over all nodes in this
    order. Vertices are numbered by the split that creates them, after the `roots` vertices that exist before
    any split.

    Attributes
    ----------
    vertices : (v, 3) float64, metres, of all levels.
    colors : (v, 3) uint8 RGB, or None.
    roots : number of vertices that exist before any split.
    origin : (v - roots,) uint32, by vertex from `roots` on: the vertex it merges into when its split is
        undone.
    made, born : (s,) uint8, vertices (1 or 2) and triangles (0 to 2) that each split adds.
    triangles : (t, 3) uint32, triangles of each node with all splits done: first the triangles of its coarse
        mesh, then the triangles added by its splits, in order. Corners index `vertices`; with fewer splits, a
        corner is replaced by the vertex it has merged into.
    parent : (n,) int32, parent of each node; -1 for the root.
    level : (n,) int32, 0 for the first level of simplification.
    coarse : (n,) int32, number of triangles of the coarse mesh.
    first_split, first_triangle : (n + 1,) int64, start of each node's splits and triangles.
    shape_bound, color_bound : (n,) float64, metres and levels, proven two-sided bound at every point between
        the coarse mesh and the node's part of the input; at least the bound of each child.
    base_shape_bound, base_color_bound : the bounds of the base mesh, from which the hierarchy was built.
    input_triangles : number of triangles of the input mesh.
    diagnostics : warnings about the input mesh, and about the file that the levels were read from.
    dropped_islands, dropped_triangles : number of dropped small components and their triangles. They are on
        no level, so bounds are one-sided: each level is near the input, but dropped components are near no
        level.
    up : (3,) unit up direction of the mesh, or None if unknown.
    model_glb : the textured input mesh as a GLB file, or None; see `model`.
    """

    vertices: Floats
    colors: NDArray[np.uint8] | None
    roots: int
    origin: NDArray[np.uint32]
    made: NDArray[np.uint8]
    born: NDArray[np.uint8]
    triangles: NDArray[np.uint32]
    parent: NDArray[np.int32]
    level: NDArray[np.int32]
    coarse: NDArray[np.int32]
    first_split: Ids
    first_triangle: Ids
    shape_bound: Floats
    color_bound: Floats
    base_shape_bound: float
    base_color_bound: float
    input_triangles: int
    diagnostics: tuple[Diagnostic, ...] = ()
    dropped_islands: int = 0
    dropped_triangles: int = 0
    up: tuple[float, float, float] | None = None
    model_glb: bytes | None = None

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.parent)

    @cached_property
    def model(self) -> Mesh | None:
        """Textured input mesh, source of the images of tiles, and of cuts with `scanloom.bake`.

        Raises
        ------
        InputError, MeshError
            If `model_glb` is not a valid mesh.
        """
        return None if self.model_glb is None else decode_glb(self.model_glb)

    @property
    def is_one_sided(self) -> bool:
        """True if dropped components of the input mesh are on no level."""
        return self.dropped_islands > 0

    @cached_property
    def children(self) -> tuple[Ids, ...]:
        """Children of each node, ascending."""
        order = np.argsort(self.parent, kind="stable")
        starts = np.searchsorted(self.parent[order], np.arange(self.nodes + 1))
        return tuple(order[a:b] for a, b in pairwise(starts))

    @cached_property
    def splits(self) -> Ids:
        """Number of splits of each node (n,)."""
        return np.diff(self.first_split)

    @cached_property
    def full(self) -> Ids:
        """Number of triangles of each node (n,) with all splits done."""
        return np.diff(self.first_triangle)

    @cached_property
    def full_shape_bound(self) -> Floats:
        """Shape bound of each node (n,) with all splits done, metres.

        It is the maximum of the children's bounds, or the base bound at a leaf.
        """
        return self._compute_child_max(self.shape_bound, self.base_shape_bound)

    @cached_property
    def full_color_bound(self) -> Floats:
        """Colour bound of each node (n,) with all splits done, levels."""
        return self._compute_child_max(self.color_bound, self.base_color_bound)

    def _compute_child_max(self, bounds: Floats, base_bound: float) -> Floats:
        child_max = np.full(self.nodes, -np.inf)
        np.maximum.at(child_max, self.parent[1:], bounds[1:])
        return np.where(np.isinf(child_max) & (child_max < 0), base_bound, child_max)

    @cached_property
    def vertices_after(self) -> Ids:
        """Number of vertices (s + 1,) after the first 0, 1, … splits of all nodes."""
        return self.roots + np.concatenate([[0], np.cumsum(self.made, dtype=np.int64)])

    @cached_property
    def born_before(self) -> Ids:
        """Number of triangles (s + 1,) added by the first 0, 1, … splits of all nodes."""
        return np.concatenate([[0], np.cumsum(self.born, dtype=np.int64)])

    @cached_property
    def node_vertices(self) -> NodeVertices:
        """Vertices of each node in flat arrays."""
        lists = [self.list_vertices(node) for node in range(self.nodes)]
        return NodeVertices.of(lists, self.parent, self.full, self.triangles)

    @cached_property
    def spheres(self) -> tuple[Floats, Floats]:
        """Bounding spheres of each node and its descendants: centre (n, 3) and radius (n,), metres."""
        low, high = self.boxes
        middle, of = 0.5 * (low + high), self.node_vertices
        away = self.vertices[of.vertices] - np.repeat(middle, np.diff(of.start), axis=0)
        radius = np.sqrt(of.reduce(np.maximum, np.einsum("ij,ij->i", away, away), 0.0))
        for node in range(self.nodes - 1, 0, -1):
            above = self.parent[node]
            reach = float(np.linalg.norm(middle[node] - middle[above])) + radius[node]
            radius[above] = max(radius[above], reach)
        return middle, radius

    @cached_property
    def boxes(self) -> tuple[Floats, Floats]:
        """Bounding boxes of each node and its descendants: minimum and maximum corners (n, 3), metres."""
        of = self.node_vertices
        points = self.vertices[of.vertices]
        low = -of.propagate_max(-of.reduce(np.minimum, points, np.inf))
        return low, of.propagate_max(of.reduce(np.maximum, points, -np.inf))

    @cached_property
    def cones(self) -> tuple[Floats, Floats]:
        """Normal cones of each node: unit axis (n, 3) and half angle (n,), radians.

        A cone contains the normals of the mesh with all splits done. The half angle is π if the axis is
        undefined.
        """
        node = np.repeat(np.arange(self.nodes), self.full)
        corners = self.vertices[self.triangles[: len(node)]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1)
        mean = np.stack([np.bincount(node, column, self.nodes) for column in normals.T], axis=1)
        mean_length = np.linalg.norm(mean, axis=1)
        is_defined = mean_length > 0
        axis = np.divide(mean, mean_length[:, None], out=np.zeros_like(mean), where=is_defined[:, None])
        has_area = length > 0
        cosine = np.einsum("ij,ij->i", normals[has_area], axis[node[has_area]]) / length[has_area]
        min_cosine = np.ones(self.nodes)
        np.minimum.at(min_cosine, node[has_area], cosine)
        return axis, np.where(is_defined, np.arccos(np.clip(min_cosine, -1, 1)), np.pi)

    def list_vertices(self, node: int) -> NDArray[np.uint32]:
        """Return all vertices that a node uses at any number of splits, ascending."""
        a, b = self.vertices_after[self.first_split[node : node + 2]]
        corners = self.triangles[self.first_triangle[node] : self.first_triangle[node + 1]]
        corner_vertices = coarse_vertices = _sort_unique(corners.reshape(-1))
        while len(coarse_vertices) and (is_split := coarse_vertices >= a).any():
            coarse_vertices = _sort_unique(
                np.where(
                    is_split,
                    self.origin[np.maximum(coarse_vertices, self.roots) - self.roots],
                    coarse_vertices,
                )
            )
        return _sort_unique(
            np.concatenate([corner_vertices, coarse_vertices, np.arange(a, b, dtype=np.uint32)])
        )

    def count_affordable_splits(self, node: int, max_triangles: int) -> int:
        """Return the maximum number of a node's splits that add at most `max_triangles` triangles."""
        a, b = self.first_split[node : node + 2]
        born = self.born_before[a : b + 1] - self.born_before[a]
        return int(np.searchsorted(born, max(max_triangles, 0), side="right")) - 1

    def mesh(self, nodes: Sequence[int] | Ids, splits: Sequence[int] | Ids) -> Mesh:
        """Assemble the mesh of some nodes, each with a number of splits done.

        No node may be an ancestor of another. Nodes that cover the whole surface fit without cracks, whatever
        their splits.
        """
        mesh, _ = self.mesh_and_nodes(nodes, splits)
        return mesh

    def mesh_and_nodes(
        self, nodes: Sequence[int] | Ids, splits: Sequence[int] | Ids
    ) -> tuple[Mesh, NDArray[np.int32]]:
        """Assemble the mesh as `mesh` does, and return the node of each triangle (m,) as well."""
        chosen, done = np.asarray(nodes, np.int64), np.asarray(splits, np.int64)
        if ((done < 0) | (done > self.splits[chosen])).any():
            raise ValueError("a node has fewer splits than requested")
        first = self.first_split[chosen]
        count = self.coarse[chosen] + self.born_before[first + done] - self.born_before[first]
        front = _kernels.assemble_front(
            self.triangles,
            self.origin,
            roots=self.roots,
            start=np.ascontiguousarray(self.first_triangle[chosen]),
            count=np.ascontiguousarray(count),
            below=np.ascontiguousarray(self.vertices_after[first + done]),
        )
        colors = None if self.colors is None else self.colors[front.vertices]
        mesh = Mesh(self.vertices[front.vertices], front.triangles, colors=colors, up=self.up)
        return mesh, np.repeat(chosen, count).astype(np.int32)

    def to_dict(self) -> dict[str, Any]:
        """Return statistics and bounds by level, coarsest first, for JSON."""
        levels = []
        for level in range(int(self.level.max(initial=-1)), -1, -1):
            nodes = np.flatnonzero(self.level == level)
            if len(nodes):
                levels.append(
                    {
                        "level": level + 1,
                        "nodes": len(nodes),
                        "triangles": int(self.coarse[nodes].sum()),
                        "largest_node_triangles": int(self.coarse[nodes].max()),
                        "shape_bound_m": float(self.shape_bound[nodes].max()),
                        "color_bound_levels": None
                        if self.colors is None
                        else float(self.color_bound[nodes].max()),
                    }
                )
        leaves = np.flatnonzero([len(c) == 0 for c in self.children])
        base = int(self.full[leaves].sum())
        return {
            "input_triangles": self.input_triangles,
            "base_triangles": base,
            "base_shape_bound_m": self.base_shape_bound,
            "one_sided": self.is_one_sided,
            "dropped_islands": self.dropped_islands,
            "dropped_triangles": self.dropped_triangles,
            "nodes": self.nodes,
            "leaves": len(leaves),
            "levels": levels,
            "stored_triangles": len(self.triangles),
            "stored_per_input": len(self.triangles) / max(self.input_triangles, 1),
            "up": self.up,
        }


def _sort_unique(ids: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the sorted unique ids (k,); ten times faster than np.unique, which hashes."""
    ids = np.sort(ids)
    return ids[np.flatnonzero(np.diff(ids, prepend=ids[:1] + 1))]
