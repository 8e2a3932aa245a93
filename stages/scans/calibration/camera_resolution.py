"""Camera intrinsics of folders that do not store them: from the user, a discovered file, or a guess.

The rule is the same for all layouts. A folder of loose images without a camera file gets a guessed camera
with a warning that names the options. Stereo pairs never get a guess, because focal length × baseline scales
every depth: a calibration is required. A file that contains both frames and camera (scan.json, .sens,
transforms.json, Record3D's metadata.json) is rejected as damaged if the camera is missing.
"""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.file_access_log import record_opened
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.discovery import find_cameras, warn_rejected_files
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera

# Focal length in image widths of a PrimeSense or Kinect, 62.7° wide; Open3D's default, and close to a
# RealSense.
_DEFAULT_FOCAL_RATIO = 525 / 640
# Focal length in pixels and device, by depth map sizes that are specific to a device. Phones are held in
# either orientation.
_DEVICES_BY_SIZE = {
    (192, 256): (187, "a phone's LiDAR"),
    (256, 192): (187, "a phone's LiDAR"),
    (512, 424): (365, "a Kinect v2"),
    (640, 576): (504, "an Azure Kinect, narrow"),
    (320, 288): (252, "an Azure Kinect, narrow"),
}


def get_stated_camera(options: ReadingParams, folder: Path, width: int, height: int) -> Camera | None:
    """Return the camera that the user gave as numbers or file.

    Returns None if not given.
    """
    path = options.resolve_file("calibration", folder)
    stated = options.get_camera(width, height)
    return calibration.read_camera(path, width, height) if stated is None and path is not None else stated


def find_or_guess_camera(folder: Path, width: int, height: int) -> tuple[Camera, Path | None]:
    """Find the camera for depth maps of a size in the files of a folder, or guess it.

    Emits a warning in both cases.

    Returns
    -------
    The camera, and its file or None for a guess.
    """
    found = find_cameras(folder, width, height)
    if len({camera for camera, *_ in found}) == 1:
        camera, path, diagnostics = found[0]
        record_opened(path)
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the camera is read from {file}, which was found next to the images",
                file=path.relative_to(folder).as_posix(),
            ),
            *diagnostics,
        )
        return camera, path
    if found:
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "{files} state different cameras; none of them is used",
                files=", ".join(path.name for _, path, _ in found[:5]),
            )
        )
    else:
        warn_rejected_files(folder, width, height, calibration.read_camera)
    return _guess_camera(width, height), None


def _guess_camera(width: int, height: int) -> Camera:
    """Guess the camera from the size of the depth maps, with a warning."""
    focal, device = _DEVICES_BY_SIZE.get((width, height), (width * _DEFAULT_FOCAL_RATIO, None))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)
    emit(
        CAMERA_INTRINSICS_GUESSED.warning(
            "the folder has no intrinsics; {fx:g},{fy:g},{cx:g},{cy:g} is guessed ({whose})",
            remedy="for another camera set scan.intrinsics=NAME (such as d435, azure or kinect2), "
            "scan.intrinsics=fx,fy,cx,cy or scan.calibration=FILE",
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            whose="the field of view of a Kinect" if device is None else f"the camera of {device}",
        )
    )
    return camera
