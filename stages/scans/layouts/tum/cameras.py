"""Cameras of the TUM RGB-D data set, known by recording name.

The folders of the data set do not contain a calibration.
"""

from __future__ import annotations

import re
from pathlib import Path

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.files import documents
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED
from scanloom.stages.scans.image_folders.image_files import find_first_existing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, scale_camera

# fx fy cx cy, then k1 k2 p1 p2 k3.
_DATA_SET_CAMERAS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}
# The first lines of the lists name the recording: `# file: 'rgbd_dataset_freiburg1_rpy.bag'`.
_RECORDING_LINE = re.compile(r"^#\s*file:\s*['\"]?([^'\"\n]+)", re.MULTILINE)
_DATA_SET_NAME = re.compile(r"rgbd_dataset_freiburg([123])(?!\d)")
_SIMILAR_NAME = re.compile(r"(?<![a-z])(?:freiburg|fr)_?[123](?!\d)", re.IGNORECASE)
_HEADER_CHARS = 1000


def find_tum_camera(
    folder: Path, options: ReadingParams, width: int, height: int
) -> tuple[Camera, Path | None]:
    """Return the camera for an image size, and its file or None.

    Raises
    ------
    InputError
        If the calibration file cannot be read.
    """
    path = options.resolve_file("calibration", folder) or find_first_existing(
        folder, "camera.json", "intrinsic.json"
    )
    camera = options.get_camera(width, height)
    if camera is not None:
        return camera, path
    if path is not None:
        return calibration.read_camera(path, width, height), path
    with collecting(forward=False) as diagnostics:
        camera, path = find_or_guess_camera(folder, width, height)
    own, source = identify_camera(folder)
    if path is None and own is not None:
        matrix, distortion = _DATA_SET_CAMERAS[own]
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the camera of {camera} is used, according to {source}", camera=own, source=source
            )
        )
        return scale_camera(Camera(640, 480, *matrix, distortion), width, height), None
    emit(*diagnostics)
    if path is None and _SIMILAR_NAME.search(resolve_path(folder).name):
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the folder is named like a recording of TUM RGB-D, but its files do not confirm it: the "
                "lens distortion of the data set is not applied"
            )
        )
    return camera, path


def is_data_set_list(path: Path) -> bool:
    """Return True if a list names a recording of TUM in its header."""
    return _DATA_SET_NAME.search(documents.read_text(path)[:_HEADER_CHARS]) is not None


def identify_camera(folder: Path) -> tuple[str | None, str]:
    """Return the data set's camera of a folder, and how it was identified.

    The camera is None for other cameras. The lists take precedence. The folder name counts only if the
    lists name no recording, and only in the exact form of the data set: any recording may be in a folder
    called freiburg1.
    """
    recorded = _read_recording_name(folder)
    named = _DATA_SET_NAME.match(resolve_path(folder).name if recorded is None else recorded)
    source = "the folder name" if recorded is None else "the recording name in the file lists"
    return (None if named is None else f"freiburg{named[1]}"), source


def _read_recording_name(folder: Path) -> str | None:
    """Return the recording named in the header of the lists, or None."""
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        head = documents.read_text(folder / name)[:_HEADER_CHARS] if (folder / name).is_file() else ""
        if named := _RECORDING_LINE.search(head):
            return named[1]
    return None
