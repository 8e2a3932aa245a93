"""Do the images agree with what the folder says of them? Cheap tests on a few frames.

They emit or return diagnostics. They catch the mistakes that give a blurred or mirrored mesh and no
error: poses taken the wrong way round, a wrong axis, colour beside depth, left and right exchanged.
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
from scanloom.stages.inspecting.meant import AS_GIVEN, advice, motions
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, Pose, Scan, StereoRig
from scanloom.stages.stereo.codes import DEPTH_PAIR_ROWS_DIFFER, DEPTH_PAIR_SWAPPED

RESULT_VERSION = 2

_COUPLES = 8
# Of the points of one frame, the share that must fall on depth of the other for the two to be compared.
_LEAST_OVERLAP = 0.1
# Depth of one frame meets another's to half a per cent with sound poses; beyond 3 % nothing fits.
_SOUND_SHARE = 0.005
_FITTING_SHARE = 0.03
# Noise of depth differs from pixel to pixel, poses move whole patches: so many pixels wide, each with so many
# points that meet another frame's depth within this share of the distance.
_PATCH, _LEAST_POINTS, _NEAR_SHARE = 64, 16, 0.05
# Recordings with sound poses come to 0.1 to 0.3 %; those with poses of another moment, or half a degree off,
# to 0.6 to 1 %.
_INEXACT_SHARE = 0.005
# The same for the unit of depth: below the first the declared one is right, below the second another is.
_SOUND_SCALE_SHARE = 0.015
_FITTING_SCALE_SHARE = 0.012
_CLEARLY = 1.25

# The places of two frames among those compared, and the depth of both.
_Couple: TypeAlias = tuple[tuple[int, DepthImage], tuple[int, DepthImage]]


def require_poses(scan: Scan) -> None:
    """Stop when another reading of the poses clearly fits the depth better; warn if that is only suspected.

    Raises
    ------
    InputError
        With the comparison of `check_poses`. Where frames do not overlap with the poses as given, there is
        nothing to compare, which is only suspicious.
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
            remedy=advice(min(errors, key=lambda name: errors[name])),
            compared=compared,
        )
    emit(suspicion)


def check_poses(frames: Sequence[Frame]) -> tuple[dict[str, float], Diagnostic | None]:
    """Reproject depth from frame to frame with the poses as given, inverted, with flipped axes, and both.

    And with the last pose for the first frame, and so on: files that list frames the other way round.

    Parameters
    ----------
    frames : with depth and poses; those without a pose are left out.

    Returns
    -------
    The median depth error in metres of each way (those that overlap enough), and a warning when another way
    fits, with less than half the error of the declared one, and that one does not. It names all ways that
    fit as well: of a camera that moves evenly, poses inverted and poses backwards are the same.
    """
    frames, poses = _posed(frames)
    errors: dict[str, list[NDArray[np.float64]]] = {}
    distances = []
    for (i, first), (k, second) in _couples(frames):
        points = _points(first, frames[i].camera)
        distances.append(points[:, 2])
        for name, second_from_first in motions(poses, i, k).items():
            found = _depth_errors(points, second_from_first, second, frames[k].camera)
            if found.size > _LEAST_OVERLAP * len(points):
                errors.setdefault(name, []).append(found)
    medians = {name: float(np.median(np.concatenate(found))) for name, found in errors.items()}
    if not medians:
        return {}, None
    distance = float(np.median(np.concatenate(distances)))
    declared = medians.get(AS_GIVEN)
    best = min(medians, key=lambda name: medians[name])
    is_sound = declared is not None and declared < max(2 * medians[best], _SOUND_SHARE * distance)
    if is_sound or medians[best] > _FITTING_SHARE * distance:
        return medians, None
    was = "no overlap" if declared is None else f"{declared * 1000:.0f} mm"
    alike = [name for name, error in medians.items() if error < _CLEARLY * medians[best]]
    return medians, POSE_CONVENTION_SUSPECT.warning(
        "the poses are probably {alike}: so taken, the depth of one frame meets another's to {best_mm:.0f} "
        "mm, as given to {given}",
        alike=", or ".join(alike),
        best_mm=1000 * medians[best],
        given=was,
    )


def pose_doubts(frames: Sequence[Frame]) -> None:
    """Carry surfaces from frame to frame by the poses as given; warn when patches lie off as a whole.

    Parameters
    ----------
    frames : with depth and poses; those without a pose are left out.
    """
    frames, poses = _posed(frames)
    shares = []
    for (i, first), (k, second) in _couples(frames):
        points = _points(first, frames[i].camera)
        meets = _meeting(points, inverted(poses[k]) @ poses[i], second, frames[k].camera)
        if len(meets) > _LEAST_OVERLAP * len(points):
            shares += _off_in_patches(meets)
    usual = float(np.median(shares)) if shares else 0.0
    if usual > _INEXACT_SHARE:
        emit(
            POSE_INEXACT.warning(
                "by the poses, surfaces of one frame lie {share:.1%} of their distance off another's "
                "(median): they are inexact",
                remedy=("register.enabled=true with register.refine=true brings them nearer by the surfaces"),
                share=usual,
            )
        )


