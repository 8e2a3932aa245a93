"""Coverage analysis: missing and weakly observed surface of a scan.

Three kinds of defects are reported:

- holes in the surface,
- free space that ends at space no frame observed,
- surface that was measured by few frames, only obliquely, only from far, or inconsistently.

Defects are ranked by area times the weight of their kind. Each defect lists the frames that came nearest to
observing it, with the reasons why they did not. It also suggests a viewpoint for another capture.
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

# Factors of derived parameters; see `CoverageParams`.
_FEW, _SHARE_OF_FRAMES = 3, 5
_FAR = 2.5
_APART, _LEAST_EDGES = 2.5, 0.5
_LEAST_AREA = 1 / 2000
_PLACE_SIZE = 0.75
# Multiple of the median viewing distance: range of the surface that counts as being around a gap.
_REACH = 2.0
# Number of frames listed per defect.
_NEAREST = 5


def coverage(
    mesh: MeshLike | Piecewise,
    frames: Scan | Iterable[Frame],
    params: CoverageParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CoverageKeywords],
) -> Coverage:
    """Find missing and weakly observed surface of a scan.

    Each depth map is read once. Memory holds the mesh (one batch at a time if chunked), a grid of up to 1.5
    million cells, and about 40 kB per frame. The result does not depend on the number of threads or on
    chunking.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world coordinates of the poses; an
        oriented manifold, with or without boundary, as `clean` returns it. Or the chunked mesh that `clean`
        writes.
    frames : frames with depth and poses that the mesh was made from.
    params : see CoverageParams; single fields can be given by name.
    progress : called after each frame.

    Returns
    -------
    Coverage
        Ranked defects with suggested viewpoints, and the evidence per vertex.

    Raises
    ------
    MeshError
        If the mesh is invalid, has no area, or is not an oriented manifold.
    InputError
        If the chunked mesh file is damaged, no frame has both pose and depth, or no frame measured the mesh.
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
    """Wrap a mesh for batch-wise processing.

    A chunked mesh is not checked, because `clean` guarantees an oriented manifold.
    """
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
    # The median over the area of the nearest measuring distance.
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
    """Return the area-weighted quantile of values; `share` is 0 to 1."""
    order = np.argsort(values, kind="stable")
    ends = np.cumsum(areas[order])
    return float(values[order[np.searchsorted(ends, share * ends[-1])]])


def _missing(
    border: Border, ground: Ground, sight: Sight, size: float, reach: float, least: float
) -> tuple[list[Patch], float]:
    """Find missing surface, and the area in m² where the scan ends."""
    holes = patches_of_holes(caps(border, ground.edge, least), ground.space, ground.origin, size)
    frontier = ground.space.frontier()
    space, ends = patches_of_space(frontier, holes, ground.space, sight, ground.origin, size, reach)
    gaps = continued(border, ground.space, ground.origin, reach, size)
    space = before(space, gaps, ground.space.cell, reach)
    return [patch for patch in (*holes, *gaps, *space) if patch.area >= least], ends


def _told(patch: Patch, stand: Standpoint, seen: Seen, origin: Floats) -> Place:
    looks = looks_at(patch.points, patch.normal, seen.frames, origin, _NEAREST)
    return place_of(patch, looks, stand, origin)
