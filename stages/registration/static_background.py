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
from scanloom.stages.registration.frame_preview import FramePreview, compute_depth_tolerance
from scanloom.stages.registration.view import RegistrationView

Mask = NDArray[np.bool_]

# Criteria for a static camera in a frame pair: minimum ratio of pixels with unchanged depth, and minimum
# number of matched keypoints that stay in place, in a minimum number of cells of the image grid. Depth alone
# is not enough: a bare floor below a moving robot keeps its depth.
_MIN_UNCHANGED_RATIO, _MIN_STATIC_POINTS, _MIN_STATIC_CELLS = 0.25, 10, 4
_GRID_SHAPE = (8, 6)
# Maximum motion of a keypoint that stays in place: pixels of the image for detection, and relative depth.
_MAX_STATIC_PX, _MAX_STATIC_DEPTH_RATIO = 1.5, 0.03
# Minimum ratio of frame pairs with a static camera. A few pairs may be shaken, or covered by a hand.
_MIN_STATIC_PAIR_RATIO = 0.85
# Minimum ratio of the image that must change its depth, and minimum relative change.
_MIN_MOVED_RATIO, _MIN_MOVED_DEPTH_RATIO = 0.004, 0.04
# Minimum ratio of frames that see the background's depth at a pixel; at least two frames.
_MIN_SEEN_RATIO = 0.2
# Minimum colour difference of a changed pixel, 8-bit levels.
MIN_COLOR_CHANGE = 25.0
# Minimum area of a change, as ratio of the image; smaller ones are noise.
_MIN_AREA_RATIO = 0.0005
# Maximum width of gaps that are closed in the moving region, as ratio of the image width. Uniform surfaces do
# not change where they move.
_MAX_GAP_RATIO = 0.04
# Margin around an object in which its support is searched, relative to the square root of its area.
_MARGIN_RATIO = 0.5


def is_camera_static(views: Sequence[RegistrationView], previews: Sequence[FramePreview]) -> bool:
    """Check whether the camera is static in nearly all pairs of views."""
    couples = list(itertools.combinations(range(len(views)), 2))
    still = [
        _compute_unchanged_ratio(previews[a].depth, previews[b].depth) >= _MIN_UNCHANGED_RATIO
        and _has_static_points(views[a].features, views[b].features)
        for a, b in couples
    ]
    return bool(couples) and float(np.mean(still)) >= _MIN_STATIC_PAIR_RATIO


def has_moving_region(previews: Sequence[FramePreview]) -> bool:
    """Check whether something moves in front of a static camera."""
    shares = [_compute_moved_ratio(a.depth, b.depth) for a, b in itertools.pairwise(previews)]
    return float(np.median(shares)) >= _MIN_MOVED_RATIO


def find_static_matches(source: Features, target: Features, pairs: NDArray[np.int64]) -> Mask:
    """Check which matches (n, 2) stay in place, in the image and in depth."""
    moved = np.linalg.norm(source.pixels[pairs[:, 0]] - target.pixels[pairs[:, 1]], axis=1)
    here, there = source.points[pairs[:, 0], 2], target.points[pairs[:, 1], 2]
    return np.asarray((moved < _MAX_STATIC_PX) & (np.abs(here - there) < _MAX_STATIC_DEPTH_RATIO * here))


def _has_static_points(source: Features, target: Features) -> bool:
    if source.camera is None:
        return False
    pairs = match_descriptors(source.descriptors, target.descriptors)
    still = find_static_matches(source, target, pairs)
    if np.count_nonzero(still) < _MIN_STATIC_POINTS:
        return False
    size = (source.camera.width, source.camera.height)
    cells = (source.pixels[pairs[still, 0]] / size * _GRID_SHAPE).astype(int)
    return len(np.unique(cells, axis=0)) >= _MIN_STATIC_CELLS


