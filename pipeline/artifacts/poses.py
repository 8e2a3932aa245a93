"""Files with the poses estimated by `register`.

trajectory.tum      camera-to-world poses of the used frames, one per line
registration.json   the same poses as 4x4 matrices by frame index; edges, components and breaks of the pose
graph
path.ply            coloured point cloud of the frames, with the camera path in red
pieces/             trajectories of the other connected components, by component number
masks/              masks of the moving object by frame index, if only the object was registered; white is
object
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.depth_maps import sample_point_cloud
from scanloom.pipeline.relative_paths import make_paths_relative
from scanloom.pipeline.stage import Artifact
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import encode_gray_png
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.registration.registration_result import Registration
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import ColorImage, Frame, Scan
from scanloom.stages.scans.trajectory.trajectory_formats import write_tum
from scanloom.stages.surface.formats.ply import write_ply_cloud

# Points in the cloud: enough to judge the poses visually.
_MAX_POINTS = 500_000
# Points drawn between two consecutive camera positions.
_PATH_POINTS = 20
_PATH_COLOR = (255, 0, 0)
_FILE = "registration.json"
_MASKS = "masks"


@dataclass(frozen=True)
class Poses(Artifact):
    """Estimated poses by frame index."""

    NAME = "poses"

    def apply_to(self, scan: Scan) -> Scan:
        """Apply the estimated poses to a scan, dropping frames without a pose."""
        document = self._read()
        return self._apply_poses(scan, document["poses"], document)

    def load_separate_components(self, scan: Scan) -> dict[int, Scan]:
        """Load the connected components that are separate from the main one, by number."""
        document = self._read()
        return {
            int(number): self._apply_poses(scan, poses, document)
            for number, poses in document["apart"].items()
        }

    def _read(self) -> Any:
        return json.loads((self.folder / _FILE).read_text(encoding="utf-8"))

    def _apply_poses(self, scan: Scan, poses: Mapping[str, Any], document: Mapping[str, Any]) -> Scan:
        frames = []
        focal = document.get("focal_px")
        for index, pose in poses.items():
            frame = replace(scan.frames[int(index)], world_from_camera=np.array(pose))
            if focal is not None:
                frame = replace(frame, camera=replace(frame.camera, fx=focal, fy=focal, is_guess=False))
            mask = self.folder / _MASKS / _make_mask_name(int(index))
            # The stored mask already includes the frame's input mask.
            frames.append(replace(frame, mask=mask) if mask.exists() else frame)
        # The new world frame is the camera frame of the first frame, so an input up direction is invalid.
        return replace(scan, frames=frames, missing=(), up=None)


def write_poses(
    folder: Path, registration: Registration, scan_folder: Path | None = None
) -> Mapping[str, Any]:
    """Write a registration into an empty folder and return its metrics.

    Paths in texts are made relative to the scan folder.
    """
    used = dict(zip(registration.frame_indices, registration.frames, strict=True))
    _write_trajectory(folder / "trajectory.tum", used)
    others = {number: frames for number, frames in registration.other_pieces.items() if len(frames) > 1}
    if others:
        (folder / "pieces").mkdir()
    for number, frames in others.items():
        _write_trajectory(folder / "pieces" / f"trajectory-{number}.tum", frames)
    if registration.subject == "object":
        _write_masks(folder / _MASKS, used)
        for frames in others.values():
            _write_masks(folder / _MASKS, frames)
    document = {
        "subject": registration.subject,
        "focal_px": registration.focal_estimate and registration.focal_estimate.focal_px,
        "poses": _format_poses(used),
        "apart": {str(number): _format_poses(frames) for number, frames in others.items()},
        "pieces": [list(piece) for piece in registration.pieces],
        "edges": [dict(edge) for edge in registration.edges],
        "breaks": [{"frame": one.name, "reason": one.reason} for one in registration.breaks],
        "skipped": [{"frame": one.name, "reason": one.reason} for one in registration.skipped],
    }
    text = json.dumps(make_paths_relative(document, scan_folder), indent=1)
    (folder / _FILE).write_text(text + "\n", encoding="utf-8", newline="\n")
    write_ply_cloud(folder / "path.ply", *_make_path_cloud(registration.frames))
    return registration.to_dict()


def _write_masks(folder: Path, frames: Mapping[int, Frame]) -> None:
    folder.mkdir(exist_ok=True)
    for place, frame in frames.items():
        if isinstance(frame.mask, np.ndarray):
            (folder / _make_mask_name(place)).write_bytes(encode_gray_png(frame.mask))


def _make_mask_name(frame_index: int) -> str:
    return f"{frame_index:06d}.png"


def _write_trajectory(path: Path, frames: Mapping[int, Frame]) -> None:
    times = [place if frame.timestamp is None else frame.timestamp / 1e9 for place, frame in frames.items()]
    write_tum(path, times, [require_rigid_pose(frame) for frame in frames.values()])


def _format_poses(frames: Mapping[int, Frame]) -> dict[str, Any]:
    return {str(place): require_rigid_pose(frame).tolist() for place, frame in frames.items()}


def _make_path_cloud(frames: Sequence[Frame]) -> tuple[NDArray[np.float32], ColorImage]:
    points, colors = [], []
    for frame in frames:
        try:
            depth = read_depth(frame)
            if depth is None:
                continue
            shown = (
                np.full((*depth.shape, 3), 160, np.uint8)
                if frame.color is None
                else read_color_aligned_to_depth(frame, depth)
            )
        except InputError:
            continue
        some, their = sample_point_cloud(depth, shown, frame, max(1, _MAX_POINTS // len(frames)))
        points.append(some)
        colors.append(their)
    centres = np.array([pose[:3, 3] for frame in frames if (pose := frame.world_from_camera) is not None])
    share = np.linspace(0, 1, _PATH_POINTS, endpoint=False)[:, None]
    path = [a + share * (b - a) for a, b in itertools.pairwise(centres)]
    points += [np.asarray(line, np.float32) for line in path]
    colors += [np.full((len(line), 3), _PATH_COLOR, np.uint8) for line in path]
    return np.concatenate(points), np.concatenate(colors)
