"""EuRoC MAV (ASL): unrectified stereo, with extrinsics and poses of the body.

TUM-VI uses the same folders, but its fisheye cameras are described in dso/camchain.yaml (Kalibr), and
its images are 16-bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.codes import FILE_IMAGE_FORMAT
from scanloom.stages.files.images import read_stored
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.calibration.image_size import for_images, stated_size
from scanloom.stages.scans.calibration.table_values import number_row
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_LENS_UNKNOWN,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import common_size, first_existing, has
from scanloom.stages.scans.layouts.shared.gravity import ups_of
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.poses import inverted, matrix_of, rigid
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Packed, Pose, Scan, SkippedFrame, StereoRig
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.streams.clocked_streams import Accelerometer
from scanloom.stages.scans.trajectory.timed_poses import poses_at

# Nanoseconds. Ground truth runs at 20 to 200 Hz: half of the longest interval, and a margin.
_TOLERANCE = 30_000_000
_CAMCHAIN = "dso/camchain.yaml"
_IMU = "imu0"
_GROUND_TRUTH = ("state_groundtruth_estimate0/data.csv", "mocap0/data.csv", "vicon0/data.csv")


def _mav(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _matches(folder: Path) -> str | None:
    mav = _mav(folder)
    if (mav / "cam0" / "sensor.yaml").exists():
        return (mav / "cam0" / "sensor.yaml").relative_to(folder).as_posix()
    if mav != folder and (mav / "cam0" / "data.csv").exists():
        return "mav0/cam0/data.csv"
    is_chained = (mav / "cam0" / "data.csv").exists() and (folder / _CAMCHAIN).exists()
    return f"cam0/data.csv and {_CAMCHAIN}" if is_chained else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    mav = _mav(folder)
    streams = [_stream(mav / name) for name in ("cam0", "cam1")]
    size = common_size(list(streams[0].values()))
    chain = options.file("calibration", folder) or first_existing(folder, _CAMCHAIN)
    if chain is not None and (options.calibration or not has(mav, "cam0/sensor.yaml")):
        rig, body_from_left = _chained(chain, size, options)
    else:
        rig, body_from_left = _rig(mav, size, options)
    path = options.file("poses", folder) or first_existing(mav, *_GROUND_TRUTH)
    accelerometer = _accelerometer(mav, body_from_left)
    frames: list[Frame] = []
    skipped = [
        SkippedFrame(
            str(time),
            FRAME_IMAGE_MISSING.warning("cam{side} has no image with this timestamp", side=1 - side),
        )
        for side in (0, 1)
        for time in sorted(streams[side].keys() - streams[1 - side].keys())
    ]
    is_wide = _is_wide(list(streams[0].values()))
    times = sorted(streams[0].keys() & streams[1].keys())
    poses: list[Pose | None] = [None] * len(times)
    if path is not None:
        poses = poses_at(path, times, [str(time) for time in times], _TOLERANCE, options)
    for time, pose in zip(times, poses, strict=True):
        if pose is None and path is not None:
            skipped.append(
                SkippedFrame(
                    str(time), FRAME_POSE_MISSING.warning("the trajectory has no pose within 0.03 s")
                )
            )
            continue
        frames.append(
            Frame(
                name=str(time),
                camera=rig.left,
                color=_narrowed(streams[0][time]) if is_wide else streams[0][time],
                right=_narrowed(streams[1][time]) if is_wide else streams[1][time],
                world_from_camera=None if pose is None else pose @ body_from_left,
                timestamp=time,
            )
        )
    moments = np.array([frame.timestamp for frame in frames], np.int64)
    ups = ups_of(accelerometer if frames else None, moments)
    frames = [replace(frame, up=up) for frame, up in zip(frames, ups, strict=True)]
    lacking = poses_missing(
        "{file} is missing",
        remedy="name a trajectory of the body frame with scan.poses=FILE",
        file=_GROUND_TRUTH[0],
    )
    missing = (lacking,) if path is None else ()
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _stream(camera: Path) -> dict[int, Path]:
    """Read the images of a camera by timestamp (ns) from data.csv."""
    path = camera / "data.csv"
    found: dict[int, Path] = {}
    for number, text in documents.lines(path):
        time, _, name = text.partition(",")
        if not time.strip().isdigit() or not name.strip() or int(time) >= 1 << 62:
            raise InputError(
                SCAN_TABLE_DAMAGED, "line {number} is not `nanoseconds,file`.", path, number=number
            )
        found[int(time)] = camera / "data" / documents.require_inside(name.strip(), path, f"line {number}")
    if not found:
        raise InputError(SCAN_TABLE_DAMAGED, "the file lists no images.", path)
    return found


def _accelerometer(mav: Path, body_from_left: Pose) -> Accelerometer | None:
    """Read the accelerometer of imu0, or return None if there is none.

    At rest, its readings point up.
    """
    path, sensor = mav / _IMU / "data.csv", mav / _IMU / "sensor.yaml"
    if not path.exists():
        return None
    times, readings = [], []
    for number, text in documents.lines(path):
        words = text.split(",")
        try:
            time, values = int(words[0]), [float(word) for word in words[1:7]]
        except ValueError:
            values = []
        if len(values) < 6 or not 0 <= time < 1 << 62:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "line {number} is not a timestamp (ns), three angular rates and three accelerations.",
                path,
                number=number,
            )
        times.append(time)
        readings.append(values[3:])
    turn = None
    if sensor.exists():
        body_from_imu = _mounting(documents.read_document(sensor), sensor)
        turn = body_from_left[:3, :3].T @ body_from_imu[:3, :3]
    rows = np.array(readings, np.float64).reshape(-1, 3)
    return Accelerometer(_IMU, np.array(times, np.int64), lambda number: rows[number], turn)


def _rig(mav: Path, size: tuple[int, int], options: ReadingParams) -> tuple[StereoRig, Pose]:
    """Read the rig and body_from_left, the extrinsics of the left camera."""
    cameras, body_from_camera = [], []
    for name in ("cam0", "cam1"):
        path = mav / name / "sensor.yaml"
        document = documents.read_document(path)
        cameras.append(_camera(document, size, options, path))
        body_from_camera.append(_mounting(document, path))
    right_from_left = inverted(body_from_camera[1]) @ body_from_camera[0]
    if options.baseline is not None:
        right_from_left = rig_calibration.with_baseline(right_from_left, options.baseline)
    return StereoRig(cameras[0], cameras[1], right_from_left, rectified=False), body_from_camera[0]


def _is_wide(files: Sequence[Path]) -> bool:
    """Return True if the images are 16-bit.

    The first existing file decides.
    """
    first = next((path for path in files if path.exists()), None)
    try:
        return first is not None and read_stored(first).dtype == np.uint16
    except InputError:
        return False


def _narrowed(path: Path) -> Packed:
    return Packed(path, "image", partial(_high_bytes, path))


def _high_bytes(path: Path) -> NDArray[np.uint8]:
    image = read_stored(path)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(
            FILE_IMAGE_FORMAT, "a 16-bit greyscale image is expected, like the other images.", path
        )
    return (image >> 8).astype(np.uint8)


def _chained(path: Path, size: tuple[int, int], options: ReadingParams) -> tuple[StereoRig, Pose]:
    """Read the rig and body_from_left from a Kalibr camchain file."""
    document = documents.read_document(path)
    rig = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
    stated = options.camera(*size)
    if stated is not None:
        rig = replace(rig, left=stated, right=stated)
    return rig, inverted(rig_calibration.camera_from_body(document, "cam0", path))


def _camera(document: dict[str, Any], size: tuple[int, int], options: ReadingParams, path: Path) -> Camera:
    if document.get("camera_model", "pinhole") != "pinhole":
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "camera_model {document} is not supported; only pinhole is.",
            path,
            document=document["camera_model"],
        )
    fisheye = calibration.is_fisheye(document.get("distortion_model"), path)
    fx, fy, cx, cy = _four(document, "intrinsics", path)
    distortion = _four(document, "distortion_coefficients", path)
    stated = options.camera(*size)
    if stated is not None:
        return stated
    camera = Camera(*stated_size(document, *size, path), fx, fy, cx, cy, distortion, fisheye)
    return for_images(calibration.checked(camera, path), *size, path)


def _four(document: dict[str, Any], key: str, path: Path) -> tuple[float, ...]:
    row = number_row(document.get(key), key, path)
    if len(row) != 4:
        raise InputError(CAMERA_CALIBRATION_INVALID, "{key} must be 4 numbers.", path, key=key)
    return row


def _mounting(document: dict[str, Any], path: Path) -> Pose:
    """Return T_BS (camera to body) as a (4, 4) pose."""
    matrix = document.get("T_BS")
    data = matrix.get("data") if isinstance(matrix, dict) else matrix
    pose = rigid(matrix_of(data, path, "T_BS"), path, "T_BS")
    if pose is None:
        raise InputError(CAMERA_CALIBRATION_INVALID, "T_BS contains NaN or infinity.", path)
    return pose


LAYOUT = Layout(
    name="euroc",
    text="mav0/cam0, mav0/cam1 with sensor.yaml (or dso/camchain.yaml) and data.csv (EuRoC, ASL, TUM-VI)",
    matches=_matches,
    read=_read,
    up=Z_UP,
    is_level=True,
)
