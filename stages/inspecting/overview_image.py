"""Overview image of a scan: trajectory, and depth over colour."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.scans.model.images import read_color, read_depth, read_right
from scanloom.stages.scans.model.scan import ColorImage, Frame, Scan

_PANEL_HEIGHT_PX = 480
_MARGIN_PX = 48
_TEXT_COLOR, _GAP_COLOR, _BACKGROUND_COLOR = (32, 32, 40), (170, 170, 178), (248, 248, 250)
_START_COLOR, _END_COLOR = np.array((40.0, 90.0, 200.0)), np.array((220.0, 80.0, 30.0))
# Length of a drawn optical axis, as ratio of the trajectory's extent.
_AXIS_LENGTH_RATIO = 0.08


def draw_inspection(scan: Scan) -> ColorImage:
    """Draw the camera trajectory from two sides, and the middle frame.

    Parameters
    ----------
    scan : scan with or without poses.

    Returns
    -------
    (h, w, 3) uint8 RGB. The trajectory runs from blue to red, with the optical axis of each camera. "above"
    and "side" look along the two axes of smallest extent. Near depth is yellow, far depth is purple; colour
    shows where depth is missing. Stereo scans show the pair instead.

    Raises
    ------
    InputError
        If the images of the middle frame cannot be read.
    """
    frame = scan.frames[len(scan.frames) // 2]
    panels = [*_draw_trajectories(scan), _draw_frame_panel(frame)]
    gap = np.full((_PANEL_HEIGHT_PX, 8, 3), _GAP_COLOR, np.uint8)
    row: list[NDArray[np.uint8]] = []
    for panel in panels:
        row += [panel, gap]
    return np.concatenate(row[:-1], axis=1)


def _draw_trajectories(scan: Scan) -> list[NDArray[np.uint8]]:
    poses = np.array([f.world_from_camera for f in scan.frames if f.world_from_camera is not None])
    if len(poses) == 0:
        panel = np.full((_PANEL_HEIGHT_PX, _PANEL_HEIGHT_PX, 3), _BACKGROUND_COLOR, np.uint8)
        _write_text(panel, "no poses", (_MARGIN_PX, _PANEL_HEIGHT_PX // 2))
        return [panel]
    centres = poses[:, :3, 3]
    _, _, axes = np.linalg.svd(centres - centres.mean(axis=0), full_matrices=True)
    return [_draw_trajectory(poses, axes[[0, 1]], "above"), _draw_trajectory(poses, axes[[0, 2]], "side")]


def _draw_trajectory(poses: NDArray[np.float64], axes: NDArray[np.float64], name: str) -> NDArray[np.uint8]:
    import cv2

    panel = np.full((_PANEL_HEIGHT_PX, _PANEL_HEIGHT_PX, 3), _BACKGROUND_COLOR, np.uint8)
    flat = poses[:, :3, 3] @ axes.T
    middle = (flat.max(axis=0) + flat.min(axis=0)) / 2
    # Both panels have the same scale, set by the extent of the trajectory.
    extent = max(float(np.ptp(poses[:, :3, 3], axis=0).max()), 1e-6)
    unit = (_PANEL_HEIGHT_PX - 2 * _MARGIN_PX) / (1.2 * extent)

    def to_pixel(point: NDArray[np.float64]) -> tuple[int, int]:
        x, y = (point - middle) * unit
        return round(_PANEL_HEIGHT_PX / 2 + x), round(_PANEL_HEIGHT_PX / 2 - y)

    for i, pose in enumerate(poses):
        share = i / max(len(poses) - 1, 1)
        color = tuple(int(c) for c in (1 - share) * _START_COLOR + share * _END_COLOR)
        here = to_pixel(flat[i])
        ahead = to_pixel(flat[i] + _AXIS_LENGTH_RATIO * extent * (axes @ pose[:3, 2]))
        if i:
            cv2.line(panel, to_pixel(flat[i - 1]), here, color, 1, cv2.LINE_AA)
        cv2.line(panel, here, ahead, color, 1, cv2.LINE_AA)
        cv2.circle(panel, here, 2, color, -1, cv2.LINE_AA)
    _write_text(panel, f"{len(poses)} cameras, {name}", (12, 22))
    bar = 10.0 ** np.floor(np.log10(extent))
    length = round(bar * unit)
    cv2.line(panel, (12, _PANEL_HEIGHT_PX - 16), (12 + length, _PANEL_HEIGHT_PX - 16), _TEXT_COLOR, 2)
    _write_text(panel, f"{bar:g} m", (18 + length, _PANEL_HEIGHT_PX - 11))
    return panel


def _draw_frame_panel(frame: Frame) -> NDArray[np.uint8]:
    depth = read_depth(frame)
    if depth is None:
        sides = [image for image in (read_color(frame), read_right(frame)) if image is not None]
        if not sides:
            raise InputError(
                SCAN_DEPTH_MOSTLY_EMPTY,
                "the frame has neither colour nor depth.",
                DiagnosticLocation(frame=frame.name),
            )
        panel = np.concatenate([_resize_to_height(image) for image in sides], axis=1)
        _write_text(panel, frame.name, (12, 22))
        return panel
    color = None if frame.color is None else read_color_aligned_to_depth(frame, depth)
    panel = _resize_to_height(_blend_depth_over_color(depth, color))
    seen = depth[depth > 0]
    span = f", {seen.min():.2f} to {seen.max():.2f} m" if seen.size else ", no depth"
    _write_text(panel, f"{frame.name}{span}", (12, 22))
    return panel


def _blend_depth_over_color(depth: NDArray[np.float32], color: ColorImage | None) -> NDArray[np.uint8]:
    """Blend colour-mapped depth with the colour image."""
    import cv2

    valid = depth > 0
    near, far = np.percentile(depth[valid], (2, 98)) if valid.any() else (0.0, 1.0)
    level = np.clip((far - depth) / max(far - near, 1e-6), 0, 1)
    painted = cv2.cvtColor(
        cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB
    )
    base = np.full((*depth.shape, 3), 255, np.uint8) if color is None else color
    grey = cv2.cvtColor(cv2.cvtColor(base, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    mixed = (0.55 * np.asarray(painted, np.float32) + 0.45 * np.asarray(grey, np.float32)).astype(np.uint8)
    return np.where(valid[..., None], mixed, base)


def _resize_to_height(image: NDArray[Any]) -> NDArray[np.uint8]:
    import cv2

    width = round(image.shape[1] * _PANEL_HEIGHT_PX / image.shape[0])
    return np.asarray(cv2.resize(image, (width, _PANEL_HEIGHT_PX), interpolation=cv2.INTER_AREA), np.uint8)


def _write_text(panel: NDArray[np.uint8], text: str, at: tuple[int, int]) -> None:
    import cv2

    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    (width, height), below = cv2.getTextSize(text, font, size, 1)
    corners = (at[0] - 4, at[1] - height - 4), (at[0] + width + 4, at[1] + below + 2)
    cv2.rectangle(panel, *corners, _BACKGROUND_COLOR, -1)
    cv2.putText(panel, text, at, font, size, _TEXT_COLOR, 1, cv2.LINE_AA)
