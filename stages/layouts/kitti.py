"""KITTI odometry: rectified pairs in numbered folders, calib.txt with projection matrices, a pose a line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.formats import documents, trajectories
from stages.formats.calibration import matrix_camera, with_baseline
from stages.layouts.files import common_size, first_existing, has, images, pair
from stages.layouts.layout import Layout
from stages.layouts.rigs import uncalibrated
from stages.scan import Frame, Pose, Scan, StereoRig

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

# Left folder, right folder, the number of the left projection matrix. Colour is preferred.
_CAMERAS = (("image_2", "image_3", 2), ("image_0", "image_1", 0), ("image_l", "image_r", 0))


def _matches(folder: Path) -> str | None:
    for left, right, _ in _CAMERAS:
        if has(folder, left, right) and (left != "image_l" or has(folder, "calib.txt")):
            return f"{left}/ and {right}/" + (" with calib.txt" if has(folder, "calib.txt") else "")
    return None


def _read(folder: Path, options: ScanParams) -> Scan:
    calib = options.file("calibration", folder) or first_existing(folder, "calib.txt")
    projections = {} if calib is None else _projections(calib)
    left, right, at = next(
        (
            names
            for names in _CAMERAS
            if has(folder, *names[:2]) and (calib is None or {names[2], names[2] + 1} <= projections.keys())
        ),
        (None, None, 0),
    )
    if left is None or right is None:
        raise InputError("it states no two projection matrices for a pair of image folders.", calib or folder)
    pairs, skipped = pair(images(folder / left), images(folder / right), f"{left}/", f"{right}/", folder)
    names = [one.stem for one, _ in pairs]
    size = common_size([one for one, _ in pairs])
    missing: tuple[str, ...] = ()
    rig, left_from_cam0 = uncalibrated(size), np.eye(4)
    if calib is None:
        lacking = "calib.txt (the projection matrices P0 to P3) is missing"
        missing = (f"calibration: {lacking}; name one with scan.calibration=FILE",)
    else:
        rig, left_from_cam0 = _rig(projections[at], projections[at + 1], size, options, calib)
    world_from_cam0: list[Pose | None] = [None] * len(names)
    path = options.file("poses", folder) or _pose_file(folder)
    if path is None:
        lacking = f"poses.txt (or ../../poses/{folder.resolve().name}.txt) is missing"
        missing = (*missing, f"poses: {lacking}; name one with scan.poses=FILE")
    else:
        world_from_cam0 = trajectories.match(trajectories.read_trajectory(path), names, path)
    times = trajectories.read_times(folder / "times.txt", names)
    cam0_from_left = np.linalg.inv(left_from_cam0)
    frames = [
        Frame(
            name=one.stem,
            camera=rig.left,
            color=one,
            right=other,
            world_from_camera=None if pose is None else pose @ cam0_from_left,
            timestamp=time,
        )
        for (one, other), pose, time in zip(pairs, world_from_cam0, times, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), (), missing)


def _projections(calib: Path) -> dict[int, NDArray[np.float64]]:
    """Return the 3x4 projection matrices by number, from `P0: …` rows or from bare rows in order."""
    found: dict[int, NDArray[np.float64]] = {}
    bare = 0
    for number, line in enumerate(documents.read_text(calib).splitlines(), 1):
        key, _, text = line.rpartition(":")
        if not text.strip():
            continue
        if not key:
            key, bare = f"P{bare}", bare + 1
        if not re.fullmatch(r"P[0-3]", key.strip()):
            continue
        try:
            row = np.array([float(word) for word in text.split()])
        except ValueError:
            row = np.empty(0)
        if row.size != 12 or not np.isfinite(row).all():
            raise InputError(f"line {number} ({key}) is not 12 numbers.", calib)
        found[int(key.strip()[1])] = row.reshape(3, 4)
    return found


def _rig(
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    size: tuple[int, int],
    options: ScanParams,
    calib: Path,
) -> tuple[StereoRig, NDArray[np.float64]]:
    """Return the rig and left_from_cam0: in a projection K [I | t], t takes camera 0 to its camera."""
    cameras, offsets = [], []
    for matrix in (left, right):
        k = matrix[:, :3]
        cameras.append(options.camera(*size) or matrix_camera(k, (), *size, calib))
        if abs(np.linalg.det(k)) < 1e-9:
            raise InputError("a projection matrix is singular.", calib)
        offset = np.eye(4)
        offset[:3, 3] = np.linalg.solve(k, matrix[:, 3])
        offsets.append(offset)
    right_from_left = offsets[1] @ np.linalg.inv(offsets[0])
    if right_from_left[0, 3] >= 0:
        raise InputError(
            "the second camera is not right of the first (its P[0,3] must be smaller); are the rows swapped?",
            calib,
        )
    if options.baseline is not None:
        right_from_left = with_baseline(right_from_left, options.baseline)
    return StereoRig(cameras[0], cameras[1], right_from_left, rectified=True), offsets[0]


def _pose_file(folder: Path) -> Path | None:
    """Return the poses: poses.txt in the sequence, or poses/NN.txt as the data set packs them."""
    number = folder.resolve().name
    return first_existing(
        folder,
        "poses.txt",
        f"poses/{number}.txt",
        f"{number}.txt",
        f"../poses/{number}.txt",
        f"../../poses/{number}.txt",
    )


LAYOUT = Layout(
    name="kitti",
    text="image_0/ image_1/ (or image_2/ image_3/, image_l/ image_r/), calib.txt, poses.txt (KITTI odometry)",
    matches=_matches,
    read=_read,
)
