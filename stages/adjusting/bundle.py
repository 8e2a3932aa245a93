"""Camera fits to matches: poses alone, with the colour camera, with rolling shutter.

Held-out tracks decide which model is used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.anchor import Anchor
from scanloom.stages.adjusting.cameras import FREE, Cameras
from scanloom.stages.adjusting.lifting import in_world, lifted
from scanloom.stages.adjusting.matching import GAP_SHARE, Matches, errors, gaps
from scanloom.stages.adjusting.problem import Frees, Problem, State
from scanloom.stages.adjusting.resection import resected
from scanloom.stages.adjusting.solve import solve
from scanloom.stages.adjusting.surfaces import Surfaces
from scanloom.stages.adjusting.tracks import Tracks, tracks
from scanloom.stages.adjusting.view import View

# One of this many tracks is held out.
_HELD_OUT = 5
# Initial focal lengths of the colour camera, relative to the given one. Colour cameras of RGB-D sensors often
# have a wider field of view than the scan states.
_ZOOMS = (1.0, 0.9)
# Approximate number of tracks in the fits that select a model; rounds of depth lookup, and solver steps in
# each round.
_FEW, _TURNS, _STEPS = 1500, 4, 3
# Maximum error ratio for accepting a fitted colour camera, at this percentile of the transfer error. The
# percentile is high because a wrong lens shows most at the image border.
_BETTER_CAMERA, _MOST = 0.8, 90
# Maximum error ratio for accepting rolling-shutter rotations, at the same percentile. The fit is only tried
# if the cheaper fit of single views to fixed points reaches the second ratio.
_BETTER_TURNS, _PROMISING = 0.8, 0.85
# Transfer error above which a match is an outlier, after a first fit of the cameras, pixels.
_WRONG_PX = 8.0


@dataclass(frozen=True, eq=False)
class Bundle:
    """Result of the bundle adjustment.

    Attributes
    ----------
    cameras : adjusted cameras of all m views.
    has_camera : the colour camera was adjusted.
    has_turns : rolling-shutter rotations were adjusted.
    before, after : (n,) transfer errors of the held-out matches that have an error in both cases, pixels.
    points : number of adjusted points.
    seen : (m,) number of observations in each view.
    """

    cameras: Cameras
    has_camera: bool
    has_turns: bool
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    points: int
    seen: NDArray[np.intp]


def bundle(
    views: Sequence[View],
    given: Cameras,
    found: Matches,
    pose_prior: NDArray[np.float64],
    camera: bool | None,
    shutter: bool | None,
    outlined: Callable[[Cameras], tuple[Cameras, Anchor | None]],
    tell: Callable[[], object],
) -> Bundle | None:
    """Fit cameras to matches by bundle adjustment.

    Parameters
    ----------
    views : keypoints and depth of m views.
    given : initial cameras of the views.
    found : matches that satisfy the epipolar geometry.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    camera : fit the colour camera; None accepts it only if held-out points become clearly better.
    shutter : fit rolling-shutter rotations; None as for `camera`.
    outlined : corrects a fitted colour camera by silhouettes and returns it with a prior. If the offset is
        unclear, it returns the cameras unchanged and None.
    tell : called after each of five parts of the work.

    Returns
    -------
    Bundle, or None if there are too few tracks.
    """
    near = gaps(views, given, found) < GAP_SHARE
    joined = tracks(views, found.take(near))
    if joined.count < 2 * _HELD_OUT:
        return None
    held = np.arange(joined.count) % _HELD_OUT == 0
    of_held = np.zeros(len(found), bool)
    of_held[np.flatnonzero(near)] = np.where(joined.matched >= 0, held[joined.matched], False)
    judged = found.take(of_held)

    surfaces = Surfaces.of(views, np.unique(found.couples, axis=0))
    measured = Measured(views, given, surfaces, pose_prior)
    fitted = partial(solved, measured)

    def off(cameras: Cameras) -> NDArray[np.float64]:
        return errors(views, cameras, judged)

    train = joined.of(~held)
    few = train.of(np.arange(train.count) % max(train.count // _FEW, 1) == 0)
    best = given if camera else fitted(given, few, Frees())
    has_camera = has_turns = False
    tell()
    if camera or camera is None:
        for number, zoom in enumerate(_ZOOMS):
            other = fitted(given.zoomed(zoom), few, Frees(camera=True))
            needed = 1.0 if has_camera else _BETTER_CAMERA
            if (camera and number == 0) or _ratio(off(best), off(other)) < needed:
                best, has_camera = other, True
            tell()
    may_turn = shutter is None and _ratio(off(best), off(_each_alone(measured, best, few))) < _PROMISING
    if shutter or may_turn:
        other = fitted(best, few, Frees(has_camera, turns=True))
        if shutter or _ratio(off(best), off(other)) < _BETTER_TURNS:
            best, has_turns = other, True
    tell()
    # Fitted cameras separate inliers from outliers better than epipolar geometry, so tracks are built again.
    rest = found.take(~of_held)
    rest = rest.take(np.flatnonzero(errors(views, best, rest) < _WRONG_PX))
    train = tracks(views, _without_held(rest, judged))
    if not train.count:
        return None
    best, anchor = outlined(best) if has_camera else (best, None)
    best = fitted(best, train, Frees(has_camera, has_turns), anchor)
    tell()
    before, after = off(given), off(best)
    both = ~(np.isnan(before) | np.isnan(after))
    return Bundle(
        cameras=best,
        has_camera=has_camera,
        has_turns=has_turns,
        before=before[both],
        after=after[both],
        points=train.count,
        seen=np.bincount(train.view, minlength=len(views)),
    )


def _without_held(rest: Matches, judged: Matches) -> Matches:
    """Drop matches that share a keypoint with a held-out match."""
    most = int(max(rest.points.max(initial=0), judged.points.max(initial=0))) + 1
    held = np.unique(judged.couples * most + judged.points)
    shared = np.asarray(np.isin(rest.couples * most + rest.points, held).any(axis=1))
    return rest.take(~shared)


def _ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Compute the error ratio other / one, at the percentile `_MOST`.

    Only matches with an error in both are compared; infinity without any.
    """
    both = ~(np.isnan(one) | np.isnan(other))
    if not both.any():
        return np.inf
    return float(np.percentile(other[both], _MOST) / np.percentile(one[both], _MOST))


