"""What is missing in a scan: where to go again.

Something is missing where the surface has a hole, where space that frames looked through ends at space that
none did, and where the surface is there but was measured by few frames, only obliquely, or only from far.
Places are told by how much they matter: their area, times how much their kind counts. For each it is told
which frames came nearest to seeing it, what kept them from it, and from where one should look.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from stages.inspecting.coverage.continued import continued
from stages.inspecting.coverage.covered import Coverage
from stages.inspecting.coverage.evidence import with_rims
from stages.inspecting.coverage.kinds import KINDS, MISSING, THIN
from stages.inspecting.coverage.missing import before, patches_of_holes, patches_of_space
from stages.inspecting.coverage.nearest import looks_at
from stages.inspecting.coverage.painted import painted
from stages.inspecting.coverage.params import CoverageKeywords, CoverageParams
from stages.inspecting.coverage.patches import Patch
from stages.inspecting.coverage.place import Place, place_of
from stages.inspecting.coverage.rims import caps
from stages.inspecting.coverage.seen import Ground, Seen, look
from stages.inspecting.coverage.standpoints import Standing
from stages.inspecting.coverage.thin import Limits, kinds_at, patches_of_thin
from stages.params import resolve
from stages.progress import Progress, silent
from stages.scans.scan import Frame, Scan
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface
from stages.surface.topology import require_area, require_manifold

if TYPE_CHECKING:
    from typing_extensions import Unpack

RESULT_VERSION = 1

# Derived parameters; see CoverageParams.
_FEW, _SHARE_OF_FRAMES = 3, 5
_FAR = 2.5
_LEAST_AREA = 1 / 2000
_PLACE_SIZE = 0.75
# Of the same distance: what is around a gap is as near.
_REACH = 2.0
# Frames that are told of each place.
_NEAREST = 5


def coverage(
    mesh: MeshLike,
    frames: Scan | Iterable[Frame],
    params: CoverageParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CoverageKeywords],
) -> Coverage:
    """Tell what is missing in a scan, and from where one should look at it.

    Each frame's depth map is read once. Beside the mesh, and a grid of a million and a half cells at most,
    memory grows by some 40 kB a frame. Equal input gives an equal result, on any number of threads.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world of the poses; an oriented manifold,
        border allowed, as `clean` leaves it.
    frames : with depth and poses, those that the mesh was made of.
    params : see CoverageParams; single ones can be given by name.
    progress : called after each frame.

    Raises
    ------
    MeshError
        If the mesh is not valid, has no area, or is no oriented manifold.
    InputError
        If no frame has a pose and depth, or none has measured the mesh.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(CoverageParams, params, changes)
    given = as_mesh(mesh)
    require_area(given, "mesh")
    require_manifold(given)
    where = frames.folder if isinstance(frames, Scan) else None
    shown = list(frames.frames if isinstance(frames, Scan) else frames)
    ground = Ground.of(given, params.spacing)
    seen = look(ground, shown, where, progress)
    evidence = with_rims(seen.evidence.at(ground.probes.of_vertex), given.triangles)
    known = (evidence.frames > 0) & (ground.around > 0)
    # From how far the median place was measured best.
    usual = float(np.median(evidence.distance[known]))
    limits = _limits(len(seen.frames), usual, params)
    kinds = kinds_at(evidence, limits)
    least = _LEAST_AREA * float(ground.around.sum()) if params.least_area is None else params.least_area
    size = params.place_size or _PLACE_SIZE * usual
    surface = Surface(given)
    missing, ends = _missing(given, ground, surface, size, _REACH * usual, least)
    thin = patches_of_thin(
        ground.vertices, ground.normals, given.triangles, ground.around, kinds, size, least
    )
    ranked = sorted((*missing, *thin), key=lambda patch: -KINDS[patch.kind].weight * patch.area)
    standing = Standing(
        ground.space, surface, np.array([frame.place for frame in seen.frames]), usual, ground.origin
    )
    told = [_told(patch, seen, standing) for patch in ranked[: params.places]]
    shapes = [
        (place.kind, patch.corners + ground.origin)
        for patch, place in zip(ranked, told, strict=False)
        if len(patch.corners)
    ]
    return Coverage(
        places=tuple(told),
        left_out=len(ranked) - len(told),
        evidence=evidence,
        kinds=kinds,
        painted=painted(given, ground.normals, kinds, shapes),
        limits=limits,
        least_area=least,
        place_size=size,
        spacing=ground.space.cell,
        frames=len(seen.frames),
        skipped=tuple(seen.skipped),
        surface_area=float(ground.around.sum()),
        thin_areas={kind: float(ground.around[kinds == number].sum()) for number, kind in enumerate(THIN)},
        missing_areas={
            kind: float(sum(patch.area for patch in missing if patch.kind == kind)) for kind in MISSING
        },
        ends_area=ends,
    )


def _limits(frames: int, usual: float, params: CoverageParams) -> Limits:
    few = params.few_frames or min(_FEW, max(frames // _SHARE_OF_FRAMES, 1))
    return Limits(few, float(np.cos(np.radians(params.oblique))), params.far or _FAR * usual)


def _missing(
    mesh: Mesh, ground: Ground, surface: Surface, size: float, reach: float, least: float
) -> tuple[list[Patch], float]:
    """Return what is not there at all, and how much of the scan just ends, m²."""
    holes = patches_of_holes(caps(mesh, ground.edge, least), ground.space, ground.origin, size)
    frontier = ground.space.frontier()
    space, ends = patches_of_space(frontier, holes, ground.space, surface, ground.origin, size, reach)
    gaps = continued(mesh, ground.normals, ground.space, ground.origin, reach, size)
    space = before(space, gaps, ground.space.cell, reach)
    return [patch for patch in (*holes, *gaps, *space) if patch.area >= least], ends


def _told(patch: Patch, seen: Seen, standing: Standing) -> Place:
    looks = looks_at(patch.points, patch.normal, seen.frames, standing.origin, _NEAREST)
    return place_of(patch, looks, standing.best(patch), standing.origin)
