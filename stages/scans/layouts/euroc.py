"""EuRoC MAV (ASL): unrectified stereo, with extrinsics and poses of the body.

TUM-VI uses the same folders, but its fisheye cameras are described in dso/camchain.yaml (Kalibr), and its
images are 16-bit.
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
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.calibration.image_size import get_stated_size, scale_to_images
from scanloom.stages.scans.calibration.table_values import flatten_numbers
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_LENS_UNKNOWN,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import find_common_size, find_first_existing, has_all
from scanloom.stages.scans.layouts.shared.gravity import estimate_up_directions
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose, parse_pose_matrix
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame, StereoRig
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.streams.timestamped_streams import Accelerometer
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

# Nanoseconds. Ground truth runs at 20 to 200 Hz: half of the longest interval, and a margin.
_POSE_TOLERANCE_NS = 30_000_000
_CAMCHAIN_FILE = "dso/camchain.yaml"
_IMU_FOLDER = "imu0"
_GROUND_TRUTH_FILES = ("state_groundtruth_estimate0/data.csv", "mocap0/data.csv", "vicon0/data.csv")


def _find_mav_folder(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _matches(folder: Path) -> str | None:
    mav = _find_mav_folder(folder)
    if (mav / "cam0" / "sensor.yaml").exists():
        return (mav / "cam0" / "sensor.yaml").relative_to(folder).as_posix()
    if mav != folder and (mav / "cam0" / "data.csv").exists():
        return "mav0/cam0/data.csv"
    is_chained = (mav / "cam0" / "data.csv").exists() and (folder / _CAMCHAIN_FILE).exists()
    return f"cam0/data.csv and {_CAMCHAIN_FILE}" if is_chained else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    mav = _find_mav_folder(folder)
    streams = [_read_stream(mav / name) for name in ("cam0", "cam1")]
    size = find_common_size(list(streams[0].values()))
    chain = options.resolve_file("calibration", folder) or find_first_existing(folder, _CAMCHAIN_FILE)
    if chain is not None and (options.calibration or not has_all(mav, "cam0/sensor.yaml")):
        rig, body_from_left = _read_camchain_rig(chain, size, options)
    else:
        rig, body_from_left = _read_rig(mav, size, options)
    path = options.resolve_file("poses", folder) or find_first_existing(mav, *_GROUND_TRUTH_FILES)
    accelerometer = _read_accelerometer(mav, body_from_left)
    frames: list[Frame] = []
    skipped = [
        SkippedFrame(
            str(time),
            FRAME_IMAGE_MISSING.warning("cam{side} has no image with this timestamp", side=1 - side),
        )
        for side in (0, 1)
        for time in sorted(streams[side].keys() - streams[1 - side].keys())
    ]
    is_16_bit = _is_16_bit(list(streams[0].values()))
    times = sorted(streams[0].keys() & streams[1].keys())
    poses: list[Pose | None] = [None] * len(times)
    if path is not None:
        poses = match_poses_by_time(path, times, [str(time) for time in times], _POSE_TOLERANCE_NS, options)
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
                color=_wrap_8_bit(streams[0][time]) if is_16_bit else streams[0][time],
                right=_wrap_8_bit(streams[1][time]) if is_16_bit else streams[1][time],
                world_from_camera=None if pose is None else pose @ body_from_left,
                timestamp=time,
            )
        )
    moments = np.array([frame.timestamp for frame in frames], np.int64)
    ups = estimate_up_directions(accelerometer if frames else None, moments)
    frames = [replace(frame, up=up) for frame, up in zip(frames, ups, strict=True)]
    lacking = describe_missing_poses(
        "{file} is missing",
        remedy="name a trajectory of the body frame with scan.poses=FILE",
        file=_GROUND_TRUTH_FILES[0],
    )
    missing = (lacking,) if path is None else ()
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _read_stream(camera: Path) -> dict[int, Path]:
    """Read the images of a camera by timestamp (ns) from data.csv."""
    path = camera / "data.csv"
    found: dict[int, Path] = {}
    for number, text in documents.iterate_lines(path):
        time, _, name = text.partition(",")
        if not time.strip().isdigit() or not name.strip() or int(time) >= 1 << 62:
            raise InputError(
                SCAN_TABLE_DAMAGED, "line {number} is not `nanoseconds,file`.", path, number=number
            )
        found[int(time)] = camera / "data" / documents.require_inside(name.strip(), path, f"line {number}")
    if not found:
        raise InputError(SCAN_TABLE_DAMAGED, "the file lists no images.", path)
    return found


def _read_accelerometer(mav: Path, body_from_left: Pose) -> Accelerometer | None:
    """Read the accelerometer of imu0; None if it does not exist.

    At rest, its readings point up.
    """
    path, sensor = mav / _IMU_FOLDER / "data.csv", mav / _IMU_FOLDER / "sensor.yaml"
    if not path.exists():
        return None
    times, readings = [], []
    for number, text in documents.iterate_lines(path):
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
        body_from_imu = _parse_body_from_sensor(documents.read_document(sensor), sensor)
        turn = body_from_left[:3, :3].T @ body_from_imu[:3, :3]
    rows = np.array(readings, np.float64).reshape(-1, 3)
    return Accelerometer(_IMU_FOLDER, np.array(times, np.int64), lambda number: rows[number], turn)


def _read_rig(mav: Path, size: tuple[int, int], options: ReadingParams) -> tuple[StereoRig, Pose]:
    """Read the rig and body_from_left, the extrinsics of the left camera."""
    cameras, body_from_camera = [], []
    for name in ("cam0", "cam1"):
        path = mav / name / "sensor.yaml"
        document = documents.read_document(path)
        cameras.append(_read_camera(document, size, options, path))
        body_from_camera.append(_parse_body_from_sensor(document, path))
    right_from_left = invert_pose(body_from_camera[1]) @ body_from_camera[0]
    if options.baseline is not None:
        right_from_left = rig_calibration.set_baseline(right_from_left, options.baseline)
    return StereoRig(cameras[0], cameras[1], right_from_left, is_rectified=False), body_from_camera[0]


def _is_16_bit(files: Sequence[Path]) -> bool:
    """Return True if the images are 16-bit.

    The first existing file decides.
    """
    first = next((path for path in files if path.exists()), None)
    try:
        return first is not None and read_stored_image(first).dtype == np.uint16
    except InputError:
        return False


def _wrap_8_bit(path: Path) -> PackedImage:
    return PackedImage(path, "image", partial(_read_high_bytes, path))


def _read_high_bytes(path: Path) -> NDArray[np.uint8]:
    image = read_stored_image(path)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(
            FILE_IMAGE_FORMAT, "a 16-bit greyscale image is expected, like the other images.", path
        )
    return (image >> 8).astype(np.uint8)


def _read_camchain_rig(path: Path, size: tuple[int, int], options: ReadingParams) -> tuple[StereoRig, Pose]:
    """Read the rig and body_from_left from a Kalibr camchain file."""
    document = documents.read_document(path)
    rig = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
    stated = options.get_camera(*size)
    if stated is not None:
        rig = replace(rig, left=stated, right=stated)
    return rig, invert_pose(rig_calibration.read_camera_from_body(document, "cam0", path))


def _read_camera(
    document: dict[str, Any], size: tuple[int, int], options: ReadingParams, path: Path
) -> Camera:
    if document.get("camera_model", "pinhole") != "pinhole":
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "camera_model {document} is not supported; only pinhole is.",
            path,
            document=document["camera_model"],
        )
    fisheye = calibration.is_fisheye(document.get("distortion_model"), path)
    fx, fy, cx, cy = _parse_four_numbers(document, "intrinsics", path)
    distortion = _parse_four_numbers(document, "distortion_coefficients", path)
    stated = options.get_camera(*size)
    if stated is not None:
        return stated
    camera = Camera(*get_stated_size(document, *size, path), fx, fy, cx, cy, distortion, fisheye)
    return scale_to_images(calibration.check_camera_values(camera, path), *size, path)


def _parse_four_numbers(document: dict[str, Any], key: str, path: Path) -> tuple[float, ...]:
    row = flatten_numbers(document.get(key), key, path)
    if len(row) != 4:
        raise InputError(CAMERA_CALIBRATION_INVALID, "{key} must be 4 numbers.", path, key=key)
    return row


def _parse_body_from_sensor(document: dict[str, Any], path: Path) -> Pose:
    """Return T_BS (camera to body) as a (4, 4) pose."""
    matrix = document.get("T_BS")
    data = matrix.get("data") if isinstance(matrix, dict) else matrix
    pose = check_rigid_pose(parse_pose_matrix(data, path, "T_BS"), path, "T_BS")
    if pose is None:
        raise InputError(CAMERA_CALIBRATION_INVALID, "T_BS contains NaN or infinity.", path)
    return pose


LAYOUT = Layout(
    name="euroc",
    description="mav0/cam0, mav0/cam1 with sensor.yaml (or dso/camchain.yaml) and data.csv (EuRoC, ASL, "
    "TUM-VI)",
    matches=_matches,
    read=_read,
    up=Z_UP,
    is_gravity_aligned=True,
)
