"""Readers for trajectory files of all supported formats.

Poses are rigid and camera-to-world, in metres and OpenCV camera axes. Each reader converts the pose
direction, quaternion order and matrix order of its format.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.images import read_array
from scanloom.stages.files.number_rows import parse_number_row
from scanloom.stages.scans.codes import POSE_ASSUMED, POSE_TRAJECTORY_UNREADABLE
from scanloom.stages.scans.model.poses import (
    MAX_POSE_VALUE,
    check_rigid_pose,
    create_pose_from_quaternion,
    invert_pose,
    parse_pose_matrix,
)
from scanloom.stages.scans.model.scan import Pose

T = TypeVar("T")

# Shapes of one pose in a NumPy array, and maximum number of poses (days of video).
_POSE_SHAPES = ((3, 4), (4, 4), (12,), (16,))
_MAX_POSES = 1 << 22
# Characters; Python refuses to parse integers of thousands of digits.
_MAX_NUMBER_LENGTH = 255


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in file order.

    Attributes
    ----------
    poses : (4, 4) float64 world_from_camera (or world_from_body, depending on the format); None where
        tracking was lost.
    timestamps : (n,) int64 nanoseconds; None if the format has none.
    names : name or number of each pose's frame; None if the format has none.
    """

    poses: Sequence[Pose | None]
    timestamps: NDArray[np.int64] | None = None
    names: Sequence[str] | None = None

    def __len__(self) -> int:
        return len(self.poses)


