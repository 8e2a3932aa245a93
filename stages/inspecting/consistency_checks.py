"""Consistency checks of images, poses and calibration on a few frames.

They emit or return diagnostics. They detect input mistakes that produce a blurred or mirrored mesh without an
error: inverted poses, wrong axes, unregistered colour, swapped left and right images.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.codes import POSE_CONVENTION_SUSPECT, POSE_INEXACT, SCALE_DEPTH_UNIT_SUSPECT
from scanloom.stages.inspecting.pose_conventions import (
    AS_GIVEN,
    compute_relative_poses,
    suggest_pose_convention,
)
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, Pose, Scan, StereoRig
from scanloom.stages.stereo.codes import DEPTH_PAIR_ROWS_DIFFER, DEPTH_PAIR_SWAPPED

RESULT_VERSION = 2

_PAIR_COUNT = 8
# Minimum ratio of a frame's points that fall on depth of the other frame for a comparison.
_MIN_OVERLAP_RATIO = 0.1
# Relative depth errors between frames: correct poses reach 0.5 %; above 3 % no convention fits.
_MAX_SOUND_ERROR_RATIO = 0.005
_MAX_FITTING_ERROR_RATIO = 0.03
# Depth noise varies from pixel to pixel, pose errors displace whole patches. Side of a patch in pixels,
# minimum number of matching points per patch, maximum relative depth difference of a matching point.
_PATCH_SIDE_PX, _MIN_PATCH_POINTS, _MAX_MATCH_RATIO = 64, 16, 0.05
# Measured relative offsets: 0.1 to 0.3 % with correct poses, 0.6 to 1 % with wrong timestamps or half a
# degree of rotation error.
_MAX_OFFSET_RATIO = 0.005
# The same for the depth unit. Below the first value the declared unit is accepted; below the second another
# one fits.
_MAX_SOUND_SCALE_RATIO = 0.015
_MAX_FITTING_SCALE_RATIO = 0.012
_AMBIGUITY_FACTOR = 1.25

# Two frames to compare: index and depth map of each.
_FramePair: TypeAlias = tuple[tuple[int, DepthImage], tuple[int, DepthImage]]


def require_poses(scan: Scan) -> None:
    """Reject poses if another convention clearly fits the depth better.

    A suspicion that cannot be confirmed only emits a warning.

    Raises
    ------
    InputError
        With the comparison of `check_poses`. If frames do not overlap with the poses as given, there is
        nothing to compare, and only a warning is emitted.
    """
    errors, suspicion = check_poses(scan.frames)
    if suspicion is None:
        return
    if AS_GIVEN in errors:
        compared = "; ".join(f"{error * 1000:.0f} mm {name}" for name, error in errors.items())
        raise InputError(
            POSE_CONVENTION_SUSPECT,
            "{suspicion} (compared: {compared}).",
            scan.folder,
            suspicion=suspicion.message,
            remedy=suggest_pose_convention(min(errors, key=lambda name: errors[name])),
            compared=compared,
        )
    emit(suspicion)


def check_poses(frames: Sequence[Frame]) -> tuple[dict[str, float], Diagnostic | None]:
    """Compare pose conventions by reprojecting depth between frames.

    Candidates are the poses as given, inverted, with flipped axes, both, and in reverse frame order.

    Parameters
    ----------
    frames : frames with depth and poses; frames without a pose are ignored.

    Returns
    -------
    errors : median depth error in metres by convention, for conventions with enough overlap.
    suspicion : warning if another convention fits with less than half the error of the declared one, which
        does not fit; else None. It names all conventions that fit equally well: for uniform camera motion,
        inverted and reversed poses are the same.
    """
    frames, poses = _select_posed_frames(frames)
    errors: dict[str, list[NDArray[np.float64]]] = {}
    distances = []
    for (i, first), (k, second) in _sample_frame_pairs(frames):
        points = _unproject_sampled(first, frames[i].camera)
        distances.append(points[:, 2])
        for name, second_from_first in compute_relative_poses(poses, i, k).items():
            found = _measure_depth_errors(points, second_from_first, second, frames[k].camera)
            if found.size > _MIN_OVERLAP_RATIO * len(points):
                errors.setdefault(name, []).append(found)
    medians = {name: float(np.median(np.concatenate(found))) for name, found in errors.items()}
    if not medians:
        return {}, None
    distance = float(np.median(np.concatenate(distances)))
    declared = medians.get(AS_GIVEN)
    best = min(medians, key=lambda name: medians[name])
    is_sound = declared is not None and declared < max(2 * medians[best], _MAX_SOUND_ERROR_RATIO * distance)
    if is_sound or medians[best] > _MAX_FITTING_ERROR_RATIO * distance:
        return medians, None
    given_text = "no overlap" if declared is None else f"{declared * 1000:.0f} mm"
    similar = [name for name, error in medians.items() if error < _AMBIGUITY_FACTOR * medians[best]]
    return medians, POSE_CONVENTION_SUSPECT.warning(
        "the poses are probably {alike}: overlapping depth maps then agree to {best_mm:.0f} mm; as given: "
        "{given}",
        alike=", or ".join(similar),
        best_mm=1000 * medians[best],
        given=given_text,
    )


def warn_inexact_poses(frames: Sequence[Frame]) -> None:
    """Warn if surfaces of neighbouring frames are offset patch by patch.

    Such an offset indicates inexact poses rather than depth noise.

    Parameters
    ----------
    frames : frames with depth and poses; frames without a pose are ignored.
    """
    frames, poses = _select_posed_frames(frames)
    shares = []
    for (i, first), (k, second) in _sample_frame_pairs(frames):
        points = _unproject_sampled(first, frames[i].camera)
        reprojected = _reproject_depth(points, invert_pose(poses[k]) @ poses[i], second, frames[k].camera)
        if len(reprojected) > _MIN_OVERLAP_RATIO * len(points):
            shares += _measure_patch_offsets(reprojected)
    median_offset = float(np.median(shares)) if shares else 0.0
    if median_offset > _MAX_OFFSET_RATIO:
        emit(
            POSE_INEXACT.warning(
                "the poses are inexact: surfaces of overlapping frames are offset by {share:.1%} of their "
                "distance (median)",
                remedy="register.enabled=true with register.refine=true refines the poses",
                share=median_offset,
            )
        )


def _measure_patch_offsets(reprojected: NDArray[np.float64]) -> list[float]:
    """Compute the median relative depth offset of each patch.

    Parameters
    ----------
    reprojected : (n, 4) reprojected points from `_reproject_depth`.
    """
    column, row, distance, off = reprojected.T
    near = np.abs(off) < _MAX_MATCH_RATIO * distance
    patch = (row // _PATCH_SIDE_PX) * 10_000 + column // _PATCH_SIDE_PX
    each = [near & (patch == one) for one in np.unique(patch[near])]
    return [
        abs(float(np.median(off[here] / distance[here])))
        for here in each
        if np.count_nonzero(here) >= _MIN_PATCH_POINTS
    ]


def check_scale(frames: Sequence[Frame], scales: Iterable[float]) -> Diagnostic | None:
    """Compare depth units by reprojecting depth between frames.

    Parameters
    ----------
    frames : frames with depth and metric poses of a moving camera; frames without a pose are ignored.
    scales : candidate depth units per metre.

    Returns
    -------
    A warning if another unit clearly fits better, else None.
    """
    frames, poses = _select_posed_frames(frames)
    frame_pairs = _sample_frame_pairs(frames)
    if not frame_pairs:
        return None
    declared = frames[0].depth_scale

    def measure_misfit(units: float) -> float | None:
        return _measure_relative_misfit(frames, poses, frame_pairs, units)

    given = measure_misfit(1.0)
    if given is not None and given < _MAX_SOUND_SCALE_RATIO:
        return None
    found = {
        other: share
        for other in scales
        if other != declared and (share := measure_misfit(other / declared)) is not None
    }
    best = min(found, key=lambda other: found[other], default=declared)
    if best == declared or found[best] > min(_MAX_FITTING_SCALE_RATIO, (given or 1) / 2):
        return None
    if sum(share < _AMBIGUITY_FACTOR * found[best] for share in found.values()) > 1:
        return None  # The camera moves too little to distinguish the candidates.
    given_text = "no overlap" if given is None else f"{given:.1%}"
    return SCALE_DEPTH_UNIT_SUSPECT.warning(
        "the depth unit is probably wrong: with scan.depth_scale={best:g}, overlapping depth maps agree to "
        "{share:.1%} of the distance; with {declared:g} units per metre: {was}",
        best=best,
        share=found[best],
        declared=declared,
        was=given_text,
    )


def _measure_relative_misfit(
    frames: Sequence[Frame], poses: Sequence[Pose], frame_pairs: Sequence[_FramePair], scale_ratio: float
) -> float | None:
    """Measure the median relative depth error under another depth unit.

    Returns None if the frames do not overlap.

    Parameters
    ----------
    scale_ratio : candidate units per metre, relative to the declared ones.
    """
    shares = []
    for (i, first), (k, second) in frame_pairs:
        points = _unproject_sampled(first, frames[i].camera)
        given = invert_pose(poses[k]) @ poses[i]
        # Scaling the translation up is equivalent to scaling depth down.
        given[:3, 3] *= scale_ratio
        errors = _measure_depth_errors(points, given, second, frames[k].camera)
        if errors.size > _MIN_OVERLAP_RATIO * len(points):
            shares.append(float(np.median(errors)) / float(np.median(points[:, 2])))
    return float(np.median(shares)) if len(shares) > len(frame_pairs) / 2 else None


def report_stereo_faults(
    pairs: Sequence[tuple[ColorImage | None, ColorImage | None]], rig: StereoRig
) -> None:
    """Warn about stereo pairs that are swapped, or not rectified as declared.

    Rows and disparities are measured on feature matches.
    """
    moves = [
        _measure_feature_displacements(left, right)
        for left, right in pairs
        if left is not None and right is not None
    ]
    found = np.concatenate(moves) if moves else np.empty((0, 2))
    if len(found) < 50:
        return
    # Different principal points can make the disparity negative in a correct pair.
    disparity = float(np.median(found[:, 0])) + rig.right.cx - rig.left.cx
    row = float(np.median(np.abs(found[:, 1])))
    if disparity < 0:
        emit(
            DEPTH_PAIR_SWAPPED.warning(
                "left and right images seem swapped: the median disparity is {disparity:.1f} px",
                disparity=disparity,
            )
        )
    if rig.is_rectified and row > 0.5:
        emit(
            DEPTH_PAIR_ROWS_DIFFER.warning(
                "the pairs are declared as rectified, but matched features differ by {rows:.1f} rows",
                rows=row,
            )
        )


def _sample_frame_pairs(frames: Sequence[Frame]) -> list[_FramePair]:
    """Read frame pairs that are far enough apart for camera motion."""
    step = max(1, len(frames) // 25)
    last = len(frames) - 1 - step
    if last < 0:
        return []
    starts = sample_evenly(last + 1, _PAIR_COUNT)
    frame_pairs = []
    for i in starts:
        first, second = (_read_depth_or_none(frames[place]) for place in (i, i + step))
        if first is not None and second is not None:
            frame_pairs.append(((i, first), (i + step, second)))
    return frame_pairs


def _read_depth_or_none(frame: Frame) -> DepthImage | None:
    try:
        return read_depth(frame)
    except InputError:
        return None


def _select_posed_frames(frames: Sequence[Frame]) -> tuple[Sequence[Frame], list[Pose]]:
    """Return the frames that have a pose, and their poses."""
    posed = [frame for frame in frames if frame.world_from_camera is not None]
    return posed, [frame.world_from_camera for frame in posed if frame.world_from_camera is not None]


def _unproject_sampled(depth: DepthImage, camera: Camera) -> NDArray[np.float64]:
    """Unproject every eighth pixel with depth to points (n, 3) in camera coordinates."""
    rows, columns = np.mgrid[4 : depth.shape[0] : 8, 4 : depth.shape[1] : 8]
    z = depth[rows, columns].astype(np.float64)
    points: NDArray[np.float64] = unproject(columns, rows, z, camera)[z > 0]
    return points


def _measure_depth_errors(
    points: NDArray[np.float64], second_from_first: Pose, depth: DepthImage, camera: Camera
) -> NDArray[np.float64]:
    """Return the absolute depth difference of each overlapping point, metres."""
    return np.asarray(np.abs(_reproject_depth(points, second_from_first, depth, camera)[:, 3]))


def _reproject_depth(
    points: NDArray[np.float64], second_from_first: Pose, depth: DepthImage, camera: Camera
) -> NDArray[np.float64]:
    """Reproject points into a depth map and compare depths.

    Points that fall on no measured depth are dropped.

    Returns
    -------
    (n, 4) column, row, depth of the point, and measured depth minus that depth, metres.
    """
    moved = points @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    moved = moved[moved[:, 2] > 0.05]
    columns, rows = map(np.rint, project(moved, camera))
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    seen = depth[rows[inside].astype(int), columns[inside].astype(int)]
    distance = moved[inside, 2]
    found = np.stack([columns[inside], rows[inside], distance, seen - distance], axis=1)
    return np.asarray(found[seen > 0])


def _measure_feature_displacements(left: ColorImage, right: ColorImage) -> NDArray[np.float64]:
    """Return the displacements (n, 2), left minus right, of mutual feature matches, pixels."""
    import cv2

    finder = cv2.ORB.create(1000)
    points_left, words_left = finder.detectAndCompute(left, None)
    points_right, words_right = finder.detectAndCompute(right, None)
    if not points_left or not points_right:
        return np.empty((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(words_left, words_right)
    moves = [
        np.subtract(points_left[one.queryIdx].pt, points_right[one.trainIdx].pt)
        for one in matches
        if one.distance < 40
    ]
    return np.reshape(np.array(moves, np.float64), (-1, 2))
