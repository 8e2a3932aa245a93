"""World axes of ScanNet scans: z is up.

The optional axisAlignment matrix rotates the world so that walls run along x and y.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.scans.codes import SCAN_ALIGNMENT_MISSING, SCAN_ASSUMED
from scanloom.stages.scans.model.poses import check_rigid_pose
from scanloom.stages.scans.model.scan import Pose, Scan
from scanloom.stages.scans.model.world import Z_UP, WorldUp, create_layout_up

_SCENE_NAME = re.compile(r"scene\d{4}_\d\d")


def apply_axis_alignment(scan: Scan, folder: Path) -> Scan:
    """Apply the axisAlignment of scene*.txt to the poses of a scan.

    Without poses, the scan is returned unchanged, with a warning.

    Raises
    ------
    InputError
        If no such file exists, or its matrix is not rigid.
    """
    if not scan.has_poses:
        emit(
            SCAN_ASSUMED.warning(
                "axisAlignment is not applied: it requires the poses of the data set, and the scan has no "
                "poses"
            )
        )
        return scan
    path, alignment = _read_alignment(folder)
    frames = [
        frame
        if frame.world_from_camera is None
        else replace(frame, world_from_camera=alignment @ frame.world_from_camera)
        for frame in scan.frames
    ]
    emit(SCAN_ASSUMED.info("the world is rotated by the axisAlignment of {file}", file=path.name))
    up = scan.up
    if up is not None:
        x, y, z = (alignment[:3, :3] @ up.direction).tolist()
        up = replace(up, direction=(x, y, z))
    return replace(scan, frames=frames, up=up)


def find_scannet_up(source: Path, layout: str) -> WorldUp | None:
    """Return the up direction of an original ScanNet scan, or None.

    Other data packed in ScanNet's layout has an unknown up direction.

    Parameters
    ----------
    source : scan folder or file.
    layout : name of the layout.
    """
    scan_folder = source.parent if source.is_file() else source
    is_own = any(_SCENE_NAME.search(name) for name in (source.name, resolve_path(scan_folder).name)) or any(
        scan_folder.glob("scene*.txt")
    )
    return create_layout_up(layout, Z_UP) if is_own else None


def _read_alignment(folder: Path) -> tuple[Path, Pose]:
    scan_folder = folder.parent if folder.is_file() else folder
    for path in sorted(scan_folder.glob("scene*.txt")):
        found = documents.parse_assignments(documents.read_text(path)).get("axisAlignment")
        if not found:
            continue
        try:
            values = [float(word) for word in found.split()]
        except ValueError:
            values = []
        if len(values) != 16:
            raise InputError(SCAN_ALIGNMENT_MISSING, "axisAlignment must be 16 numbers.", path)
        pose = check_rigid_pose(np.reshape(values, (4, 4)), path, "axisAlignment")
        if pose is None:
            raise InputError(SCAN_ALIGNMENT_MISSING, "axisAlignment contains NaN or infinity.", path)
        return path, pose
    raise InputError(
        SCAN_ALIGNMENT_MISSING,
        "the folder has no scene*.txt with an axisAlignment",
        folder,
        remedy="leave out scan.align_axes.",
    )
