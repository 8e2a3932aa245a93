"""Thin sheet seen from both sides."""

from __future__ import annotations

import numpy as np

from scanloom.stages.scans.model.scan import Camera, Frame

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)


def thin_sheet(side: int, x: float, thickness: float, color: tuple[int, int, int]) -> Frame:
    """Render half a metre of sheet at the origin in front of a grey wall.

    The colour of the sheet is visible from this side only.

    Parameters
    ----------
    side : −1 for a camera 1 m in front, 1 for one behind.
    x : of the camera, metres.
    thickness : metres.
    """
    rows, columns = np.mgrid[:120, :160]
    across, down = (columns - CAMERA.cx) / CAMERA.fx + x, (rows - CAMERA.cy) / CAMERA.fy
    is_near = (abs(across) < 0.25) & (abs(down) < 0.25)
    pose = np.diag([-side, 1.0, -side, 1.0])
    pose[0, 3], pose[2, 3] = -side * x, side * (1 + thickness / 2)
    painted = np.where(is_near[..., None], np.uint8(color), np.uint8([90, 90, 90]))
    depth = np.where(is_near, 1, 3).astype(np.float32)
    return Frame(f"{side} {x}", CAMERA, color=painted, depth=depth, world_from_camera=pose)
