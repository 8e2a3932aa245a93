"""World axes of ScanNet, and its alignment of walls with the axes.

z is up. axisAlignment rotates the world so that walls run along x and y.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import SCAN_ALIGNMENT_MISSING, SCAN_ASSUMED
from scanloom.stages.scans.model.poses import rigid
from scanloom.stages.scans.model.scan import Pose, Scan
from scanloom.stages.scans.model.world import Z_UP, WorldUp, up_of_layout

_NAME = re.compile(r"scene\d{4}_\d\d")
_LINE = re.compile(r"^\s*axisAlignment\s*=\s*(.+?)\s*$", re.MULTILINE)


def aligned(scan: Scan, folder: Path) -> Scan:
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
    path, alignment = _alignment(folder)
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


def up_of_scannet(place: Path, layout: str) -> WorldUp | None:
    """Return the up direction of an original ScanNet scan, or None.

    Other data packed in ScanNet's layout has an unknown up direction.

    Parameters
    ----------
    place : scan folder or file.
    layout : name of the layout.
    """
    beside = place.parent if place.is_file() else place
    is_own = any(_NAME.search(name) for name in (place.name, beside.resolve().name)) or any(
        beside.glob("scene*.txt")
    )
    return up_of_layout(layout, Z_UP) if is_own else None


def _alignment(folder: Path) -> tuple[Path, Pose]:
    beside = folder.parent if folder.is_file() else folder
    for path in sorted(beside.glob("scene*.txt")):
        found = _LINE.search(documents.read_text(path))
        if found is None:
            continue
        try:
            values = [float(word) for word in found[1].split()]
        except ValueError:
            values = []
        if len(values) != 16:
            raise InputError(SCAN_ALIGNMENT_MISSING, "axisAlignment must be 16 numbers.", path)
        pose = rigid(np.reshape(values, (4, 4)), path, "axisAlignment")
        if pose is None:
            raise InputError(SCAN_ALIGNMENT_MISSING, "axisAlignment contains NaN or infinity.", path)
        return path, pose
    raise InputError(
        SCAN_ALIGNMENT_MISSING,
        "the folder has no scene*.txt with an axisAlignment",
        folder,
        remedy="leave out scan.align_axes.",
    )
