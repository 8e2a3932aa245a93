"""Consistency check of photos and their given poses by epipolar geometry.

Under correct poses, matched features are on each other's epipolar lines and in front of both cameras. If they
only are under another pose convention, depth from these photos would be missing or wrong.

Hartley and Zisserman, "Multiple view geometry", 2004, section 9.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import (
    Keypoints,
    detect_keypoints,
    find_epipolar_inliers,
    match_descriptors,
)
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.codes import POSE_CONVENTION_SUSPECT
from scanloom.stages.inspecting.meant import AS_GIVEN, advice, motions
from scanloom.stages.scans.model.images import read_pinhole
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, pinhole, scaled

RESULT_VERSION = 1

# Number of view pairs, maximum index distance within a pair, maximum image width in pixels, number of
# keypoints.
_COUPLES, _AFTER, _WIDEST, _KEYPOINTS = 5, 2, 1200, 2000
# Minimum number of geometrically consistent matches per pair.
_LEAST = 24
# Pixels. Another convention must fit below the first value; below the second, the declared convention is
# accepted.
_FITTING_PX, _SOUND_PX = 2.0, 4.0
# Minimum ratio between the errors of the declared and a better convention.
_CLEARLY = 4.0
# Minimum ratio of matches in front of both cameras; otherwise the convention is rejected.
_LEAST_IN_FRONT = 0.5

Pixels = NDArray[np.float64]


def require_view_poses(scan: Scan) -> None:
    """Reject poses if another convention clearly fits the photos better.

    Raises
    ------
    InputError
        With the comparison of `check_view_poses`.
    """
    errors, suspicion = check_view_poses(scan.frames)
    if suspicion is not None:
        compared = "; ".join(f"{error:.1f} px {name}" for name, error in errors.items())
        raise InputError(
            POSE_CONVENTION_SUSPECT,
            "{suspicion} (compared: {compared}).",
            scan.folder,
            suspicion=suspicion.message,
            remedy=advice(min(errors, key=lambda name: errors[name])),
            compared=compared,
        )


def check_view_poses(frames: Sequence[Frame]) -> tuple[dict[str, float], Diagnostic | None]:
    """Compare pose conventions by the epipolar distances of feature matches.

    Parameters
    ----------
    frames : frames with photos and poses; other frames are ignored.

    Returns
    -------
    errors : median distance to the epipolar lines by convention, in pixels of photos up to 1200 wide;
        infinite if points are behind a camera.
    suspicion : warning if another convention fits clearly better than the declared one, else None.
    """
    posed = [frame for frame in frames if frame.color is not None and frame.world_from_camera is not None]
    poses = [frame.world_from_camera for frame in posed if frame.world_from_camera is not None]
    found: dict[str, list[Pixels]] = {}
    for first, second, one, other, camera in _matched(posed):
        for name, motion in motions(poses, first, second).items():
            found.setdefault(name, []).append(_errors(motion, one, other, camera))
    errors = {name: float(np.median(np.concatenate(each))) for name, each in found.items()}
    if not errors:
        return {}, None
    declared, best = errors[AS_GIVEN], min(errors, key=lambda name: errors[name])
    if declared < max(_SOUND_PX, _CLEARLY * errors[best]) or errors[best] > _FITTING_PX:
        return errors, None
    alike = [name for name, error in errors.items() if error < max(_CLEARLY * errors[best], 1.0)]
    was = f"{declared:.0f} px" if np.isfinite(declared) else "points behind the cameras"
    return errors, POSE_CONVENTION_SUSPECT.warning(
        "the poses are probably {alike}: feature matches then agree to {best_px:.1f} px; as given: {given}",
        alike=", or ".join(alike),
        best_px=max(errors[best], 0.1),
        given=was,
    )


def _matched(
    frames: Sequence[Frame],
) -> list[tuple[int, int, Pixels, Pixels, tuple[Camera, Camera]]]:
    """Match features in pairs of neighbouring views.

    Returns
    -------
    Per pair: indices of both views, matched pixels (n, 2) in each, and their cameras.
    """
    count = len(frames)
    starts = sample_evenly(max(count - 1, 0), _COUPLES)
    places = sorted({int(at) + n for at in starts for n in range(_AFTER + 1) if at + n < count})
    threads = workers()
    seen = dict(
        zip(
            places,
            read_ahead(lambda at: _seen(frames[at]), places, threads=threads, ahead=threads),
            strict=True,
        )
    )
    couples = []
    for at in starts:
        for second in range(int(at) + 1, min(int(at) + _AFTER + 1, count)):
            one, other = seen[int(at)], seen[second]
            if one is None or other is None:
                continue
            pixels = _agreeing(one[0], other[0])
            if pixels is not None:
                couples.append((int(at), second, *pixels, (one[1], other[1])))
                break
    return couples


def _seen(frame: Frame) -> tuple[Keypoints, Camera] | None:
    """Detect features of a view, with its camera at that image size.

    Returns None if the photo cannot be read.
    """
    import cv2

    try:
        image = read_pinhole(frame)
    except InputError:
        return None
    if image is None:
        return None
    camera = pinhole(frame.camera)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if camera.width > _WIDEST:
        camera = scaled(camera, _WIDEST, max(round(camera.height * _WIDEST / camera.width), 1))
        grey = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return detect_keypoints(np.asarray(grey, np.uint8), _KEYPOINTS), camera


def _agreeing(one: Keypoints, other: Keypoints) -> tuple[Pixels, Pixels] | None:
    """Match the features of two views and keep the epipolar inliers.

    Returns None with fewer than `_LEAST` inliers.
    """
    pairs = match_descriptors(one.descriptors, other.descriptors)
    first, second = one.pixels[pairs[:, 0]], other.pixels[pairs[:, 1]]
    good = find_epipolar_inliers(first, second)
    if np.count_nonzero(good) < _LEAST:
        return None
    return first[good].astype(np.float64), second[good].astype(np.float64)


def _errors(
    second_from_first: Pose, first: Pixels, second: Pixels, cameras: tuple[Camera, Camera]
) -> NDArray[np.float64]:
    """Compute the Sampson distances (n,) of matches (n, 2) in pixels.

    All distances are infinite if too many points are behind a camera.
    """
    turn, shift = second_from_first[:3, :3], second_from_first[:3, 3]
    rays = [_rays(pixels, camera) for pixels, camera in zip((first, second), cameras, strict=True)]
    across = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    essential = across @ turn / max(float(np.linalg.norm(shift)), 1e-300)
    lines, others = rays[0] @ essential.T, rays[1] @ essential
    off = np.abs((rays[1] * lines).sum(axis=1))
    # Convert line slopes to pixels; the rays are at focal length 1.
    slopes = (
        np.hypot(*(lines[:, :2] / _focal(cameras[1])).T),
        np.hypot(*(others[:, :2] / _focal(cameras[0])).T),
    )
    distance = off / np.hypot(*slopes).clip(1e-300)
    turned = rays[0] @ turn.T
    # Signs of the depths where both rays come closest: d1 · turned + shift = d2 · ray.
    normal = np.cross(turned, rays[1])
    depths = [-(np.cross(shift, ray) * normal).sum(axis=1) for ray in (rays[1], turned)]
    in_front = (depths[0] > 0) & (depths[1] > 0)
    if np.count_nonzero(in_front) < _LEAST_IN_FRONT * len(in_front):
        return np.full(len(first), np.inf)
    return np.asarray(distance)


def _rays(pixels: Pixels, camera: Camera) -> NDArray[np.float64]:
    return np.column_stack([(pixels - (camera.cx, camera.cy)) / _focal(camera), np.ones(len(pixels))])


def _focal(camera: Camera) -> NDArray[np.float64]:
    return np.array([camera.fx, camera.fy])
