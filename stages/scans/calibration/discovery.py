"""Discovery of calibration and trajectory files in a scan folder by their content."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import named_arrays, rig_calibration
from scanloom.stages.scans.calibration.image_size import has_scaling_warning, is_off_centre
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED
from scanloom.stages.scans.model.scan import Camera, StereoRig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Camera or rig, its file, and the diagnostics of reading the file.
T = TypeVar("T")
Discovered = tuple[T, Path, list[Diagnostic]]

_CALIBRATION_SUFFIXES = (".json", ".yaml", ".yml", ".toml", ".xml", ".txt", ".ini", ".conf", ".npy", ".npz")
# Names of subfolders that may contain calibrations.
_FOLDER_NAMES = re.compile("calib|param|intrinsic", re.IGNORECASE)
# Bytes of a calibration file, and number of candidate files; folders with more hold other data.
_MAX_BYTES = 1 << 16
_MAX_FILES = 64
_TRAJECTORY_SUFFIXES = (".txt", ".log", ".tum", ".traj", ".csv", ".freiburg", ".json", ".npy")
_MAX_TRAJECTORY_BYTES = 1 << 24
# A single 4x4 matrix is not necessarily a pose.
_MIN_POSES = 2
# Files of software projects, which may contain matching words.
_PROGRAM_FILES = ("CMakeLists.txt", "requirements.txt", "package.json", "package-lock.json")
# Words that occur in camera calibration files of any program.
_CAMERA_WORDS = re.compile(r"intrinsic|camera_?matrix|\bmtx|\bf[xy]\b|focal|\bK[12]?\b", re.IGNORECASE)
_OFF_CENTRE_REASON = "its principal point is far from the centre of these images."
# Plausible focal lengths as ratio of the longer image side; other matrices are not camera matrices.
_FOCAL_RANGE_RATIO = (0.1, 30.0)


def list_calibration_folders(folder: Path) -> list[Path]:
    """List the folders that may contain calibrations.

    These are the scan folder, and its subfolders with names like `calib` or `params`.
    """
    inside = [path for path in folder.iterdir() if _FOLDER_NAMES.search(path.name) and path.is_dir()]
    return [folder, *sorted(inside)]


def read_split_calibration(folder: Path) -> tuple[dict[str, Any], list[Path]]:
    """Read a calibration that is split into one file per matrix or vector.

    Returns
    -------
    Numbers of each file by file stem, and the paths of the files.
    """
    found, files = {}, []
    for path in list_small_documents(folder):
        if path.suffix not in calibration.TEXT_SUFFIXES:
            continue
        try:
            found[path.stem] = calibration.read_bare_numbers(path)
            files.append(path)
        except InputError:
            continue
    return found, files


def _list_candidates(folder: Path) -> list[Path]:
    """Return the candidate calibration files of a scan folder."""
    return [path for place in list_calibration_folders(folder) for path in list_small_documents(place)]


def list_small_documents(folder: Path, max_bytes: int = _MAX_BYTES) -> list[Path]:
    """Return the small text and array files of a folder, sorted by name.

    Returns an empty list if there are too many to be calibrations.

    Parameters
    ----------
    max_bytes : maximum size of a file, bytes.
    """
    found = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in _CALIBRATION_SUFFIXES
        and path.name not in _PROGRAM_FILES
        and path.is_file()
        and path.stat().st_size <= max_bytes
    )
    if len(found) > _MAX_FILES:
        # Many .txt files are usually one pose per frame.
        found = [path for path in found if path.suffix.lower() != ".txt"]
    return found if len(found) <= _MAX_FILES else []


def find_cameras(folder: Path, width: int, height: int) -> list[Discovered[Camera]]:
    """Find the cameras for an image size in the files of a folder.

    Cameras for another size of the same aspect ratio are scaled. They are returned only if no file has a
    camera for this size. Diagnostics are returned with each camera and not emitted.
    """
    with pause_recording():
        found = list(_read_cameras(folder, width, height))
    return _prefer_unscaled(found)


def _read_cameras(folder: Path, width: int, height: int) -> Iterator[Discovered[Camera]]:
    for path in _list_candidates(folder):
        try:
            with collecting(forward=False) as diagnostics:
                camera = calibration.read_camera(path, width, height)
        except InputError:
            continue
        if _has_plausible_focal_length(camera) and not is_off_centre(camera):
            yield camera, path, diagnostics


def find_rigs(folder: Path, width: int, height: int, baseline: float | None) -> list[Discovered[StereoRig]]:
    """Find the stereo rigs for an image size in the files of a folder.

    See `find_cameras`.

    Parameters
    ----------
    baseline : metres, overrides the baseline of the files; None to use theirs.
    """
    found = []
    with pause_recording():
        for path in _list_candidates(folder):
            try:
                with collecting(forward=False) as diagnostics:
                    rig = rig_calibration.read_rig(path, width, height, baseline=baseline)
            except InputError:
                continue
            if _has_plausible_focal_length(rig.left) and _has_plausible_focal_length(rig.right):
                found.append((rig, path, diagnostics))
    return _prefer_unscaled(found)


def find_trajectory(folder: Path, count: int) -> Path | None:
    """Find the only trajectory file of a folder with `count` poses.

    Returns None if there is no such file.
    """
    if count < _MIN_POSES:
        return None
    with pause_recording():
        found = [path for path in list_trajectory_candidates(folder) if _count_poses(path) == count]
    return found[0] if len(found) == 1 else None


def list_trajectory_candidates(folder: Path) -> list[Path]:
    """Return the possible trajectory files of a folder by suffix and size, sorted."""
    found = [
        path for path in folder.iterdir() if path.suffix.lower() in _TRAJECTORY_SUFFIXES and path.is_file()
    ]
    return [path for path in sorted(found)[:_MAX_FILES] if path.stat().st_size <= _MAX_TRAJECTORY_BYTES]


def _count_poses(path: Path) -> int:
    try:
        return len(trajectories.read_trajectory(path))
    except InputError:
        return 0


def warn_rejected_files(
    folder: Path, width: int, height: int, read: Callable[[Path, int, int], object]
) -> None:
    """Warn about each file of a folder that looks like a calibration but was rejected.

    Parameters
    ----------
    read : reader for a camera or rig, called with path, width and height.
    """
    with pause_recording():
        doubtful = [
            (path, _find_rejection_reason(path, width, height, read)) for path in _list_candidates(folder)
        ]
    for path, fault in doubtful:
        if fault is not None:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "it looks like a calibration but is not used: {fault}", path, fault=fault
                )
            )


def _find_rejection_reason(
    path: Path, width: int, height: int, read: Callable[[Path, int, int], object]
) -> str | None:
    try:
        if not _CAMERA_WORDS.search(_read_words(path)):
            return None
        with collecting(forward=False):
            found = read(path, width, height)
    except InputError as error:
        return str(error.diagnostic.replace_location(None))
    return _OFF_CENTRE_REASON if isinstance(found, Camera) and is_off_centre(found) else None


def _read_words(path: Path) -> str:
    """Return the words of a file that indicate a calibration.

    The result is empty for .npy.
    """
    if path.suffix == calibration.ARRAY_SUFFIX:
        return ""
    if path.suffix == calibration.ARCHIVE_SUFFIX:
        return " ".join(named_arrays.read_small_arrays(path))
    return documents.read_text(path)


def _prefer_unscaled(found: list[Discovered[T]]) -> list[Discovered[T]]:
    """Drop scaled cameras if there are unscaled ones."""
    return [one for one in found if not has_scaling_warning(one[2])] or found


def _has_plausible_focal_length(camera: Camera) -> bool:
    longer = max(camera.width, camera.height)
    return all(
        _FOCAL_RANGE_RATIO[0] * longer <= f <= _FOCAL_RANGE_RATIO[1] * longer for f in (camera.fx, camera.fy)
    )
