"""Missing surface: holes in the mesh, and frontiers to unobserved space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.patches import Patch, cut_up, squares, total_area
from scanloom.stages.inspecting.coverage.rims import Cap
from scanloom.stages.inspecting.coverage.sight import Sight
from scanloom.stages.inspecting.coverage.space import BLANK, HIDDEN, NOTHING, Frontier, Space
from scanloom.stages.inspecting.coverage.views import Floats

# Kind of a defect, by the state of the space behind its frontier.
_KINDS = {NOTHING: "unseen", BLANK: "blank", HIDDEN: "hidden"}
# Maximum angle in degrees of a sector around a patch without any surface. In a wider sector, the scan ends.
# The limit is larger where frames looked but have no depth.
_OPEN = {NOTHING: 135.0, BLANK: 200.0}
# Number of ray directions in the plane of a patch, and tilts out of that plane in degrees. Tilts go both
# ways, because the surface may continue slightly in front of or behind the patch.
_DIRECTIONS = 72
_TILTS = (-5.0, 0.0, 5.0)
# Positions per batch, to limit memory.
_AT_ONCE = 1000
# Maximum distance, in cells, of a frontier in front of the hole it belongs to.
_BEFORE = 3.0
# Minimum number of connected faces; smaller components are grid noise.
_LEAST_FACES = 6
# Minimum mean number of frontier cells around each cell of a patch; strips one cell wide have fewer.
_LEAST_BESIDE = 5.0
# Minimum number of cells near the surface, relative to the circumference of a round patch with the same
# number of faces. Frontiers that are open all around, such as the sky, are not missing surface.
_RIM = 0.5
# Number of points sampled per patch, and minimum ratio of points with a gap behind them.
_ASKED, _SHARE_BEFORE = 40, 0.3


def patches_of_holes(caps: list[Cap], space: Space, origin: Floats, size: float) -> list[Patch]:
    """Convert holes that no frame looked through into patches.

    Parameters
    ----------
    caps : triangles that would close the holes.
    space : space carved by the frames.
    origin : (3,) origin of the coordinates of `space` and of the patches, metres.
    size : maximum size of a patch, metres.
    """
    found = []
    for cap in caps:
        points, areas = _spread(cap, space.cell)
        points = points - origin
        # Frames looked through an opening, so there is no surface.
        if areas[space.is_free(points)].sum() > 0.5 * areas.sum():
            continue
        normals = np.tile(cap.normal, (len(points), 1))
        share, corners = cap.area / areas.sum(), cap.corners - origin
        steps = len(points) // len(corners)
        for rows in cut_up(points, normals, areas, size):
            area = share * float(areas[rows].sum())
            shown = corners[np.unique(rows // steps)]
            found.append(Patch("hole", points[rows], normals[rows], areas[rows], area, shown))
    return found


def patches_of_space(
    frontier: Frontier,
    holes: list[Patch],
    space: Space,
    sight: Sight,
    origin: Floats,
    size: float,
    reach: float,
) -> tuple[list[Patch], float]:
    """Convert frontiers between free and unobserved space into patches.

    Parameters
    ----------
    frontier : faces between free and unknown cells.
    holes : patches already reported; frontier faces close to them are dropped.
    space, sight : space carved by the frames, and occlusion test.
    origin : (3,) origin of the coordinates of the patches, metres.
    size : maximum size of a patch, metres.
    reach : range in which surface counts as being around a gap, metres.

    Returns
    -------
    The patches, and the area in m² where the scan ends: nothing was measured beyond, and a wide sector around
    has no surface.
    """
    left = _away_from(frontier.points, holes, _BEFORE * space.cell)
    counts = np.bincount(frontier.parts, left)
    at_rim = np.bincount(frontier.parts, frontier.at_rim & left)
    around = 2 * np.sqrt(np.pi * counts)
    is_kept = (counts >= _LEAST_FACES) & (at_rim >= _RIM * around)
    found = []
    for part in np.flatnonzero(is_kept):
        (members,) = np.nonzero((frontier.parts == part) & left)
        points, normals = frontier.points[members], frontier.normals[members]
        areas = np.full(len(members), frontier.face)
        behind = int(frontier.behind[members[0]])
        for rows in cut_up(points, normals, areas, size):
            if frontier.beside[members[rows]].mean() < _LEAST_BESIDE:
                continue
            area = total_area(normals[rows], areas[rows])
            corners = squares(points[rows], normals[rows], space.cell)
            patch = Patch(_KINDS[behind], points[rows], normals[rows], areas[rows], area, corners)
            found.append((behind, patch))
    return _within(found, sight, origin, reach)


def _within(
    found: list[tuple[int, Patch]], sight: Sight, origin: Floats, reach: float
) -> tuple[list[Patch], float]:
    """Separate patches inside the scan from patches where the scan ends.

    Returns the patches inside the scan, and the area of the others in m².
    """
    asked = [patch for behind, patch in found if behind != HIDDEN]
    middles, normals = (
        np.array([getattr(patch, name) for patch in asked]).reshape(-1, 3) for name in ("middle", "normal")
    )
    sectors = iter(_measure_open_sectors(middles + origin, normals, sight, reach))
    kept, ends = [], 0.0
    for behind, patch in found:
        sector = 0.0 if behind == HIDDEN else float(next(sectors))
        if behind != HIDDEN and sector >= _OPEN[behind]:
            ends += patch.area
        else:
            kept.append(patch if sector < _OPEN[NOTHING] else replace(patch, kind="end"))
    return kept, ends


def _measure_open_sectors(middles: Floats, normals: Floats, sight: Sight, reach: float) -> Floats:
    """Measure the widest sector (k,) without surface around each position, in degrees.

    A wall of a room that no frame saw is surrounded by surface. Where a scan ends, surface is on one side
    only. Without any surface around, the sector is 360°.

    Parameters
    ----------
    middles : (k, 3) positions in world coordinates, metres.
    normals : (k, 3) directions towards the viewer; 0 if the position is visible from all sides.
    sight : occlusion test.
    reach : range in which surface counts, metres.
    """
    sectors = np.full(len(middles), 360.0)
    (rows,) = np.nonzero(normals.any(axis=1))
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        rays = np.stack([_fan_directions(normal) for normal in normals[some]])
        count = rays.shape[1]
        met = sight.is_met(
            np.repeat(middles[some], count, axis=0), rays.reshape(-1, 3), np.full(len(some) * count, reach)
        )
        hits = met.reshape(len(some), len(_TILTS), _DIRECTIONS)
        for row, at_tilts in zip(some, hits, strict=True):
            (ways,) = np.nonzero(at_tilts.any(axis=0))
            if len(ways):
                widest = np.diff(ways, append=ways[0] + _DIRECTIONS).max()
                sectors[row] = float(widest) * 360 / _DIRECTIONS
    return sectors


def _fan_directions(normal: Floats) -> Floats:
    """Return ray directions (k, 3) around a normal; tilts vary slowest."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    return np.asarray(rays.reshape(-1, 3), np.float64)


