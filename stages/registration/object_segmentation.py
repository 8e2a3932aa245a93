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
from scanloom.stages.registration.frame_preview import (
    FramePreview,
    compute_depth_tolerance,
    read_preview,
    read_previews,
)
from scanloom.stages.registration.motion import compute_rotation_angle
from scanloom.stages.registration.static_background import Mask
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

Floats = NDArray[np.float64]

# Number of frames that vote, spread over the scan.
_VOTER_COUNT = 8
# Colour difference from which colour contradicts a hypothesis, 8-bit levels. The tolerance is wide because
# shading changes when an object turns.
_MAX_COLOR_DIFFERENCE = 30.0
# Minimum lead in votes for a certain pixel.
_MIN_LEAD = 1.5
# Minimum rotation from which an axis is estimated, and maximum deviation between axes of one turntable,
# radians; maximum translation along the axis, relative to the distance of the object.
_MIN_ROTATION_RAD, _MAX_AXIS_DEVIATION_RAD, _MAX_SLIDE_RATIO = np.radians(8), np.radians(8), 0.05
# Percentile of the radii of certain pixels that gives the radius of the object, and a margin as factor.
_RADIUS_PERCENTILE, _RADIUS_MARGIN = 97.0, 1.03
# Minimum number of certain pixels to estimate the extent of the object. The table is searched up to
# `_TABLE_RADIUS_FACTOR` object radii; it exists if at least the ratio `_MIN_FLAT_RATIO` of the points there
# is at one height.
_MIN_CERTAIN_PIXELS, _TABLE_RADIUS_FACTOR, _MIN_FLAT_RATIO = 50, 1.5, 0.5
# Minimum colour difference between table and plate, 8-bit levels. The plate's colour is sampled within this
# ratio of the object radius.
_MIN_COLOR_DIFFERENCE, _PLATE_RADIUS_RATIO = 15.0, 0.7
# Minimum rotation of the object between two frames that vote on each other, radians.
_MIN_VOTER_ROTATION_RAD = np.radians(3)
# Maximum area of spots and holes that are removed, as ratio of the image.
_MAX_SPOT_RATIO = 0.001
# Marker labels of the watershed.
_BACKGROUND_LABEL, _OBJECT_LABEL = 1, 2


@dataclass(frozen=True, eq=False)
class RotationAxis:
    """Rotation axis of an object: a point (3,) and a direction (3,), in the object's world."""

    point: Floats
    direction: Floats

    def compute_radius_and_height(self, points: Floats) -> tuple[Floats, Floats]:
        """Compute the distance of points (…, 3) from the axis, and their height along it."""
        away = points - self.point
        height = away @ self.direction
        return np.linalg.norm(away - height[..., None] * self.direction, axis=-1), height


def estimate_rotation_axis(poses: Sequence[Pose], distance_m: float) -> RotationAxis | None:
    """Estimate the common rotation axis of all motions; None without one.

    Parameters
    ----------
    poses : world_from_camera of a static camera; the world turns with the object.
    distance_m : distance of the object from the camera, metres.
    """
    from scipy.spatial.transform import Rotation

    first = invert_pose(poses[0])
    motions = [pose @ first for pose in poses[1:]]
    motions = [motion for motion in motions if compute_rotation_angle(motion) > _MIN_ROTATION_RAD]
    if not motions:
        return None
    turns = np.array([Rotation.from_matrix(motion[:3, :3]).as_rotvec() for motion in motions])
    directions = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    directions *= np.sign(directions @ directions[0])[:, None]
    mean = directions.mean(axis=0)
    mean /= np.linalg.norm(mean)
    off = np.arccos(np.clip(np.abs(directions @ mean), 0, 1))
    slides = np.abs([motion[:3, 3] @ mean for motion in motions])
    if np.median(off) > _MAX_AXIS_DEVIATION_RAD or np.median(slides) > _MAX_SLIDE_RATIO * distance_m:
        return None
    # Least-squares fixed point of all motions. The last row selects one of the points along the axis.
    rows = np.concatenate([np.eye(3) - motion[:3, :3] for motion in motions] + [mean[None]])
    sides = np.concatenate([motion[:3, 3] for motion in motions] + [np.zeros(1)])
    return RotationAxis(np.linalg.lstsq(rows, sides, rcond=None)[0], mean)


