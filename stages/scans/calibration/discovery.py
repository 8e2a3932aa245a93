"""Camera files that lie beside the images under a name of their own, known by what they hold."""

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

# A camera or rig, the file that states it, and what was emitted while that was read.
T = TypeVar("T")
Found = tuple[T, Path, list[Diagnostic]]

_SUFFIXES = (".json", ".yaml", ".yml", ".toml", ".xml", ".txt", ".ini", ".conf", ".npy", ".npz")
# Folders that calibrations are kept in, inside that of a scan.
_PLACES = re.compile("calib|param|intrinsic", re.IGNORECASE)
# A calibration is a page or two; a folder with more texts than this holds something else in them.
_MAX_BYTES = 1 << 16
_MOST_FILES = 64
_TRAJECTORIES = (".txt", ".log", ".tum", ".traj", ".csv", ".freiburg", ".json", ".npy")
_MOST_TRAJECTORY_BYTES = 1 << 24
# A single pose may be any matrix.
_LEAST_POSES = 2
# Texts of programs, whatever words stand in them.
_OF_PROGRAMS = ("CMakeLists.txt", "requirements.txt", "package.json", "package-lock.json")
# What stands in files of cameras, whoever wrote them.
_OF_CAMERAS = re.compile(r"intrinsic|camera_?matrix|\bmtx|\bf[xy]\b|focal|\bK[12]?\b", re.IGNORECASE)
_OFF_CENTRE = "its principal point is far from the middle of these images."
# Focal lengths of lenses, as shares of an image's longer side: other matrices are none of a camera.
_FOCAL_LENGTHS = (0.1, 30.0)


def places_of_calibrations(folder: Path) -> list[Path]:
    """Return a scan's folder, and those in it whose names say that calibrations are in them."""
    inside = [path for path in folder.iterdir() if _PLACES.search(path.name) and path.is_dir()]
    return [folder, *sorted(inside)]


def parts_of_calibration(folder: Path) -> tuple[dict[str, Any], list[Path]]:
    """Return what the files of a folder that are a matrix or a row each state, by their names; and them."""
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
    """Return the files that may be calibrations, of all places of such."""
    return [path for place in places_of_calibrations(folder) for path in small_documents(place)]


def small_documents(folder: Path, most: int = _MAX_BYTES) -> list[Path]:
    """Return the files of a folder that may be a page of settings, by name; none if they are too many.

    Parameters
    ----------
    most : bytes; larger files are none.
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
        # Many texts are poses, one a frame.
        found = [path for path in found if path.suffix.lower() != ".txt"]
    return found if len(found) <= _MOST_FILES else []


def cameras_beside(folder: Path, width: int, height: int) -> list[Found[Camera]]:
    """Return the cameras for images of this size that files of a folder state, by the files' names.

    Those of files for another size of the same shape are scaled; they count only where no file is for this
    size. Diagnostics of a file are returned and not emitted.
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
    """Return the rigs for images of this size that files of a folder state; see `cameras_beside`."""
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
    """Return the only file of a folder that holds as many poses as there are frames; None without one."""
    if count < _LEAST_POSES:
        return None
    with only_looking():
        found = [path for path in texts_of_poses(folder) if _count_of_poses(path) == count]
    return found[0] if len(found) == 1 else None


def texts_of_poses(folder: Path) -> list[Path]:
    """Return the files of a folder that may hold poses, by their extension and size, in order."""
    found = [path for path in folder.iterdir() if path.suffix.lower() in _TRAJECTORIES and path.is_file()]
    return [path for path in sorted(found)[:_MOST_FILES] if path.stat().st_size <= _MOST_TRAJECTORY_BYTES]


def _count_of_poses(path: Path) -> int:
    try:
        return len(trajectories.read_trajectory(path))
    except InputError:
        return 0


def warn_of_rejected(folder: Path, width: int, height: int, read: Callable[[Path, int, int], object]) -> None:
    """Warn of each file of a folder that seems to state a camera for such images, and say why it is none."""
    with only_looking():
        doubtful = [(path, _fault(path, width, height, read)) for path in _documents(folder)]
    for path, fault in doubtful:
        if fault is not None:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "it seems to state a camera and is not taken: {fault}", path, fault=fault
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
    """Return what tells whether a file is about cameras; an array has no words."""
    if path.suffix == calibration.ARRAY:
        return ""
    if path.suffix == calibration.ARCHIVE:
        return " ".join(named_arrays.tables(path))
    return documents.read_text(path)


def _of_this_size(found: list[Found[T]]) -> list[Found[T]]:
    """Leave out cameras that are scaled, where others are not."""
    return [one for one in found if not was_scaled(one[2])] or found


def _is_a_lens(camera: Camera) -> bool:
    longer = max(camera.width, camera.height)
    return all(_FOCAL_LENGTHS[0] * longer <= f <= _FOCAL_LENGTHS[1] * longer for f in (camera.fx, camera.fy))