def read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory file; the format is detected by suffix and first line.

    Formats: KITTI (12 numbers per line, row-major), 4x4 matrices (16 numbers per line), TUM
    (`t tx ty tz qx qy qz qw`), SLAMBench (the same without t), Redwood and Open3D `.log`, Open3D `.json`
    (world-to-camera, column-major), nested rows in JSON, EuRoC `.csv`, ARKitScenes `.traj`, NumPy `.npy`.

    Raises
    ------
    InputError
        If the format is unknown or a pose is not rigid. The message names the file and the line.
    """
    if path.suffix == ".json":
        return read_json(path)
    if path.suffix == ".csv":
        return read_euroc(path)
    if path.suffix == ".traj":
        return read_arkit_traj(path)
    if path.suffix == ".npy":
        return read_pose_array(path)
    first = next(_iterate_number_lines(path), None)
    if first is None:
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "the trajectory file holds no poses.", path)
    count = len(first[1])
    if count == 3:
        return read_log(path)
    if count == 8:
        return read_tum(path)
    if count == 7:
        return read_translation_first(path)
    if count in (12, 16):
        return read_matrices(path)
    if count == 4:
        return Trajectory([read_pose(path)])
    raise InputError(
        POSE_TRAJECTORY_UNREADABLE,
        (
            "line {first} holds {count} numbers; expected are 12 or 16 (a matrix), 8 (t tx ty tz "
            "qx qy qz qw), 7 (the same without t) or 3 (a .log header)."
        ),
        path,
        first=first[0],
        count=count,
    )


def read_pose(path: Path) -> Pose | None:
    """Read one pose from a file with a row-major 4x4 or 3x4 matrix.

    Returns None if the matrix marks lost tracking.

    Raises
    ------
    InputError
        If the file holds another number of values, or the pose is not rigid.
    """
    values = [value for _, row in _iterate_number_lines(path) for value in row]
    if len(values) not in (12, 16):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "a pose of 4 rows of 4 numbers is expected; it holds {values_count} numbers.",
            path,
            values_count=len(values),
        )
    return check_rigid_pose(np.reshape(values, (-1, 4)), path)


def read_matrices(path: Path) -> Trajectory:
    """Read lines of 12 (KITTI, 3x4) or 16 (4x4) row-major numbers, camera-to-world."""
    poses = []
    for number, row in _iterate_number_lines(path):
        if len(row) not in (12, 16):
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; a pose needs 12 or 16.",
                path,
                number=number,
                row_count=len(row),
            )
        poses.append(check_rigid_pose(np.reshape(row, (-1, 4)), path, f"line {number}"))
    return Trajectory(poses)


def read_pose_array(path: Path) -> Trajectory:
    """Read a NumPy array of camera-to-world poses.

    Shapes are (n, 3, 4), (n, 4, 4), (n, 12) or (n, 16).
    """
    array = read_array(path, "the trajectory file")
    is_stack = array.ndim > 1 and array.dtype.kind == "f" and array.shape[1:] in _POSE_SHAPES
    if not is_stack or not 0 < len(array) <= _MAX_POSES:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            (
                "poses are expected, (n, 3, 4) or (n, 4, 4) numbers; this is {array_shape} "
                "of type {array_dtype}."
            ),
            path,
            array_shape=array.shape,
            array_dtype=array.dtype,
        )
    matrices = np.asarray(array, np.float64).reshape(len(array), -1, 4)
    return Trajectory([check_rigid_pose(matrix, path, f"pose {i}") for i, matrix in enumerate(matrices)])


def read_tum(path: Path) -> Trajectory:
    """Read TUM lines: seconds, translation, quaternion with the scalar last; camera-to-world.

    A common writer omits the line end after its header `# …>`, so that the first pose is in the comment. That
    pose is read, too.
    """
    poses, times = [], []
    swallowed = re.match(
        r"#[^\n]*>[ \t]*([-+.\deE]+(?:[ \t]+[-+.\deE]+){7})[ \t]*\n", documents.read_text(path)
    )
    first = [(1, read_number_line(swallowed[1], 1, path))] if swallowed else []
    for number, row in (*first, *_iterate_number_lines(path)):
        if len(row) != 8:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 8 (t tx ty tz qx qy qz qw) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        times.append(to_nanoseconds(row[0], path, number))
        poses.append(create_pose_from_quaternion(row[1:4], row[4:8], path, f"line {number}"))
    return Trajectory(poses, np.array(times, np.int64))


def write_tum(path: Path, seconds: Sequence[float], poses: Sequence[Pose]) -> None:
    """Write a trajectory as TUM lines.

    Time in seconds, translation in metres, quaternion x y z w; poses are camera-to-world.
    """
    from scipy.spatial.transform import Rotation

    lines = ["# seconds tx ty tz qx qy qz qw"]
    for time, pose in zip(seconds, poses, strict=True):
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat()
        lines.append(" ".join([f"{time:.9f}", *(f"{value:.9f}" for value in (*pose[:3, 3], *turn))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read_log(path: Path) -> Trajectory:
    """Read a Redwood or Open3D `.log` of camera-to-world poses.

    Each pose is a header of three integers and four rows of a matrix.
    """
    content = list(_iterate_number_lines(path))
    poses = []
    for at in range(0, len(content), 5):
        number, header = content[at]
        rows = [row for _, row in content[at + 1 : at + 5]]
        if len(header) != 3 or len(rows) != 4 or any(len(row) != 4 for row in rows):
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "the entry at line {number} is not a header of 3 numbers and 4 rows of 4 numbers.",
                path,
                number=number,
            )
        poses.append(check_rigid_pose(np.array(rows), path, f"entry at line {number}"))
    return Trajectory(poses)


def read_sun3d(path: Path) -> Trajectory:
    """Read SUN3D poses: three rows of four numbers each, without separators; camera-to-world."""
    rows = list(_iterate_number_lines(path))
    for number, row in rows:
        if len(row) != 4:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; rows of 4 are expected.",
                path,
                number=number,
                row_count=len(row),
            )
    if not rows or len(rows) % 3:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "it holds {rows_count} rows of numbers; a pose needs 3.",
            path,
            rows_count=len(rows),
        )
    poses = [
        check_rigid_pose(np.array([row for _, row in rows[at : at + 3]]), path, f"pose at line {rows[at][0]}")
        for at in range(0, len(rows), 3)
    ]
    return Trajectory(poses)


def read_json(path: Path) -> Trajectory:
    """Read poses from JSON: an Open3D camera trajectory or pose graph, or 4x4 matrices.

    Open3D stores 16 numbers column-major: world-to-camera extrinsics in a camera trajectory, camera-to-world
    poses in a pose graph. Other matrices are row-major and camera-to-world, in a list or in an object by
    frame name or number.
    """
    document = documents.read_json(path)
    if isinstance(document, dict) and isinstance(document.get("parameters"), list):
        entries, key, inverse = document["parameters"], "extrinsic", True
    elif isinstance(document, dict) and isinstance(document.get("nodes"), list):
        entries, key, inverse = document["nodes"], "pose", False
    else:
        entries = document.get("poses", document) if isinstance(document, dict) else document
        names = None
        if isinstance(entries, dict) and entries and all(isinstance(one, list) for one in entries.values()):
            names, entries = tuple(entries), list(entries.values())
        if not isinstance(entries, list):
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "it is not a trajectory: the keys `parameters`, `nodes` and `poses` are missing.",
                path,
            )
        matrices = [parse_pose_matrix(entry, path, f"pose {i}") for i, entry in enumerate(entries)]
        return Trajectory(
            [check_rigid_pose(matrix, path, f"pose {i}") for i, matrix in enumerate(matrices)], names=names
        )
    poses = []
    for i, entry in enumerate(entries):
        flat = entry.get(key) if isinstance(entry, dict) else None
        pose = check_rigid_pose(parse_pose_matrix(flat, path, f"{key} {i}").T, path, f"{key} {i}")
        poses.append(invert_pose(pose) if inverse and pose is not None else pose)
    return Trajectory(poses)


def read_euroc(path: Path) -> Trajectory:
    """Read EuRoC ground truth: nanoseconds, position, quaternion with the scalar *first*; body-to-world."""
    poses, times = [], []
    for number, text in documents.iterate_lines(path):
        fields = text.split(",")
        try:
            # Parsed as int, because float64 cannot represent nanoseconds since 1970 exactly.
            time, row = int(fields[0]), [float(value) for value in fields[1:8]]
        except ValueError as error:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} is not `ns, px, py, pz, qw, qx, qy, qz, …`.",
                path,
                number=number,
            ) from error
        if len(row) != 7 or abs(time) >= 1 << 62:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} is not `ns, px, py, pz, qw, qx, qy, qz, …`.",
                path,
                number=number,
            )
        times.append(time)
        poses.append(create_pose_from_quaternion(row[:3], [*row[4:], row[3]], path, f"line {number}"))
    return Trajectory(poses, np.array(times, np.int64))


def read_arkit_traj(path: Path) -> Trajectory:
    """Read ARKitScenes lines: seconds, rotation vector (radians), translation; *world-to-camera*."""
    from scipy.spatial.transform import Rotation

    poses: list[Pose | None] = []
    times = []
    for number, row in _iterate_number_lines(path):
        if len(row) != 7:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 7 (t rx ry rz tx ty tz) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        times.append(to_nanoseconds(row[0], path, number))
        values = np.array(row[1:])
        if not np.isfinite(values).all():
            poses.append(None)
            continue
        if np.abs(values).max() > MAX_POSE_VALUE:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number}: the value {max:g} is implausible.",
                path,
                number=number,
                max=np.abs(values).max(),
            )
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = Rotation.from_rotvec(values[:3]).as_matrix()
        camera_from_world[:3, 3] = values[3:]
        poses.append(invert_pose(camera_from_world))
    if not poses:
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "the trajectory file holds no poses.", path)
    return Trajectory(poses, np.array(times, np.int64))


def read_translation_first(path: Path) -> Trajectory:
    """Read lines of translation and quaternion, scalar last (TartanAir, SLAMBench).

    The camera axes stay as in the file.
    """
    poses = []
    for number, row in _iterate_number_lines(path):
        if len(row) != 7:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 7 (tx ty tz qx qy qz qw) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        poses.append(create_pose_from_quaternion(row[:3], row[3:], path, f"line {number}"))
    return Trajectory(poses)


def interpolate_pose(trajectory: Trajectory, time: int, tolerance: int) -> Pose | None:
    """Interpolate the pose at a time.

    Returns None if no pose is within `tolerance`.

    Translation is interpolated linearly, rotation along the shortest arc. In a gap of the trajectory the
    nearest pose is returned.

    Parameters
    ----------
    trajectory : trajectory with increasing timestamps, see `sort_by_time`.
    time, tolerance : nanoseconds.

    Returns
    -------
    (4, 4) world_from_camera.
    """
    times = trajectory.timestamps
    if times is None or not len(times):
        return None
    after = int(np.searchsorted(times, time))
    before = max(after - 1, 0)
    after = min(after, len(times) - 1)
    first, second = trajectory.poses[before], trajectory.poses[after]
    gaps = abs(time - int(times[before])), abs(int(times[after]) - time)
    if min(gaps) > tolerance or first is None or second is None:
        return None
    if before == after or max(gaps) > 2 * tolerance:
        # Next to a gap, the nearest pose is better than interpolation across the gap.
        return first if gaps[0] <= gaps[1] else second
    from scipy.spatial.transform import Rotation

    fraction = gaps[0] / (gaps[0] + gaps[1])
    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec() * fraction
    pose = np.eye(4)
    pose[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = first[:3, 3] * (1 - fraction) + second[:3, 3] * fraction
    return pose


def sort_by_time(trajectory: Trajectory) -> Trajectory:
    """Sort a trajectory by time, without lost poses and repeated timestamps."""
    if trajectory.timestamps is None:
        return trajectory
    tracked = [i for i, pose in enumerate(trajectory.poses) if pose is not None]
    times, first = np.unique(trajectory.timestamps[tracked], return_index=True)
    return Trajectory([trajectory.poses[tracked[i]] for i in first], times)


def match_poses_to_frames(trajectory: Trajectory, names: Sequence[str], path: Path) -> list[Pose | None]:
    """Assign poses to frames for a format without timestamps.

    If the file names its frames, poses are assigned by name or by the number in the name; a frame that is not
    in the file gets None. Otherwise poses are assigned by order, see `assign_by_number`.

    Raises
    ------
    InputError
        If no frame matches, or the number of poses does not fit.
    """
    if trajectory.names is None:
        return assign_by_number(trajectory.poses, names, path, "poses")
    by_key = [
        {key(name): pose for name, pose in zip(trajectory.names, trajectory.poses, strict=True)}
        for key in (_get_stem, _parse_last_number)
    ]
    found = [
        [of.get(key(name)) for name in names]
        for of, key in zip(by_key, (_get_stem, _parse_last_number), strict=True)
    ]
    best = max(found, key=lambda poses: sum(pose is not None for pose in poses))
    if all(pose is None for pose in best):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "its frame names, such as {names!r}, match no frame of the scan, such as {names_2!r}.",
            path,
            names=trajectory.names[0],
            names_2=names[0],
        )
    return best


def _get_stem(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).stem


def _parse_last_number(name: str) -> object:
    """Return the last number in a name, or the name if it has no number."""
    digits = re.findall(r"\d+", _get_stem(name)[-_MAX_NUMBER_LENGTH:])
    return int(digits[-1]) if digits else name


def assign_by_number(values: Sequence[T], names: Sequence[str], path: Path, noun: str) -> list[T]:
    """Assign values to frames: by order if the counts agree, else by the number in the name.

    Parameters
    ----------
    noun : plural noun for the values in messages, such as "poses".

    Raises
    ------
    InputError
        If there are fewer values than frames, or more and the numbers in the names are not valid indices.
    """
    if len(values) == len(names):
        return list(values)
    last = [int((re.findall(r"\d+", name[-_MAX_NUMBER_LENGTH:]) or ["-1"])[-1]) for name in names]
    if len(values) > len(names) == len(set(last)) and min(last) >= 0 and max(last) < len(values):
        emit(
            POSE_ASSUMED.warning(
                "it holds {value_count} {what} for {frame_count} frames; they are assigned by the "
                "number in each frame's name",
                path,
                value_count=len(values),
                what=noun,
                frame_count=len(names),
            )
        )
        return [values[number] for number in last]
    raise InputError(
        POSE_TRAJECTORY_UNREADABLE,
        "it holds {values_count} {what}, but the scan has {names_count} frames.",
        path,
        remedy="Give one per frame, or remove the frames without one.",
        values_count=len(values),
        what=noun,
        names_count=len(names),
    )


def read_times(path: Path, names: Sequence[str]) -> list[int | None]:
    """Read the timestamp of each frame from a file with seconds per line.

    Returns nanoseconds; None for each frame if the file does not exist.
    """
    if not path.exists():
        return [None] * len(names)
    times = [to_nanoseconds(row[0], path, number) for number, row in _iterate_number_lines(path)]
    return list(assign_by_number(times, names, path, "times"))


def to_nanoseconds(seconds: float, path: Path, line: int) -> int:
    """Convert seconds to integer nanoseconds.

    Raises
    ------
    InputError
        If the time is not below 2³² s.
    """
    if not abs(seconds) < 1 << 32:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {line}: the time {seconds:g} s is implausible.",
            path,
            line=line,
            seconds=seconds,
        )
    return round(seconds * 1e9)


def parse_timestamp(word: str, path: Path, line: int) -> int:
    """Parse a time in seconds and convert it to nanoseconds.

    Raises
    ------
    InputError
        If the word is not a number, or is an implausible time.
    """
    try:
        seconds = float(word if "." in word else word.replace(",", "."))
    except ValueError as error:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {line}: {word!r} is not a time in seconds.",
            path,
            line=line,
            word=word[:40],
        ) from error
    return to_nanoseconds(seconds, path, line)


def _iterate_number_lines(path: Path) -> Iterator[tuple[int, list[float]]]:
    """Yield (line number from 1, numbers) of each line with content, without comments."""
    for number, text in documents.iterate_lines(path):
        yield number, read_number_line(text, number, path)


def read_number_line(text: str, number: int, path: Path) -> list[float]:
    """Parse the numbers on a line; see `scanloom.stages.files.number_rows`.

    Raises
    ------
    InputError
        If the line holds anything else. The message names the line by its `number`.
    """
    try:
        return parse_number_row(text)
    except ValueError as error:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {number} holds something that is not a number.",
            path,
            number=number,
        ) from error
