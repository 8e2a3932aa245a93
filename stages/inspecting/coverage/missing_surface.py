"""Missing surface: holes in the mesh, and frontiers to unobserved space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.carved_space import NO_DEPTH, OCCLUDED, UNSEEN, CarvedSpace, Frontier
from scanloom.stages.inspecting.coverage.defect_patches import (
    DefectPatch,
    compute_plane_area,
    make_squares,
    split_patch,
)
from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.hole_caps import HoleCap
from scanloom.stages.inspecting.coverage.occlusion_test import OcclusionTest

# Kind of a defect, by the state of the space behind its frontier.
_KIND_BY_STATE = {UNSEEN: "unseen", NO_DEPTH: "blank", OCCLUDED: "hidden"}
# Maximum angle in degrees of a sector around a patch without any surface. In a wider sector, the scan ends.
# The limit is larger where frames looked but have no depth.
_MAX_OPEN_SECTOR_DEG = {UNSEEN: 135.0, NO_DEPTH: 200.0}
# Number of ray directions in the plane of a patch, and tilts out of that plane in degrees. Tilts go both
# ways, because the surface may continue slightly in front of or behind the patch.
_DIRECTION_COUNT = 72
_TILTS_DEG = (-5.0, 0.0, 5.0)
# Positions per batch, to limit memory.
_BATCH_SIZE = 1000
# Maximum distance, in cells, of a frontier in front of the hole it belongs to.
_MAX_FRONT_CELLS = 3.0
# Minimum number of connected faces; smaller components are grid noise.
_MIN_FACES = 6
# Minimum mean number of frontier cells around each cell of a patch; strips one cell wide have fewer.
_MIN_NEIGHBOURS = 5.0
# Minimum number of cells near the surface, relative to the circumference of a round patch with the same
# number of faces. Frontiers that are open all around, such as the sky, are not missing surface.
_MIN_RIM_RATIO = 0.5
# Number of points sampled per patch, and minimum ratio of points with a gap behind them.
_SAMPLE_COUNT, _MIN_GAP_BEHIND_RATIO = 40, 0.3


def find_hole_patches(
    caps: list[HoleCap], space: CarvedSpace, origin: Floats, max_patch_size: float
) -> list[DefectPatch]:
    """Convert holes that no frame looked through into patches.

    Parameters
    ----------
    caps : triangles that would close the holes.
    space : space carved by the frames.
    origin : (3,) origin of the coordinates of `space` and of the patches, metres.
    max_patch_size : maximum size of a patch, metres.
    """
    found = []
    for cap in caps:
        points, areas = _sample_cap(cap, space.cell_size)
        points = points - origin
        # Frames looked through an opening, so there is no surface.
        if areas[space.is_free(points)].sum() > 0.5 * areas.sum():
            continue
        normals = np.tile(cap.normal, (len(points), 1))
        share, corners = cap.area / areas.sum(), cap.corners - origin
        steps = len(points) // len(corners)
        for rows in split_patch(points, normals, areas, max_patch_size):
            area = share * float(areas[rows].sum())
            shown = corners[np.unique(rows // steps)]
            found.append(DefectPatch("hole", points[rows], normals[rows], areas[rows], area, shown))
    return found


def find_frontier_patches(
    frontier: Frontier,
    holes: list[DefectPatch],
    space: CarvedSpace,
    occlusion: OcclusionTest,
    origin: Floats,
    max_patch_size: float,
    reach: float,
) -> tuple[list[DefectPatch], float]:
    """Convert frontiers between free and unobserved space into patches.

    Parameters
    ----------
    frontier : faces between free and unknown cells.
    holes : patches already reported; frontier faces close to them are dropped.
    space, occlusion : space carved by the frames, and occlusion test.
    origin : (3,) origin of the coordinates of the patches, metres.
    max_patch_size : maximum size of a patch, metres.
    reach : range in which surface counts as being around a gap, metres.

    Returns
    -------
    The patches, and the area in m² where the scan ends: nothing was measured beyond, and a wide sector around
    has no surface.
    """
    is_uncovered = _mask_far_points(frontier.points, holes, _MAX_FRONT_CELLS * space.cell_size)
    counts = np.bincount(frontier.component_labels, is_uncovered)
    at_rim = np.bincount(frontier.component_labels, frontier.is_near_surface & is_uncovered)
    circumference = 2 * np.sqrt(np.pi * counts)
    is_kept = (counts >= _MIN_FACES) & (at_rim >= _MIN_RIM_RATIO * circumference)
    found = []
    for part in np.flatnonzero(is_kept):
        (members,) = np.nonzero((frontier.component_labels == part) & is_uncovered)
        points, normals = frontier.points[members], frontier.normals[members]
        areas = np.full(len(members), frontier.face_area)
        behind = int(frontier.state_behind[members[0]])
        for rows in split_patch(points, normals, areas, max_patch_size):
            if frontier.neighbour_counts[members[rows]].mean() < _MIN_NEIGHBOURS:
                continue
            area = compute_plane_area(normals[rows], areas[rows])
            corners = make_squares(points[rows], normals[rows], space.cell_size)
            patch = DefectPatch(
                _KIND_BY_STATE[behind], points[rows], normals[rows], areas[rows], area, corners
            )
            found.append((behind, patch))
    return _separate_open_ends(found, occlusion, origin, reach)


def _separate_open_ends(
    patches: list[tuple[int, DefectPatch]], occlusion: OcclusionTest, origin: Floats, reach: float
) -> tuple[list[DefectPatch], float]:
    """Separate patches inside the scan from patches where the scan ends.

    Returns the patches inside the scan, and the area of the others in m².
    """
    tested = [patch for behind, patch in patches if behind != OCCLUDED]
    middles, normals = (
        np.array([getattr(patch, name) for patch in tested]).reshape(-1, 3) for name in ("middle", "normal")
    )
    sectors = iter(_measure_open_sectors(middles + origin, normals, occlusion, reach))
    kept, ends = [], 0.0
    for behind, patch in patches:
        sector = 0.0 if behind == OCCLUDED else float(next(sectors))
        if behind != OCCLUDED and sector >= _MAX_OPEN_SECTOR_DEG[behind]:
            ends += patch.area
        else:
            kept.append(patch if sector < _MAX_OPEN_SECTOR_DEG[UNSEEN] else replace(patch, kind="end"))
    return kept, ends


def _measure_open_sectors(middles: Floats, normals: Floats, occlusion: OcclusionTest, reach: float) -> Floats:
    """Measure the widest sector (k,) without surface around each position, in degrees.

    A wall of a room that no frame saw is surrounded by surface. Where a scan ends, surface is on one side
    only. Without any surface around, the sector is 360°.

    Parameters
    ----------
    middles : (k, 3) positions in world coordinates, metres.
    normals : (k, 3) directions towards the viewer; 0 if the position is visible from all sides.
    occlusion : occlusion test.
    reach : range in which surface counts, metres.
    """
    sectors = np.full(len(middles), 360.0)
    (rows,) = np.nonzero(normals.any(axis=1))
    for start in range(0, len(rows), _BATCH_SIZE):
        some = rows[start : start + _BATCH_SIZE]
        rays = np.stack([_make_fan_directions(normal) for normal in normals[some]])
        count = rays.shape[1]
        met = occlusion.is_hit(
            np.repeat(middles[some], count, axis=0), rays.reshape(-1, 3), np.full(len(some) * count, reach)
        )
        hits = met.reshape(len(some), len(_TILTS_DEG), _DIRECTION_COUNT)
        for row, at_tilts in zip(some, hits, strict=True):
            (ways,) = np.nonzero(at_tilts.any(axis=0))
            if len(ways):
                widest = np.diff(ways, append=ways[0] + _DIRECTION_COUNT).max()
                sectors[row] = float(widest) * 360 / _DIRECTION_COUNT
    return sectors


def _make_fan_directions(normal: Floats) -> Floats:
    """Return ray directions (k, 3) around a normal; tilts vary slowest."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTION_COUNT) / _DIRECTION_COUNT
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS_DEG)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    return np.asarray(rays.reshape(-1, 3), np.float64)


