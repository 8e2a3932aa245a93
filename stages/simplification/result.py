"""What `simplify` returns, whatever the method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.simplification.planar.patches import Patches
from stages.simplification.records.record import CollapseRecord
from stages.surface.edges import edges_of
from stages.surface.mesh import Mesh

# What only one of the methods has to tell.
_FIGURES = {
    "quadric": ("fitted",),
    "certified": (
        "shape_bound_m",
        "shape_attained_m",
        "color_bound_levels",
        "color_attained_levels",
        "slack_m",
        "color_slack_levels",
        "proven",
        "unproven_triangles",
        "iterations",
        "max_shape_m",
        "max_texture_levels",
    ),
    "seams": ("fitted", "similar_distance_m", "joined_vertices", "texture_scale_m", "seam_drift"),
    "jia01": (
        "largest_shape_change_m",
        "largest_texture_change_levels",
        "resolution_m",
        "max_shape_m",
        "max_texture_levels",
        "bounded",
        "splits",
    ),
    "planar": (
        "shape_bound_m",
        "color_bound_levels",
        "max_shape_m",
        "max_texture_levels",
        "kept_patches",
        "iterations",
    ),
}

# Where a larger share of the edges stands for the topology, little is left to choose. A street of 1.1 million
# triangles with 5,439 holes: 11 % of them at a tenth of the triangles, 65 % at a twenty-fifth.
_CROWDED = 0.5


@dataclass(frozen=True, eq=False)
class Simplified:
    """A simplified mesh, where its parts came from, and what limited it.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, for each vertex an input vertex that became part of it.
    triangle_source : (q,) int32, for each triangle the input triangle it is what is left of.
    method : "quadric", "certified", "seams", "jia01" or "planar".
    stopped_by : "bounds" when no edge may collapse any more, "triangles" when the wanted number was reached,
        "request" when the caller was content with less, "unproven" when the bounds cannot be proven: they do
        not even hold between the input and itself, as where sheets of different colours touch.
    refused : edges of the result by the rule that refused them last: "length", "shape", "texture" and "color"
        are bounds; "topology" stands for a changed topology, "bridge" for an edge across the interior
        between two boundary vertices, "fold" for a flipped or degenerate triangle, "needle" for one too thin
        for a proof, "seam" for an edge that would cut or join texture seams, "chart" for one that would turn
        a triangle over in the image or take a texture coordinate out of its chart, "drift" for the bound
        max_seam_drift, "locked" for an edge between two vertices that must stay. Edges whose turn had not
        come are not counted.
        For planar these are edges of the input between two patches, by the first of the rules that keeps the
        patches on both sides apart: "fidelity" and "detail" are the angles with the patch and with the
        neighbour, "shape" the distance, "other" colours, a locked vertex, or that another patch was there
        first.
    attribute_scale_m_per_level : what was used; 0 for planar, which has no use for it.
    splits, collapses, attempts : edges split and collapsed; edges whose turn came, some repeatedly.
    triangles_before : triangles of the input.
    fitted : whether vertices and colours were moved to fit the input at the end.
    record : all collapses, if that was asked for.
    shape_bound, color_bound : certified: (q,) float64, metres and levels, proven for each triangle, both
        ways: for its points, and for points of the input whose nearest point is on it. `color_bound` is None
        for a mesh without colours. They may be as large as `max_shape` and `max_texture` though less is true,
        unless `close_bounds` is set.
        planar: how far each triangle's patch is off at most, both ways: every point of the patch, in the
        input and in the result, has a counterpart in the other within `shape_bound`, and the colours of the
        two differ by `color_bound` at most. That need not be the nearest point; 0 where nothing changed.
    shape_bound_m, color_bound_levels : certified, planar: the greatest of all, input and result.
    shape_attained_m, color_attained_levels : certified: the greatest found at a point; the true maximum is
        between that and the bound.
    slack_m, color_slack_levels : certified: contained in the bounds, for searches in single precision. Twice
        `slack_m` takes the place of a smaller bound on shape, and half a level that of one on colour.
    proven : certified: whether max_shape and max_texture are proven. The bounds above hold anyway.
    unproven_triangles : certified: triangles of the result and of the input that are not proven to stay
        within max_shape and max_texture.
    iterations : certified: how often it went on simplifying and then looked at the bounds. planar: how often
        patches were triangulated, as vertices were put back.
    largest_shape_change_m, largest_texture_change_levels : jia01: largest sums on any edge at any time.
    resolution_m : jia01: what was used.
    max_shape_m, max_texture_levels : jia01, certified and planar: what was used; None for no bound.
    similar_distance_m : seams: vertices closer than this were taken for one.
    joined_vertices : seams: how many vertices of the input were copies of others.
    texture_scale_m : seams: metres that a shift by the image's side counted as.
    seam_drift : seams: proven: no point of a seam is farther, in the image, from where it was; as a share of
        the image's side.
    bounded : jia01: whether resolution, max_shape and max_texture were bounds, or only ordered the collapses.
    patches : planar: those of the input.
    triangle_patch : planar: (q,) int32, the patch of each triangle of the result.
    kept_patches : planar: patches that have all their triangles still.
    """

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    method: str
    stopped_by: str
    refused: dict[str, int]
    attribute_scale_m_per_level: float
    splits: int
    collapses: int
    attempts: int
    triangles_before: int
    fitted: bool = False
    record: CollapseRecord | None = None
    shape_bound: NDArray[np.float64] | None = None
    color_bound: NDArray[np.float64] | None = None
    shape_bound_m: float | None = None
    color_bound_levels: float | None = None
    shape_attained_m: float | None = None
    color_attained_levels: float | None = None
    slack_m: float | None = None
    color_slack_levels: float | None = None
    proven: bool | None = None
    unproven_triangles: tuple[int, int] | None = None
    iterations: int | None = None
    largest_shape_change_m: float | None = None
    largest_texture_change_levels: float | None = None
    resolution_m: float | None = None
    max_shape_m: float | None = None
    max_texture_levels: float | None = None
    bounded: dict[str, bool] = field(default_factory=dict)
    similar_distance_m: float | None = None
    joined_vertices: int | None = None
    texture_scale_m: float | None = None
    seam_drift: float | None = None
    patches: Patches | None = None
    triangle_patch: NDArray[np.int32] | None = None
    kept_patches: int | None = None

    def follow(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return an array (n, …) over the input's vertices for the result's: (p, …)."""
        return values[self.vertex_source]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know of the result, in plain sentences."""
        return (*self._of_topology(), *self._of_ties())

    def _of_topology(self) -> tuple[str, ...]:
        kept = self.refused.get("topology", 0) + self.refused.get("bridge", 0)
        by_bounds = self.method not in ("quadric", "seams") and self.stopped_by != "triangles"
        share = self._share_of_edges(kept)
        if by_bounds or share <= _CROWDED:
            return ()
        return (
            f"{share:.0%} of the edges that are left stand for holes, handles and loose pieces, which "
            "all stay, so that the rest lost more than it had to; fill or remove small ones first "
            "(fill_holes and min_island_area of clean), or keep more triangles.",
        )

    def _of_ties(self) -> tuple[str, ...]:
        if self.method != "seams" or self.stopped_by != "bounds":
            return ()
        share = self._share_of_edges(self.refused.get("locked", 0))
        if share <= _CROWDED:
            return ()
        return (
            f"{min(share, 1):.0%} of the edges that are left lie where sheets touch that cannot be joined, "
            "as doubled faces do and parts that stand on each other, or are locked; they all stay. Run clean "
            "first: it takes doubled faces away and lets the others move.",
        )

    def _share_of_edges(self, count: int) -> float:
        """Return what share of the edges are so many; 0 where it is clear that this is less than half."""
        # There are at least half as many edges as sides of triangles.
        if count <= _CROWDED * 1.5 * len(self.mesh.triangles):
            return 0.0
        return count / len(edges_of(self.mesh.triangles, len(self.mesh.vertices)).ends)

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON; what the method has no figure for is left out."""
        triangles = len(self.mesh.triangles)
        figures: dict[str, Any] = {
            "method": self.method,
            "triangles_before": self.triangles_before,
            "triangles": triangles,
            "vertices": len(self.mesh.vertices),
            "reduction": 1 - triangles / self.triangles_before if self.triangles_before else 0.0,
            "stopped_by": self.stopped_by,
            "refused_edges": dict(self.refused),
            "attribute_scale_m_per_level": self.attribute_scale_m_per_level,
            "collapses": self.collapses,
            "attempts": self.attempts,
            "warnings": list(self.warnings),
        }
        figures |= {name: _plain(getattr(self, name)) for name in _FIGURES[self.method]}
        return figures if self.patches is None else figures | self.patches.figures()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value
