"""Clean a mesh: what comes out is an oriented manifold without islands, with its colours.

In order: borders that lie on each other are stitched, triangles without area and duplicates removed,
neighbours oriented alike, non-manifold edges and vertices taken apart, small islands dropped, small holes
filled on request, unused vertices dropped. A mesh that is clean comes back as it is.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stages.convert import MeshLike, as_mesh
from stages.degenerate import without_degenerate
from stages.edges import Ids, components, edges_of
from stages.errors import MeshError, StageError
from stages.holes import fill_holes
from stages.manifold import make_manifold
from stages.mesh import Mesh
from stages.params import check, param, resolve
from stages.progress import Progress, silent
from stages.stitch import stitch, weld
from stages.topology import is_duplicate, require_manifold
from stages.traced import Traced

VERSION = 1

# An island smaller than this share of the largest piece is noise by default. In 7-Scenes redkitchen at 2 cm
# that is 198 of 205 pieces, which hold 0.7 % of the triangles.
_ISLAND_SHARE = 1e-3
_STEPS = 6


@dataclass(frozen=True, kw_only=True)
class CleanParams:
    """What is removed and what is repaired."""

    min_island_area: float | None = param(
        None,
        "Loose pieces with less surface are removed; by default a thousandth of the largest piece's. "
        "0 keeps all.",
        unit="m²",
        low=0,
    )
    keep_largest: bool = param(False, "Keep only the piece with the largest surface.")
    fill_holes: float = param(
        0.0, "Holes with a rim no longer than this are filled; 0 fills none.", unit="m", low=0
    )
    stitch: bool = param(
        True, "Join borders that lie exactly on each other, such as seams of textured files."
    )
    weld_distance: float = param(
        0.0, "Vertices no farther apart than this become one before all else; 0 = off.", unit="m", low=0
    )

    def __post_init__(self) -> None:
        check(self)


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
    """

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids
    changes: Removed
    min_island_area: float

    def figures(self) -> dict[str, Any]:
        """Return sizes and what was changed, for reports."""
        return {
            "vertices": len(self.mesh.vertices),
            "triangles": len(self.mesh.triangles),
            "min_island_area_m2": self.min_island_area,
            **asdict(self.changes),
        }


def clean(
    mesh: MeshLike, params: CleanParams | None = None, *, progress: Progress = silent, **changes: Any
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
    traced = Traced.start(mesh)
    progress(0, _STEPS)
    if params.weld_distance > 0:
        traced = weld(traced, params.weld_distance)
    stitched = 0
    if params.stitch:
        traced, stitched = stitch(traced)
    progress(1, _STEPS)

    before = len(traced.mesh.triangles)
    traced = without_degenerate(traced)
    degenerate = before - len(traced.mesh.triangles)
    traced, duplicate = _without_duplicates(traced)
    progress(2, _STEPS)
    manifold = make_manifold(traced)
    progress(3, _STEPS)
    traced, islands, island_triangles, min_area = _without_islands(manifold.traced, params)
    progress(4, _STEPS)
    filled = fill_triangles = 0
    if params.fill_holes > 0:
        before = len(traced.mesh.triangles)
        traced, filled = fill_holes(traced, params.fill_holes)
        fill_triangles = len(traced.mesh.triangles) - before
    traced = traced.compact()
    progress(5, _STEPS)
    if len(traced.mesh.triangles) == 0:
        raise MeshError("has no triangle with an area; nothing is left of it.", "mesh")
    try:
        require_manifold(traced.mesh)
    except MeshError as error:
        raise StageError(f"cleaning failed, its result {error}") from error
    progress(_STEPS, _STEPS)
    removed = Removed(
        degenerate_triangles=degenerate,
        duplicate_triangles=duplicate,
        nonmanifold_triangles=manifold.removed,
        islands=islands,
        island_triangles=island_triangles,
        unused_vertices=len(mesh.vertices) + manifold.split_vertices - len(traced.mesh.vertices),
        stitched_edges=stitched,
        flipped_triangles=manifold.flipped,
        split_vertices=manifold.split_vertices,
        filled_holes=filled,
        fill_triangles=fill_triangles,
    )
    return Cleaned(traced.mesh, traced.vertex_source, traced.triangle_source, removed, min_area)


def _without_duplicates(traced: Traced) -> tuple[Traced, int]:
    again = is_duplicate(edges_of(traced.mesh.triangles, len(traced.mesh.vertices)))
    return traced.keep(~again), int(np.count_nonzero(again))


def _without_islands(traced: Traced, params: CleanParams) -> tuple[Traced, int, int, float]:
    """Return what is left, the pieces and triangles removed, and the smallest area that was kept for sure."""
    triangles = traced.mesh.triangles
    tails, heads = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
    _, labels = components(len(traced.mesh.vertices), tails, heads)
    piece = labels[triangles[:, 0]]
    a, b, c = traced.mesh.vertices[triangles].transpose(1, 0, 2)
    area = np.bincount(piece, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    min_area = params.min_island_area
    if min_area is None:
        min_area = _ISLAND_SHARE * float(area.max(initial=0.0))
    kept = area >= min_area
    if params.keep_largest and len(area):
        kept[:] = False
        kept[area.argmax()] = True
    keep = kept[piece]
    gone = np.count_nonzero(~kept & (np.bincount(piece) > 0))
    return traced.keep(keep), int(gone), int(np.count_nonzero(~keep)), min_area
