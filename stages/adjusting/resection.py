"""Localisation of frames between key frames, by matches with the nearest key frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import CAMERA_PARAMETER_COUNT, Cameras, invert_poses
from scanloom.stages.adjusting.matching import match_views
from scanloom.stages.adjusting.problem import AdjustmentProblem, AdjustmentState, FreeParameters
from scanloom.stages.adjusting.rolling_shutter import compute_readout_times
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.unprojection import transform_to_world, unproject_pixels
from scanloom.stages.adjusting.view import AdjustmentView, read_view_or_reason
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, SkippedFrame

# Minimum number of matched points and of inliers, solver steps, and maximum error of an inlier in pixels.
_MIN_POINTS, _STEP_COUNT, _INLIER_PX = 30, 12, 4.0
# Number of nearest key views to match.
_NEIGHBOUR_COUNT = 4


class LocalisedFrame(NamedTuple):
    """Pose (4, 4) world_from_camera, and rotation during readout (3,), of a localised frame."""

    pose: NDArray[np.float64]
    readout_rotation: NDArray[np.float64]


def localise_between_key_frames(
    frames: Sequence[Frame],
    frame_indices: Sequence[int],
    key_views: Mapping[int, AdjustmentView],
    given_cameras: Cameras,
    cameras: Cameras,
    pose_prior: NDArray[np.float64],
    free: FreeParameters,
) -> Iterator[tuple[int, LocalisedFrame | SkippedFrame | None]]:
    """Localise frames between the adjusted key frames.

    Yields the index and the pose of each frame. Unusable frames have the reason instead of the pose; frames
    with too few matches have None.

    Parameters
    ----------
    frames : frames of the scan.
    frame_indices : indices of the frames to localise.
    key_views : views of the key frames by frame index.
    given_cameras, cameras : cameras of the key frames, before and after adjustment.
    pose_prior : (6,) standard deviations of the expected poses, metres and radians.
    free : optional unknowns of the adjustment of the key frames.
    """
    numbers, views = np.array(list(key_views)), list(key_views.values())

    def localise_one(place: int) -> LocalisedFrame | SkippedFrame | None:
        view = read_view_or_reason(frames[place])
        if isinstance(view, SkippedFrame):
            return view
        order = np.argsort(np.abs(numbers - place), kind="stable")
        nearest, around = order[:1], np.sort(order[:_NEIGHBOUR_COUNT])
        # The expected pose keeps the given motion relative to the nearest key frame.
        was = Cameras.from_frames([frames[place]], [view.lens])
        expected = cameras.poses[nearest] @ invert_poses(given_cameras.poses[nearest]) @ was.poses
        alone = replace(cameras.select(nearest), poses=expected, readout_rotations=was.readout_rotations)
        return _localise_view(
            view, alone, [views[n] for n in around], cameras.select(around), pose_prior, free
        )

    threads = get_worker_count()
    yield from zip(
        frame_indices,
        map_ordered(localise_one, frame_indices, threads=threads, max_pending=threads + 2),
        strict=True,
    )


def _localise_view(
    view: AdjustmentView,
    initial: Cameras,
    key_views: Sequence[AdjustmentView],
    key_cameras: Cameras,
    pose_prior: NDArray[np.float64],
    free: FreeParameters,
) -> LocalisedFrame | None:
    """Localise a view by matches with a few key views.

    Returns None if too few points match.

    Parameters
    ----------
    view : view to localise.
    initial : its camera: expected pose, adjusted colour camera.
    key_views : key views.
    key_cameras : adjusted cameras of the key views.
    pose_prior : (6,) standard deviations of the expected pose, metres and radians.
    free : optional unknowns; the colour camera stays fixed.
    """
    views = [*key_views, view]
    last = len(key_views)
    found = match_views(views, [(number, last) for number in range(last)])
    there, here = found.get_pixels(views)
    keyed = found.pair_indices[:, 0]
    points = transform_to_world(
        key_cameras,
        keyed,
        unproject_pixels(key_views, key_cameras, keyed, there),
        compute_readout_times(key_views, keyed, there),
    )
    known = ~np.isnan(points[:, 0])
    points, here = points[known], here[known]
    if len(points) < _MIN_POINTS:
        return None
    count = len(points)
    alone = np.zeros(count, np.intp)
    tracks = Tracks(
        alone, np.arange(count), here, compute_readout_times([view], alone, here), np.zeros(0, np.intp)
    )
    problem = AdjustmentProblem.from_tracks(
        tracks, initial.poses, pose_prior, free=FreeParameters(shutter=free.shutter)
    )
    problem, state = fit_poses_separately(
        [view], problem, AdjustmentState(initial, points, np.zeros(CAMERA_PARAMETER_COUNT)), _STEP_COUNT
    )
    near = np.count_nonzero(problem.compute_reprojection_errors(state) < _INLIER_PX)
    return (
        LocalisedFrame(state.cameras.poses[0], state.cameras.readout_rotations[0])
        if near >= _MIN_POINTS
        else None
    )


def fit_poses_separately(
    views: Sequence[AdjustmentView], problem: AdjustmentProblem, state: AdjustmentState, steps: int
) -> tuple[AdjustmentProblem, AdjustmentState]:
    """Fit the pose of each view alone, with fixed points.

    Gauss-Newton with depth looked up in every step. Returns the problem with updated planes, and the state.
    """
    still, count = np.zeros_like(state.points), len(views)
    order = np.argsort(problem.tracks.view_indices, kind="stable")
    used, starts = np.unique(problem.tracks.view_indices[order], return_index=True)
    for _ in range(steps):
        problem = problem.update_planes(views, state)
        linear = problem.linearise(state)
        by_pose = linear.by_pose[order]
        size = by_pose.shape[2]
        normal = np.tile(np.diag(linear.pose_weights), (count, 1, 1))
        normal[used] += np.add.reduceat(by_pose.swapaxes(1, 2) @ by_pose, starts, axis=0)
        towards = -np.broadcast_to(linear.pose_gradient, (count, size)).copy()
        off = np.einsum("nri,nr->ni", by_pose, linear.residuals[order])
        towards[used] -= np.add.reduceat(off, starts, axis=0)
        state = state.apply_step(
            np.linalg.solve(normal, towards[..., None])[..., 0], np.zeros(CAMERA_PARAMETER_COUNT), still
        )
    return problem, state
