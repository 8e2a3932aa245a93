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
from scanloom.stages.scans.layouts.shared.axis_alignment import up_of_scannet
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.poses import rigid
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Packed, Pose, Scan, SkippedFrame
from scanloom.stages.scans.recordings import sens
from scanloom.stages.scans.recordings.choice import one_recording
from scanloom.stages.scans.trajectory import files as trajectories


def _matches(folder: Path) -> str | None:
    return next((path.name for path in sorted(folder.glob("*.sens"))), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    recording = sens.read_sens(one_recording(folder, ".sens"))
    camera, color_camera = _cameras(recording, folder, options)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for number, (entry, pose) in enumerate(
        zip(recording.frames, _poses(recording, folder, options), strict=True)
    ):
        name, color = _name(number), None
        if isinstance(pose, SkippedFrame):
            skipped.append(pose)
            continue
        if color_camera is not None:
            if not entry.color.size:
                skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
                continue
            color = _packed(recording, entry.color, f"colour {name}", sens.read_color)
        frames.append(
            Frame(
                name=name,
                camera=camera,
                color=color,
                depth=_packed(recording, entry.depth, f"depth {name}", sens.read_depth),
                depth_scale=options.depth_scale or recording.depth_scale,
                world_from_camera=pose,
                color_camera=color_camera,
            )
        )
    _check_header(recording)
    up = up_of_scannet(recording.path, LAYOUT.name)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), up=up)


def _check_header(recording: sens.Sens) -> None:
    """Warn about truncated files and ignored extrinsics."""
    if len(recording.frames) < recording.promised:
        emit(
            RECORDING_DAMAGED.warning(
                "the file is truncated or damaged: {count} of {promised} frames are readable",
                recording.path,
                count=len(recording.frames),
                promised=recording.promised,
            )
        )
    extrinsics = (recording.color_extrinsic, recording.depth_extrinsic)
    if not all(np.allclose(matrix, np.eye(4), atol=1e-4) for matrix in extrinsics):
        emit(
            SCAN_ASSUMED.warning(
                "the extrinsics of the cameras are not the identity matrix; they are ignored", recording.path
            )
        )


def _cameras(recording: sens.Sens, folder: Path, options: ReadingParams) -> tuple[Camera, Camera | None]:
    """Return the depth camera, and the colour camera (None without colour)."""
    size, path = recording.depth_size, recording.path
    stated, given = options.camera(*size), options.file("calibration", folder)
    if stated is not None:
        camera = stated
    elif given is not None:
        camera = calibration.read_camera(given, *size)
    else:
        camera = calibration.matrix_camera(recording.depth_matrix, (), *size, path)
    if not any(frame.color.size for frame in recording.frames):
        return camera, None
    return camera, calibration.matrix_camera(recording.color_matrix, (), *recording.color_size, path)


def _poses(
    recording: sens.Sens, folder: Path, options: ReadingParams
) -> Sequence[Pose | SkippedFrame | None]:
    """Return the pose of each frame, or the reason to skip it.

    A pose is None if tracking was lost.
    """
    given = options.file("poses", folder)
    if given is None:
        return [_pose(frame, number, recording.path) for number, frame in enumerate(recording.frames)]
    names = [_name(number) for number in range(len(recording.frames))]
    return trajectories.match(trajectories.read_trajectory(given), names, given)


def _pose(frame: sens.SensFrame, number: int, path: Path) -> Pose | SkippedFrame | None:
    # The user cannot correct a single pose in a packed file, so an invalid pose only skips its frame.
    try:
        return rigid(frame.pose, path, f"frame {number}")
    except InputError as error:
        return SkippedFrame(_name(number), error.diagnostic)


def _name(number: int) -> str:
    return f"{number:06d}"


def _packed(
    recording: sens.Sens,
    blob: sens.Blob,
    name: str,
    read: Callable[[sens.Sens, sens.Blob, str], NDArray[Any]],
) -> Packed:
    return Packed(recording.path, name, partial(read, recording, blob, name))


LAYOUT = Layout(
    name="scannet-sens",
    text=".sens (ScanNet, packed)",
    matches=_matches,
    read=_read,
    suffixes=(".sens",),
)
