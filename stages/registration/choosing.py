"""Which poses are taken: those that points agree with by which they were not found."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.registration.chain import Chain
from scanloom.stages.registration.codes import REGISTER_NOT_BETTER
from scanloom.stages.registration.graph import Edge, pieces
from scanloom.stages.registration.motion import Motion
from scanloom.stages.registration.odometry import meeting
from scanloom.stages.registration.placing import placed_pieces
from scanloom.stages.registration.points import step_of
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Pose

# Fewer loops than this are not asked what they say of each other.
_FEW_LOOPS = 6
# Where the points of loops land this near to their matches without them, the path is not bent, pixels; and
# the times by which a median may be more without being worse: a thousand points tell it no better.
_AGREED_PX, _SAME = 1.0, 1.02
# How much farther off points of the chain may land with loops than without: a share, and pixels.
_BENT_SHARE, _BENT_PX = 2.0, 0.25
# Poses are better where points land nearer by this share, or surfaces meet more; fewer points say nothing.
_BETTER, _POINTS = 0.02, 50
# Poses that leave the given ones altogether must be better by this share.
_CLEARLY = 0.5
# Couples of key frames, next but one to each other, whose surfaces are looked at.
_COUPLES = 40
# The parts of a step, and the least that given poses are off by, radians and metres.
_LEAST = ((slice(0, 3), 1e-4), (slice(3, 6), 1e-4))


@dataclass(frozen=True, eq=False)
class Placed:
    """Poses that were chosen.

    Attributes
    ----------
    poses : world_from_camera by the frame's place; each piece in a world of its own.
    used, wrong : edges.
    idle : loops that are left out, for they make nothing agree better.
    """

    poses: dict[int, Pose]
    used: list[Edge]
    wrong: list[Edge]
    idle: list[Edge] = field(default_factory=list)


def placed(
    chain: Chain, groups: Sequence[Sequence[int]], edges: Sequence[Edge], given: Mapping[int, Pose]
) -> Placed:
    """Return the poses of all frames; of given ones, what is better than these.

    Parameters
    ----------
    groups : numbers of the key frames of each piece.
    given : world_from_camera by the frame's place.
    """
    idle, false = _unsound_loops(chain, groups, edges)
    kept = _without(edges, [*idle, *false])
    found = Placed(*placed_pieces(chain, groups, kept))
    if given:
        held = _held(chain, groups, given, found.poses)
        near = Placed(*placed_pieces(chain, groups, kept, held))
        found = _best(chain, groups, given, near, found)
    return replace(found, wrong=[*found.wrong, *false], idle=idle)


def _unsound_loops(
    chain: Chain, groups: Sequence[Sequence[int]], edges: Sequence[Edge]
) -> tuple[list[Edge], list[Edge]]:
    """Return the loops along an unbroken chain, first those that are idle, then those that are false.

    They are idle if the chain brings their points together as it is, and halves of them bring those of the
    other, or the chain's own, no nearer but farther apart; they are false if they bend the chain until its
    own points are off.
    """
    certain = [edge for edge in edges if edge.is_certain]
    part = {key: i for i, one in enumerate(pieces(len(chain.keys), certain)) for key in one}
    along = [edge for edge in edges if not edge.is_certain and part[edge.source] == part[edge.target]]
    if sum(edge.motion.held is not None for edge in along) < _FEW_LOOPS:
        return [], []
    rest = _without(edges, along)
    unlooped = placed_pieces(chain, groups, rest)[0]
    straight = _median(_errors(chain, certain, unlooped))
    with_loops, without, bent = [], [], []
    for half in (0, 1):
        looped = placed_pieces(chain, groups, [*rest, *along[half::2]])[0]
        bent.append(_errors(chain, certain, looped))
        if _median(bent[-1]) > _BENT_SHARE * straight + _BENT_PX:
            return [], along
        with_loops.append(_errors(chain, along[1 - half :: 2], looped))
        without.append(_errors(chain, along[1 - half :: 2], unlooped))
    apart = _median(np.concatenate(without))
    needed = apart > _AGREED_PX or (
        _median(np.concatenate(with_loops)) <= _SAME * apart
        and _median(np.concatenate(bent)) <= _SAME * straight
    )
    return ([] if needed else along), []


def _held(
    chain: Chain,
    groups: Sequence[Sequence[int]],
    given: Mapping[int, Pose],
    found: Mapping[int, Pose],
) -> list[Edge]:
    """Return edges that hold key frames to where they are given, seen from the first of their piece.

    They hold as firmly as steps from one to the next agree with those that were found.
    """
    held = []
    for group in groups:
        known = [chain.keys[key] for key in group if chain.keys[key] in given]
        if len(known) < 2:
            continue
        off = [
            step_of(inverted(_between(found, a, b)) @ _between(given, a, b))
            for a, b in itertools.pairwise(known)
        ]
        turn, shift = (
            max(float(np.median(np.abs([one[axes] for one in off]))), least) for axes, least in _LEAST
        )
        information = np.diag([turn**-2] * 3 + [shift**-2] * 3)
        number = dict(zip((chain.keys[key] for key in group), group, strict=True))
        for place in known[1:]:
            motion = Motion(_between(given, known[0], place), information, 1.0, None, 0)
            held.append(Edge(number[place], number[known[0]], motion, is_certain=True))
    return held


def _between(poses: Mapping[int, Pose], first: int, second: int) -> Pose:
    return inverted(poses[first]) @ poses[second]


def _best(
    chain: Chain, groups: Sequence[Sequence[int]], given: Mapping[int, Pose], near: Placed, free: Placed
) -> Placed:
    """Return poses better than those given, free of these only if that is clearly better; else these."""
    known = set(given)
    edges = [edge for edge in free.used if {chain.keys[edge.source], chain.keys[edge.target]} <= known]
    off = [_errors(chain, edges, one) for one in (given, near.poses, free.poses)]
    are_enough = len(off[0]) >= _POINTS
    if are_enough:
        measures = [_median(one) for one in off]
    else:
        measures = [1 - _meeting(chain, one, known) for one in (given, near.poses, free.poses)]
    as_given, near_off, free_off = measures
    best, found = (free, free_off) if free_off < (1 - _CLEARLY) * near_off else (near, near_off)
    # What is asked is whether these are better, and not whether others would be.
    if found < (1 - _BETTER) * as_given:
        return best
    message = (
        "the poses found are not better, those given are kept: points that are recognised land {found:.2f} "
        "px from their matches, {given:.2f} px with those given"
        if are_enough
        else "the poses found are not better, those given are kept: {found:.1%} of surfaces do not meet, "
        "{given:.1%} with those given"
    )
    emit(REGISTER_NOT_BETTER.warning(message, found=found, given=as_given))
    return Placed(_completed(chain, groups, given, free.poses), free.used, free.wrong)


def _completed(
    chain: Chain, groups: Sequence[Sequence[int]], given: Mapping[int, Pose], found: Mapping[int, Pose]
) -> dict[int, Pose]:
    """Return given poses, and of frames without one that which was found beside the nearest that has one."""
    piece_of_key = {key: i for i, group in enumerate(groups) for key in group}
    piece = {place: piece_of_key[bisect_right(chain.keys, place) - 1] for place in found}
    poses = {}
    for place, pose in found.items():
        beside = [one for one in given if one in found and piece[one] == piece[place]]
        if place in given or not beside:
            poses[place] = given.get(place, pose)
        else:
            nearest = min(beside, key=lambda one: abs(one - place))
            poses[place] = given[nearest] @ inverted(found[nearest]) @ pose
    return poses


def _errors(chain: Chain, edges: Sequence[Edge], poses: Mapping[int, Pose]) -> NDArray[np.float64]:
    """Return how far held-out points of edges land from their matches, (n,) pixels."""
    errors = [np.zeros(0)]
    for edge in edges:
        if edge.motion.held is not None:
            source, target = (poses[chain.keys[end]] for end in (edge.source, edge.target))
            errors.append(edge.motion.held.transfer_errors(inverted(target) @ source))
    return np.concatenate(errors)


def _median(errors: NDArray[np.float64]) -> float:
    return float(np.median(errors)) if len(errors) else 0.0


def _without(edges: Sequence[Edge], some: Sequence[Edge]) -> list[Edge]:
    left = {id(edge) for edge in some}
    return [edge for edge in edges if id(edge) not in left]


def _meeting(chain: Chain, poses: Mapping[int, Pose], known: set[int]) -> float:
    """Return the share of surfaces that meet, of key frames next but one to each other."""
    couples = [(a, b) for a, b in zip(chain.keys, chain.keys[2:], strict=False) if a in known and b in known]
    couples = couples[:: max(len(couples) // _COUPLES, 1)]
    shares = [
        meeting(chain.views.view(b), chain.views.view(a), inverted(poses[a]) @ poses[b]) for a, b in couples
    ]
    return float(np.mean(shares)) if shares else 0.0
