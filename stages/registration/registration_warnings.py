"""Diagnostics of registration: components, moving parts, rejected loops, black and repeated frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.registration.codes import (
    REGISTER_AMBIGUOUS_PLACES,
    REGISTER_CAMERA_STILL,
    REGISTER_FRAMES_REPEATED,
    REGISTER_FRAMES_UNUSABLE,
    REGISTER_MOTION_UNCLEAR,
    REGISTER_NOT_CONNECTED,
)
from scanloom.stages.registration.motion import Motion, compute_rotation_angle
from scanloom.stages.registration.odometry_chain import OdometryChain
from scanloom.stages.registration.pose_graph import PoseGraphEdge
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose, SkippedFrame

_MAX_STILL_M, _MAX_STILL_RAD = 0.005, np.radians(0.5)
_MAX_DARK_LEVEL = 8.0


def report_pieces(count: int, usable: int, piece: int, breaks: Sequence[SkippedFrame]) -> None:
    """Warn if the frames form several connected components."""
    if count <= 1:
        return
    another = f" (register.piece={1 if piece > 1 else 2} selects another)" if usable > 1 else ""
    more = f" and {len(breaks) - 1} more" if len(breaks) > 1 else ""
    emit(
        REGISTER_NOT_CONNECTED.warning(
            "the frames form {count} pieces that could not be connected; piece {piece} is used{another}. "
            "The chain broke at frame {first}{more}: {reason}",
            count=count,
            piece=piece,
            another=another,
            first=breaks[0].name,
            more=more,
            reason=breaks[0].reason,
        )
    )


def report_poses(
    frames: Sequence[Frame],
    chain: OdometryChain,
    poses: Sequence[Pose],
    accepted: Sequence[PoseGraphEdge],
    rejected: Sequence[PoseGraphEdge],
) -> None:
    """Warn about doubtful poses, rejected loops, and black or repeated frames.

    Poses are checked for the selected component; loops and frames for all components.
    """
    motions = [motion for motion in chain.motions.values() if isinstance(motion, Motion)]
    split = [motion for motion in motions if motion.has_moving_part]
    if len(split) > 0.1 * max(len(motions), 1):
        emit(
            REGISTER_MOTION_UNCLEAR.warning(
                "in {split} of {steps} steps parts of the view move differently: something moves "
                "independently (a person, a turntable), or colour and depth do not belong together. The "
                "motion of most of the surface is used as the motion of the camera",
                split=len(split),
                steps=len(motions),
            )
        )
    loops = [edge for edge in (*accepted, *rejected) if not edge.is_certain]
    if len(rejected) > max(0.5 * len(loops), 3):
        emit(
            REGISTER_AMBIGUOUS_PLACES.warning(
                "{wrong} of {loops} loop closures do not fit the path of the camera: the path has drifted, "
                "or different places look the same; see path.ply",
                wrong=len(rejected),
                loops=len(loops),
            )
        )
    if poses and all(np.linalg.norm(pose[:3, 3] - poses[0][:3, 3]) < _MAX_STILL_M for pose in poses):
        turned = max(compute_rotation_angle(invert_pose(poses[0]) @ pose) for pose in poses)
        if turned < _MAX_STILL_RAD:
            emit(
                REGISTER_CAMERA_STILL.warning(
                    "the camera does not move: all frames show the scene from one position",
                    remedy="if an object turns in front of the camera, use register.subject=object",
                )
            )
    _report_frames(frames, chain, motions)


def _report_frames(frames: Sequence[Frame], chain: OdometryChain, motions: Sequence[Motion]) -> None:
    dark = [number for number, one in chain.summaries.items() if one.mean_color < _MAX_DARK_LEVEL]
    if dark:
        emit(
            REGISTER_FRAMES_UNUSABLE.warning(
                "{count} colour images are black (first: frame {first})",
                count=len(dark),
                first=frames[dark[0]].name,
            )
        )
    same = sum(
        np.linalg.norm(m.target_from_source[:3, 3]) < 1e-5
        and compute_rotation_angle(m.target_from_source) < 1e-5
        for m in motions
    )
    if same:
        emit(
            REGISTER_FRAMES_REPEATED.warning(
                "{count} frames are copies of the previous frame", count=int(same)
            )
        )
