"""Selection of poses by points that were held out from their estimation."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.registration.codes import REGISTER_NOT_BETTER
from scanloom.stages.registration.component_poses import estimate_component_poses
from scanloom.stages.registration.matched_points import decompose_motion
from scanloom.stages.registration.motion import Motion
from scanloom.stages.registration.odometry_chain import OdometryChain
from scanloom.stages.registration.pose_graph import PoseGraphEdge, find_components
from scanloom.stages.registration.surface_alignment import compute_overlap
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Pose

# Minimum number of loops for a test of loops against each other.
_MIN_LOOPS = 6
# Median transfer error of loops along the chain, pixels, below which the chain does not need loops. Medians
# within this factor count as equal: about a thousand points give no better precision.
_MAX_LOOP_ERROR_PX, _EQUAL_FACTOR = 1.0, 1.02
# Maximum rise of the transfer error along the chain that loops may cause: a factor, plus pixels.
_MAX_BEND_FACTOR, _MAX_BEND_PX = 2.0, 0.25
# Minimum relative decrease of the error for better poses. With fewer held-out points than this, the overlap
# of surfaces is compared instead.
_MIN_GAIN_RATIO, _MIN_POINTS = 0.02, 50
# Minimum relative decrease of the error for poses that are not tied to the given ones.
_MIN_FREE_GAIN_RATIO = 0.5
# Approximate number of key-frame pairs whose surface overlap is measured.
_PAIR_COUNT = 40
# Rotation and translation in a step, each with the minimum standard deviation of given poses, radians and
# metres.
_MIN_SIGMAS = ((slice(0, 3), 1e-4), (slice(3, 6), 1e-4))


@dataclass(frozen=True, eq=False)
class PoseSolution:
    """Selected poses, with the edges of the pose graph.

    Attributes
    ----------
    poses : world_from_camera by frame index; each connected component has a separate world.
    accepted, rejected : accepted and rejected edges.
    idle_loops : loops left out because they do not improve the agreement.
    """

    poses: dict[int, Pose]
    accepted: list[PoseGraphEdge]
    rejected: list[PoseGraphEdge]
    idle_loops: list[PoseGraphEdge] = field(default_factory=list)


def select_poses(
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    edges: Sequence[PoseGraphEdge],
    given_poses: Mapping[int, Pose],
) -> PoseSolution:
    """Compute the poses of all frames; keep given poses unless improved.

    Parameters
    ----------
    chain : odometry with key frames.
    components : indices of the key frames in each connected component.
    edges : motions between key frames.
    given_poses : world_from_camera by frame index; may be empty.
    """
    idle, false = _find_unsound_loops(chain, components, edges)
    kept = _exclude_edges(edges, [*idle, *false])
    found = PoseSolution(*estimate_component_poses(chain, components, kept))
    if given_poses:
        held = _create_prior_edges(chain, components, given_poses, found.poses)
        near = PoseSolution(*estimate_component_poses(chain, components, kept, held))
        found = _choose_best(chain, components, given_poses, near, found)
    return replace(found, rejected=[*found.rejected, *false], idle_loops=idle)


def _find_unsound_loops(
    chain: OdometryChain, components: Sequence[Sequence[int]], edges: Sequence[PoseGraphEdge]
) -> tuple[list[PoseGraphEdge], list[PoseGraphEdge]]:
    """Find loops that do not improve an unbroken chain, or contradict it.

    The loops are split into two halves, and each half is tested on the points of the other half.

    Returns
    -------
    idle : loops whose points agree without loop closure, while closing them makes other points worse.
    false : loops that bend the chain until its own points disagree.
    """
    certain = [edge for edge in edges if edge.is_certain]
    part = {key: i for i, one in enumerate(find_components(len(chain.key_indices), certain)) for key in one}
    along = [edge for edge in edges if not edge.is_certain and part[edge.source] == part[edge.target]]
    if sum(edge.motion.held_out is not None for edge in along) < _MIN_LOOPS:
        return [], []
    rest = _exclude_edges(edges, along)
    unlooped = estimate_component_poses(chain, components, rest)[0]
    straight = _compute_median(_compute_held_out_errors(chain, certain, unlooped))
    with_loops, without, bent = [], [], []
    for half in (0, 1):
        looped = estimate_component_poses(chain, components, [*rest, *along[half::2]])[0]
        bent.append(_compute_held_out_errors(chain, certain, looped))
        if _compute_median(bent[-1]) > _MAX_BEND_FACTOR * straight + _MAX_BEND_PX:
            return [], along
        with_loops.append(_compute_held_out_errors(chain, along[1 - half :: 2], looped))
        without.append(_compute_held_out_errors(chain, along[1 - half :: 2], unlooped))
    apart = _compute_median(np.concatenate(without))
    needed = apart > _MAX_LOOP_ERROR_PX or (
        _compute_median(np.concatenate(with_loops)) <= _EQUAL_FACTOR * apart
        and _compute_median(np.concatenate(bent)) <= _EQUAL_FACTOR * straight
    )
    return ([] if needed else along), []


def _create_prior_edges(
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    given_poses: Mapping[int, Pose],
    estimated: Mapping[int, Pose],
) -> list[PoseGraphEdge]:
    """Create edges that tie key frames to their given poses.

    Each edge starts at the first key frame of its component with a given pose. Its weight follows from the
    difference between given and estimated steps.
    """
    held = []
    for group in components:
        known = [chain.key_indices[key] for key in group if chain.key_indices[key] in given_poses]
        if len(known) < 2:
            continue
        off = [
            decompose_motion(
                invert_pose(_compute_relative_pose(estimated, a, b))
                @ _compute_relative_pose(given_poses, a, b)
            )
            for a, b in itertools.pairwise(known)
        ]
        turn, shift = (
            max(float(np.median(np.abs([one[axes] for one in off]))), least) for axes, least in _MIN_SIGMAS
        )
        information = np.diag([turn**-2] * 3 + [shift**-2] * 3)
        number = dict(zip((chain.key_indices[key] for key in group), group, strict=True))
        for place in known[1:]:
            motion = Motion(_compute_relative_pose(given_poses, known[0], place), information, 1.0, None, 0)
            held.append(PoseGraphEdge(number[place], number[known[0]], motion, is_certain=True))
    return held


def _compute_relative_pose(poses: Mapping[int, Pose], first: int, second: int) -> Pose:
    return invert_pose(poses[first]) @ poses[second]


def _choose_best(
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    given_poses: Mapping[int, Pose],
    refined: PoseSolution,
    unconstrained: PoseSolution,
) -> PoseSolution:
    """Select the best of given, refined and freely estimated poses.

    `refined` is tied to the given poses; `unconstrained` is not, and must be clearly better than `refined`.
    If the selected poses are not better than the given ones, the given poses stay, with a warning.
    """
    known = set(given_poses)
    edges = [
        edge
        for edge in unconstrained.accepted
        if {chain.key_indices[edge.source], chain.key_indices[edge.target]} <= known
    ]
    off = [
        _compute_held_out_errors(chain, edges, one)
        for one in (given_poses, refined.poses, unconstrained.poses)
    ]
    are_enough = len(off[0]) >= _MIN_POINTS
    if are_enough:
        measures = [_compute_median(one) for one in off]
    else:
        measures = [
            1 - _compute_mean_overlap(chain, one, known)
            for one in (given_poses, refined.poses, unconstrained.poses)
        ]
    as_given, near_off, free_off = measures
    best, found = (
        (unconstrained, free_off) if free_off < (1 - _MIN_FREE_GAIN_RATIO) * near_off else (refined, near_off)
    )
    if found < (1 - _MIN_GAIN_RATIO) * as_given:
        return best
    message = (
        "refined poses are not better, so the given poses are kept: the median error of held-out points is "
        "{found:.2f} px, with the given poses {given:.2f} px"
        if are_enough
        else "refined poses are not better, so the given poses are kept: {found:.1%} of the surfaces do not "
        "overlap, with the given poses {given:.1%}"
    )
    emit(REGISTER_NOT_BETTER.warning(message, found=found, given=as_given))
    return PoseSolution(
        _complete_given_poses(chain, components, given_poses, unconstrained.poses),
        unconstrained.accepted,
        unconstrained.rejected,
    )


def _complete_given_poses(
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    given_poses: Mapping[int, Pose],
    estimated: Mapping[int, Pose],
) -> dict[int, Pose]:
    """Complete the given poses with estimated poses of the other frames.

    Frames without a given pose keep their estimated motion relative to the nearest given frame of their
    component.
    """
    piece_of_key = {key: i for i, group in enumerate(components) for key in group}
    piece = {place: piece_of_key[bisect_right(chain.key_indices, place) - 1] for place in estimated}
    poses = {}
    for place, pose in estimated.items():
        beside = [one for one in given_poses if one in estimated and piece[one] == piece[place]]
        if place in given_poses or not beside:
            poses[place] = given_poses.get(place, pose)
        else:
            nearest = min(beside, key=lambda one: abs(one - place))
            poses[place] = given_poses[nearest] @ invert_pose(estimated[nearest]) @ pose
    return poses


def _compute_held_out_errors(
    chain: OdometryChain, edges: Sequence[PoseGraphEdge], poses: Mapping[int, Pose]
) -> NDArray[np.float64]:
    """Compute the transfer errors (n,) of the held-out points of edges, pixels."""
    errors = [np.zeros(0)]
    for edge in edges:
        if edge.motion.held_out is not None:
            source, target = (poses[chain.key_indices[end]] for end in (edge.source, edge.target))
            errors.append(edge.motion.held_out.compute_transfer_errors(invert_pose(target) @ source))
    return np.concatenate(errors)


def _compute_median(errors: NDArray[np.float64]) -> float:
    return float(np.median(errors)) if len(errors) else 0.0


def _exclude_edges(edges: Sequence[PoseGraphEdge], excluded: Sequence[PoseGraphEdge]) -> list[PoseGraphEdge]:
    left = {id(edge) for edge in excluded}
    return [edge for edge in edges if id(edge) not in left]


def _compute_mean_overlap(chain: OdometryChain, poses: Mapping[int, Pose], known: set[int]) -> float:
    """Compute the mean surface overlap of key frames that are two apart."""
    couples = [
        (a, b)
        for a, b in zip(chain.key_indices, chain.key_indices[2:], strict=False)
        if a in known and b in known
    ]
    couples = couples[:: max(len(couples) // _PAIR_COUNT, 1)]
    shares = [
        compute_overlap(chain.views.get_view(b), chain.views.get_view(a), invert_pose(poses[a]) @ poses[b])
        for a, b in couples
    ]
    return float(np.mean(shares)) if shares else 0.0
