"""KITTI calibration files: projection matrices of the rectified cameras."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration.camera_files import create_camera_from_matrix
from scanloom.stages.scans.calibration.image_size import MAX_SIDE_PX, has_same_aspect_ratio, scale_to_images
from scanloom.stages.scans.calibration.rig_calibration import set_baseline
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID, CAMERA_CALIBRATION_MISMATCH
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, StereoRig

# Maximum width of downscaled images, as a ratio of the stated width. A smaller difference means the
# calibration of another day.
_MAX_DOWNSCALED_RATIO = 0.9


def read_projections(calib: Path) -> dict[int, NDArray[np.float64]]:
    """Read the projection matrices (3, 4), by camera number.

    Rows are `P0: …` or `P_rect_00: …`; rows without a name are numbered in file order.

    Raises
    ------
    InputError
        If such a row is not 12 finite numbers.
    """
    found: dict[int, NDArray[np.float64]] = {}
    bare = 0
    for number, line in enumerate(documents.read_text(calib).splitlines(), 1):
        key, _, text = line.rpartition(":")
        if not text.strip():
            continue
        if not key:
            key, bare = f"P{bare}", bare + 1
        named = re.fullmatch(r"P(?:_rect_0)?([0-3])", key.strip())
        if named is None:
            continue
        try:
            row = np.array([float(word) for word in text.split()])
        except ValueError:
            row = np.empty(0)
        if row.size != 12 or not np.isfinite(row).all():
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "line {number} ({key}) must be 12 finite numbers.",
                calib,
                number=number,
                key=key,
            )
        found[int(named[1])] = row.reshape(3, 4)
    return found


def resolve_rectified_size(calib: Path, size: tuple[int, int]) -> tuple[int, int]:
    """Return the rectified image size that a calibration file is for.

    Parameters
    ----------
    size : size (width, height) of the images.

    Returns
    -------
    (width, height)
        `size` itself, or the larger stated size if the images were downscaled.

    Raises
    ------
    InputError
        If the stated size differs otherwise. The images are then unrectified, or from a day with another
        calibration, whose sizes differ only slightly.
    """
    values = documents.parse_assignments(documents.read_text(calib), ":")
    words = [text.split() for name, text in values.items() if name.startswith("S_rect_0")]
    stated = [pair for pair in words if len(pair) == 2]
    try:
        sizes = [(round(float(width)), round(float(height))) for width, height in stated]
    except (ValueError, OverflowError) as error:
        raise InputError(CAMERA_CALIBRATION_INVALID, "S_rect must be two numbers.", calib) from error
    if any(not 1 <= side <= MAX_SIDE_PX for one in sizes for side in one):
        raise InputError(CAMERA_CALIBRATION_INVALID, "S_rect is not a valid image size.", calib)
    if not sizes or size in sizes:
        return size
    width, height = sizes[0]
    if size[0] > _MAX_DOWNSCALED_RATIO * width or not has_same_aspect_ratio(sizes[0], size):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the calibration is for rectified images of {width}×{height} pixels, but the images have "
                "{size}×{size_2}, so they are not rectified."
            ),
            calib,
            remedy="Use the synchronised and rectified images.",
            width=width,
            height=height,
            size=size[0],
            size_2=size[1],
        )
    return width, height


def decompose_projection(
    projection: NDArray[np.float64],
    size: tuple[int, int],
    options: ReadingParams,
    calib: Path,
    stated_size: tuple[int, int] | None = None,
) -> tuple[Camera, NDArray[np.float64]]:
    """Return the camera of a projection K [I | t], and camera_from_cam0.

    Parameters
    ----------
    projection : (3, 4) float64.
    size : image size (width, height) in pixels.
    stated_size : image size that the projection is for; None for `size`.

    Raises
    ------
    InputError
        If the matrix is singular or not a camera projection.
    """
    k = projection[:, :3]
    camera = create_camera_from_matrix(k, (), *(stated_size or size), calib)
    camera = options.get_camera(*size) or scale_to_images(camera, *size, calib)
    if abs(np.linalg.det(k)) < 1e-9:
        raise InputError(CAMERA_CALIBRATION_INVALID, "a projection matrix is singular.", calib)
    offset = np.eye(4)
    offset[:3, 3] = np.linalg.solve(k, projection[:, 3])
    return camera, offset


def create_projected_rig(
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    size: tuple[int, int],
    options: ReadingParams,
    calib: Path,
    stated_size: tuple[int, int] | None = None,
) -> tuple[StereoRig, NDArray[np.float64]]:
    """Return the rig of two projections K [I | t], and left_from_cam0.

    Parameters
    ----------
    left, right : (3, 4) float64 projections.
    size : image size (width, height) in pixels.
    stated_size : image size that the projections are for; None for `size`.

    Raises
    ------
    InputError
        If a matrix is singular, or the second camera is not right of the first.
    """
    cameras, offsets = zip(
        *(decompose_projection(matrix, size, options, calib, stated_size) for matrix in (left, right)),
        strict=True,
    )
    right_from_left = offsets[1] @ np.linalg.inv(offsets[0])
    if right_from_left[0, 3] >= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            ("the second camera is not right of the first (P[0,3] must be smaller); are the rows swapped?"),
            calib,
        )
    if options.baseline is not None:
        right_from_left = set_baseline(right_from_left, options.baseline)
    return StereoRig(cameras[0], cameras[1], right_from_left, is_rectified=True), offsets[0]
