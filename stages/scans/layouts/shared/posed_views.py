"""Posed views without depth: frame construction, units and errors."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import has_alpha, read_alpha, read_image_size
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_MISMATCH, SCAN_DEPTH_MISSING
from scanloom.stages.scans.layouts.shared.phone_scans import scale_to_size
from scanloom.stages.scans.model.depth_range import estimate_depth_range
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose

# Widths that differ by a smaller ratio indicate a cropped or undistorted image, not a downscaled one.
_NEARLY_SAME_RATIO = 0.1


def create_view_frame(
    name: str,
    camera: Camera,
    color: Path,
    pose: Pose | None,
    *,
    points: NDArray[np.float64] | None = None,
    mask: Path | PackedImage | None = None,
) -> Frame:
    """Create the frame of a view without depth.

    Parameters
    ----------
    camera : camera at any image size, because images are often downscaled after calibration.
    pose : world-from-camera, metres.
    points : (n, 3) world points observed in the view, metres; they determine the depth range.
    mask : mask as in `Frame`.

    Raises
    ------
    InputError
        If the image is missing or damaged, or its aspect ratio differs from the camera's.
    """
    size = read_image_size(color)
    if size != (camera.width, camera.height):
        _warn_if_nearly_same_size(camera, size, color)
        camera = scale_to_size(camera, size, "the image", color)
    depth_range = None
    if points is not None and pose is not None:
        depth_range = estimate_depth_range((points - pose[:3, 3]) @ pose[:3, 2])
    return Frame(name, camera, color=color, world_from_camera=pose, mask=mask, depth_range=depth_range)


def find_transparency_mask(color: Path) -> PackedImage | None:
    """Return the transparency of an image as mask; None without an alpha channel."""
    return PackedImage(color, "transparency", partial(read_alpha, color)) if has_alpha(color) else None


def _warn_if_nearly_same_size(camera: Camera, size: tuple[int, int], color: Path) -> None:
    """Warn if the image size differs slightly from the camera's.

    Nobody downscales images by a few percent. Rather, the camera belongs to undistorted images.
    """
    if abs(size[0] / camera.width - 1) < _NEARLY_SAME_RATIO:
        emit(
            CAMERA_CALIBRATION_MISMATCH.warning(
                "the image is {width}×{height} but its camera {camera_width}×{camera_height}: such "
                "cameras usually belong to undistorted images, and this image may not be undistorted. The "
                "camera is scaled",
                color,
                width=size[0],
                height=size[1],
                camera_width=camera.width,
                camera_height=camera.height,
            )
        )


def to_metres(pose: Pose | None, units_per_metre: float | None) -> Pose | None:
    """Convert a pose to metres, given the world units per metre.

    `units_per_metre` is None if the scale is unknown; the pose is then unchanged.
    """
    if pose is None or units_per_metre is None:
        return pose
    metric: Pose = pose.copy()
    metric[:3, 3] /= units_per_metre
    return metric


def create_depth_missing_error(source: Path, advice: str) -> InputError:
    """Create the error for posed views whose depth maps are missing.

    Parameters
    ----------
    source : folder or list of frames, named in the message.
    advice : a sentence that names the usual location of the depth maps.
    """
    return InputError(
        SCAN_DEPTH_MISSING,
        "the views have no depth, and this layout requires depth. {advice}",
        source,
        advice=advice,
    )
