"""Whether the camera stands still while something moves before it, and what then stands still with it.

A camera that moves sees no pixel at the same depth and with the same look again, but by chance; one that
stands still sees its background so in all frames, those far apart in time, too.
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

# A camera stands still between two frames where this share of the pixels keeps its depth, and so many points
# are recognised at the same place, in so many cells of the image: a bare floor keeps its depth under a robot.
_STILL_SHARE, _STILL_POINTS, _STILL_CELLS = 0.25, 10, 4
_CELLS = (8, 6)
# Pixels, of images as wide as those features are found in, and the share of the depth, that are no motion.
_STILL_PX, _STILL_DEPTH = 1.5, 0.03
# Of the couples of frames in which the camera must stand still; one may be shaken, or be hidden by a hand.
_MOST_COUPLES = 0.85
# Something moves where that much of the image is at another depth, by more than this share of it.
_MOVED_SHARE, _MOVED_DEPTH = 0.004, 0.04
# What is behind is what is seen at the same depth in so many of the frames, at least two.
_SEEN_SHARE = 0.2
# A pixel has another look from this difference on, 8-bit levels.
OTHER_LOOK = 25.0
# Spots of less than this share of the image are noise.
_SPOT = 0.0005
# Gaps in what moves, of an image's width, are closed: what is plain does not change where it moves.
_GAP = 0.04
# What a thing stands on is looked for so far around it, as a share of the side of a square of its size.
_AROUND = 0.5


def stands_still(views: Sequence[View], looks: Sequence[Look]) -> bool:
    """Say whether the camera stands still in nearly all couples of views."""
    couples = list(itertools.combinations(range(len(views)), 2))
    still = [
        _same_depth(looks[a].depth, looks[b].depth) >= _STILL_SHARE
        and _has_still_points(views[a].features, views[b].features)
        for a, b in couples
    ]
    return bool(couples) and float(np.mean(still)) >= _MOST_COUPLES


def something_moves(looks: Sequence[Look]) -> bool:
    """Say whether a good part of what a camera sees that stands still is not where it was."""
    shares = [_moved(a.depth, b.depth) for a, b in itertools.pairwise(looks)]
    return float(np.median(shares)) >= _MOVED_SHARE


def is_still(source: Features, target: Features, pairs: NDArray[np.int64]) -> Mask:
    """Say which matches (n, 2) are of points that stay where they are in the image, and in depth."""
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
    """What is behind what moves, as a camera that stands still sees it.

    Attributes
    ----------
    depth : (h, w) the farthest depth that is seen again and again, 0 where there is none.
    color : (h, w, 3) of the median frame; None without colour.
    is_passed : (h, w) something nearer is seen there at times.
    moving : (h, w) where something changes, and what lies between.
    around : (h, w) the same and what is beside it: what it stands on is in it.
    """

    depth: NDArray[np.float32]
    color: NDArray[np.float32] | None
    is_passed: Mask
    moving: Mask
    around: Mask

    def changed(self, look: Look) -> Mask:
        """Return which pixels (h, w) of a frame have another look than usual."""
        if self.color is None or look.color is None:
            return np.zeros(look.depth.shape, bool)
        return np.asarray(np.abs(look.color - self.color).max(axis=2) > OTHER_LOOK)

    def shows_it(self, look: Look) -> Mask:
        """Return which pixels (h, w) of a frame show the backdrop itself, where something else may pass."""
        same = np.abs(look.depth - self.depth) < same_within(self.depth)
        return np.asarray(self.is_passed & same & ~self.changed(look))

    def first_mask(self, look: Look) -> Mask:
        """Return which pixels (h, w) of a frame may show what moves, before any motion is known."""
        return np.asarray(self.moving & (look.depth > 0) & ~self.shows_it(look))


def backdrop_of(looks: Mapping[int, Look]) -> Backdrop:
    """Return what is behind, by frames spread over the scan."""
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
    # What a plain plate shows in its middle never changes: what lies between is taken in.
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
    """Return the convex hull of a mask's largest part, and a good deal more to all sides."""
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
    """Return a mask with its holes filled: those of another than the outermost outline."""
    import cv2

    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(mask.copy(), outlines, -1, 1, cv2.FILLED), np.uint8)
