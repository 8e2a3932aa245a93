"""Poses of frames between key frames: each is placed alone, to points that the key frames around it have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import FREE, Cameras, inverted_all
from stages.adjusting.lifting import in_world, lifted
from stages.adjusting.matching import match
from stages.adjusting.problem import Problem, State
from stages.adjusting.tracks import Tracks
from stages.adjusting.view import View

# Fewer points do not place a frame; steps; pixels that a point may be off in the end.
_LEAST, _STEPS, _OFF_PX = 30, 12, 4.0


def placed(
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
    problem = Problem(
        tracks=Tracks(np.zeros(count, np.intp), np.arange(count), here, np.zeros(0, np.intp)),
        normals=np.zeros((count, 3)),
        depths=np.zeros(count),
        deviations=np.ones(count),
        given=one.poses,
        pose_prior=pose_prior,
        frees_camera=False,
        width=view.size[0],
    )
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


def expected(
    given: NDArray[np.float64], keys_given: NDArray[np.float64], keys: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where a frame is if it stands to the nearest key frame as before, (4, 4)."""
    return np.asarray(keys @ inverted_all(keys_given[None])[0] @ given)