class Measured(NamedTuple):
    """Input that all fits share.

    Attributes
    ----------
    views : keypoints and depth of m views.
    given : cameras of the views as given, the centre of the pose prior.
    surfaces : surface points of frame pairs, for point-to-plane residuals.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    """

    views: Sequence[View]
    given: Cameras
    surfaces: Surfaces
    pose_prior: NDArray[np.float64]


def solved(
    measured: Measured, start: Cameras, train: Tracks, frees: Frees, anchor: Anchor | None = None
) -> Cameras:
    """Fit cameras by alternating depth lookup and solver steps.

    Returns `start` if no track has a measured depth.
    """
    begun = _begun(measured, start, train, frees, anchor)
    if begun is None:
        return start
    problem, state = begun
    for _ in range(_TURNS):
        problem = problem.looked_up(measured.views, state)
        state = solve(problem, state, _STEPS)
    return state.cameras


def _each_alone(measured: Measured, start: Cameras, train: Tracks) -> Cameras:
    """Fit pose and readout rotation of each view alone, to fixed points."""
    begun = _begun(measured._replace(surfaces=Surfaces.none()), start, train, Frees(turns=True))
    return start if begun is None else resected(measured.views, *begun, _STEPS)[1].cameras


def _begun(
    measured: Measured, start: Cameras, train: Tracks, frees: Frees, anchor: Anchor | None = None
) -> tuple[Problem, State] | None:
    """Set up the problem, with points at the mean of their measurements.

    Returns None if no track has a measured depth.
    """
    views, given, surfaces, pose_prior = measured
    places = in_world(start, train.view, lifted(views, start, train.view, train.pixels), train.late)
    known = ~np.isnan(places[:, 0])
    counts = np.bincount(train.point[known], minlength=train.count)
    if not counts.any():
        return None
    sums = [np.bincount(train.point[known], places[known, axis], minlength=train.count) for axis in range(3)]
    means = np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]
    train = train.of(counts > 0)
    problem = Problem.of(
        train,
        given.poses,
        pose_prior,
        surfaces=surfaces,
        frees=frees,
        width=views[0].size[0],
        anchor=anchor,
    )
    return problem, State(start, means[counts > 0], np.zeros(FREE))
