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
from scanloom.stages.inspecting.coverage.boundary import SurfaceBoundary, find_boundary
from scanloom.stages.inspecting.coverage.capture_viewpoints import CaptureViewpoint, ViewpointPlanner
from scanloom.stages.inspecting.coverage.continuation import find_continuation_gaps
from scanloom.stages.inspecting.coverage.coverage_result import Coverage, SurfaceCoverage
from scanloom.stages.inspecting.coverage.defect import CoverageDefect, build_defect
from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS, MISSING_KINDS, WEAK_KINDS
from scanloom.stages.inspecting.coverage.defect_patches import DefectPatch
from scanloom.stages.inspecting.coverage.depth_view import Floats, Singles
from scanloom.stages.inspecting.coverage.frame_ranking import rank_frames
from scanloom.stages.inspecting.coverage.hole_caps import build_caps
from scanloom.stages.inspecting.coverage.missing_surface import (
    drop_patches_before_gaps,
    find_frontier_patches,
    find_hole_patches,
)
from scanloom.stages.inspecting.coverage.observation import Observations, PreparedSurface, observe_frames
from scanloom.stages.inspecting.coverage.occlusion_test import OcclusionTest
from scanloom.stages.inspecting.coverage.params import CoverageParams
from scanloom.stages.inspecting.coverage.probes import compute_layout, reassign_rims
from scanloom.stages.inspecting.coverage.weak_surface import (
    EvidenceLimits,
    classify_evidence,
    find_weak_patches,
)
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh, wrap_large_mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.topology import require_area, require_manifold

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CoverageKeywords

RESULT_VERSION = 3

# Factors of derived parameters; see `CoverageParams`.
_MIN_FRAMES, _FRAMES_DIVISOR = 3, 5
_FAR_FACTOR = 2.5
_SPREAD_FACTOR, _MIN_SPREAD_EDGES = 2.5, 0.5
_MIN_AREA_RATIO = 1 / 2000
_PATCH_SIZE_FACTOR = 0.75
# Multiple of the median viewing distance: range of the surface that counts as being around a gap.
_REACH_FACTOR = 2.0
# Number of frames listed per defect.
_NEAREST_FRAME_COUNT = 5


