"""Rectification of a calibrated stereo pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID, CAMERA_CALIBRATION_MISMATCH
from scanloom.stages.scans.model.scan import Camera, StereoRig

# Numbers of distortion coefficients OpenCV supports: k1 k2 p1 p2, + k3, + k4–k6, + thin prism, + tilt.
_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
_FISHEYE_LENGTH = 4
# Maximum difference of cy in a rectified rig, pixels: rounding in calibration files, but no visible
# misalignment.
_ROW_TOLERANCE_PX = 0.1


@dataclass(frozen=True, eq=False)
class RectifiedRig:
    """Rectified stereo rig: parallel optical axes and common rows.

    Attributes
    ----------
    left, right : undistorted cameras with equal focal length and cy.
    baseline : metres, > 0.
    rectified_from_left : (3, 3) float64, rotation from the calibrated to the rectified left camera.
    """

    left: Camera
    right: Camera
    baseline: float
    rectified_from_left: NDArray[np.float64]
    _maps: tuple[tuple[Any, Any], tuple[Any, Any]] | None = None

    @property
    def focal_baseline(self) -> float:
        """Return focal length times baseline, pixel metres.

        Depth is f·b / (d + principal_offset).
        """
        return self.left.fx * self.baseline

    @property
    def principal_offset(self) -> float:
        """Return cx_right − cx_left, pixels (Middlebury's `doffs`).

        Depth is f·b / (d + principal_offset).
        """
        return self.right.cx - self.left.cx

    def apply(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Rectify a pair of images.

        Images of a rig that is already rectified are returned unchanged.
        """
        if self._maps is None:
            return left, right
        import cv2

        first, second = (
            cv2.remap(image, *maps, cv2.INTER_LINEAR)
            for image, maps in zip((left, right), self._maps, strict=True)
        )
        return first, second


def rectify_rig(rig: StereoRig) -> RectifiedRig:
    """Rectify a stereo rig with Bouguet's method (OpenCV).

    A rig marked as rectified is only validated. Otherwise both cameras are rotated by half of their relative
    rotation, and zoomed so that only valid pixels remain. Fisheye cameras keep their focal length and size
    instead, so that their periphery is cropped.

    Raises
    ------
    InputError
        If the cameras are not side by side in the stated order, or the calibration is invalid.
    """
    left, right = rig.left, rig.right
    if (left.width, left.height) != (right.width, right.height):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the left camera is calibrated for {left_width}×{left_height} px, the right one for "
                "{right_width}×{right_height} px; both must have the same size."
            ),
            left_width=left.width,
            left_height=left.height,
            right_width=right.width,
            right_height=right.height,
        )
    if not np.isfinite(rig.right_from_left).all() or rig.baseline == 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "both cameras of the rig have the same position",
            remedy="give the baseline in metres.",
        )
    return _wrap_rectified(rig) if rig.is_rectified else _rectify_with_opencv(rig)


def _wrap_rectified(rig: StereoRig) -> RectifiedRig:
    left, right = rig.left, rig.right
    for name, tolerance in (("fx", 1e-3 * left.fx), ("fy", 1e-3 * left.fy), ("cy", _ROW_TOLERANCE_PX)):
        a, b = getattr(left, name), getattr(right, name)
        if abs(a - b) > tolerance:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                (
                    "the rig is marked as rectified, but {name} is {a:g} px on the left and {b:g} px on the "
                    "right; correct the calibration, or mark the rig as not rectified."
                ),
                name=name,
                a=a,
                b=b,
            )
    baseline = -float(rig.right_from_left[0, 3])
    _check_camera_order(baseline)
    return RectifiedRig(left, right, baseline, np.eye(3))


def _rectify_with_opencv(rig: StereoRig) -> RectifiedRig:
    import cv2

    left, right = rig.left, rig.right
    size = (left.width, left.height)
    for side, camera in (("left", left), ("right", right)):
        if camera.fisheye != left.fisheye:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "only one camera of the pair is a fisheye camera; both must have the same model.",
            )
        if camera.fisheye and len(camera.distortion) != _FISHEYE_LENGTH:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "the {side} fisheye camera must have {fisheye_length} distortion coefficients.",
                side=side,
                fisheye_length=_FISHEYE_LENGTH,
            )
        if len(camera.distortion) not in _DISTORTION_LENGTHS:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                ("the {side} camera has {distortion_count} distortion coefficients; OpenCV supports {map}."),
                side=side,
                distortion_count=len(camera.distortion),
                map=", ".join(map(str, _DISTORTION_LENGTHS)),
            )
    distortion = [np.array(camera.distortion or (0.0,) * 4, np.float64) for camera in (left, right)]
    # The rotations do not depend on distortion. For fisheye cameras, the projection is set below.
    straight = [np.zeros(4) if left.fisheye else bent for bent in distortion]
    # OpenCV 5 requires a column vector, and ignores strides, hence the copies.
    rotation, translation = rig.right_from_left[:3, :3].copy(), rig.right_from_left[:3, 3:].copy()
    r_left, r_right, p_left, p_right = cv2.stereoRectify(
        left.matrix,
        straight[0],
        right.matrix,
        straight[1],
        size,
        rotation,
        translation,
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]
    if p_right[1, 3] != 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the cameras are one above the other; only cameras side by side can be matched.",
            remedy="Rotate images and calibration by 90 degrees.",
        )
    baseline = -float(p_right[0, 3] / p_right[0, 0])
    _check_camera_order(baseline)
    if left.fisheye:
        focal = (left.fx + left.fy + right.fx + right.fy) / 4
        p_left = p_right = np.array(
            [[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]], np.float64
        )
    maps = tuple(
        cv2.fisheye.initUndistortRectifyMap(camera.matrix, d, r, p, size, cv2.CV_16SC2)
        if camera.fisheye
        else cv2.initUndistortRectifyMap(camera.matrix, d, r, p, size, cv2.CV_16SC2)
        for camera, d, r, p in zip(
            (left, right), distortion, (r_left, r_right), (p_left, p_right), strict=True
        )
    )
    return RectifiedRig(
        _make_camera(size, p_left),
        _make_camera(size, p_right),
        baseline,
        np.asarray(r_left),
        (maps[0], maps[1]),
    )


def _make_camera(size: tuple[int, int], projection: NDArray[Any]) -> Camera:
    fx, fy, cx, cy = (float(projection[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(*size, fx, fy, cx, cy)


def _check_camera_order(baseline: float) -> None:
    if baseline <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "the right camera is left of the left one in the calibration: the cameras are swapped, or "
                "rotation and translation map points from the right to the left camera"
            ),
            remedy="swap the cameras, or invert rotation and translation.",
        )