def _off_in_patches(meets: NDArray[np.float64]) -> list[float]:
    """Return how far patches lie off, as shares of their distance, from points as `_meeting` returns them."""
    column, row, distance, off = meets.T
    near = np.abs(off) < _NEAR_SHARE * distance
    patch = (row // _PATCH) * 10_000 + column // _PATCH
    each = [near & (patch == one) for one in np.unique(patch[near])]
    return [
        abs(float(np.median(off[here] / distance[here])))
        for here in each
        if np.count_nonzero(here) >= _LEAST_POINTS
    ]


def check_scale(frames: Sequence[Frame], scales: Iterable[float]) -> Diagnostic | None:
    """Reproject depth from frame to frame in each of several units; return a warning if another one fits.

    Parameters
    ----------
    frames : with depth and metric poses between which the camera moves; those without a pose are left out.
    scales : units a metre that depth files use.
    """
    frames, poses = _posed(frames)
    couples = _couples(frames)
    if not couples:
        return None
    declared = frames[0].depth_scale

    def misfit(units: float) -> float | None:
        return _misfit_share(frames, poses, couples, units)

    given = misfit(1.0)
    if given is not None and given < _SOUND_SCALE_SHARE:
        return None
    found = {
        other: share
        for other in scales
        if other != declared and (share := misfit(other / declared)) is not None
    }
    best = min(found, key=lambda other: found[other], default=declared)
    if best == declared or found[best] > min(_FITTING_SCALE_SHARE, (given or 1) / 2):
        return None
    if sum(share < _CLEARLY * found[best] for share in found.values()) > 1:
        return None  # The camera moves too little to tell them apart.
    was = "no overlap" if given is None else f"{given:.1%}"
    return SCALE_DEPTH_UNIT_SUSPECT.warning(
        "depth and poses fit together with scan.depth_scale={best:g}: so taken, depth of one frame meets "
        "another's to {share:.1%} of the distance, with {declared:g} units a metre to {was}",
        best=best,
        share=found[best],
        declared=declared,
        was=was,
    )


def _misfit_share(
    frames: Sequence[Frame], poses: Sequence[Pose], couples: Sequence[_Couple], units: float
) -> float | None:
    """Return the median depth error as a share of the depth if a metre were so many times the units it is.

    None where the frames do not overlap.
    """
    shares = []
    for (i, first), (k, second) in couples:
        points = _points(first, frames[i].camera)
        given = inverted(poses[k]) @ poses[i]
        # As if the camera had moved farther, instead of depth being less.
        given[:3, 3] *= units
        errors = _depth_errors(points, given, second, frames[k].camera)
        if errors.size > _LEAST_OVERLAP * len(points):
            shares.append(float(np.median(errors)) / float(np.median(points[:, 2])))
    return float(np.median(shares)) if len(shares) > len(couples) / 2 else None


def report_pairs(pairs: Sequence[tuple[ColorImage | None, ColorImage | None]], rig: StereoRig) -> None:
    """Match features of left and right; warn if their rows differ though rectified, or left is right."""
    moves = [_feature_moves(left, right) for left, right in pairs if left is not None and right is not None]
    found = np.concatenate(moves) if moves else np.empty((0, 2))
    if len(found) < 50:
        return
    # With an offset between the centres, disparity may rightly be negative.
    disparity = float(np.median(found[:, 0])) + rig.right.cx - rig.left.cx
    row = float(np.median(np.abs(found[:, 1])))
    if disparity < 0:
        emit(
            DEPTH_PAIR_SWAPPED.warning(
                "left and right seem exchanged: the median disparity is {disparity:.1f} px",
                disparity=disparity,
            )
        )
    if rig.rectified and row > 0.5:
        emit(
            DEPTH_PAIR_ROWS_DIFFER.warning(
                "the pairs are said to be rectified, but matched features differ by {rows:.1f} rows", rows=row
            )
        )


def _couples(frames: Sequence[Frame]) -> list[_Couple]:
    """Read a few couples of frames some way apart, so that the camera has moved between them."""
    step = max(1, len(frames) // 25)
    last = len(frames) - 1 - step
    if last < 0:
        return []
    starts = sample_evenly(last + 1, _COUPLES)
    couples = []
    for i in starts:
        first, second = (_depth_or_none(frames[place]) for place in (i, i + step))
        if first is not None and second is not None:
            couples.append(((i, first), (i + step, second)))
    return couples


def _depth_or_none(frame: Frame) -> DepthImage | None:
    try:
        return read_depth(frame)
    except InputError:
        return None


def _posed(frames: Sequence[Frame]) -> tuple[Sequence[Frame], list[Pose]]:
    """Return the frames that have a pose, and their poses."""
    posed = [frame for frame in frames if frame.world_from_camera is not None]
    return posed, [frame.world_from_camera for frame in posed if frame.world_from_camera is not None]


def _points(depth: DepthImage, camera: Camera) -> NDArray[np.float64]:
    """Return (n, 3) points in the camera's axes from every eighth pixel that has depth."""
    rows, columns = np.mgrid[4 : depth.shape[0] : 8, 4 : depth.shape[1] : 8]
    z = depth[rows, columns].astype(np.float64)
    points: NDArray[np.float64] = unproject(columns, rows, z, camera)[z > 0]
    return points


def _depth_errors(
    points: NDArray[np.float64], second_from_first: Pose, depth: DepthImage, camera: Camera
) -> NDArray[np.float64]:
    """Return how far the depth map lies from each point that falls on it, in metres."""
    return np.asarray(np.abs(_meeting(points, second_from_first, depth, camera)[:, 3]))


def _meeting(
    points: NDArray[np.float64], second_from_first: Pose, depth: DepthImage, camera: Camera
) -> NDArray[np.float64]:
    """Return the points that fall on depth of a map, (n, 4): column, row, distance, how far it is behind."""
    moved = points @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    moved = moved[moved[:, 2] > 0.05]
    columns, rows = map(np.rint, project(moved, camera))
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    seen = depth[rows[inside].astype(int), columns[inside].astype(int)]
    distance = moved[inside, 2]
    found = np.stack([columns[inside], rows[inside], distance, seen - distance], axis=1)
    return np.asarray(found[seen > 0])


def _feature_moves(left: ColorImage, right: ColorImage) -> NDArray[np.float64]:
    """Return (n, 2) left minus right positions of features that match both ways, in pixels."""
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
