"""What is not there at all: holes within the surface, and space that no frame saw."""

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

# What is told of the sides of a frontier.
_KINDS = {NOTHING: "unseen", BLANK: "blank", HIDDEN: "hidden"}
# Of the circle around a patch, degrees: without surface in a wider sector the scan ends there; where frames
# looked and have no depth, one may be wider.
_OPEN = {NOTHING: 135.0, BLANK: 200.0}
# Directions in the plane of a patch, and how far they are turned out of it, degrees: to both sides, because
# what goes on beside it may lie a little before or behind it.
_DIRECTIONS = 72
_TILTS = (-5.0, 0.0, 5.0)
# Positions whose surroundings are measured at a time: bounds the memory.
_AT_ONCE = 1000
# Cells that a frontier may lie before a hole that it belongs to.
_BEFORE = 3.0
# Faces that hang together: fewer are the noise of the grid.
_LEAST_FACES = 6
# Cells of a patch around each of it, in the mean: strips of a cell's width have fewer.
_LEAST_BESIDE = 5.0
# Of what would go around a patch of that many faces if it were round, cells at the surface: space that is
# open all around, such as the sky, is not missing.
_RIM = 0.5
# Points of a patch that are asked whether a gap is behind them, and the share of them for which it is.
_ASKED, _SHARE_BEFORE = 40, 0.3


def patches_of_holes(caps: list[Cap], space: Space, origin: Floats, size: float) -> list[Patch]:
    """Return the holes that no frame looked through, cut up into patches of `size` metres at most."""
    found = []
    for cap in caps:
        points, areas = _spread(cap, space.cell)
        points = points - origin
        # Frames have looked through an opening: there is nothing.
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
    """Return where free space ends at space that no frame saw, cut up into patches of `size` metres at most.

    Beside them the area in m² where the scan ends: nobody measured anything beyond, and it is open to the
    other side.

    Parameters
    ----------
    holes : what is told already.
    reach : metres, up to which surface counts that is around a gap.
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
    """Return patches within a scan, and the area of those where it ends, m²."""
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
    """Measure the widest sector (k,), in degrees, without surface around each position.

    The wall of a room that no frame saw has surface all around. Where a scan ends, surface lies on one side.
    Without any surface around, the sector is 360°.

    Parameters
    ----------
    middles : (k, 3) metres, in the axes of the surface.
    normals : (k, 3) towards the viewer of each position; 0 if it is seen from all sides.
    reach : metres, up to which surface counts.
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
    """Return directions (k, 3) around a normal: all directions for each tilt in turn."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    level = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(normal, across)
    tilts = np.radians(_TILTS)
    rays = np.cos(tilts)[:, None, None] * level + np.sin(tilts)[:, None, None] * normal
    return np.asarray(rays.reshape(-1, 3), np.float64)


def before(patches: list[Patch], gaps: list[Patch], cell: float, reach: float) -> list[Patch]:
    """Return patches without those that lie before a gap: it is told where the surface would be.

    Parameters
    ----------
    patches, gaps : from the origin on.
    cell, reach : metres, how finely one looks behind a patch, and how far.
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
    """Return points all over a cap, and the area of each, whose sum is that of its triangles."""
    first, second, middle = cap.corners.transpose(1, 0, 2)
    outer = (first + second) / 2
    steps = max(1, int(np.ceil(np.linalg.norm(outer - middle, axis=1).max() / spacing)))
    shares = (np.arange(steps) + 0.5) / steps
    points = middle[:, None] + shares[None, :, None] * (outer - middle)[:, None]
    whole = np.linalg.norm(np.cross(second - first, middle - first), axis=1) / 2
    areas = whole[:, None] * (2 * np.arange(steps) + 1)[None] / steps**2
    return points.reshape(-1, 3), np.maximum(areas.reshape(-1), np.finfo(np.float64).tiny)


def _away_from(points: Floats, patches: list[Patch], reach: float) -> NDArray[np.bool_]:
    """Return which points no patch is near to."""
    from scipy.spatial import cKDTree

    if not patches or not len(points):
        return np.ones(len(points), bool)
    tree = cKDTree(np.concatenate([patch.points for patch in patches]))
    return np.asarray(tree.query(points, distance_upper_bound=reach)[0] > reach)
