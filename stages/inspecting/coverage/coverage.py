"""What is missing in a scan: where to go again.

Something is missing where the surface has a hole, where space that frames looked through ends at space that
none did, and where the surface is there but was measured by few frames, only obliquely, only from far, or by
frames that disagree. Places are told by how much they matter: their area, times how much their kind counts.
For each it is told which frames came nearest to seeing it, what kept them from it, and from where one should
look.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.inspecting.coverage.borders import Border, border_of
from scanloom.stages.inspecting.coverage.continued import continued
from scanloom.stages.inspecting.coverage.covered import Coverage, Covered
from scanloom.stages.inspecting.coverage.kinds import KINDS, MISSING, THIN
from scanloom.stages.inspecting.coverage.missing import before, patches_of_holes, patches_of_space
from scanloom.stages.inspecting.coverage.nearest import looks_at
from scanloom.stages.inspecting.coverage.params import CoverageParams
from scanloom.stages.inspecting.coverage.patches import Patch
from scanloom.stages.inspecting.coverage.place import Place, place_of
from scanloom.stages.inspecting.coverage.probes import laid_out, with_rims
from scanloom.stages.inspecting.coverage.rims import caps
from scanloom.stages.inspecting.coverage.seen import Ground, Seen, look
from scanloom.stages.inspecting.coverage.sight import Sight
from scanloom.stages.inspecting.coverage.standpoints import Standing, Standpoint
from scanloom.stages.inspecting.coverage.thin import Limits, kinds_at, patches_of_thin
from scanloom.stages.inspecting.coverage.views import Floats, Singles
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.piecewise import OnePiece, Piecewise, piecewise
from scanloom.stages.surface.topology import require_area, require_manifold

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CoverageKeywords

RESULT_VERSION = 3

# Derived parameters; see CoverageParams.
_FEW, _SHARE_OF_FRAMES = 3, 5
_FAR = 2.5
_APART, _LEAST_EDGES = 2.5, 0.5
_LEAST_AREA = 1 / 2000
_PLACE_SIZE = 0.75
# Of the same distance: what is around a gap is as near.
_REACH = 2.0
# Frames that are told of each place.
_NEAREST = 5


def coverage(
    mesh: MeshLike | Piecewise,
    frames: Scan | Iterable[Frame],
    params: CoverageParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CoverageKeywords],
) -> Coverage:
    """Tell what is missing in a scan, and from where one should look at it.

    Each frame's depth map is read once. Beside the mesh, of one in pieces a piece at a time, and a grid of a
    million and a half cells at most, memory grows by some 40 kB a frame. Equal input gives an equal result,
    on any number of threads, in pieces or not.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world of the poses; an oriented manifold,
        border allowed, as `clean` leaves it; or one in pieces, as that leaves it.
    frames : with depth and poses, those that the mesh was made of.
    params : see CoverageParams; single ones can be given by name.
    progress : called after each frame.

    Raises
    ------
    MeshError
        If the mesh is not valid, has no area, or is no oriented manifold.
    InputError
        If the file of pieces is damaged, no frame has a pose and depth, or none has measured the mesh.
    UsageError
        If a parameter is out of range.
    """
    where = frames.folder if isinstance(frames, Scan) else None
    shown = list(frames.frames if isinstance(frames, Scan) else frames)
    params = resolve(CoverageParams, params, changes)
    with collecting() as diagnostics:
        found = _covered(_surface_of(mesh), shown, where, params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _surface_of(mesh: MeshLike | Piecewise) -> OnePiece | Piecewise:
    """Return a mesh as one of pieces; what cleaning left in pieces is known to be an oriented manifold."""
    if isinstance(mesh, Piecewise):
        return mesh
    given = as_mesh(mesh)
    require_area(given, "mesh")
    require_manifold(given)
    found = piecewise(given)
    return found if isinstance(found, Piecewise) else OnePiece(found)


def _covered(
    surface: OnePiece | Piecewise,
    frames: Sequence[Frame],
    where: Path | None,
    params: CoverageParams,
    progress: Progress,
) -> Coverage:
    ground = Ground.of(surface, params.spacing)
    seen = look(ground, frames, where, progress)
    probes = with_rims(ground.probes, surface, seen.evidence.frames)
    laid = laid_out(probes, surface)
    (known,) = np.nonzero(seen.evidence.frames[:-1])
    measured, around = seen.evidence.at(known), laid.areas[known]
    # From how far the median place was measured best.
    usual = _up_to(0.5, measured.distance, around)
    spread = _up_to(0.5, measured.spread, around)
    apart = params.spread or max(_APART * spread, _LEAST_EDGES * ground.edge)
    limits = _limits(len(seen.frames), usual, apart, params)
    kinds = kinds_at(seen.evidence, limits)
    least = _LEAST_AREA * surface.area if params.least_area is None else params.least_area
    size = params.place_size or _PLACE_SIZE * usual
    sight = Sight(surface)
    missing, ends = _missing(border_of(surface), ground, sight, size, _REACH * usual, least)
    thin = patches_of_thin(probes, laid, kinds[:-1], size, least)
    ranked = sorted((*missing, *thin), key=lambda patch: -KINDS[patch.kind].weight * patch.area)
    standing = Standing(
        ground.space, sight, np.array([frame.place for frame in seen.frames]), usual, ground.origin
    )
    chosen = ranked[: params.places]
    places = tuple(
        _told(patch, stand, seen, ground.origin)
        for patch, stand in zip(chosen, standing.best(chosen), strict=True)
    )
    caps = tuple((patch.kind, patch.corners + ground.origin) for patch in chosen if len(patch.corners))
    return Coverage(
        places=places,
        left_out=len(ranked) - len(places),
        covered=Covered(surface, probes, seen.evidence, kinds, caps),
        limits=limits,
        least_area=least,
        place_size=size,
        spacing=ground.space.cell,
        frames=len(seen.frames),
        skipped=tuple(seen.skipped),
        surface_area=surface.area,
        spread_median=spread,
        spread_95=_up_to(0.95, measured.spread, around),
        thin_areas={kind: float(laid.areas[kinds[:-1] == number].sum()) for number, kind in enumerate(THIN)},
        missing_areas={
            kind: float(sum(patch.area for patch in missing if patch.kind == kind)) for kind in MISSING
        },
        ends_area=ends,
    )


def _limits(frames: int, usual: float, apart: float, params: CoverageParams) -> Limits:
    few = params.few_frames or min(_FEW, max(frames // _SHARE_OF_FRAMES, 1))
    return Limits(few, float(np.cos(np.radians(params.oblique))), params.far or _FAR * usual, apart)


def _up_to(share: float, values: Singles, areas: Floats) -> float:
    """Return the value that so much of an area has at most."""
    order = np.argsort(values, kind="stable")
    ends = np.cumsum(areas[order])
    return float(values[order[np.searchsorted(ends, share * ends[-1])]])


def _missing(
    border: Border, ground: Ground, sight: Sight, size: float, reach: float, least: float
) -> tuple[list[Patch], float]:
    """Return what is not there at all, and how much of the scan just ends, m²."""
    holes = patches_of_holes(caps(border, ground.edge, least), ground.space, ground.origin, size)
    frontier = ground.space.frontier()
    space, ends = patches_of_space(frontier, holes, ground.space, sight, ground.origin, size, reach)
    gaps = continued(border, ground.space, ground.origin, reach, size)
    space = before(space, gaps, ground.space.cell, reach)
    return [patch for patch in (*holes, *gaps, *space) if patch.area >= least], ends


def _told(patch: Patch, stand: Standpoint, seen: Seen, origin: Floats) -> Place:
    looks = looks_at(patch.points, patch.normal, seen.frames, origin, _NEAREST)
    return place_of(patch, looks, stand, origin)
