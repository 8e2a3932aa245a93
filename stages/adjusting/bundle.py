"""Cameras that fit what views have matched: poses alone, with the colour camera, with rolling shutters.

Which of these is judged on other points.
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

# Every fifth point is held out.
_HELD_OUT = 5
# The colour camera begins as given, and as one that sees more (colour cameras of RGB-D sensors often do).
_ZOOMS = (1.0, 0.9)
# Points that are enough to choose by; turns of looking depth up and steps between.
_FEW, _TURNS, _STEPS = 1500, 4, 3
# A colour camera of its own must leave less than this share of the error that nine tenths of the points stay
# below: a wrong lens is off most at the border of the image.
_BETTER_CAMERA, _MOST = 0.8, 90
# Cameras that turn while rows are read must leave less than this share of it; that is worth a try only where
# less than another is left by each camera alone, while points stay.
_BETTER_TURNS, _PROMISING = 0.8, 0.85
# Matches that land farther off than this, once cameras fit, are wrong.
_WRONG_PX = 8.0


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras that were found.

    Attributes
    ----------
    cameras : of all views.
    has_camera : the colour camera was adjusted, too.
    has_turns : so was how cameras turn while rows are read.
    before, after : (n,) pixels, transfer errors of held-out matches that are measured both times.
    points : that were adjusted, by (n,) tracks.
    seen : (m,) observations of each view.
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
    """Adjust cameras to matches.

    Parameters
    ----------
    given : to begin with.
    found : all matches that a motion explains.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    camera : adjust the colour camera: True, False, or None where it is clearly better on held-out points.
    shutter : the same for how cameras turn while rows are read.
    outlined : moves the colour camera of cameras to where outlines say that it is, and says what holds it
        there; where that is not clear, it does neither.
    tell : called after each of five parts of the work.

    Returns
    -------
    Bundle, or None if too few points are seen by three views.
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
    # With cameras that nearly fit, wrong matches are told from right ones, and right ones from wrong ones.
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
    """Return matches without those that share a keypoint with what is held out."""
    most = int(max(rest.points.max(initial=0), judged.points.max(initial=0))) + 1
    held = np.unique(judged.couples * most + judged.points)
    shared = np.asarray(np.isin(rest.couples * most + rest.points, held).any(axis=1))
    return rest.take(~shared)


def _ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return what share of one's error the other has, of matches that both measure."""
    both = ~(np.isnan(one) | np.isnan(other))
    if not both.any():
        return np.inf
    return float(np.percentile(other[both], _MOST) / np.percentile(one[both], _MOST))


class Measured(NamedTuple):
    """What all fits have in common.

    Attributes
    ----------
    views : what was seen, and how deep.
    given : their cameras.
    surfaces : of couples of views, which are to meet.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    """

    views: Sequence[View]
    given: Cameras
    surfaces: Surfaces
    pose_prior: NDArray[np.float64]


def solved(
    measured: Measured, start: Cameras, train: Tracks, frees: Frees, anchor: Anchor | None = None
) -> Cameras:
    """Return the cameras of least cost, by turns of looking up depth and stepping."""
    begun = _begun(measured, start, train, frees, anchor)
    if begun is None:
        return start
    problem, state = begun
    for _ in range(_TURNS):
        problem = problem.looked_up(measured.views, state)
        state = solve(problem, state, _STEPS)
    return state.cameras


def _each_alone(measured: Measured, start: Cameras, train: Tracks) -> Cameras:
    """Return cameras that turn while rows are read, each fitted alone to points where they are measured."""
    begun = _begun(measured._replace(surfaces=Surfaces.none()), start, train, Frees(turns=True))
    return start if begun is None else resected(measured.views, *begun, _STEPS)[1].cameras


def _begun(
    measured: Measured, start: Cameras, train: Tracks, frees: Frees, anchor: Anchor | None = None
) -> tuple[Problem, State] | None:
    """Return the problem, and points at the means of where views measure them; None if none is measured."""
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
