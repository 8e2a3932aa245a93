"""Segmentation of the object that moved between frames.

Each pixel is reprojected into other frames twice: as part of the moving object, and as part of the static
background. The hypothesis that agrees in depth and colour gets the vote. For a turntable, the object is
everything within the radius of the pixels that surely turned, minus surely static pixels and the table. The
table differs from the plate in colour, and extends beyond the plate. Without a common axis, undecided pixels
follow their neighbours.
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

# Number of frames that vote, spread over the scan.
_ASKED = 8
# Colour difference from which colour contradicts a hypothesis, 8-bit levels. The tolerance is wide because
# shading changes when an object turns.
_OTHER_SHADE = 30.0
# Minimum lead in votes for a certain pixel.
_SURE = 1.5
# Minimum rotation from which an axis is estimated, and maximum deviation between axes of one turntable,
# radians; maximum translation along the axis, relative to the distance of the object.
_TURNED, _ONE_AXIS, _ALONG = np.radians(8), np.radians(8), 0.05
# Percentile of the radii of certain pixels that gives the radius of the object, and a margin as factor.
_REACH, _MORE = 97.0, 1.03
# Minimum number of certain pixels to estimate the extent of the object. The table is searched up to `_BESIDE`
# object radii; it exists if at least the ratio `_FLAT` of the points there is at one height.
_LEAST_SURE, _BESIDE, _FLAT = 50, 1.5, 0.5
# Minimum colour difference between table and plate, 8-bit levels. The plate's colour is sampled within this
# ratio of the object radius.
_TWO_COLORS, _PLATE = 15.0, 0.7
# Minimum rotation of the object between two frames that vote on each other, radians.
_MOVED = np.radians(3)
# Maximum area of spots and holes that are removed, as ratio of the image.
_SPOT = 0.001
# Marker labels of the watershed.
_STILL, _THING = 1, 2


@dataclass(frozen=True, eq=False)
class Axis:
    """Rotation axis of an object: a point (3,) and a direction (3,), in the object's world."""

    point: Floats
    direction: Floats

    def radius_and_height(self, points: Floats) -> tuple[Floats, Floats]:
        """Compute the distance of points (…, 3) from the axis, and their height along it."""
        away = points - self.point
        height = away @ self.direction
        return np.linalg.norm(away - height[..., None] * self.direction, axis=-1), height


def axis_of(poses: Sequence[Pose], distance: float) -> Axis | None:
    """Estimate the common rotation axis of all motions; None without one.

    Parameters
    ----------
    poses : world_from_camera of a static camera; the world turns with the object.
    distance : distance of the object from the camera, metres.
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
    # Least-squares fixed point of all motions. The last row selects one of the points along the axis.
    rows = np.concatenate([np.eye(3) - motion[:3, :3] for motion in motions] + [mean[None]])
    sides = np.concatenate([motion[:3, 3] for motion in motions] + [np.zeros(1)])
    return Axis(np.linalg.lstsq(rows, sides, rcond=None)[0], mean)


def masks_of_thing(frames: Mapping[int, Frame]) -> dict[int, Mask]:
    """Segment the moving object in each frame.

    Parameters
    ----------
    frames : frames of one static camera by index, without object masks. Their poses are relative to the
        object.

    Returns
    -------
    Masks (h, w) of the object by frame index, at the resolution of `Look`, for all readable frames.
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
    """Votes (h, w) for each pixel.

    Attributes
    ----------
    says : votes for the moving object minus votes for the static background, by depth and colour.
    seen_through : frames that see through the pixel as part of the object, minus those that see through the
        pixel as part of the background.
    """

    says: Floats
    seen_through: Floats


