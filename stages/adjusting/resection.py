"""Localisation of frames between key frames, by matches with the nearest key frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import FREE, Cameras, inverted_all
from scanloom.stages.adjusting.lifting import in_world, lifted
from scanloom.stages.adjusting.matching import match
from scanloom.stages.adjusting.problem import Frees, Problem, State
from scanloom.stages.adjusting.shutter import late_of
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.view import View, view_or_none
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, SkippedFrame

# Minimum number of matched points and of inliers, solver steps, and maximum error of an inlier in pixels.
_LEAST, _STEPS, _OFF_PX = 30, 12, 4.0
# Number of nearest key views to match.
_AROUND = 4


class Placed(NamedTuple):
    """Pose (4, 4) world_from_camera, and rotation during readout (3,), of a localised frame."""

    pose: NDArray[np.float64]
    turn: NDArray[np.float64]


def placed_between(
    frames: Sequence[Frame],
    places: Sequence[int],
    keys: Mapping[int, View],
    given: Cameras,
    cameras: Cameras,
    pose_prior: NDArray[np.float64],
    frees: Frees,
) -> Iterator[tuple[int, Placed | SkippedFrame | None]]:
    """Localise frames between the adjusted key frames.

    Yields the index and the pose of each frame. Unusable frames have the reason instead of the pose; frames
    with too few matches have None.

    Parameters
    ----------
    frames : frames of the scan.
    places : indices of the frames to localise.
    keys : views of the key frames by frame index.
    given, cameras : cameras of the key frames, before and after adjustment.
    pose_prior : (6,) standard deviations of the expected poses, metres and radians.
    frees : optional unknowns of the adjustment of the key frames.
    """
    numbers, views = np.array(list(keys)), list(keys.values())

    def place_one(place: int) -> Placed | SkippedFrame | None:
        view = view_or_none(frames[place])
        if isinstance(view, SkippedFrame):
            return view
        order = np.argsort(np.abs(numbers - place), kind="stable")
        nearest, around = order[:1], np.sort(order[:_AROUND])
        # The expected pose keeps the given motion relative to the nearest key frame.
        was = Cameras.given([frames[place]], [view.lens])
        expected = cameras.poses[nearest] @ inverted_all(given.poses[nearest]) @ was.poses
        alone = replace(cameras.of(nearest), poses=expected, turns=was.turns)
        return _placed(view, alone, [views[n] for n in around], cameras.of(around), pose_prior, frees)

    threads = workers()
    yield from zip(places, read_ahead(place_one, places, threads=threads, ahead=threads + 2), strict=True)


def _placed(
    view: View,
    one: Cameras,
    keys: Sequence[View],
    cameras: Cameras,
    pose_prior: NDArray[np.float64],
    frees: Frees,
) -> Placed | None:
    """Localise a view by matches with a few key views.

    Returns None if too few points match.

    Parameters
    ----------
    view : view to localise.
    one : its camera: expected pose, adjusted colour camera.
    keys : key views.
    cameras : adjusted cameras of the key views.
    pose_prior : (6,) standard deviations of the expected pose, metres and radians.
    frees : optional unknowns; the colour camera stays fixed.
    """
    views = [*keys, view]
    last = len(keys)
    found = match(views, [(number, last) for number in range(last)])
    there, here = found.pixels(views)
    keyed = found.couples[:, 0]
    points = in_world(cameras, keyed, lifted(keys, cameras, keyed, there), late_of(keys, keyed, there))
    known = ~np.isnan(points[:, 0])
    points, here = points[known], here[known]
    if len(points) < _LEAST:
        return None
    count = len(points)
    alone = np.zeros(count, np.intp)
    tracks = Tracks(alone, np.arange(count), here, late_of([view], alone, here), np.zeros(0, np.intp))
    problem = Problem.of(tracks, one.poses, pose_prior, frees=Frees(turns=frees.turns))
    problem, state = resected([view], problem, State(one, points, np.zeros(FREE)), _STEPS)
    near = np.count_nonzero(problem.pixels_off(state) < _OFF_PX)
    return Placed(state.cameras.poses[0], state.cameras.turns[0]) if near >= _LEAST else None


def resected(views: Sequence[View], problem: Problem, state: State, steps: int) -> tuple[Problem, State]:
    """Fit the pose of each view alone, with fixed points.

    Gauss-Newton with depth looked up in every step. Returns the problem with updated planes, and the state.
    """
    still, count = np.zeros_like(state.points), len(views)
    order = np.argsort(problem.tracks.view, kind="stable")
    used, starts = np.unique(problem.tracks.view[order], return_index=True)
    for _ in range(steps):
        problem = problem.looked_up(views, state)
        linear = problem.linear(state)
        by_pose = linear.by_pose[order]
        size = by_pose.shape[2]
        normal = np.tile(np.diag(linear.pose_weights), (count, 1, 1))
        normal[used] += np.add.reduceat(by_pose.swapaxes(1, 2) @ by_pose, starts, axis=0)
        towards = -np.broadcast_to(linear.poses, (count, size)).copy()
        off = np.einsum("nri,nr->ni", by_pose, linear.residuals[order])
        towards[used] -= np.add.reduceat(off, starts, axis=0)
        state = state.moved(np.linalg.solve(normal, towards[..., None])[..., 0], np.zeros(FREE), still)
    return problem, state
