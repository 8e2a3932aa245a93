"""A frame's depth map with its pose, in two sizes: as it is, and coarse, for space."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_depth, read_seen
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Camera, DepthImage, Frame, pinhole

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Of coarse depth, the longer side, pixels.
_COARSE = 160
# Of its width: so far from the nearest pixel with a depth it counts as that deep, where it has none itself.
_FILLED = 0.1
# Of the four sides of a gap, on how many there is some depth in its row or column.
_SIDES = 4


@dataclass(frozen=True, eq=False)
class View:
    """What a frame measured.

    Attributes
    ----------
    name : of the frame.
    camera : without distortion.
    place : (3,) float64 where it stood, metres.
    turn, shift : (3, 3) and (3,) float32: take points from `origin` on to the camera's axes.
    depth : (h, w) float32 metres, 0 where missing.
    coarse : (h', w') float32, the least depth of `step` × `step` pixels each, 0 where missing in all.
    filled : `coarse` with what is missing as deep as the nearest pixel beside it, if one is near; infinite
        where a mask says that nothing of the scene is there.
    step : pixels.
    """

    name: str
    camera: Camera
    place: Floats
    turn: Singles
    shift: Singles
    depth: DepthImage
    coarse: DepthImage
    filled: DepthImage
    step: int

    def in_camera(self, points: Singles) -> tuple[Singles, Singles, Singles]:
        """Return where points (n, 3), from the origin on, appear: columns, rows and depths (n,)."""
        x, y, z = self.turn @ points.T + self.shift[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            columns = np.float32(self.camera.fx) * x / z + np.float32(self.camera.cx)
            rows = np.float32(self.camera.fy) * y / z + np.float32(self.camera.cy)
        return columns, rows, z

    def point_at(self, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> Singles:
        """Return where what pixels measured is, (3, k) along the axes of the camera, metres."""
        camera = self.camera
        z = self.depth[rows, columns]
        across = (columns.astype(np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
        down = (rows.astype(np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
        return np.stack([across * z, down * z, z])

    def pixels(
        self, columns: Singles, rows: Singles, z: Singles, step: int = 1
    ) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Return which points are in the picture, and the pixels of these, numbered row by row.

        Parameters
        ----------
        step : 1 for `depth`, that of the view for `coarse`.
        """
        width, height = self.camera.width, self.camera.height
        (inside,) = np.nonzero(
            (z > 0) & (columns > -0.5) & (rows > -0.5) & (columns < width - 0.5) & (rows < height - 0.5)
        )
        across = (columns[inside] + np.float32(0.5)).astype(np.int64) // step
        down = (rows[inside] + np.float32(0.5)).astype(np.int64) // step
        return inside, down * math.ceil(width / step) + across


def read_view(frame: Frame, origin: Floats) -> View:
    """Read a frame.

    Parameters
    ----------
    origin : (3,) metres, from which points are counted: near them, so that single precision is enough.

    Raises
    ------
    InputError
        If the frame has no pose or no depth, or its file cannot be read.
    """
    pose = require_rigid_pose(frame)
    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", Where(frame=frame.name))
    if not depth.any():
        raise InputError(SCAN_DEPTH_MOSTLY_EMPTY, "no pixel has a depth.", Where(frame=frame.name))
    to_camera = inverted(pose)
    step = max(1, round(max(depth.shape) / _COARSE))
    coarse = _least(depth, step)
    return View(
        name=frame.name,
        camera=pinhole(frame.camera),
        place=pose[:3, 3],
        turn=to_camera[:3, :3].astype(np.float32),
        shift=(to_camera[:3, :3] @ origin + to_camera[:3, 3]).astype(np.float32),
        depth=depth,
        coarse=coarse,
        filled=_without_masked(_filled(coarse), frame, step),
        step=step,
    )


def _without_masked(filled: DepthImage, frame: Frame, step: int) -> DepthImage:
    """Return depth that is infinite where a mask leaves out all of a square of pixels."""
    if frame.mask is None:
        return filled
    mask = read_seen(frame).astype(np.float32)
    is_shown = _least(np.where(mask > 0, mask, np.float32(2)), step) < 2
    return np.asarray(np.where(is_shown, filled, np.inf), np.float32)


def _least(depth: DepthImage, step: int) -> DepthImage:
    """Return the least depth of squares of pixels, 0 where none has one."""
    rows, columns = (math.ceil(size / step) for size in depth.shape)
    padded = np.full((rows * step, columns * step), np.inf, np.float32)
    padded[: depth.shape[0], : depth.shape[1]] = np.where(depth > 0, depth, np.float32(np.inf))
    least = padded.reshape(rows, step, columns, step).min(axis=(1, 3))
    return np.asarray(np.where(np.isfinite(least), least, 0), np.float32)


def _filled(coarse: DepthImage) -> DepthImage:
    """Return depth with gaps as deep as the nearest pixel.

    Through glass and black things one looks as far as what is around them. What lies beyond the edge of a
    thing is no gap: there may be nothing at all.
    """
    import cv2

    known = coarse > 0
    if known.all():
        return coarse
    sides = sum(
        np.maximum.accumulate(known[turn], axis=axis)[turn].astype(np.int8)
        for axis, turn in ((0, np.s_[:]), (0, np.s_[::-1]), (1, np.s_[:]), (1, np.s_[:, ::-1]))
    )
    missing = (~known).astype(np.uint8)
    away, labels = cv2.distanceTransformWithLabels(missing, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    depth = np.zeros(int(labels.max()) + 1, np.float32)
    depth[labels[known]] = coarse[known]
    is_gap = (away <= _FILLED * coarse.shape[1]) & (sides >= _SIDES)
    return np.asarray(np.where(known | is_gap, depth[labels], 0), np.float32)
