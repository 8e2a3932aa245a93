"""Read trajectory files into rigid camera-to-world poses (metres, OpenCV camera axes).

Every form that scan folders use is here; what a pose means in the file (its direction, its quaternion order,
row- or column-major) is undone once, by the reader of that form.
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
from scanloom.stages.files.row_numbers import numbers_on
from scanloom.stages.scans.codes import POSE_ASSUMED, POSE_TRAJECTORY_UNREADABLE
from scanloom.stages.scans.model.poses import LARGEST_VALUE, inverted, matrix_of, pose_from_quaternion, rigid
from scanloom.stages.scans.model.scan import Pose

T = TypeVar("T")

# Of a pose in a NumPy array, and how many there may be: days of frames.
_STACKED = ((3, 4), (4, 4), (12,), (16,))
_MOST_POSES = 1 << 22
# Python reads no number of thousands of digits.
_LONGEST_NUMBER = 255


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in the order of their file.

    Attributes
    ----------
    poses : (4, 4) float64 world-from-camera (or -body, where the file says so); None where tracking was lost.
    timestamps : (n,) int64 nanoseconds, or None when the form has none.
    names : what the file calls the frame of each, its name or its number; None when the form has none.
    """

    poses: Sequence[Pose | None]
    timestamps: NDArray[np.int64] | None = None
    names: Sequence[str] | None = None

    def __len__(self) -> int:
        return len(self.poses)


def read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory file of any known form, told apart by its suffix and its first line of numbers.

    KITTI and plain 4x4 lines (12 or 16 numbers, row-major), TUM lines (`t tx ty tz qx qy qz qw`), the same
    without times (SLAMBench), Redwood and Open3D `.log`, Open3D `.json` (world-to-camera, column-major),
    EuRoC `.csv`, ARKitScenes `.traj`, nested rows in JSON, in a list or by frame, and matrices as NumPy's
    `.npy`.

    Raises
    ------
    InputError
        If the form is unknown or a pose is not rigid; the message names the file and the line.
    """
    if path.suffix == ".json":
        return read_json(path)
    if path.suffix == ".csv":
        return read_euroc(path)
    if path.suffix == ".traj":
        return read_traj(path)
    if path.suffix == ".npy":
        return read_stack(path)
    first = next(_number_lines(path), None)
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
            "line {first} holds {count} numbers. Expected are 12 or 16 (a matrix), 8 (t "
            "tx ty tz qx qy qz qw), 7 (the same without t) or 3 (a .log header)."
        ),
        path,
        first=first[0],
        count=count,
    )


def read_pose(path: Path) -> Pose | None:
    """Read one pose from a file with a 4x4 (or 3x4) matrix in rows; None when it marks lost tracking."""
    values = [value for _, row in _number_lines(path) for value in row]
    if len(values) not in (12, 16):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "a pose of 4 rows of 4 numbers is expected; it holds {values_count} numbers.",
            path,
            values_count=len(values),
        )
    return rigid(np.reshape(values, (-1, 4)), path)


def read_matrices(path: Path) -> Trajectory:
    """Read lines of 12 (KITTI, 3x4) or 16 (4x4) row-major numbers, camera-to-world."""
    poses = []
    for number, row in _number_lines(path):
        if len(row) not in (12, 16):
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; a pose needs 12 or 16.",
                path,
                number=number,
                row_count=len(row),
            )
        poses.append(rigid(np.reshape(row, (-1, 4)), path, f"line {number}"))
    return Trajectory(poses)


def read_stack(path: Path) -> Trajectory:
    """Read a NumPy array (n, 3, 4), (n, 4, 4), (n, 12) or (n, 16) of such matrices, camera-to-world."""
    array = read_array(path, "the trajectory file")
    is_stack = array.ndim > 1 and array.dtype.kind == "f" and array.shape[1:] in _STACKED
    if not is_stack or not 0 < len(array) <= _MOST_POSES:
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
    return Trajectory([rigid(matrix, path, f"pose {i}") for i, matrix in enumerate(matrices)])


def read_tum(path: Path) -> Trajectory:
    """Read TUM lines: seconds, translation, quaternion with the scalar last; camera-to-world.

    A widely used writer forgets to end its header `# …>`, so that the first pose stands in the comment; it is
    taken from there.
    """
    poses, times = [], []
    swallowed = re.match(
        r"#[^\n]*>[ \t]*([-+.\deE]+(?:[ \t]+[-+.\deE]+){7})[ \t]*\n", documents.read_text(path)
    )
    first = [(1, numbers_of(swallowed[1], 1, path))] if swallowed else []
    for number, row in (*first, *_number_lines(path)):
        if len(row) != 8:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 8 (t tx ty tz qx qy qz qw) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        times.append(nanoseconds(row[0], path, number))
        poses.append(pose_from_quaternion(row[1:4], row[4:8], path, f"line {number}"))
    return Trajectory(poses, np.array(times, np.int64))


def write_tum(path: Path, seconds: Sequence[float], poses: Sequence[Pose]) -> None:
    """Write TUM lines, as `read_tum` reads them: times in seconds, camera-to-world poses in metres."""
    from scipy.spatial.transform import Rotation

    lines = ["# seconds tx ty tz qx qy qz qw"]
    for time, pose in zip(seconds, poses, strict=True):
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat()
        lines.append(" ".join([f"{time:.9f}", *(f"{value:.9f}" for value in (*pose[:3, 3], *turn))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read_log(path: Path) -> Trajectory:
    """Read a Redwood or Open3D `.log`: a header of three integers, then four rows; camera-to-world."""
    content = list(_number_lines(path))
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
        poses.append(rigid(np.array(rows), path, f"entry at line {number}"))
    return Trajectory(poses)


def read_stacked(path: Path) -> Trajectory:
    """Read three rows of four numbers a pose (SUN3D), one after the other without a mark; camera-to-world."""
    rows = list(_number_lines(path))
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
        rigid(np.array([row for _, row in rows[at : at + 3]]), path, f"pose at line {rows[at][0]}")
        for at in range(0, len(rows), 3)
    ]
    return Trajectory(poses)


def read_json(path: Path) -> Trajectory:
    """Read poses from JSON: Open3D's camera trajectory or pose graph, or row-major 4x4 matrices.

    Open3D writes 16 numbers column-major; its camera trajectory holds *world-to-camera* extrinsics, its pose
    graph camera-to-world poses. Matrices are camera-to-world, in a list, or the values of an object whose
    names are those of the frames, or their numbers.
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
                "it holds none of `parameters`, `nodes` or `poses`, so no trajectory.",
                path,
            )
        matrices = [matrix_of(entry, path, f"pose {i}") for i, entry in enumerate(entries)]
        return Trajectory(
            [rigid(matrix, path, f"pose {i}") for i, matrix in enumerate(matrices)], names=names
        )
    poses = []
    for i, entry in enumerate(entries):
        flat = entry.get(key) if isinstance(entry, dict) else None
        pose = rigid(matrix_of(flat, path, f"{key} {i}").T, path, f"{key} {i}")
        poses.append(inverted(pose) if inverse and pose is not None else pose)
    return Trajectory(poses)