def coverage(
    mesh: MeshLike | ChunkedMesh,
    frames: Scan | Iterable[Frame],
    params: CoverageParams | None = None,
    *,
    progress: Progress = ignore_progress,
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
    folder = frames.folder if isinstance(frames, Scan) else None
    frame_list = list(frames.frames if isinstance(frames, Scan) else frames)
    params = resolve(CoverageParams, params, changes)
    with collecting() as diagnostics:
        found = _analyse_coverage(_wrap_surface(mesh), frame_list, folder, params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _wrap_surface(mesh: MeshLike | ChunkedMesh) -> SingleChunkMesh | ChunkedMesh:
    """Wrap a mesh for batch-wise processing.

    A chunked mesh is not checked, because `clean` guarantees an oriented manifold.
    """
    if isinstance(mesh, ChunkedMesh):
        return mesh
    given = as_mesh(mesh)
    require_area(given, "mesh")
    require_manifold(given)
    found = wrap_large_mesh(given)
    return found if isinstance(found, ChunkedMesh) else SingleChunkMesh(found)


def _analyse_coverage(
    surface: SingleChunkMesh | ChunkedMesh,
    frames: Sequence[Frame],
    folder: Path | None,
    params: CoverageParams,
    progress: Progress,
) -> Coverage:
    prepared_surface = PreparedSurface.from_surface(surface, params.spacing)
    observations = observe_frames(prepared_surface, frames, folder, progress)
    probes = reassign_rims(prepared_surface.probes, surface, observations.evidence.frame_counts)
    layout = compute_layout(probes, surface)
    (known,) = np.nonzero(observations.evidence.frame_counts[:-1])
    measured, around = observations.evidence.select(known), layout.areas[known]
    # The median over the area of the nearest measuring distance.
    median_distance = _compute_area_quantile(0.5, measured.min_distance, around)
    spread = _compute_area_quantile(0.5, measured.rms_height, around)
    max_spread = params.spread or max(
        _SPREAD_FACTOR * spread, _MIN_SPREAD_EDGES * prepared_surface.median_edge
    )
    limits = _derive_limits(len(observations.frame_summaries), median_distance, max_spread, params)
    kinds = classify_evidence(observations.evidence, limits)
    min_area = _MIN_AREA_RATIO * surface.area if params.min_area is None else params.min_area
    max_patch_size = params.max_patch_size or _PATCH_SIZE_FACTOR * median_distance
    sight = OcclusionTest(surface)
    missing, ends = _find_missing(
        find_boundary(surface),
        prepared_surface,
        sight,
        max_patch_size,
        _REACH_FACTOR * median_distance,
        min_area,
    )
    weak = find_weak_patches(probes, layout, kinds[:-1], max_patch_size, min_area)
    ranked = sorted((*missing, *weak), key=lambda patch: -DEFECT_KINDS[patch.kind].weight * patch.area)
    planner = ViewpointPlanner(
        prepared_surface.space,
        sight,
        np.array([frame.position for frame in observations.frame_summaries]),
        median_distance,
        prepared_surface.origin,
    )
    chosen = ranked[: params.max_defects]
    defects = tuple(
        _describe_defect(patch, stand, observations, prepared_surface.origin)
        for patch, stand in zip(chosen, planner.find_best_viewpoints(chosen), strict=True)
    )
    caps = tuple(
        (patch.kind, patch.display_triangles + prepared_surface.origin)
        for patch in chosen
        if len(patch.display_triangles)
    )
    return Coverage(
        defects=defects,
        omitted_count=len(ranked) - len(defects),
        surface_coverage=SurfaceCoverage(surface, probes, observations.evidence, kinds, caps),
        limits=limits,
        min_area=min_area,
        max_patch_size=max_patch_size,
        spacing=prepared_surface.space.cell_size,
        frame_count=len(observations.frame_summaries),
        skipped=tuple(observations.skipped),
        surface_area=surface.area,
        spread_median=spread,
        spread_95=_compute_area_quantile(0.95, measured.rms_height, around),
        weak_areas={
            kind: float(layout.areas[kinds[:-1] == number].sum()) for number, kind in enumerate(WEAK_KINDS)
        },
        missing_areas={
            kind: float(sum(patch.area for patch in missing if patch.kind == kind)) for kind in MISSING_KINDS
        },
        scan_end_area=ends,
    )


def _derive_limits(
    frame_count: int, median_distance: float, max_spread: float, params: CoverageParams
) -> EvidenceLimits:
    few = params.few_frames or min(_MIN_FRAMES, max(frame_count // _FRAMES_DIVISOR, 1))
    return EvidenceLimits(
        few,
        float(np.cos(np.radians(params.max_angle))),
        params.max_distance or _FAR_FACTOR * median_distance,
        max_spread,
    )


def _compute_area_quantile(ratio: float, values: Singles, areas: Floats) -> float:
    """Return the area-weighted quantile of values; `ratio` is 0 to 1."""
    order = np.argsort(values, kind="stable")
    ends = np.cumsum(areas[order])
    return float(values[order[np.searchsorted(ends, ratio * ends[-1])]])


def _find_missing(
    border: SurfaceBoundary,
    prepared_surface: PreparedSurface,
    sight: OcclusionTest,
    max_patch_size: float,
    reach: float,
    min_area: float,
) -> tuple[list[DefectPatch], float]:
    """Find missing surface, and the area in m² where the scan ends."""
    holes = find_hole_patches(
        build_caps(border, prepared_surface.median_edge, min_area),
        prepared_surface.space,
        prepared_surface.origin,
        max_patch_size,
    )
    frontier = prepared_surface.space.find_frontier()
    space, ends = find_frontier_patches(
        frontier, holes, prepared_surface.space, sight, prepared_surface.origin, max_patch_size, reach
    )
    gaps = find_continuation_gaps(
        border, prepared_surface.space, prepared_surface.origin, reach, max_patch_size
    )
    space = drop_patches_before_gaps(space, gaps, prepared_surface.space.cell_size, reach)
    return [patch for patch in (*holes, *gaps, *space) if patch.area >= min_area], ends


def _describe_defect(
    patch: DefectPatch, viewpoint: CaptureViewpoint, observations: Observations, origin: Floats
) -> CoverageDefect:
    looks = rank_frames(
        patch.points, patch.normal, observations.frame_summaries, origin, _NEAREST_FRAME_COUNT
    )
    return build_defect(patch, looks, viewpoint, origin)
