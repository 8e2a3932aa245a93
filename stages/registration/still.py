"""Detection of a static camera, of something that moves, and of the static background.

A moving camera sees a pixel with the same depth and colour again only by chance. A static camera sees its
background unchanged in all frames, also in frames far apart in time.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import match_descriptors
from scanloom.stages.registration.features import Features
from scanloom.stages.registration.looks import Look, same_within
from scanloom.stages.registration.view import View

Mask = NDArray[np.bool_]

# Criteria for a static camera in a frame pair: minimum ratio of pixels with unchanged depth, and minimum
# number of matched keypoints that stay in place, in a minimum number of cells of the image grid. Depth alone
# is not enough: a bare floor below a moving robot keeps its depth.
_STILL_SHARE, _STILL_POINTS, _STILL_CELLS = 0.25, 10, 4
_CELLS = (8, 6)
# Maximum motion of a keypoint that stays in place: pixels of the image for detection, and relative depth.
_STILL_PX, _STILL_DEPTH = 1.5, 0.03
# Minimum ratio of frame pairs with a static camera. A few pairs may be shaken, or covered by a hand.
_MOST_COUPLES = 0.85
# Minimum ratio of the image that must change its depth, and minimum relative change.
_MOVED_SHARE, _MOVED_DEPTH = 0.004, 0.04
# Minimum ratio of frames that see the background's depth at a pixel; at least two frames.
_SEEN_SHARE = 0.2
# Minimum colour difference of a changed pixel, 8-bit levels.
OTHER_LOOK = 25.0
# Minimum area of a change, as ratio of the image; smaller ones are noise.
_SPOT = 0.0005
# Maximum width of gaps that are closed in the moving region, as ratio of the image width. Uniform surfaces do
# not change where they move.
_GAP = 0.04
# Margin around an object in which its support is searched, relative to the square root of its area.
_AROUND = 0.5


def stands_still(views: Sequence[View], looks: Sequence[Look]) -> bool:
    """Check whether the camera is static in nearly all pairs of views."""
    couples = list(itertools.combinations(range(len(views)), 2))
    still = [
        _same_depth(looks[a].depth, looks[b].depth) >= _STILL_SHARE
        and _has_still_points(views[a].features, views[b].features)
        for a, b in couples
    ]
    return bool(couples) and float(np.mean(still)) >= _MOST_COUPLES


def something_moves(looks: Sequence[Look]) -> bool:
    """Check whether something moves in front of a static camera."""
    shares = [_moved(a.depth, b.depth) for a, b in itertools.pairwise(looks)]
    return float(np.median(shares)) >= _MOVED_SHARE


def is_still(source: Features, target: Features, pairs: NDArray[np.int64]) -> Mask:
    """Check which matches (n, 2) stay in place, in the image and in depth."""
    moved = np.linalg.norm(source.pixels[pairs[:, 0]] - target.pixels[pairs[:, 1]], axis=1)
    here, there = source.points[pairs[:, 0], 2], target.points[pairs[:, 1], 2]
    return np.asarray((moved < _STILL_PX) & (np.abs(here - there) < _STILL_DEPTH * here))


def _has_still_points(source: Features, target: Features) -> bool:
    if source.camera is None:
        return False
    pairs = match_descriptors(source.descriptors, target.descriptors)
    still = is_still(source, target, pairs)
    if np.count_nonzero(still) < _STILL_POINTS:
        return False
    size = (source.camera.width, source.camera.height)
    cells = (source.pixels[pairs[still, 0]] / size * _CELLS).astype(int)
    return len(np.unique(cells, axis=0)) >= _STILL_CELLS


def _same_depth(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    both = (one > 0) & (other > 0)
    same = np.abs(one - other)[both] < same_within(one[both])
    return float(same.mean()) if both.any() else 0.0


def _moved(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    import cv2

    both = (one > 0) & (other > 0)
    moved = both & (np.abs(one - other) > _MOVED_DEPTH * np.minimum(one, other))
    opened = cv2.morphologyEx(moved.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return float(opened.mean())


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Static background behind a moving object, with the region of the motion.

    Attributes
    ----------
    depth : (h, w) farthest depth that is seen repeatedly, metres; 0 without.
    color : (h, w, 3) median over the frames; None without colour.
    is_passed : (h, w) something nearer is seen here in some frames.
    moving : (h, w) region with changes, gaps and holes filled.
    around : (h, w) convex hull of that region with a margin, so that it includes the support of the object.
    """

    depth: NDArray[np.float32]
    color: NDArray[np.float32] | None
    is_passed: Mask
    moving: Mask
    around: Mask

    def changed(self, look: Look) -> Mask:
        """Detect pixels (h, w) that differ in colour from the background."""
        if self.color is None or look.color is None:
            return np.zeros(look.depth.shape, bool)
        return np.asarray(np.abs(look.color - self.color).max(axis=2) > OTHER_LOOK)

    def shows_it(self, look: Look) -> Mask:
        """Detect pixels (h, w) that show the background, where the object may pass."""
        same = np.abs(look.depth - self.depth) < same_within(self.depth)
        return np.asarray(self.is_passed & same & ~self.changed(look))

    def first_mask(self, look: Look) -> Mask:
        """Mask pixels (h, w) that may show the object, before motions are known."""
        return np.asarray(self.moving & (look.depth > 0) & ~self.shows_it(look))


def backdrop_of(looks: Mapping[int, Look]) -> Backdrop:
    """Estimate the static background from previews spread over the scan."""
    import cv2

    depths = np.stack([look.depth for look in looks.values()])
    there = depths > 0
    least = max(2, int(np.ceil(_SEEN_SHARE * len(depths))))
    behind = np.zeros_like(depths[0])
    for depth in depths:
        seen = (there & (np.abs(depths - depth) < same_within(depth))).sum(axis=0)
        behind = np.maximum(behind, np.where(seen >= least, depth, 0))
    passed = (there & (depths < behind - 2 * same_within(behind))).any(axis=0)
    colors = [look.color for look in looks.values() if look.color is not None]
    color = np.median(np.stack(colors), axis=0).astype(np.float32) if colors else None
    changes = _without_spots(passed)
    for one in colors:
        assert color is not None
        changes |= _without_spots(np.abs(one - color).max(axis=2) > OTHER_LOOK)
    gap = max(round(_GAP * changes.shape[1]), 3) | 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    # The middle of a uniform plate never changes, so that enclosed areas are included.
    closed = cv2.morphologyEx(changes.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    moving = _filled(np.asarray(closed, np.uint8)) > 0
    return Backdrop(behind, color, passed, moving, _around(moving))


def _without_spots(mask: Mask) -> Mask:
    import cv2

    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(opened)
    large = stats[:, cv2.CC_STAT_AREA] >= _SPOT * mask.size
    large[0] = False
    return np.asarray(large[labels])


def _around(mask: Mask) -> Mask:
    """Compute the convex hull of the largest mask component, with a margin."""
    import cv2

    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    wider = np.zeros(mask.shape, np.uint8)
    if outlines:
        hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
        cv2.fillConvexPoly(wider, hull, 1)
        more = round(_AROUND * float(np.sqrt(wider.sum()))) | 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (more, more))
        return np.asarray(cv2.dilate(wider, disc) > 0)
    return wider > 0


def _filled(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Fill the holes of a mask."""
    import cv2

    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(mask.copy(), outlines, -1, 1, cv2.FILLED), np.uint8)
