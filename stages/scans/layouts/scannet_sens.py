"""ScanNet, packed: one `.sens` file with images, poses and cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_ASSUMED
from scanloom.stages.scans.layouts.shared.axis_alignment import find_scannet_up
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.poses import check_rigid_pose
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.recordings import sens
from scanloom.stages.scans.recordings.recording_selection import find_single_recording
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories


def _matches(folder: Path) -> str | None:
    return next((path.name for path in sorted(folder.glob("*.sens"))), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    recording = sens.read_sens(find_single_recording(folder, ".sens"))
    camera, color_camera = _read_cameras(recording, folder, options)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for number, (entry, pose) in enumerate(
        zip(recording.frames, _read_poses(recording, folder, options), strict=True)
    ):
        name, color = _format_name(number), None
        if isinstance(pose, SkippedFrame):
            skipped.append(pose)
            continue
        if color_camera is not None:
            if not entry.color.size:
                skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
                continue
            color = _wrap_blob(recording, entry.color, f"colour {name}", sens.read_color)
        frames.append(
            Frame(
                name=name,
                camera=camera,
                color=color,
                depth=_wrap_blob(recording, entry.depth, f"depth {name}", sens.read_depth),
                depth_scale=options.depth_scale or recording.depth_scale,
                world_from_camera=pose,
                color_camera=color_camera,
            )
        )
    _check_header(recording)
    up = find_scannet_up(recording.path, LAYOUT.name)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), up=up)


def _check_header(recording: sens.SensFile) -> None:
    """Warn about truncated files and ignored extrinsics."""
    if len(recording.frames) < recording.stated_frame_count:
        emit(
            RECORDING_DAMAGED.warning(
                "the file is truncated or damaged: {count} of {promised} frames are readable",
                recording.path,
                count=len(recording.frames),
                promised=recording.stated_frame_count,
            )
        )
    extrinsics = (recording.color_extrinsic, recording.depth_extrinsic)
    if not all(np.allclose(matrix, np.eye(4), atol=1e-4) for matrix in extrinsics):
        emit(
            SCAN_ASSUMED.warning(
                "the extrinsics of the cameras are not the identity matrix; they are ignored", recording.path
            )
        )


def _read_cameras(
    recording: sens.SensFile, folder: Path, options: ReadingParams
) -> tuple[Camera, Camera | None]:
    """Return the depth camera, and the colour camera (None without colour)."""
    size, path = recording.depth_size, recording.path
    stated, given = options.get_camera(*size), options.resolve_file("calibration", folder)
    if stated is not None:
        camera = stated
    elif given is not None:
        camera = calibration.read_camera(given, *size)
    else:
        camera = calibration.create_camera_from_matrix(recording.depth_matrix, (), *size, path)
    if not any(frame.color.size for frame in recording.frames):
        return camera, None
    return camera, calibration.create_camera_from_matrix(
        recording.color_matrix, (), *recording.color_size, path
    )


def _read_poses(
    recording: sens.SensFile, folder: Path, options: ReadingParams
) -> Sequence[Pose | SkippedFrame | None]:
    """Return the pose of each frame, or the reason to skip it.

    A pose is None if tracking was lost.
    """
    given = options.resolve_file("poses", folder)
    if given is None:
        return [_parse_pose(frame, number, recording.path) for number, frame in enumerate(recording.frames)]
    names = [_format_name(number) for number in range(len(recording.frames))]
    return trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)


def _parse_pose(frame: sens.SensFrame, number: int, path: Path) -> Pose | SkippedFrame | None:
    # The user cannot correct a single pose in a packed file, so an invalid pose only skips its frame.
    try:
        return check_rigid_pose(frame.pose, path, f"frame {number}")
    except InputError as error:
        return SkippedFrame(_format_name(number), error.diagnostic)


def _format_name(number: int) -> str:
    return f"{number:06d}"


def _wrap_blob(
    recording: sens.SensFile,
    blob: sens.Blob,
    name: str,
    read: Callable[[sens.SensFile, sens.Blob, str], NDArray[Any]],
) -> PackedImage:
    return PackedImage(recording.path, name, partial(read, recording, blob, name))


LAYOUT = Layout(
    name="scannet-sens",
    description=".sens (ScanNet, packed)",
    matches=_matches,
    read=_read,
    suffixes=(".sens",),
)
