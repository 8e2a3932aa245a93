"""Which pixels show the thing that moved: each is asked of other frames, as part of it and as standing still.

What would be seen through, or looks different where it should be, is not there. What turned about an axis is
all that is as near to it as what surely turned, but for what surely stands still, and for the table beside,
which is of another colour than the plate and goes on beyond. Where nothing turned about one axis, what is
not sure goes with what is around it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.projection import project
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.registration.looks import Look, read_look, read_looks, same_within
from scanloom.stages.registration.motion import angle
from scanloom.stages.registration.still import Mask
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

Floats = NDArray[np.float64]

# Frames that are asked, spread over the scan.
_ASKED = 8
# From this difference on colours speak against, 8-bit levels: a thing that turns is lit otherwise.
_OTHER_SHADE = 30.0
# How many more frames must speak for one than for the other.
_SURE = 1.5
# A turn tells an axis from this on; axes of one turntable differ by less, radians, and shifts along it are
# less, as a share of the thing's distance.
_TURNED, _ONE_AXIS, _ALONG = np.radians(8), np.radians(8), 0.05
# The thing reaches as far as nearly all pixels that surely show it, and a little.
_REACH, _MORE = 97.0, 1.03
# Pixels that must surely show it, for that. A table is beside it where so large a share of what is so much
# farther out is at one height.
_LEAST_SURE, _BESIDE, _FLAT = 50, 1.5, 0.5
# Table and plate differ by so many 8-bit levels or cannot be told apart; the plate is within this share.
_TWO_COLORS, _PLATE = 15.0, 0.7
# Frames ask each other where the thing turned by this much between them, radians.
_MOVED = np.radians(3)
# Spots and gaps of fewer pixels, as a share of the image, are taken away.
_SPOT = 0.001
# Names of what is flooded.
_STILL, _THING = 1, 2


@dataclass(frozen=True, eq=False)
class Axis:
    """What a thing turned about: a point (3,) and a direction (3,), in its own world."""

    point: Floats
    direction: Floats

    def radius_and_height(self, points: Floats) -> tuple[Floats, Floats]:
        """Return how far points (…, 3) are from it, and where along it."""
        away = points - self.point
        height = away @ self.direction
        return np.linalg.norm(away - height[..., None] * self.direction, axis=-1), height


def axis_of(poses: Sequence[Pose], distance: float) -> Axis | None:
    """Return the axis that all motions between cameras turn about; None if there is not one.

    Parameters
    ----------
    poses : world_from_camera of a camera that stands still, the world being what turns.
    distance : of the thing from the camera, metres.
    """
    from scipy.spatial.transform import Rotation

    first = inverted(poses[0])
    motions = [pose @ first for pose in poses[1:]]
    motions = [motion for motion in motions if angle(motion) > _TURNED]
    if not motions:
        return None
    turns = np.array([Rotation.from_matrix(motion[:3, :3]).as_rotvec() for motion in motions])
    directions = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    directions *= np.sign(directions @ directions[0])[:, None]
    mean = directions.mean(axis=0)
    mean /= np.linalg.norm(mean)
    off = np.arccos(np.clip(np.abs(directions @ mean), 0, 1))
    slides = np.abs([motion[:3, 3] @ mean for motion in motions])
    if np.median(off) > _ONE_AXIS or np.median(slides) > _ALONG * distance:
        return None
    # A point that stays where it is, in the least squares of all motions; along the axis any does.
    rows = np.concatenate([np.eye(3) - motion[:3, :3] for motion in motions] + [mean[None]])
    sides = np.concatenate([motion[:3, 3] for motion in motions] + [np.zeros(1)])
    return Axis(np.linalg.lstsq(rows, sides, rcond=None)[0], mean)


def masks_of_thing(frames: Mapping[int, Frame]) -> dict[int, Mask]:
    """Return which pixels (h, w), of a size of their own, show the thing in each frame that can be read.

    Parameters
    ----------
    frames : by their places, all from one camera that stands still, without a mask of the thing; their poses
        are of one world, which is the thing.
    """
    poses = {n: frame.world_from_camera for n, frame in frames.items() if frame.world_from_camera is not None}
    places = list(poses)
    asked = [places[k] for k in sample_evenly(len(places), _ASKED + 1)]
    others = read_looks(frames, asked)
    said = {n: _said(look, poses[n], others, poses, n) for n, look in others.items()}
    reach = _reach(others, said, poses)

    def mask(n: int) -> Mask | None:
        look = others[n] if n in others else read_look(frames[n])
        if look is None:
            return None
        one = said[n] if n in said else _said(look, poses[n], others, poses, n)
        if reach is None:
            belongs = _with_around(look, one.says >= _SURE, one.says <= -_SURE)
        else:
            where = look.points() @ poses[n][:3, :3].T + poses[n][:3, 3]
            belongs = reach.holds(where) & (one.seen_through < _SURE) & ~reach.table(look, where)
        return _smoothed(belongs & (look.depth > 0))

    threads = workers()
    found = zip(places, read_ahead(mask, places, threads=threads, ahead=threads), strict=True)
    return {n: one for n, one in found if one is not None}


@dataclass(frozen=True, eq=False)
class _Said:
    """How many more frames speak for a pixel (h, w) as one of the thing than as one that stands still.

    `says` counts depth and colour, `seen_through` how many more see through it as one of the thing.
    """

    says: Floats
    seen_through: Floats


@dataclass(frozen=True, eq=False)
class _Reach:
    """How far the thing reaches from its axis and along it, and how high the table beside it is, metres."""

    axis: Axis
    radius: float
    low: float
    high: float
    table_at: float | None
    same_m: float

    def holds(self, points: Floats) -> Mask:
        """Say which points (h, w, 3) are as near to the axis as the thing is."""
        radius, height = self.axis.radius_and_height(points)
        return np.asarray((radius < self.radius) & (height > self.low) & (height < self.high))

    def table(self, look: Look, points: Floats) -> Mask:
        """Return the table (h, w) that goes on beyond the thing's reach without an edge of colour."""
        import cv2

        if self.table_at is None:
            return np.zeros(look.depth.shape, bool)
        radius, height = self.axis.radius_and_height(points)
        flat = (np.abs(height - self.table_at) < self.same_m) & (look.depth > 0)
        beside, plate = flat & (radius > self.radius), flat & (radius < _PLATE * self.radius)
        if look.color is None or not beside.any() or not plate.any():
            return np.zeros(look.depth.shape, bool)
        # Two colours, or it cannot be told where the plate ends; that of the table is taken near the plate.
        beside &= radius < _BESIDE * self.radius
        colors = [np.median(look.color[where], axis=0) for where in (beside, plate)]
        if not beside.any() or np.abs(colors[0] - colors[1]).max() < _TWO_COLORS:
            return np.zeros(look.depth.shape, bool)
        off = [np.linalg.norm(look.color - color, axis=2) for color in colors]
        _, labels = cv2.connectedComponents((flat & (off[0] < off[1])).astype(np.uint8), connectivity=4)
        beyond = np.unique(labels[beside])
        table = np.isin(labels, beyond[beyond > 0])
        # The edge itself is of both.
        return np.asarray(cv2.dilate(table.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & flat


def _reach(looks: Mapping[int, Look], said: Mapping[int, _Said], poses: Mapping[int, Pose]) -> _Reach | None:
    """Return how far what surely turned reaches; None if it did not turn about one axis."""
    distance = float(np.median([np.median(look.depth[look.depth > 0]) for look in looks.values()]))
    axis = axis_of(list(poses.values()), distance)
    if axis is None:
        return None
    sure, all_ = [], []
    for n, look in looks.items():
        points = look.points() @ poses[n][:3, :3].T + poses[n][:3, 3]
        sure.append(points[_core(said[n].says >= _SURE)])
        all_.append(points[look.depth > 0])
    radius, height = axis.radius_and_height(np.concatenate(sure))
    if len(radius) < _LEAST_SURE:
        return None
    reach = _MORE * float(np.percentile(radius, _REACH))
    low, high = np.percentile(height, (0.5, 99.5))
    more = 0.1 * (high - low)
    around, at = axis.radius_and_height(np.concatenate(all_))
    beside = at[(around > reach) & (around < _BESIDE * reach) & (at > low - more) & (at < high + more)]
    same = 1.5 * float(same_within(np.float32(distance)))
    table_at = float(np.median(beside)) if len(beside) >= _LEAST_SURE else None
    if table_at is not None and np.mean(np.abs(beside - table_at) < same) < _FLAT:
        table_at = None
    return _Reach(axis, reach, low - more, high + more, table_at, same)


def _said(look: Look, pose: Pose, others: Mapping[int, Look], poses: Mapping[int, Pose], place: int) -> _Said:
    """Ask frames, but for the one of this place, what they see where its pixels show something."""
    says, through = np.zeros(look.depth.shape), np.zeros(look.depth.shape)
    points = look.points()
    for n, other in others.items():
        motion = inverted(poses[n]) @ pose
        if n == place or angle(motion) < _MOVED:
            continue
        as_thing, alike_thing = _votes(look, points @ motion[:3, :3].T + motion[:3, 3], other)
        as_still, alike_still = _votes(look, points, other)
        through += (as_thing < 0).astype(float) - (as_still < 0)
        # That one can be seen says nothing against the other where that is hidden.
        both = (as_thing != 0) & (as_still != 0)
        as_thing = np.where(as_thing > 0, both * alike_thing, as_thing)
        says += as_thing - np.where(as_still > 0, both * alike_still, as_still)
    return _Said(says, through)


def _votes(look: Look, points: Floats, other: Look) -> tuple[Floats, Floats]:
    """Ask another frame what it sees where points (h, w, 3) are.

    Returns
    -------
    (h, w) 1 where it sees them, -1 where it sees through them, 0 where something hides them; and how alike
    they look, 1 for the same and down to -1.
    """
    rows, columns, inside = _pixels(points, other.camera)
    there = other.depth[rows, columns]
    off = there - points[..., 2]
    near = np.abs(off) < 1.5 * same_within(there)
    seen = inside & (look.depth > 0) & (there > 0)
    votes = np.where(seen & near, 1.0, np.where(seen & (off > 0), -1.0, 0.0))
    if look.color is None or other.color is None:
        return votes, np.ones(votes.shape)
    differs = np.abs(other.color[rows, columns] - look.color).max(axis=2)
    return votes, 1 - np.minimum(differs / _OTHER_SHADE, 2)


def _with_around(look: Look, is_thing: Mask, is_still: Mask) -> Mask:
    """Return the thing with what goes with it: what is not sure is flooded over flat colour first."""
    import cv2

    markers = np.zeros(look.depth.shape, np.int32)
    markers[_core(is_still)] = _STILL
    markers[_core(is_thing)] = _THING
    if not (markers == _THING).any() or not (markers == _STILL).any():
        return is_thing
    shown = np.repeat((look.depth / look.depth.max() * 255)[..., None], 3, axis=2)
    if look.color is not None:
        shown = look.color
    flooded = cv2.watershed(np.ascontiguousarray(shown.clip(0, 255).astype(np.uint8)), markers)
    return np.asarray(flooded == _THING)


def _core(mask: Mask) -> Mask:
    """Return the inner part of a mask: single pixels are not sure of anything."""
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _pixels(points: Floats, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Return the row and column that see each point (h, w, 3), and which of them are in the image."""
    columns, rows = map(np.rint, project(points, camera))
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    inside &= points[..., 2] > 1e-6
    return (
        np.where(inside, rows, 0).astype(np.int64),
        np.where(inside, columns, 0).astype(np.int64),
        np.asarray(inside),
    )


def _smoothed(mask: Mask) -> Mask:
    """Return a mask as its neighbourhoods say, without spots and holes."""
    import cv2

    smooth = cv2.medianBlur(mask.astype(np.uint8), 5)
    for value in (1, 0):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth == value).astype(np.uint8))
        small = stats[:, cv2.CC_STAT_AREA] < _SPOT * mask.size
        small[0] = False
        smooth[small[labels]] = 1 - value
    return np.asarray(smooth > 0)
