"""Clean a mesh: what comes out is an oriented manifold without islands, with its colours.

In order: borders that lie on each other are stitched, triangles without area and duplicates removed,
neighbours oriented alike, non-manifold edges and vertices taken apart, small islands dropped, small holes
filled on request, unused vertices dropped; then, on request, what is irregular is repaired. A mesh that is
clean comes back as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.check import CheckParams
from scanloom.stages.cleaning.codes import CLEAN_NOTHING_LEFT
from scanloom.stages.cleaning.degenerate import without_degenerate
from scanloom.stages.cleaning.manifold import make_manifold
from scanloom.stages.cleaning.repair import Repaired, repair
from scanloom.stages.cleaning.stitch import stitch, weld
from scanloom.stages.diagnostics.codes import MACHINE_BUG, USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import MeshError, StageError, UsageError
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_fields, by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.edges import Ids, components, edges_of
from scanloom.stages.surface.holes import fill_holes
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import areas, is_duplicate, require_manifold, require_measurable
from scanloom.stages.surface.traced import Traced

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CleanKeywords

RESULT_VERSION = 1

# An island smaller than this share of the largest piece is noise by default. In 7-Scenes redkitchen at 2 cm
# that is 198 of 205 pieces, which hold 0.7 % of the triangles.
_ISLAND_SHARE = 1e-3
# Each round stitches what the one before made possible; more than two are for soups only.
_ROUNDS = 4
_STEPS = 4


@dataclass(frozen=True, kw_only=True)
class CleanParams:
    """What is removed and what is repaired."""

    min_island_area: float | None = param(
        None,
        "Loose pieces with less surface are removed; by default a thousandth of the largest piece's. "
        "0 keeps all.",
        unit="m²",
        low=0,
        common=True,
    )
    keep_largest: bool = param(False, "Keep only the piece with the largest surface.", common=True)
    fill_holes: float = param(
        0.0,
        "Holes with a rim no longer than this are filled; 0 fills none.",
        unit="m",
        low=0,
        common=True,
    )
    stitch: bool = param(
        True, "Join borders that lie exactly on each other, such as seams of textured files."
    )
    weld_distance: float = param(
        0.0, "Vertices no farther apart than this become one before all else; 0 = off.", unit="m", low=0
    )
    repair: bool = param(
        False,
        "Repair caps, needles, folds and spikes, each where nothing else becomes irregular, no seam is torn "
        "and the surface provably stays within max_shape; what is left is told.",
        common=True,
    )
    repair_angle: float = param(
        CheckParams().corner_angle,
        "A triangle with a smaller angle is a needle; one with an angle above 180° less this is a cap.",
        unit="degrees",
        low=0,
        high=30,
    )
    max_shape: float | None = param(
        None,
        "How far repairs may move the surface; by default a twentieth of the median edge.",
        unit="m",
        low=0,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.max_shape is not None and not self.repair:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "is for repairs",
                Where(parameter="max_shape"),
                remedy="give repair, too.",
            )


@dataclass(frozen=True)
class Removed:
    """What cleaning changed.

    Attributes
    ----------
    degenerate_triangles, duplicate_triangles : removed.
    nonmanifold_triangles : removed because two sheets stayed joined at both ends of an edge.
    islands, island_triangles : loose pieces removed, and their triangles.
    unused_vertices : removed, those of removed triangles included.
    stitched_edges : pairs of border edges made one.
    flipped_triangles : turned over to agree with their neighbours.
    split_vertices : vertices added to take sheets apart.
    filled_holes, fill_triangles : holes closed, and the triangles added for it.
    """

    degenerate_triangles: int
    duplicate_triangles: int
    nonmanifold_triangles: int
    islands: int
    island_triangles: int
    unused_vertices: int
    stitched_edges: int
    flipped_triangles: int
    split_vertices: int
    filled_holes: int
    fill_triangles: int

    __repr__ = by_fields


@dataclass(frozen=True, eq=False)
class Cleaned:
    """A clean mesh and where it came from.

    Attributes
    ----------
    mesh : an oriented manifold, border allowed.
    vertex_source : (n,) the vertex of the input each vertex was.
    triangle_source : (m,) the triangle of the input each one was, or lies on; -1 where a hole was filled.
    changes : the counts of what was changed.
    min_island_area : m², as used.
    repaired : what repairs did to the mesh that was clean, by whose vertices and triangles places are told;
        None if they were not asked for.
    """

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids
    changes: Removed
    min_island_area: float
    repaired: Repaired | None = None

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return sizes and what was changed, for reports."""
        figures = {
            "vertices": len(self.mesh.vertices),
            "triangles": len(self.mesh.triangles),
            "min_island_area_m2": self.min_island_area,
            **asdict(self.changes),
        }
        return figures if self.repaired is None else figures | {"repair": self.repaired.figures()}


