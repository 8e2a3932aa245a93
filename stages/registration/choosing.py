"""Selection of poses by points that were held out from their estimation."""

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

# Minimum number of loops for a test of loops against each other.
_FEW_LOOPS = 6
# Median transfer error of loops along the chain, pixels, below which the chain does not need loops. Medians
# within this factor count as equal: about a thousand points give no better precision.
_AGREED_PX, _SAME = 1.0, 1.02
# Maximum rise of the transfer error along the chain that loops may cause: a factor, plus pixels.
_BENT_SHARE, _BENT_PX = 2.0, 0.25
# Minimum relative decrease of the error for better poses. With fewer held-out points than this, the overlap
# of surfaces is compared instead.
_BETTER, _POINTS = 0.02, 50
# Minimum relative decrease of the error for poses that are not tied to the given ones.
_CLEARLY = 0.5
# Approximate number of key-frame pairs whose surface overlap is measured.
_COUPLES = 40
# Rotation and translation in a step, each with the minimum standard deviation of given poses, radians and
# metres.
_LEAST = ((slice(0, 3), 1e-4), (slice(3, 6), 1e-4))


@dataclass(frozen=True, eq=False)
class Placed:
    """Selected poses, with the edges of the pose graph.

    Attributes
    ----------
    poses : world_from_camera by frame index; each connected component has a separate world.
    used, wrong : accepted and rejected edges.
    idle : loops left out because they do not improve the agreement.
    """

    poses: dict[int, Pose]
    used: list[Edge]
    wrong: list[Edge]
    idle: list[Edge] = field(default_factory=list)


def placed(
    chain: Chain, groups: Sequence[Sequence[int]], edges: Sequence[Edge], given: Mapping[int, Pose]
) -> Placed:
    """Compute the poses of all frames; keep given poses unless improved.

    Parameters
    ----------
    chain : odometry with key frames.
    groups : indices of the key frames in each connected component.
    edges : motions between key frames.
    given : world_from_camera by frame index; may be empty.
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
    """Find loops that do not improve an unbroken chain, or contradict it.

    The loops are split into two halves, and each half is tested on the points of the other half.

    Returns
    -------
    idle : loops whose points agree without loop closure, while closing them makes other points worse.
    false : loops that bend the chain until its own points disagree.
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
    """Create edges that tie key frames to their given poses.

    Each edge starts at the first key frame of its component with a given pose. Its weight follows from the
    difference between given and estimated steps.
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
    """Select the best of given, refined and freely estimated poses.

    `near` is tied to the given poses; `free` is not, and must be clearly better than `near`. If the selected
    poses are not better than the given ones, the given poses stay, with a warning.
    """
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
    if found < (1 - _BETTER) * as_given:
        return best
    message = (
        "refined poses are not better, so the given poses are kept: the median error of held-out points is "
        "{found:.2f} px, with the given poses {given:.2f} px"
        if are_enough
        else "refined poses are not better, so the given poses are kept: {found:.1%} of the surfaces do not "
        "overlap, with the given poses {given:.1%}"
    )
    emit(REGISTER_NOT_BETTER.warning(message, found=found, given=as_given))
    return Placed(_completed(chain, groups, given, free.poses), free.used, free.wrong)


def _completed(
    chain: Chain, groups: Sequence[Sequence[int]], given: Mapping[int, Pose], found: Mapping[int, Pose]
) -> dict[int, Pose]:
    """Complete the given poses with estimated poses of the other frames.

    Frames without a given pose keep their estimated motion relative to the nearest given frame of their
    component.
    """
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
    """Compute the transfer errors (n,) of the held-out points of edges, pixels."""
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
    """Compute the mean surface overlap of key frames that are two apart."""
    couples = [(a, b) for a, b in zip(chain.keys, chain.keys[2:], strict=False) if a in known and b in known]
    couples = couples[:: max(len(couples) // _COUPLES, 1)]
    shares = [
        meeting(chain.views.view(b), chain.views.view(a), inverted(poses[a]) @ poses[b]) for a, b in couples
    ]
    return float(np.mean(shares)) if shares else 0.0