def segment_moving_object(frames: Mapping[int, Frame]) -> dict[int, Mask]:
    """Segment the moving object in each frame.

    Parameters
    ----------
    frames : frames of one static camera by index, without object masks. Their poses are relative to the
        object.

    Returns
    -------
    Masks (h, w) of the object by frame index, at the resolution of `FramePreview`, for all readable frames.
    """
    poses = {n: frame.world_from_camera for n, frame in frames.items() if frame.world_from_camera is not None}
    places = list(poses)
    asked = [places[k] for k in sample_evenly(len(places), _VOTER_COUNT + 1)]
    others = read_previews(frames, asked)
    votes = {n: _accumulate_votes(look, poses[n], others, poses, n) for n, look in others.items()}
    extent = _estimate_object_extent(others, votes, poses)

    def segment_frame(n: int) -> Mask | None:
        look = others[n] if n in others else read_preview(frames[n])
        if look is None:
            return None
        one = votes[n] if n in votes else _accumulate_votes(look, poses[n], others, poses, n)
        if extent is None:
            belongs = _assign_undecided_pixels(
                look, one.object_lead >= _MIN_LEAD, one.object_lead <= -_MIN_LEAD
            )
        else:
            where = look.unproject_pixels() @ poses[n][:3, :3].T + poses[n][:3, 3]
            belongs = (
                extent.contains(where)
                & (one.see_through_lead < _MIN_LEAD)
                & ~extent.segment_table(look, where)
            )
        return _smooth_mask(belongs & (look.depth > 0))

    threads = get_worker_count()
    found = zip(places, map_ordered(segment_frame, places, threads=threads, max_pending=threads), strict=True)
    return {n: one for n, one in found if one is not None}


@dataclass(frozen=True, eq=False)
class _Votes:
    """Votes (h, w) for each pixel.

    Attributes
    ----------
    object_lead : votes for the moving object minus votes for the static background, by depth and colour.
    see_through_lead : frames that see through the pixel as part of the object, minus those that see through
        the
        pixel as part of the background.
    """

    object_lead: Floats
    see_through_lead: Floats


