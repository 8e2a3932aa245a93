"""Camera intrinsics for folders that do not store them: from the user, from a file nearby, or guessed.

One rule for every layout. A folder of loose files whose camera file is missing gets the guess below, with a
warning that names the options. Pairs get none, since focal length times baseline is the scale of all they
show: the calibration is asked for. A file that holds its frames and their camera in one (scan.json, .sens,
transforms.json, Record3D's metadata.json) is damaged without it, and refused.
"""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.noting import note
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.discovery import cameras_beside, warn_of_rejected
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera

# A PrimeSense or Kinect sees 62.7 degrees across; it is what Open3D falls back to, and near to a RealSense's.
_FOCAL_LENGTH = 525 / 640
# Depth maps of sizes that one kind of device has, and its focal length, px; a phone is held either way.
_OF_SIZE = {
    (192, 256): (187, "a phone's LiDAR"),
    (256, 192): (187, "a phone's LiDAR"),
    (512, 424): (365, "a Kinect v2"),
    (640, 576): (504, "an Azure Kinect, narrow"),
    (320, 288): (252, "an Azure Kinect, narrow"),
}


def stated_camera(options: ReadingParams, folder: Path, width: int, height: int) -> Camera | None:
    """Return the camera that the person states for images of this size, in numbers or as a file, or None."""
    path = options.file("calibration", folder)
    stated = options.camera(width, height)
    return calibration.read_camera(path, width, height) if stated is None and path is not None else stated


def found_camera(folder: Path, width: int, height: int) -> tuple[Camera, Path | None]:
    """Return the camera for depth maps of this size that a file beside the images states, and that file.

    Without one the camera is a guess. Both give a warning.
    """
    found = cameras_beside(folder, width, height)
    if len({camera for camera, *_ in found}) == 1:
        camera, path, diagnostics = found[0]
        note(path)
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the camera is read from {file}, which lies beside the images",
                file=path.relative_to(folder).as_posix(),
            ),
            *diagnostics,
        )
        return camera, path
    if found:
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "{files} state different cameras: none is taken",
                files=", ".join(path.name for _, path, _ in found[:5]),
            )
        )
    else:
        warn_of_rejected(folder, width, height, calibration.read_camera)
    return _guessed_camera(width, height), None


def _guessed_camera(width: int, height: int) -> Camera:
    """Return the camera to take for depth maps of this size when nothing is known, with a warning."""
    focal, device = _OF_SIZE.get((width, height), (width * _FOCAL_LENGTH, None))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)
    emit(
        CAMERA_INTRINSICS_GUESSED.warning(
            "the folder has no intrinsics: {fx:g},{fy:g},{cx:g},{cy:g} is guessed, {whose}",
            remedy="for another camera set scan.intrinsics=fx,fy,cx,cy, or name its file with "
            "scan.calibration=FILE",
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            whose="a Kinect's view" if device is None else f"that of {device}",
        )
    )
    return camera