def read_euroc(path: Path) -> Trajectory:
    """Read EuRoC ground truth: nanoseconds, position, quaternion with the scalar *first*; body-to-world."""
    poses, times = [], []
    for number, text in documents.lines(path):
        fields = text.split(",")
        try:
            # An int: a float64 cannot hold nanoseconds since 1970 exactly.
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
        poses.append(pose_from_quaternion(row[:3], [*row[4:], row[3]], path, f"line {number}"))
    return Trajectory(poses, np.array(times, np.int64))


def read_traj(path: Path) -> Trajectory:
    """Read ARKitScenes lines: seconds, rotation vector (radians), translation; *world-to-camera*."""
    from scipy.spatial.transform import Rotation

    poses: list[Pose | None] = []
    times = []
    for number, row in _number_lines(path):
        if len(row) != 7:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 7 (t rx ry rz tx ty tz) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        times.append(nanoseconds(row[0], path, number))
        values = np.array(row[1:])
        if not np.isfinite(values).all():
            poses.append(None)
            continue
        if np.abs(values).max() > LARGEST_VALUE:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number}: a value of {max:g} cannot be right.",
                path,
                number=number,
                max=np.abs(values).max(),
            )
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = Rotation.from_rotvec(values[:3]).as_matrix()
        camera_from_world[:3, 3] = values[3:]
        poses.append(inverted(camera_from_world))
    if not poses:
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "the trajectory file holds no poses.", path)
    return Trajectory(poses, np.array(times, np.int64))


def read_translation_first(path: Path) -> Trajectory:
    """Read lines of translation and quaternion, scalar last (TartanAir, SLAMBench); axes as in the file."""
    poses = []
    for number, row in _number_lines(path):
        if len(row) != 7:
            raise InputError(
                POSE_TRAJECTORY_UNREADABLE,
                "line {number} holds {row_count} numbers; 7 (tx ty tz qx qy qz qw) are expected.",
                path,
                number=number,
                row_count=len(row),
            )
        poses.append(pose_from_quaternion(row[:3], row[3:], path, f"line {number}"))
    return Trajectory(poses)


