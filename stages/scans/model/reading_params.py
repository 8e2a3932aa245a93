"""What a person may say about a scan folder that the folder itself does not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param
from scanloom.stages.scans.model.poses import AS_WRITTEN, CONVENTIONS
from scanloom.stages.scans.model.scan import Camera


@dataclass(frozen=True, kw_only=True)
class ReadingParams:
    """What every layout's reader may be told; everything is found in the folder when not given."""

    intrinsics: str | None = param(
        None,
        "Camera matrix as `fx,fy,cx,cy` (of both cameras of a pair), in place of the folder's.",
        unit="px",
        common=True,
    )
    baseline: float | None = param(
        None,
        "Distance between the two cameras of a pair, in place of the calibration's.",
        unit="m",
        low=0,
        low_open=True,
    )
    calibration: str | None = param(
        None,
        "Calibration file (JSON, TOML, OpenCV YAML or XML, Kalibr or ROS YAML), in place of the folder's.",
        is_path=True,
    )
    poses: str | None = param(
        None,
        "Trajectory file (KITTI, TUM, .log, .json, .traj, EuRoC .csv) in place of the folder's; "
        "camera-to-world, but for a .traj.",
        is_path=True,
        common=True,
    )
    pose_convention: str = param(
        AS_WRITTEN,
        "How the poses are meant, if not as the form of their file says: world-to-camera, of a camera with y "
        "up and z back (OpenGL's), or both.",
        choices=CONVENTIONS,
    )
    poses_by_order: bool = param(
        False,
        "Take the poses of a trajectory in the order of the frames, one each, whatever their times are.",
    )
    masks: str | None = param(
        None,
        "Folder with an image of 8 bits for each frame, of its name or number: what is 0 in it shows nothing "
        "of the scene (a backdrop, what moves) and gets no depth.",
        is_path=True,
    )
    adjusted: str | None = param(
        None,
        "A cameras.json of `scanloom adjust`, or of a run's adjusted/: its poses and its colour camera in "
        "place of the folder's.",
        is_path=True,
    )
    depth_scale: float | None = param(
        None,
        "Value of a depth file that is one metre (1000 for millimetres); by default the layout's own.",
        unit="per m",
        low=0,
        low_open=True,
    )
    least_confidence: int | None = param(
        None,
        "Depth of less confidence is left out: Polycam has 0, 127 and 255, other phones 0, 1 and 2. "
        "By default only the lowest is left out.",
        low=0,
        high=255,
    )
    align_axes: bool = param(
        False,
        "Turn the world as the axisAlignment in ScanNet's scene*.txt says, so that walls run along its axes.",
    )
    check_poses: bool = param(
        True,
        "Stop when the depth of the frames fits together clearly better under another reading of the poses: "
        "world-to-camera, of a camera with y up, or the last pose first.",
        invalidates=False,
    )
    first: int = param(0, "Position of the first frame to use, counted from 0.", unit="frames", low=0)
    last: int | None = param(
        None, "Position of the last frame to use; by default the scan's last.", unit="frames", low=0
    )
    every: int = param(1, "Use every n-th frame.", unit="frames", low=1, common=True)
    max_frames: int | None = param(
        None,
        "Use at most so many frames, spread evenly. Frames without poses and single views are all used: of "
        "these, neighbours have to overlap.",
        unit="frames",
        low=2,
    )
    hold_out: int | None = param(
        None,
        "Keep every n-th frame from all stages; a run then compares its photo with the mesh.",
        unit="frames",
        low=2,
    )

    def __post_init__(self) -> None:
        check(self)
        self.camera(1, 1)

    def camera(self, width: int, height: int) -> Camera | None:
        """Return the camera that `intrinsics` states, for images of this size; None if not given."""
        if self.intrinsics is None:
            return None
        try:
            fx, fy, cx, cy = (float(word) for word in self.intrinsics.replace(",", " ").split())
        except ValueError:
            fx = fy = cx = cy = math.nan
        if not (math.isfinite(fx + fy + cx + cy) and fx > 0 and fy > 0):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {intrinsics!r}; it must be fx,fy,cx,cy in pixels, for example 525,525,319.5,239.5.",
                Where(parameter="intrinsics"),
                intrinsics=self.intrinsics,
            )
        return Camera(width, height, fx, fy, cx, cy)

    def file(self, name: str, folder: Path) -> Path | None:
        """Return the file that a parameter names: as it stands, or inside the scan folder."""
        value = getattr(self, name)
        if value is None:
            return None
        path = Path(value)
        return folder / path if not path.exists() and (folder / path).exists() else path