def drop_patches_before_gaps(
    patches: list[DefectPatch], gaps: list[DefectPatch], cell_size: float, reach: float
) -> list[DefectPatch]:
    """Drop patches in front of a gap.

    The gap is reported at the expected surface instead.

    Parameters
    ----------
    patches, gaps : both relative to the same origin.
    cell_size, reach : step and range of the search behind each patch, metres.
    """
    from scipy.spatial import cKDTree

    if not gaps:
        return patches
    tree = cKDTree(np.concatenate([gap.points for gap in gaps]))
    depths = np.arange(0.0, reach, cell_size)
    kept = []
    for patch in patches:
        if patch.kind in ("unseen", "blank", "end"):
            rows = sample_evenly(len(patch.points), _SAMPLE_COUNT)
            behind = patch.points[rows, None] - depths[:, None] * patch.normal
            is_near = tree.query(behind, distance_upper_bound=2 * cell_size)[0] <= 2 * cell_size
            if is_near.any(axis=1).mean() >= _MIN_GAP_BEHIND_RATIO:
                continue
        kept.append(patch)
    return kept


def _sample_cap(hole_cap: HoleCap, spacing: float) -> tuple[Floats, Floats]:
    """Sample a cap; return the points (k, 3) and their areas (k,), m²."""
    first, second, middle = hole_cap.corners.transpose(1, 0, 2)
    outer = (first + second) / 2
    steps = max(1, int(np.ceil(np.linalg.norm(outer - middle, axis=1).max() / spacing)))
    shares = (np.arange(steps) + 0.5) / steps
    points = middle[:, None] + shares[None, :, None] * (outer - middle)[:, None]
    whole = np.linalg.norm(np.cross(second - first, middle - first), axis=1) / 2
    areas = whole[:, None] * (2 * np.arange(steps) + 1)[None] / steps**2
    return points.reshape(-1, 3), np.maximum(areas.reshape(-1), np.finfo(np.float64).tiny)


def _mask_far_points(points: Floats, patches: list[DefectPatch], reach: float) -> NDArray[np.bool_]:
    """Return a mask (k,) of the points farther than `reach` from all patches."""
    from scipy.spatial import cKDTree

    if not patches or not len(points):
        return np.ones(len(points), bool)
    tree = cKDTree(np.concatenate([patch.points for patch in patches]))
    return np.asarray(tree.query(points, distance_upper_bound=reach)[0] > reach)