@dataclass(frozen=True, eq=False)
class _ObjectExtent:
    """Extent of the object around its rotation axis, with the table around it.

    Attributes
    ----------
    axis : rotation axis of the object.
    radius, min_height, max_height : maximum distance from the axis, and range of heights along the axis,
        metres.
    table_height : height of the table, metres; None without a table.
    height_tolerance_m : tolerance of this height, metres.
    """

    axis: RotationAxis
    radius: float
    min_height: float
    max_height: float
    table_height: float | None
    height_tolerance_m: float

    def contains(self, points: Floats) -> Mask:
        """Check which points (h, w, 3) are within the extent of the object."""
        radius, height = self.axis.compute_radius_and_height(points)
        return np.asarray((radius < self.radius) & (height > self.min_height) & (height < self.max_height))

    def segment_table(self, preview: FramePreview, points: Floats) -> Mask:
        """Segment the table (h, w) around the plate.

        The table includes pixels within the object's radius that are connected to it without a colour edge.
        """
        import cv2

        if self.table_height is None:
            return np.zeros(preview.depth.shape, bool)
        radius, height = self.axis.compute_radius_and_height(points)
        flat = (np.abs(height - self.table_height) < self.height_tolerance_m) & (preview.depth > 0)
        beside, plate = flat & (radius > self.radius), flat & (radius < _PLATE_RADIUS_RATIO * self.radius)
        if preview.color is None or not beside.any() or not plate.any():
            return np.zeros(preview.depth.shape, bool)
        # Without two distinct colours the edge of the plate is unknown. The table's colour is sampled near
        # the plate.
        beside &= radius < _TABLE_RADIUS_FACTOR * self.radius
        colors = [np.median(preview.color[where], axis=0) for where in (beside, plate)]
        if not beside.any() or np.abs(colors[0] - colors[1]).max() < _MIN_COLOR_DIFFERENCE:
            return np.zeros(preview.depth.shape, bool)
        off = [np.linalg.norm(preview.color - color, axis=2) for color in colors]
        _, labels = cv2.connectedComponents((flat & (off[0] < off[1])).astype(np.uint8), connectivity=4)
        beyond = np.unique(labels[beside])
        table = np.isin(labels, beyond[beyond > 0])
        # Pixels on the edge mix both colours.
        return np.asarray(cv2.dilate(table.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & flat


def _estimate_object_extent(
    previews: Mapping[int, FramePreview], votes: Mapping[int, _Votes], poses: Mapping[int, Pose]
) -> _ObjectExtent | None:
    """Estimate the extent of the object from pixels that surely turned.

    Returns None without a common axis, or with too few certain pixels.
    """
    distance = float(np.median([np.median(look.depth[look.depth > 0]) for look in previews.values()]))
    axis = estimate_rotation_axis(list(poses.values()), distance)
    if axis is None:
        return None
    sure, all_ = [], []
    for n, look in previews.items():
        points = look.unproject_pixels() @ poses[n][:3, :3].T + poses[n][:3, 3]
        sure.append(points[_open_mask(votes[n].object_lead >= _MIN_LEAD)])
        all_.append(points[look.depth > 0])
    radius, height = axis.compute_radius_and_height(np.concatenate(sure))
    if len(radius) < _MIN_CERTAIN_PIXELS:
        return None
    reach = _RADIUS_MARGIN * float(np.percentile(radius, _RADIUS_PERCENTILE))
    low, high = np.percentile(height, (0.5, 99.5))
    more = 0.1 * (high - low)
    around, at = axis.compute_radius_and_height(np.concatenate(all_))
    beside = at[
        (around > reach) & (around < _TABLE_RADIUS_FACTOR * reach) & (at > low - more) & (at < high + more)
    ]
    same = 1.5 * float(compute_depth_tolerance(np.float32(distance)))
    table_at = float(np.median(beside)) if len(beside) >= _MIN_CERTAIN_PIXELS else None
    if table_at is not None and np.mean(np.abs(beside - table_at) < same) < _MIN_FLAT_RATIO:
        table_at = None
    return _ObjectExtent(axis, reach, low - more, high + more, table_at, same)


def _accumulate_votes(
    preview: FramePreview,
    pose: Pose,
    voters: Mapping[int, FramePreview],
    poses: Mapping[int, Pose],
    frame_index: int,
) -> _Votes:
    """Accumulate the votes of other frames for the pixels of a preview.

    Parameters
    ----------
    voters : previews of the voting frames by index; the frame `frame_index` itself does not vote.
    """
    says, through = np.zeros(preview.depth.shape), np.zeros(preview.depth.shape)
    points = preview.unproject_pixels()
    for n, other in voters.items():
        motion = invert_pose(poses[n]) @ pose
        if n == frame_index or compute_rotation_angle(motion) < _MIN_VOTER_ROTATION_RAD:
            continue
        as_thing, alike_thing = _compare_points(preview, points @ motion[:3, :3].T + motion[:3, 3], other)
        as_still, alike_still = _compare_points(preview, points, other)
        through += (as_thing < 0).astype(float) - (as_still < 0)
        # An occluded hypothesis gets no vote: seeing the other one does not contradict it.
        both = (as_thing != 0) & (as_still != 0)
        as_thing = np.where(as_thing > 0, both * alike_thing, as_thing)
        says += as_thing - np.where(as_still > 0, both * alike_still, as_still)
    return _Votes(says, through)


def _compare_points(preview: FramePreview, points: Floats, other: FramePreview) -> tuple[Floats, Floats]:
    """Compare points with the depth and colour that another frame sees there.

    Parameters
    ----------
    points : (h, w, 3) points of the pixels of `preview`, metres, camera axes of the other frame.

    Returns
    -------
    Votes (h, w): 1 visible, -1 contradicted (the other frame sees farther), 0 occluded or unknown. Colour
    agreement (h, w): 1 for equal colours, down to -1.
    """
    rows, columns, inside = _project_to_pixels(points, other.camera)
    there = other.depth[rows, columns]
    off = there - points[..., 2]
    near = np.abs(off) < 1.5 * compute_depth_tolerance(there)
    seen = inside & (preview.depth > 0) & (there > 0)
    votes = np.where(seen & near, 1.0, np.where(seen & (off > 0), -1.0, 0.0))
    if preview.color is None or other.color is None:
        return votes, np.ones(votes.shape)
    differs = np.abs(other.color[rows, columns] - preview.color).max(axis=2)
    return votes, 1 - np.minimum(differs / _MAX_COLOR_DIFFERENCE, 2)


def _assign_undecided_pixels(preview: FramePreview, is_object: Mask, is_background: Mask) -> Mask:
    """Assign undecided pixels to object or background by a watershed on colour."""
    import cv2

    markers = np.zeros(preview.depth.shape, np.int32)
    markers[_open_mask(is_background)] = _BACKGROUND_LABEL
    markers[_open_mask(is_object)] = _OBJECT_LABEL
    if not (markers == _OBJECT_LABEL).any() or not (markers == _BACKGROUND_LABEL).any():
        return is_object
    shown = np.repeat((preview.depth / preview.depth.max() * 255)[..., None], 3, axis=2)
    if preview.color is not None:
        shown = preview.color
    flooded = cv2.watershed(np.ascontiguousarray(shown.clip(0, 255).astype(np.uint8)), markers)
    return np.asarray(flooded == _OBJECT_LABEL)


def _open_mask(mask: Mask) -> Mask:
    """Open a mask, because single pixels are unreliable."""
    import cv2

    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _project_to_pixels(points: Floats, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
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


def _smooth_mask(mask: Mask) -> Mask:
    """Smooth a mask, and remove small spots and holes."""
    import cv2

    smooth = cv2.medianBlur(mask.astype(np.uint8), 5)
    for value in (1, 0):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((smooth == value).astype(np.uint8))
        small = stats[:, cv2.CC_STAT_AREA] < _MAX_SPOT_RATIO * mask.size
        small[0] = False
        smooth[small[labels]] = 1 - value
    return np.asarray(smooth > 0)
