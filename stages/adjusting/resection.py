"""Poses of frames between key frames: each is placed alone, to points that the key frames around it have."""

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

# Fewer points do not place a frame; steps; pixels that a point may be off in the end.
_LEAST, _STEPS, _OFF_PX = 30, 12, 4.0
# Key views that a frame between them is placed to.
_AROUND = 4


class Placed(NamedTuple):
    """Where a frame is, (4, 4) world_from_camera, and how it turns while rows are read, (3,)."""

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
    """Give where each frame at these places is, why it cannot be used, or None if it cannot be placed.

    Parameters
    ----------
    keys : the views of key frames by their places.
    given, cameras : of these, as they were and adjusted.
    pose_prior : (6,) standard deviations of a given pose, metres and radians.
    frees : what was looked for in the key frames.
    """
    numbers, views = np.array(list(keys)), list(keys.values())

    def place_one(place: int) -> Placed | SkippedFrame | None:
        view = view_or_none(frames[place])
        if isinstance(view, SkippedFrame):
            return view
        order = np.argsort(np.abs(numbers - place), kind="stable")
        nearest, around = order[:1], np.sort(order[:_AROUND])
        # It stands to the nearest key frame as before.
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
    """Return where a view is by what it matches in a few key views; None if that is too little.

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
    """Return the state after steps of each view alone, points staying, and the problem with their depth."""
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
