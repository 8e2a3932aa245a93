"""Registration: pose estimation for frames without poses."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.registration.codes import REGISTER_FRAMES_UNUSABLE, REGISTER_NOT_CONNECTED
from scanloom.stages.registration.focal_length import (
    estimate_focal_length,
    has_guessed_camera,
    report_focal_length,
)
from scanloom.stages.registration.focal_length_from_marks import estimate_focal_length_from_marks
from scanloom.stages.registration.loop_closure import find_loop_closures
from scanloom.stages.registration.motion import AlignmentFailure
from scanloom.stages.registration.moving_object import (
    create_object_error,
    detect_moving_object,
    has_moving_object,
    mask_to_object,
)
from scanloom.stages.registration.odometry_chain import OdometryChain, align_key_frames, build_odometry_chain
from scanloom.stages.registration.params import RegisterParams
from scanloom.stages.registration.pose_graph import PoseGraphEdge, find_components
from scanloom.stages.registration.pose_selection import PoseSolution, select_poses
from scanloom.stages.registration.registration_result import Registration
from scanloom.stages.registration.registration_warnings import report_pieces, report_poses
from scanloom.stages.registration.surface_alignment import limit_threads
from scanloom.stages.scans.codes import POSE_MISSING
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose, Scan, SkippedFrame

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RegisterKeywords

RESULT_VERSION = 4

# Default maximum depth, in median depths, and number of frames sampled for the median.
_MAX_DEPTH_MEDIANS, _SAMPLE_COUNT = 2.5, 7
# Fitness from which an edge needs no confirmation by other edges. Edges with few matches need more fitness:
# the keys of a keyboard look alike, and a blurred view of them fits in wrong positions. Edges without matches
# need no more, because their alignment started from the pose of the previous frame.
_MIN_FITNESS, _MIN_CERTAIN_POINTS, _MIN_FITNESS_FEW_POINTS = 0.4, 15, 0.6


def register(
    scan: Scan | Sequence[Frame],
    params: RegisterParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[RegisterKeywords],
) -> Registration:
    """Estimate the poses of frames with depth.

    Existing poses are only used with `refine`. Each frame is aligned to its predecessor: matched keypoints
    initialise the motion, surfaces refine it. Key frames that may show the same place, by pose or appearance,
    are aligned as loop closures. A robust pose graph makes all motions consistent. Frames that cannot be
    connected form separate components. If an object moves in front of a static camera, poses are relative to
    the object, and the frames get masks of the object (see `subject`). Equal input gives bit-identical
    results on any number of threads.

    Parameters
    ----------
    scan : frames with depth, in recording order; colour helps.
    params : RegisterParams; single fields can be passed by name instead.
    progress : called with the number of finished frames and of all frames. With loop closure, the total is
        twice the number of frames, and the second half covers the candidate loops.

    Returns
    -------
    Registration : posed frames of the selected component, with metrics.

    Raises
    ------
    InputError
        If fewer than two frames can be used, no two of them can be aligned, there are fewer components than
        `piece`, or `refine` finds no poses to refine.
    StageError
        If an object is to be registered alone, but cannot be separated from the scene or is not rigid.

    References
    ----------
    Choi, Zhou and Koltun, "Robust reconstruction of indoor scenes", 2015. Odometry and pose graph are
    Open3D's, features and perspective-n-point OpenCV's.
    """
    params = resolve(RegisterParams, params, changes)
    began = time.perf_counter()
    with collecting() as diagnostics:
        found = _register(scan, params, progress)
    return replace(found, diagnostics=tuple(diagnostics), seconds=time.perf_counter() - began)


def _register(scan: Scan | Sequence[Frame], params: RegisterParams, progress: Progress) -> Registration:
    frames = list(scan.frames if isinstance(scan, Scan) else scan)
    where = scan.folder if isinstance(scan, Scan) else None
    given = _collect_given_poses(frames) if params.refine else {}
    if params.refine and not given:
        raise InputError(POSE_MISSING, "no frame has a pose that could be refined.", where)
    if not (params.focal and has_guessed_camera(frames)):
        return _register_subject(frames, given, params, where, progress)
    guess = frames[0].camera
    focal = estimate_focal_length(frames)
    if focal is None and params.subject != "scene" and has_moving_object(frames):
        focal = estimate_focal_length_from_marks(frames)
    if focal is not None:
        frames = [replace(frame, camera=focal.to_camera(frame.camera)) for frame in frames]
    found = _register_subject(frames, given, params, where, progress)
    report_focal_length(focal, guess)
    return replace(found, focal_estimate=focal)


def _register_subject(
    frames: Sequence[Frame],
    given_poses: Mapping[int, Pose],
    params: RegisterParams,
    where: Path | None,
    progress: Progress,
) -> Registration:
    thing = None if given_poses else detect_moving_object(frames, params.subject, where)
    if thing is None:
        return _register_frames(frames, given_poses, given_poses, params, where, progress)
    try:
        found = _register_frames(thing.masked_frames, thing.initial_poses, {}, params, where, progress)
    except InputError as error:
        raise create_object_error(error.diagnostic.message, where, len(frames) // 2) from error
    return replace(
        found,
        frames=tuple(
            mask_to_object(
                frames, dict(zip(found.frame_indices, found.frames, strict=True)), thing, where
            ).values()
        ),
        other_pieces={
            number: mask_to_object(frames, piece, thing, where)
            for number, piece in found.other_pieces.items()
        },
        subject="object",
    )


def _register_frames(
    frames: Sequence[Frame],
    initial_poses: Mapping[int, Pose],
    given_poses: Mapping[int, Pose],
    params: RegisterParams,
    where: Path | None,
    progress: Progress,
) -> Registration:
    """Register frames of a static subject.

    Parameters
    ----------
    initial_poses : initial world_from_camera by frame index; may be empty.
    given_poses : world_from_camera by frame index that stay unless improved, and define the world; may be
        empty.
    """
    max_depth = params.max_depth or _compute_max_depth(frames)
    with limit_threads():
        chain = build_odometry_chain(
            frames, max_depth, _report_first_half(progress) if params.loops else progress, initial_poses
        )
        if len(chain.summaries) < 2:
            first = f" (frame {chain.skipped[0].name}: {chain.skipped[0].reason})" if chain.skipped else ""
            raise InputError(
                REGISTER_FRAMES_UNUSABLE,
                "{seen_count} of {count} frames can be used, but registration needs at least two{first}",
                where,
                seen_count=len(chain.summaries),
                count=len(frames),
                first=first,
            )
        edges = list(align_key_frames(chain, max_depth))
        if params.loops:
            edges += find_loop_closures(chain, max_depth, initial_poses, progress)
        if chain.break_indices:
            edges = _drop_unconfirmed(chain.key_indices, edges)
        groups = find_components(len(chain.key_indices), edges)
        found = select_poses(chain, groups, edges, given_poses)
    return _create_result(frames, chain, groups, found, where, given_poses, params.piece)


def _drop_unconfirmed(keys: Sequence[int], edges: Sequence[PoseGraphEdge]) -> list[PoseGraphEdge]:
    """Drop uncertain edges that alone connect two parts of the graph.

    Parameters
    ----------
    keys : frame indices of the key frames. Chain edges are only dropped between consecutive frames, because
        frames between two key frames belong to both.
    """
    kept = list(edges)
    for edge in edges:
        motion = edge.motion
        is_few = 0 < motion.inlier_count < _MIN_CERTAIN_POINTS
        least = _MIN_FITNESS_FEW_POINTS if is_few else _MIN_FITNESS
        is_between = edge.is_certain and keys[edge.source] - keys[edge.target] != 1
        if motion.fitness >= least or is_between:
            continue
        others = [one for one in kept if one is not edge]
        if len(find_components(len(keys), others)) > len(find_components(len(keys), kept)):
            kept = others
    return kept


def _collect_given_poses(frames: Sequence[Frame]) -> dict[int, Pose]:
    return {
        place: pose
        for place, frame in enumerate(frames)
        if (pose := frame.world_from_camera) is not None and np.isfinite(pose).all()
    }


def _compute_max_depth(frames: Sequence[Frame]) -> float:
    """Compute the default maximum depth, metres.

    Far depth is noisier, and constrains the motion less.
    """
    medians = []
    for i in sample_evenly(len(frames), _SAMPLE_COUNT):
        try:
            depth = read_depth(frames[i])
        except InputError:
            continue
        if depth is not None and depth.any():
            medians.append(float(np.median(depth[depth > 0])))
    return _MAX_DEPTH_MEDIANS * float(np.median(medians)) if medians else np.inf


def _create_result(
    frames: Sequence[Frame],
    chain: OdometryChain,
    components: Sequence[Sequence[int]],
    solution: PoseSolution,
    where: Path | None,
    given_poses: Mapping[int, Pose],
    piece: int,
) -> Registration:
    keys, numbers, poses = chain.key_indices, list(chain.summaries), solution.poses
    piece_of_key = {keys[key]: piece for piece, group in enumerate(components) for key in group}
    piece_of = {n: piece_of_key[keys[bisect_right(keys, n) - 1]] for n in numbers}
    sizes: list[list[int]] = [[] for _ in components]
    for n in numbers:
        sizes[piece_of[n]].append(n)
    order = sorted(range(len(components)), key=lambda piece: (-len(sizes[piece]), piece))
    breaks = tuple(
        SkippedFrame(frames[after].name, motion.diagnostic)
        for after, motion in zip(numbers[1:], chain.motions.values(), strict=True)
        if isinstance(motion, AlignmentFailure)
    )
    usable = sum(len(size) > 1 for size in sizes)
    if not usable:
        raise InputError(
            REGISTER_NOT_CONNECTED,
            "no two of the {numbers_count} frames can be aligned (frame {breaks_name}: {reason})",
            where,
            remedy="if poses are known, set scan.poses=FILE.",
            numbers_count=len(numbers),
            breaks_name=breaks[0].name,
            reason=breaks[0].reason,
        )
    if piece > usable:
        raise InputError(
            REGISTER_NOT_CONNECTED,
            "register.piece={piece} does not exist; pieces of two or more frames: {usable}",
            where,
            piece=piece,
            usable=usable,
        )
    rank = {index: i for i, index in enumerate(order, 1)}
    left_out = [
        SkippedFrame(
            frames[n].name,
            REGISTER_NOT_CONNECTED.warning(
                "the frame is in piece {own} of {count}, which could not be connected to piece {piece}",
                own=rank[piece_of[n]],
                count=len(order),
                piece=piece,
            ),
        )
        for n in numbers
        if rank[piece_of[n]] != piece
    ]
    in_worlds = {
        rank[index]: _transform_to_world(frames, members, poses, given_poses)
        for index, members in enumerate(sizes)
    }
    report_pieces(len(order), usable, piece, breaks)
    report_poses(frames, chain, [poses[n] for n in in_worlds[piece]], solution.accepted, solution.rejected)
    return Registration(
        frames=tuple(in_worlds[piece].values()),
        frame_indices=tuple(in_worlds[piece]),
        skipped=(*chain.skipped, *left_out),
        pieces=tuple(tuple(frames[n].name for n in sizes[index]) for index in order),
        other_pieces={number: in_worlds[number] for number in sorted(in_worlds) if number != piece},
        edges=tuple(
            _describe_edge(edge, keys, is_used)
            for edges, is_used in ((solution.accepted, True), (solution.rejected, False))
            for edge in edges
        ),
        breaks=breaks,
        key_frames=tuple(keys),
    )


def _report_first_half(progress: Progress) -> Progress:
    return lambda done, total: progress(done, 2 * total)


def _transform_to_world(
    frames: Sequence[Frame],
    frame_indices: Sequence[int],
    poses: Mapping[int, Pose],
    given_poses: Mapping[int, Pose],
) -> dict[int, Frame]:
    """Return the frames of a component by index, in their final world.

    This is the world of the given poses, if any, or else the camera of the first frame.
    """
    known = [n for n in frame_indices if n in given_poses]
    into = invert_pose(poses[frame_indices[0]])
    if known and all(poses[n] is given_poses[n] for n in known):
        into = np.eye(4)
    elif known:
        into = _fit_world_transform([poses[n] for n in known], [given_poses[n] for n in known])
    return {n: replace(frames[n], world_from_camera=into @ poses[n]) for n in frame_indices}


def _fit_world_transform(poses: Sequence[Pose], target_poses: Sequence[Pose]) -> Pose:
    """Fit the rigid motion between two sets of poses.

    The rotation is the mean of the relative rotations; the translation aligns the mean camera centres.
    """
    from scipy.spatial.transform import Rotation

    turns = [other[:3, :3] @ pose[:3, :3].T for pose, other in zip(poses, target_poses, strict=True)]
    into = np.eye(4)
    into[:3, :3] = Rotation.from_matrix(np.stack(turns)).mean().as_matrix()
    centres, others = (np.mean([pose[:3, 3] for pose in some], axis=0) for some in (poses, target_poses))
    into[:3, 3] = others - into[:3, :3] @ centres
    return into


def _describe_edge(edge: PoseGraphEdge, keys: Sequence[int], is_used: bool) -> dict[str, Any]:
    return {
        "source": keys[edge.source],
        "target": keys[edge.target],
        "fitness": edge.motion.fitness,
        "rmse_m": edge.motion.rmse_m,
        "points": edge.motion.inlier_count,
        "is_loop": not edge.is_certain,
        "is_used": is_used,
    }