def before(patches: list[Patch], gaps: list[Patch], cell: float, reach: float) -> list[Patch]:
    """Drop patches in front of a gap.

    The gap is reported at the expected surface instead.

    Parameters
    ----------
    patches, gaps : both relative to the same origin.
    cell, reach : step and range of the search behind each patch, metres.
    """
    from scipy.spatial import cKDTree

    if not gaps:
        return patches
    tree = cKDTree(np.concatenate([gap.points for gap in gaps]))
    depths = np.arange(0.0, reach, cell)
    kept = []
    for patch in patches:
        if patch.kind in ("unseen", "blank", "end"):
            rows = sample_evenly(len(patch.points), _ASKED)
            behind = patch.points[rows, None] - depths[:, None] * patch.normal
            is_near = tree.query(behind, distance_upper_bound=2 * cell)[0] <= 2 * cell
            if is_near.any(axis=1).mean() >= _SHARE_BEFORE:
                continue
        kept.append(patch)
    return kept


def _spread(cap: Cap, spacing: float) -> tuple[Floats, Floats]:
    """Sample a cap; return the points (k, 3) and their areas (k,), m²."""
    first, second, middle = cap.corners.transpose(1, 0, 2)
    outer = (first + second) / 2
    steps = max(1, int(np.ceil(np.linalg.norm(outer - middle, axis=1).max() / spacing)))
    shares = (np.arange(steps) + 0.5) / steps
    points = middle[:, None] + shares[None, :, None] * (outer - middle)[:, None]
    whole = np.linalg.norm(np.cross(second - first, middle - first), axis=1) / 2
    areas = whole[:, None] * (2 * np.arange(steps) + 1)[None] / steps**2
    return points.reshape(-1, 3), np.maximum(areas.reshape(-1), np.finfo(np.float64).tiny)


def _away_from(points: Floats, patches: list[Patch], reach: float) -> NDArray[np.bool_]:
    """Return a mask (k,) of the points farther than `reach` from all patches."""
    from scipy.spatial import cKDTree

    if not patches or not len(points):
        return np.ones(len(points), bool)
    tree = cKDTree(np.concatenate([patch.points for patch in patches]))
    return np.asarray(tree.query(points, distance_upper_bound=reach)[0] > reach)
