"""Parameters that all layout readers have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param
from scanloom.stages.scans.model.named_cameras import create_named_camera, suggest_names
from scanloom.stages.scans.model.poses import AS_WRITTEN, CONVENTIONS
from scanloom.stages.scans.model.scan import Camera


@dataclass(frozen=True, kw_only=True)
class ReadingParams:
    """Parameters of every layout reader; unset ones are taken from the folder."""

    intrinsics: str | None = param(
        None,
        "Camera intrinsics `fx,fy,cx,cy` (for both cameras of a stereo pair), instead of the folder's; or a "
        "camera: d435, d455, l515, azure, kinect1, kinect2, orbbec-astra, iphone-13-pro and others.",
        unit="px",
        common=True,
    )
    baseline: float | None = param(
        None,
        "Distance between the two cameras of a stereo pair, instead of the calibration's.",
        unit="m",
        low=0,
        low_open=True,
    )
    calibration: str | None = param(
        None,
        "Calibration file (JSON, TOML, OpenCV YAML or XML, Kalibr or ROS YAML), instead of the folder's.",
        is_path=True,
    )
    poses: str | None = param(
        None,
        "Trajectory file (KITTI, TUM, .log, .json, .traj, EuRoC .csv), instead of the folder's. Poses are "
        "camera-to-world, in a .traj world-to-camera.",
        is_path=True,
        common=True,
    )
    pose_convention: str = param(
        AS_WRITTEN,
        "Pose convention, if the file does not follow its format: world-to-camera, camera axes with y up and "
        "z backward (OpenGL), or both.",
        choices=CONVENTIONS,
    )
    poses_by_order: bool = param(
        False,
        "Match the poses of a trajectory to the frames by order instead of by timestamp, one pose per frame.",
    )
    masks: str | None = param(
        None,
        "Folder with an 8-bit mask for each frame, matched by name or number. Pixels with value 0 are not "
        "part of the scene (a backdrop, moving objects) and get no depth.",
        is_path=True,
    )
    adjusted_cameras: str | None = param(
        None,
        "cameras.json of `scanloom adjust`, or of the folder adjusted/ of a run. Its poses and colour camera "
        "replace the folder's.",
        is_path=True,
    )
    depth_calibration: str | None = param(
        None,
        "depth_calibration.json of `scanloom adjust`, or of the folder adjusted/ of a run, for the same "
        "sensor. Measured depth is corrected with it.",
        is_path=True,
    )
    depth_scale: float | None = param(
        None,
        "Units of the depth files per metre (1000 for millimetres); by default the layout's.",
        unit="per m",
        low=0,
        low_open=True,
    )
    min_confidence: int | None = param(
        None,
        "Minimum confidence of depth; depth below it is ignored. Polycam has the levels 0, 127 and 255, "
        "other phones 0, 1 and 2. By default only the lowest level is ignored.",
        low=0,
        high=255,
    )
    align_axes: bool = param(
        False,
        "Rotate the world by the axisAlignment in ScanNet's scene*.txt: walls become parallel to the axes.",
    )
    keep_unposed: bool = param(
        False,
        "Keep photos without a pose in a scan with poses, and add photos of the same folder that are not "
        "listed; `run` estimates the missing poses.",
    )
    check_poses: bool = param(
        True,
        "Stop if the depth of the frames is clearly more consistent with another pose convention: "
        "world-to-camera, camera axes with y up, or poses in reverse order.",
        invalidates=False,
    )
    first: int = param(0, "Index of the first frame to use, counted from 0.", unit="frames", low=0)
    last: int | None = param(
        None, "Index of the last frame to use; by default the scan's last.", unit="frames", low=0
    )
    every: int = param(1, "Use every n-th frame.", unit="frames", low=1, common=True)
    max_frames: int | None = param(
        None,
        "Maximum number of frames, evenly spaced. Ignored for frames without poses and for single views, "
        "because their neighbours must overlap.",
        unit="frames",
        low=2,
    )
    hold_out: int | None = param(
        None,
        "Hold out every n-th frame from all stages; a run then compares its photo with the mesh.",
        unit="frames",
        low=2,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        self.get_camera(1, 1)

    def get_camera(self, width: int, height: int) -> Camera | None:
        """Return the camera from `intrinsics` for a given image size.

        Returns None if not given.

        Raises
        ------
        UsageError
            If `intrinsics` is neither four numbers nor the name of a camera, or a focal length is not
            positive.
        """
        if self.intrinsics is None:
            return None
        named = create_named_camera(self.intrinsics, width, height)
        if named is not None:
            return named
        try:
            fx, fy, cx, cy = (float(word) for word in self.intrinsics.replace(",", " ").split())
        except ValueError:
            fx = fy = cx = cy = math.nan
        if not (math.isfinite(fx + fy + cx + cy) and fx > 0 and fy > 0):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {intrinsics!r}; it must be fx,fy,cx,cy in pixels, for example 525,525,319.5,239.5, or a "
                "camera ({names}).",
                DiagnosticLocation(parameter="intrinsics"),
                intrinsics=self.intrinsics,
                names=suggest_names(self.intrinsics),
            )
        return Camera(width, height, fx, fy, cx, cy)

    def resolve_file(self, name: str, folder: Path) -> Path | None:
        """Return the path that a parameter names; None if not given.

        If the path does not exist but exists inside the scan folder, the latter is returned.
        """
        value = getattr(self, name)
        if value is None:
            return None
        path = Path(value)
        return folder / path if not path.exists() and (folder / path).exists() else path
