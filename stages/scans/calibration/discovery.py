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
from scanloom.stages.files.noting import only_looking
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import named_arrays, rig_calibration
from scanloom.stages.scans.calibration.image_size import is_off_centre, was_scaled
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED
from scanloom.stages.scans.model.scan import Camera, StereoRig
from scanloom.stages.scans.trajectory import files as trajectories

# Camera or rig, its file, and the diagnostics of reading the file.
T = TypeVar("T")
Found = tuple[T, Path, list[Diagnostic]]

_SUFFIXES = (".json", ".yaml", ".yml", ".toml", ".xml", ".txt", ".ini", ".conf", ".npy", ".npz")
# Names of subfolders that may contain calibrations.
_PLACES = re.compile("calib|param|intrinsic", re.IGNORECASE)
# Bytes of a calibration file, and number of candidate files; folders with more hold other data.
_MAX_BYTES = 1 << 16
_MOST_FILES = 64
_TRAJECTORIES = (".txt", ".log", ".tum", ".traj", ".csv", ".freiburg", ".json", ".npy")
_MOST_TRAJECTORY_BYTES = 1 << 24
# A single 4x4 matrix is not necessarily a pose.
_LEAST_POSES = 2
# Files of software projects, which may contain matching words.
_OF_PROGRAMS = ("CMakeLists.txt", "requirements.txt", "package.json", "package-lock.json")
# Words that occur in camera calibration files of any program.
_OF_CAMERAS = re.compile(r"intrinsic|camera_?matrix|\bmtx|\bf[xy]\b|focal|\bK[12]?\b", re.IGNORECASE)
_OFF_CENTRE = "its principal point is far from the centre of these images."
# Plausible focal lengths as ratio of the longer image side; other matrices are not camera matrices.
_FOCAL_LENGTHS = (0.1, 30.0)


def places_of_calibrations(folder: Path) -> list[Path]:
    """List the folders that may contain calibrations.

    These are the scan folder, and its subfolders with names like `calib` or `params`.
    """
    inside = [path for path in folder.iterdir() if _PLACES.search(path.name) and path.is_dir()]
    return [folder, *sorted(inside)]


def parts_of_calibration(folder: Path) -> tuple[dict[str, Any], list[Path]]:
    """Read a calibration that is split into one file per matrix or vector.

    Returns
    -------
    Numbers of each file by file stem, and the paths of the files.
    """
    found, files = {}, []
    for path in small_documents(folder):
        if path.suffix not in calibration.TEXTS:
            continue
        try:
            found[path.stem] = calibration.text_numbers(path)
            files.append(path)
        except InputError:
            continue
    return found, files


def _documents(folder: Path) -> list[Path]:
    """Return the candidate calibration files of a scan folder."""
    return [path for place in places_of_calibrations(folder) for path in small_documents(place)]


def small_documents(folder: Path, most: int = _MAX_BYTES) -> list[Path]:
    """Return the small text and array files of a folder, sorted by name.

    Returns an empty list if there are too many to be calibrations.

    Parameters
    ----------
    most : maximum size of a file, bytes.
    """
    found = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in _SUFFIXES
        and path.name not in _OF_PROGRAMS
        and path.is_file()
        and path.stat().st_size <= most
    )
    if len(found) > _MOST_FILES:
        # Many .txt files are usually one pose per frame.
        found = [path for path in found if path.suffix.lower() != ".txt"]
    return found if len(found) <= _MOST_FILES else []


def cameras_beside(folder: Path, width: int, height: int) -> list[Found[Camera]]:
    """Find the cameras for an image size in the files of a folder.

    Cameras for another size of the same aspect ratio are scaled. They are returned only if no file has a
    camera for this size. Diagnostics are returned with each camera and not emitted.
    """
    with only_looking():
        found = list(_cameras(folder, width, height))
    return _of_this_size(found)


def _cameras(folder: Path, width: int, height: int) -> Iterator[Found[Camera]]:
    for path in _documents(folder):
        try:
            with collecting(forward=False) as diagnostics:
                camera = calibration.read_camera(path, width, height)
        except InputError:
            continue
        if _is_a_lens(camera) and not is_off_centre(camera):
            yield camera, path, diagnostics


def rigs_beside(folder: Path, width: int, height: int, baseline: float | None) -> list[Found[StereoRig]]:
    """Find the stereo rigs for an image size in the files of a folder.

    See `cameras_beside`.

    Parameters
    ----------
    baseline : metres, overrides the baseline of the files; None to use theirs.
    """
    found = []
    with only_looking():
        for path in _documents(folder):
            try:
                with collecting(forward=False) as diagnostics:
                    rig = rig_calibration.read_rig(path, width, height, baseline=baseline)
            except InputError:
                continue
            if _is_a_lens(rig.left) and _is_a_lens(rig.right):
                found.append((rig, path, diagnostics))
    return _of_this_size(found)


def trajectory_beside(folder: Path, count: int) -> Path | None:
    """Find the only trajectory file of a folder with `count` poses.

    Returns None if there is no such file.
    """
    if count < _LEAST_POSES:
        return None
    with only_looking():
        found = [path for path in texts_of_poses(folder) if _count_of_poses(path) == count]
    return found[0] if len(found) == 1 else None


def texts_of_poses(folder: Path) -> list[Path]:
    """Return the possible trajectory files of a folder by suffix and size, sorted."""
    found = [path for path in folder.iterdir() if path.suffix.lower() in _TRAJECTORIES and path.is_file()]
    return [path for path in sorted(found)[:_MOST_FILES] if path.stat().st_size <= _MOST_TRAJECTORY_BYTES]


def _count_of_poses(path: Path) -> int:
    try:
        return len(trajectories.read_trajectory(path))
    except InputError:
        return 0


def warn_of_rejected(folder: Path, width: int, height: int, read: Callable[[Path, int, int], object]) -> None:
    """Warn about each file of a folder that looks like a calibration but was rejected.

    Parameters
    ----------
    read : reader for a camera or rig, called with path, width and height.
    """
    with only_looking():
        doubtful = [(path, _fault(path, width, height, read)) for path in _documents(folder)]
    for path, fault in doubtful:
        if fault is not None:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "it looks like a calibration but is not used: {fault}", path, fault=fault
                )
            )


def _fault(path: Path, width: int, height: int, read: Callable[[Path, int, int], object]) -> str | None:
    try:
        if not _OF_CAMERAS.search(_words_of(path)):
            return None
        with collecting(forward=False):
            found = read(path, width, height)
    except InputError as error:
        return str(error.diagnostic.at(None))
    return _OFF_CENTRE if isinstance(found, Camera) and is_off_centre(found) else None


def _words_of(path: Path) -> str:
    """Return the words of a file that indicate a calibration.

    The result is empty for .npy.
    """
    if path.suffix == calibration.ARRAY:
        return ""
    if path.suffix == calibration.ARCHIVE:
        return " ".join(named_arrays.tables(path))
    return documents.read_text(path)


def _of_this_size(found: list[Found[T]]) -> list[Found[T]]:
    """Drop scaled cameras if there are unscaled ones."""
    return [one for one in found if not was_scaled(one[2])] or found


def _is_a_lens(camera: Camera) -> bool:
    longer = max(camera.width, camera.height)
    return all(_FOCAL_LENGTHS[0] * longer <= f <= _FOCAL_LENGTHS[1] * longer for f in (camera.fx, camera.fy))