def interpolate(trajectory: Trajectory, time: int, tolerance: int) -> Pose | None:
    """Return the pose at a moment, between its two neighbours; None if no pose is within `tolerance`.

    Translation is interpolated linearly, rotation on the shortest arc.

    Parameters
    ----------
    trajectory : with rising timestamps, as `in_order` returns it.
    time, tolerance : nanoseconds.
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
        # Beside a hole in the trajectory the near pose is better than a line across the hole.
        return first if gaps[0] <= gaps[1] else second
    from scipy.spatial.transform import Rotation

    share = gaps[0] / (gaps[0] + gaps[1])
    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec() * share
    pose = np.eye(4)
    pose[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = first[:3, 3] * (1 - share) + second[:3, 3] * share
    return pose


def in_order(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory sorted by time, lost poses and second poses of one moment left out."""
    if trajectory.timestamps is None:
        return trajectory
    tracked = [i for i, pose in enumerate(trajectory.poses) if pose is not None]
    times, first = np.unique(trajectory.timestamps[tracked], return_index=True)
    return Trajectory([trajectory.poses[tracked[i]] for i in first], times)


def match(trajectory: Trajectory, names: Sequence[str], path: Path) -> list[Pose | None]:
    """Return the pose of each frame of a form without times: the n-th, or the one its number counts to.

    Where the file names the frames, each has that of its name, or of its name's number, and a frame that is
    not in the file has none.
    """
    if trajectory.names is None:
        return by_number(trajectory.poses, names, path, "poses")
    by_key = [
        {key(name): pose for name, pose in zip(trajectory.names, trajectory.poses, strict=True)}
        for key in (_stem, _last_number)
    ]
    found = [
        [of.get(key(name)) for name in names] for of, key in zip(by_key, (_stem, _last_number), strict=True)
    ]
    most = max(found, key=lambda poses: sum(pose is not None for pose in poses))
    if all(pose is None for pose in most):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "it holds poses of {names!r} and so on, and none of a frame of the scan, such as {names_2!r}.",
            path,
            names=trajectory.names[0],
            names_2=names[0],
        )
    return most


def _stem(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).stem


def _last_number(name: str) -> object:
    """Return the last number in a name; a name without one is like no other."""
    digits = re.findall(r"\d+", _stem(name)[-_LONGEST_NUMBER:])
    return int(digits[-1]) if digits else name


def by_number(values: Sequence[T], names: Sequence[str], path: Path, what: str) -> list[T]:
    """Return the value of each frame name: in order when the counts agree, else by the number in the name.

    Raises
    ------
    InputError
        If there are fewer values than frames, or more and the names are not their positions.
    """
    if len(values) == len(names):
        return list(values)
    last = [int((re.findall(r"\d+", name) or ["-1"])[-1]) for name in names]
    if len(values) > len(names) == len(set(last)) and min(last) >= 0 and max(last) < len(values):
        emit(
            POSE_ASSUMED.warning(
                "it holds {value_count} {what} for {frame_count} frames: each has that of its name's number",
                path,
                value_count=len(values),
                what=what,
                frame_count=len(names),
            )
        )
        return [values[number] for number in last]
    raise InputError(
        POSE_TRAJECTORY_UNREADABLE,
        "it holds {values_count} {what}, but the scan has {names_count} frames.",
        path,
        remedy="Give one for each frame, or remove the frames without.",
        values_count=len(values),
        what=what,
        names_count=len(names),
    )


def read_times(path: Path, names: Sequence[str]) -> list[int | None]:
    """Return the nanoseconds of each frame from a file of seconds, one a line; None without the file."""
    if not path.exists():
        return [None] * len(names)
    times = [nanoseconds(row[0], path, number) for number, row in _number_lines(path)]
    return list(by_number(times, names, path, "times"))


def nanoseconds(seconds: float, path: Path, line: int) -> int:
    """Return seconds as whole nanoseconds."""
    if not abs(seconds) < 1 << 32:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {line}: the time {seconds:g} s cannot be right.",
            path,
            line=line,
            seconds=seconds,
        )
    return round(seconds * 1e9)


def stamp(word: str, path: Path, line: int) -> int:
    """Return the nanoseconds of a time that is written in seconds.

    Raises
    ------
    InputError
        If it is no number, or none that can be a time.
    """
    try:
        seconds = float(word if "." in word else word.replace(",", "."))
    except ValueError as error:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {line}: {word!r} is no time in seconds.",
            path,
            line=line,
            word=word[:40],
        ) from error
    return nanoseconds(seconds, path, line)


def _number_lines(path: Path) -> Iterator[tuple[int, list[float]]]:
    """Yield line numbers (from 1) and the numbers on them, without comments and empty lines."""
    for number, text in documents.lines(path):
        yield number, numbers_of(text, number, path)


def numbers_of(text: str, number: int, path: Path) -> list[float]:
    """Return the numbers on a line; see `scanloom.stages.files.row_numbers`.

    Raises
    ------
    InputError
        If there is something else on it; the message names the line by its `number`.
    """
    try:
        return numbers_on(text)
    except ValueError as error:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "line {number} holds something that is not a number.",
            path,
            number=number,
        ) from error