@dataclass(frozen=True, eq=False)
class _Reach:
    """Extent of the object around its rotation axis, with the table around it.

    Attributes
    ----------
    axis : rotation axis of the object.
    radius, low, high : maximum distance from the axis, and range of heights along the axis, metres.
    table_at : height of the table, metres; None without a table.
    same_m : tolerance of this height, metres.
    """

    axis: Axis
    radius: float
    low: float
    high: float
    table_at: float | None
    same_m: float

    def holds(self, points: Floats) -> Mask:
        """Check which points (h, w, 3) are within the extent of the object."""
        radius, height = self.axis.radius_and_height(points)
        return np.asarray((radius < self.radius) & (height > self.low) & (height < self.high))

    def table(self, look: Look, points: Floats) -> Mask:
        """Segment the table (h, w) around the plate.

        The table includes pixels within the object's radius that are connected to it without a colour edge.
        """
        import cv2

        if self.table_at is None:
            return np.zeros(look.depth.shape, bool)
        radius, height = self.axis.radius_and_height(points)
        flat = (np.abs(height - self.table_at) < self.same_m) & (look.depth > 0)
        beside, plate = flat & (radius > self.radius), flat & (radius < _PLATE * self.radius)
        if look.color is None or not beside.any() or not plate.any():
            return np.zeros(look.depth.shape, bool)
        # Without two distinct colours the edge of the plate is unknown. The table's colour is sampled near
        # the plate.
        beside &= radius < _BESIDE * self.radius
        colors = [np.median(look.color[where], axis=0) for where in (beside, plate)]
        if not beside.any() or np.abs(colors[0] - colors[1]).max() < _TWO_COLORS:
            return np.zeros(look.depth.shape, bool)
        off = [np.linalg.norm(look.color - color, axis=2) for color in colors]
        _, labels = cv2.connectedComponents((flat & (off[0] < off[1])).astype(np.uint8), connectivity=4)
        beyond = np.unique(labels[beside])
        table = np.isin(labels, beyond[beyond > 0])
        # Pixels on the edge mix both colours.
        return np.asarray(cv2.dilate(table.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & flat


def _reach(looks: Mapping[int, Look], said: Mapping[int, _Said], poses: Mapping[int, Pose]) -> _Reach | None:
    """Estimate the extent of the object from pixels that surely turned.

    Returns None without a common axis, or with too few certain pixels.
    """
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
    """Accumulate the votes of other frames for the pixels of a preview.

    Parameters
    ----------
    others : previews of the voting frames by index; the frame `place` itself does not vote.
    """
    says, through = np.zeros(look.depth.shape), np.zeros(look.depth.shape)
    points = look.points()
    for n, other in others.items():
        motion = inverted(poses[n]) @ pose
        if n == place or angle(motion) < _MOVED:
            continue
        as_thing, alike_thing = _votes(look, points @ motion[:3, :3].T + motion[:3, 3], other)
        as_still, alike_still = _votes(look, points, other)
        through += (as_thing < 0).astype(float) - (as_still < 0)
        # An occluded hypothesis gets no vote: seeing the other one does not contradict it.
        both = (as_thing != 0) & (as_still != 0)
        as_thing = np.where(as_thing > 0, both * alike_thing, as_thing)
        says += as_thing - np.where(as_still > 0, both * alike_still, as_still)
    return _Said(says, through)


def _votes(look: Look, points: Floats, other: Look) -> tuple[Floats, Floats]:
    """Compare points with the depth and colour that another frame sees there.

    Parameters
    ----------
    points : (h, w, 3) points of the pixels of `look`, metres, camera axes of the other frame.

    Returns
    -------
    Votes (h, w): 1 visible, -1 contradicted (the other frame sees farther), 0 occluded or unknown.
    Colour agreement (h, w): 1 for equal colours, down to -1.
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
    """Assign undecided pixels to object or background by a watershed on colour."""
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
    """Open a mask, because single pixels are unreliable."""
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _pixels(points: Floats, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Project points (h, w, 3) to pixels.

    Returns rows and columns (h, w), 0 outside the image, and a mask of points inside the image.
    """
    columns, rows = map(np.rint, project(points, camera))
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    inside &= points[..., 2] > 1e-6
    return (
        np.where(inside, rows, 0).astype(np.int64),
        np.where(inside, columns, 0).astype(np.int64),
        np.asarray(inside),
    )


def _smoothed(mask: Mask) -> Mask:
    """Smooth a mask, and remove small spots and holes."""
    import cv2

    smooth = cv2.medianBlur(mask.astype(np.uint8), 5)
    for value in (1, 0):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth == value).astype(np.uint8))
        small = stats[:, cv2.CC_STAT_AREA] < _SPOT * mask.size
        small[0] = False
        smooth[small[labels]] = 1 - value
    return np.asarray(smooth > 0)
