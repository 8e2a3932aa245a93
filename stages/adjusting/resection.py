"""Poses of frames between key frames: each is placed alone, to points that the key frames around it have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import FREE, Cameras, inverted_all
from stages.adjusting.lifting import in_world, lifted
from stages.adjusting.matching import match
from stages.adjusting.problem import Problem, State
from stages.adjusting.tracks import Tracks
from stages.adjusting.view import View, view_or_none
from stages.scans.prefetch import read_ahead, workers
from stages.scans.scan import Frame, SkippedFrame

# Fewer points do not place a frame; steps; pixels that a point may be off in the end.
_LEAST, _STEPS, _OFF_PX = 30, 12, 4.0
# Key views that a frame between them is placed to.
_AROUND = 4


def placed_between(
    frames: Sequence[Frame],
    places: Sequence[int],
    keys: Mapping[int, View],
    given: Cameras,
    cameras: Cameras,
    pose_prior: NDArray[np.float64],
) -> Iterator[tuple[int, NDArray[np.float64] | SkippedFrame | None]]:
    """Give the pose of each frame at these places, why it cannot be used, or None if it cannot be placed.

    Parameters
    ----------
    keys : the views of key frames by their places.
    given, cameras : of these, as they were and adjusted.
    pose_prior : (6,) standard deviations of a given pose, metres and radians.
    """
    numbers, views = np.array(list(keys)), list(keys.values())

    def place_one(place: int) -> NDArray[np.float64] | SkippedFrame | None:
        view = view_or_none(frames[place])
        if isinstance(view, SkippedFrame):
            return view
        order = np.argsort(np.abs(numbers - place), kind="stable")
        nearest, around = order[:1], np.sort(order[:_AROUND])
        # It stands to the nearest key frame as before.
        was = Cameras.given([frames[place]], [view.lens]).poses
        expected = cameras.poses[nearest] @ inverted_all(given.poses[nearest]) @ was
        alone = Cameras(expected, cameras.lenses[nearest], cameras.color_from_depth[nearest])
        near = Cameras(cameras.poses[around], cameras.lenses[around], cameras.color_from_depth[around])
        return _placed(view, alone, [views[n] for n in around], near, pose_prior)

    threads = workers()
    yield from zip(places, read_ahead(place_one, places, threads=threads, ahead=threads + 2), strict=True)


def _placed(
    view: View,
    one: Cameras,
    keys: Sequence[View],
    cameras: Cameras,
    pose_prior: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return the pose (4, 4) of a view from what it matches in a few key views; None if that is too little.

    Parameters
    ----------
    one : of the view: the pose that is expected, the adjusted colour camera.
    cameras : of the key views, adjusted.
    pose_prior : (6,) standard deviations of the expected pose, metres and radians.
    """
    views = [*keys, view]
    last = len(keys)
    found = match(views, [(number, last) for number in range(last)])
    there, here = found.pixels(views)
    points = in_world(cameras, found.couples[:, 0], lifted(keys, cameras, found.couples[:, 0], there))
    known = ~np.isnan(points[:, 0])
    points, here = points[known], here[known]
    if len(points) < _LEAST:
        return None
    count = len(points)
    tracks = Tracks(np.zeros(count, np.intp), np.arange(count), here, np.zeros(0, np.intp))
    problem = Problem.of(tracks, one.poses, pose_prior)
    state = State(one, points, np.zeros(FREE))
    still = np.zeros_like(points)
    for _ in range(_STEPS):
        problem = problem.looked_up([view], state)
        linear = problem.linear(state)
        rows = linear.by_pose.reshape(-1, 6)
        normal = np.einsum("ni,nj->ij", rows, rows) + np.diag(linear.pose_weights)
        towards = -np.einsum("ni,n->i", rows, linear.residuals.reshape(-1)) - linear.poses[0]
        state = state.moved(np.linalg.solve(normal, towards)[None], np.zeros(FREE), still)
    near = np.count_nonzero(problem.pixels_off(state) < _OFF_PX)
    return state.cameras.poses[0] if near >= _LEAST else None