def _compute_unchanged_ratio(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    both = (one > 0) & (other > 0)
    same = np.abs(one - other)[both] < compute_depth_tolerance(one[both])
    return float(same.mean()) if both.any() else 0.0


def _compute_moved_ratio(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    import cv2

    both = (one > 0) & (other > 0)
    moved = both & (np.abs(one - other) > _MIN_MOVED_DEPTH_RATIO * np.minimum(one, other))
    opened = cv2.morphologyEx(moved.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return float(opened.mean())


@dataclass(frozen=True, eq=False)
class StaticBackground:
    """Static background behind a moving object, with the region of the motion.

    Attributes
    ----------
    depth : (h, w) farthest depth that is seen repeatedly, metres; 0 without.
    color : (h, w, 3) median over the frames; None without colour.
    is_occluded_sometimes : (h, w) something nearer is seen here in some frames.
    moving_region : (h, w) region with changes, gaps and holes filled.
    support_region : (h, w) convex hull of that region with a margin, so that it includes the support of the
        object.
    """

    depth: NDArray[np.float32]
    color: NDArray[np.float32] | None
    is_occluded_sometimes: Mask
    moving_region: Mask
    support_region: Mask

    def detect_changed(self, preview: FramePreview) -> Mask:
        """Detect pixels (h, w) that differ in colour from the background."""
        if self.color is None or preview.color is None:
            return np.zeros(preview.depth.shape, bool)
        return np.asarray(np.abs(preview.color - self.color).max(axis=2) > MIN_COLOR_CHANGE)

    def detect_background(self, preview: FramePreview) -> Mask:
        """Detect pixels (h, w) that show the background, where the object may pass."""
        same = np.abs(preview.depth - self.depth) < compute_depth_tolerance(self.depth)
        return np.asarray(self.is_occluded_sometimes & same & ~self.detect_changed(preview))

    def mask_candidates(self, preview: FramePreview) -> Mask:
        """Mask pixels (h, w) that may show the object, before motions are known."""
        return np.asarray(self.moving_region & (preview.depth > 0) & ~self.detect_background(preview))


def estimate_background(previews: Mapping[int, FramePreview]) -> StaticBackground:
    """Estimate the static background from previews spread over the scan."""
    import cv2

    depths = np.stack([look.depth for look in previews.values()])
    there = depths > 0
    least = max(2, int(np.ceil(_MIN_SEEN_RATIO * len(depths))))
    behind = np.zeros_like(depths[0])
    for depth in depths:
        seen = (there & (np.abs(depths - depth) < compute_depth_tolerance(depth))).sum(axis=0)
        behind = np.maximum(behind, np.where(seen >= least, depth, 0))
    passed = (there & (depths < behind - 2 * compute_depth_tolerance(behind))).any(axis=0)
    colors = [look.color for look in previews.values() if look.color is not None]
    color = np.median(np.stack(colors), axis=0).astype(np.float32) if colors else None
    changes = _remove_spots(passed)
    for one in colors:
        assert color is not None
        changes |= _remove_spots(np.abs(one - color).max(axis=2) > MIN_COLOR_CHANGE)
    gap = max(round(_MAX_GAP_RATIO * changes.shape[1]), 3) | 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    # The middle of a uniform plate never changes, so that enclosed areas are included.
    closed = cv2.morphologyEx(changes.astype(np.uint8), cv2.MORPH_CLOSE, disc)
    moving = _fill_holes(np.asarray(closed, np.uint8)) > 0
    return StaticBackground(behind, color, passed, moving, _compute_support_region(moving))


def _remove_spots(mask: Mask) -> Mask:
    import cv2

    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(opened)
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_AREA_RATIO * mask.size
    large[0] = False
    return np.asarray(large[labels])


def _compute_support_region(mask: Mask) -> Mask:
    """Compute the convex hull of the largest mask component, with a margin."""
    import cv2

    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    wider = np.zeros(mask.shape, np.uint8)
    if outlines:
        hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
        cv2.fillConvexPoly(wider, hull, 1)
        more = round(_MARGIN_RATIO * float(np.sqrt(wider.sum()))) | 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (more, more))
        return np.asarray(cv2.dilate(wider, disc) > 0)
    return wider > 0


def _fill_holes(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Fill the holes of a mask."""
    import cv2

    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(mask.copy(), outlines, -1, 1, cv2.FILLED), np.uint8)
