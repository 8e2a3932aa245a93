"""Registration subject: the whole scene, or an object that moves in front of a static camera.

Matched points and marks give initial poses of the object (see `turning`); surfaces refine these poses. The
final masks are computed in `object_segmentation`.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.registration.codes import REGISTER_OBJECT_UNMATCHED, REGISTER_TURNING_OBJECT
from scanloom.stages.registration.features import Features
from scanloom.stages.registration.frame_preview import FramePreview, read_preview, read_previews
from scanloom.stages.registration.object_segmentation import segment_moving_object
from scanloom.stages.registration.static_background import (
    Mask,
    StaticBackground,
    estimate_background,
    has_moving_region,
    is_camera_static,
)
from scanloom.stages.registration.turntable_init import estimate_initial_poses
from scanloom.stages.registration.view import read_registration_view
from scanloom.stages.scans.model.images import read_mask
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Pose

# Number of frames sampled to detect motion, and for the static background.
_DECISION_FRAME_COUNT, _BACKGROUND_FRAME_COUNT = 7, 24
# Minimum size of an object, as ratio of the image.
_MIN_MASK_RATIO = 0.002
# Ratio of frames without a match on the object above which a warning names them, and maximum number of
# sequences of such frames in the warning.
_MAX_UNMATCHED_RATIO, _MAX_NAMED_RUNS = 0.5, 3


@dataclass(frozen=True, eq=False)
class MovingObject:
    """Moving object in front of a static camera, before registration.

    Attributes
    ----------
    masked_frames : frames of the scan, with masks of pixels that may show the object.
    initial_poses : initial world_from_camera of some frames by index; the world is the object.
    """

    masked_frames: list[Frame]
    initial_poses: dict[int, Pose]


def detect_moving_object(frames: Sequence[Frame], subject: str, where: Path | None) -> MovingObject | None:
    """Detect the moving object of a scan; None for a scene.

    Parameters
    ----------
    frames : frames of the scan.
    subject : `scene`, `object`, or `auto`: the object if the camera is static and something moves.
    where : folder of the scan, for messages.

    Raises
    ------
    StageError
        If `subject` is `object`, but the camera moves, or nothing moves in front of it.
    """
    if subject == "scene" or len(frames) < 2:
        return None
    previews, is_still, moves = _detect_motion(frames)
    if not (is_still and moves):
        if subject == "object":
            reason = "nothing moves in front of the camera" if is_still else "the camera moves"
            raise StageError(
                REGISTER_TURNING_OBJECT,
                "cannot separate a moving object from the scene: {reason}.",
                where,
                remedy=(
                    "register.subject=object needs a static camera and a moving object; use "
                    "register.subject=scene to register the whole scene."
                ),
                reason=reason,
            )
        return None
    more = [n for n in sample_evenly(len(frames), _BACKGROUND_FRAME_COUNT).tolist() if n not in previews]
    previews |= read_previews(frames, more)
    background = estimate_background(previews)
    masked, features = list(frames), {}
    threads = get_worker_count()
    shown = map_ordered(
        lambda frame: _mask_frame(frame, background), frames, threads=threads, max_pending=threads
    )
    for n, (frame, seen) in enumerate(shown):
        masked[n] = frame
        if seen is not None:
            features[n] = seen
    poses = estimate_initial_poses(frames, features, previews, background)
    _warn_unmatched(frames, sorted(features), poses)
    return MovingObject(masked, poses)


def _warn_unmatched(frames: Sequence[Frame], shown: Sequence[int], poses: Mapping[int, Pose]) -> None:
    """Warn if few frames match others on the object.

    Registration by surfaces takes minutes and often fails then, so the warning comes before it.

    Parameters
    ----------
    shown : indices of the readable frames, in order.
    poses : initial poses by frame index.
    """
    unmatched = [n for n in shown if n not in poses]
    if len(unmatched) <= _MAX_UNMATCHED_RATIO * len(shown):
        return
    runs = list(_split_runs(shown, poses))
    names = [
        frames[run[0]].name + (f" to {frames[run[-1]].name}" if len(run) > 1 else "")
        for run in runs
        if run[0] not in poses
    ]
    longest = max((run for run in runs if run[0] in poses), key=len, default=[])
    middle = shown[len(shown) // 2]
    first, last = (longest[0], longest[-1]) if len(longest) > 1 else (middle, middle)
    emit(
        REGISTER_OBJECT_UNMATCHED.warning(
            "{count} of {total} frames match no other frame on the moving object ({names}): only surfaces "
            "can give their poses, which may fail",
            remedy=(
                "scan.first={first} with scan.last={last} uses "
                + ("the longest sequence that matches" if len(longest) > 1 else "a single frame")
                + ". Texture on the object, or printed paper below it, makes all frames match."
            ),
            count=len(unmatched),
            total=len(shown),
            names=", ".join(names[:_MAX_NAMED_RUNS]) + (" …" if len(names) > _MAX_NAMED_RUNS else ""),
            first=first,
            last=last,
        )
    )


def _split_runs(shown: Sequence[int], poses: Mapping[int, Pose]) -> Iterator[list[int]]:
    """Split frame indices into runs of frames that all have poses, or all have none."""
    for _, run in itertools.groupby(shown, key=lambda n: n in poses):
        yield list(run)


def has_moving_object(frames: Sequence[Frame]) -> bool:
    """Check whether something moves in front of a static camera.

    In this case, `auto` registers the moving object only.
    """
    _, is_still, moves = _detect_motion(frames)
    return is_still and moves


def mask_to_object(
    frames: Sequence[Frame],
    posed_frames: Mapping[int, Frame],
    moving_object: MovingObject,
    where: Path | None,
) -> dict[int, Frame]:
    """Mask posed frames to the moving object.

    If all posed frames have initial poses, the initial poses replace the registered poses. Initial poses come
    from features on the object and marks below it. Registration by surfaces is less reliable: a surface of
    revolution can slide along itself, and the borders of masks move with the object.

    Parameters
    ----------
    frames : frames of the scan, as given.
    posed_frames : posed frames by index; the world is the object.
    where : folder of the scan, for messages.

    Raises
    ------
    StageError
        If hardly a pixel agrees with the poses, because the object is not rigid.
    """
    poses = {
        n: frame.world_from_camera for n, frame in posed_frames.items() if frame.world_from_camera is not None
    }
    if all(n in moving_object.initial_poses for n in poses):
        first = next(iter(poses))
        into = poses[first] @ invert_pose(moving_object.initial_poses[first])
        poses = {n: into @ moving_object.initial_poses[n] for n in poses}
    found = {n: replace(frames[n], world_from_camera=pose) for n, pose in poses.items()}
    if len(found) < 2:
        return found
    masks = segment_moving_object(found)
    if float(np.median([mask.mean() for mask in masks.values()])) < _MIN_MASK_RATIO:
        raise create_object_error(
            "no motion of a rigid object fits the frames", where, sorted(found)[len(found) // 2]
        )
    return {n: _intersect_mask(frame, masks[n]) if n in masks else frame for n, frame in found.items()}


def create_object_error(reason: str, where: Path | None, frame_index: int) -> StageError:
    """Create the error for an object whose poses cannot be estimated.

    Parameters
    ----------
    frame_index : frame for the advice to make a mesh of a single view.
    """
    return StageError(
        REGISTER_TURNING_OBJECT,
        "an object moves in front of a static camera, but its poses cannot be estimated ({why}).",
        where,
        remedy=(
            "Turn the object in smaller steps, on printed paper, or use register.subject=scene to register "
            "the whole scene. A mesh of one side needs no poses: scan.first={frame} with scan.last={frame} "
            "uses a single frame."
        ),
        why=reason,
        frame=frame_index,
    )


def _detect_motion(frames: Sequence[Frame]) -> tuple[dict[int, FramePreview], bool, bool]:
    """Detect a static camera and a moving object in sampled frames.

    Returns
    -------
    Previews by frame index; whether the camera is static; whether something moves.
    """
    looks = read_previews(frames, sample_evenly(len(frames), _DECISION_FRAME_COUNT).tolist())
    views = {}
    for n in looks:
        with contextlib.suppress(InputError):
            views[n] = read_registration_view(frames[n], np.inf)
    looks = {n: looks[n] for n in views}
    if not is_camera_static(list(views.values()), list(looks.values())):
        return looks, False, False
    return looks, True, has_moving_region(list(looks.values()))


def _mask_frame(frame: Frame, background: StaticBackground) -> tuple[Frame, Features | None]:
    """Mask a frame to candidate pixels of the object, and detect features.

    Unreadable frames have no features (None).
    """
    look = read_preview(frame)
    if look is None or look.depth.shape != background.depth.shape:
        return frame, None
    masked = _intersect_mask(frame, background.mask_candidates(look))
    try:
        return masked, read_registration_view(masked, np.inf).features
    except InputError:
        return masked, None


def _intersect_mask(frame: Frame, mask: Mask) -> Frame:
    """Intersect the mask of a frame with another mask (h, w)."""
    import cv2

    both = mask.astype(np.uint8) * np.uint8(255)
    own = read_mask(frame)
    if own is not None:
        size = (mask.shape[1], mask.shape[0])
        both &= cv2.resize(own, size, interpolation=cv2.INTER_NEAREST_EXACT)
    return replace(frame, mask=both)