def clean(
    mesh: MeshLike,
    params: CleanParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CleanKeywords],
) -> Cleaned:
    """Make a mesh an oriented manifold without islands, degenerate or duplicate triangles.

    Surface is taken apart rather than removed: a fin on a wall becomes a sheet of its own that touches the
    wall, a Möbius strip is cut along a seam. Colours, normals and texture stay with their vertices and
    corners. The same input gives the same bytes.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays.
    params : see CleanParams; single ones can be given by name.

    Raises
    ------
    MeshError
        If the mesh is not valid, or nothing of it is left.
    StageError
        If the result is not an oriented manifold, which would be a defect of this program.
    """
    params = resolve(CleanParams, params, changes)
    mesh = as_mesh(mesh)
    require_measurable(mesh, "mesh")
    counts = {field.name: 0 for field in fields(Removed)}
    steps = _STEPS + params.repair
    progress(0, steps)
    traced = Traced.start(mesh)
    if params.weld_distance > 0:
        traced = weld(traced, params.weld_distance)
    traced = _repaired(traced, params.stitch, counts)
    progress(1, steps)
    traced, min_area = _without_islands(traced, params, counts)
    progress(2, steps)
    if params.fill_holes > 0:
        before = len(traced.mesh.triangles)
        traced, counts["filled_holes"] = fill_holes(traced, params.fill_holes)
        counts["fill_triangles"] = len(traced.mesh.triangles) - before
    traced = traced.compact()
    counts["unused_vertices"] = len(mesh.vertices) + counts["split_vertices"] - len(traced.mesh.vertices)
    progress(3, steps)
    if len(traced.mesh.triangles) == 0:
        raise MeshError(CLEAN_NOTHING_LEFT, "has no triangle with an area; nothing is left of it.", "mesh")
    try:
        require_manifold(traced.mesh)
    except MeshError as error:
        raise StageError(MACHINE_BUG, "cleaning failed, its result {error}", error=error) from error
    progress(_STEPS, steps)
    cleaned = Cleaned(traced.mesh, traced.vertex_source, traced.triangle_source, Removed(**counts), min_area)
    if params.repair:
        cleaned = _with_repairs(cleaned, params, lambda: progress(_STEPS, steps))
        progress(steps, steps)
    return cleaned


def _with_repairs(cleaned: Cleaned, params: CleanParams, alive: Callable[[], object]) -> Cleaned:
    """Return it with what can be repaired, whose result is as much a manifold; ask now and then to go on."""
    repaired = repair(
        cleaned.mesh,
        corner_angle=params.repair_angle,
        max_shape=params.max_shape,
        progress=lambda done, total: alive(),  # noqa: ARG005
    )
    return replace(
        cleaned,
        mesh=repaired.mesh,
        vertex_source=cleaned.vertex_source[repaired.vertex_source],
        triangle_source=cleaned.triangle_source[repaired.triangle_source],
        repaired=repaired,
    )


def _repaired(traced: Traced, join: bool, counts: dict[str, int]) -> Traced:
    """Return an oriented manifold without flat and duplicate triangles; add to the counts."""
    for _ in range(_ROUNDS):
        if join:
            traced, stitched = stitch(traced)
            counts["stitched_edges"] += stitched
        before = len(traced.mesh.triangles)
        traced = without_degenerate(traced)
        again = is_duplicate(edges_of(traced.mesh.triangles, len(traced.mesh.vertices)))
        counts["degenerate_triangles"] += before - len(again)
        counts["duplicate_triangles"] += int(np.count_nonzero(again))
        manifold = make_manifold(traced.keep(~again))
        counts["nonmanifold_triangles"] += manifold.removed
        counts["flipped_triangles"] += manifold.flipped
        counts["split_vertices"] += manifold.split_vertices
        traced = manifold.traced
        # Borders may come to face each other where triangles were turned or removed.
        if not join or stitch(traced)[1] == 0:
            break
    return traced


def _without_islands(traced: Traced, params: CleanParams, counts: dict[str, int]) -> tuple[Traced, float]:
    """Return what is left and the area a piece had to have; add to the counts."""
    triangles = traced.mesh.triangles
    tails, heads = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
    _, labels = components(len(traced.mesh.vertices), tails, heads)
    piece = labels[triangles[:, 0]]
    area = np.bincount(piece, areas(traced.mesh.vertices, triangles)).astype(np.float64)
    kept, min_area = is_large(area, params)
    counts["islands"] = int(np.count_nonzero(~kept & (np.bincount(piece) > 0)))
    counts["island_triangles"] = int(np.count_nonzero(~kept[piece]))
    return traced.keep(kept[piece]), min_area


def is_large(area: NDArray[np.float64], params: CleanParams) -> tuple[NDArray[np.bool_], float]:
    """Return which pieces (k,) stay, by their areas in m², and the area they had to have."""
    min_area = params.min_island_area
    if min_area is None:
        min_area = _ISLAND_SHARE * float(area.max(initial=0.0))
    kept = area >= min_area
    if params.keep_largest and len(area):
        kept[:] = False
        kept[area.argmax()] = True
    return kept, min_area
