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
from scanloom.stages.inspecting.pose_conventions import (
    AS_GIVEN,
    compute_relative_poses,
    suggest_pose_convention,
)
from scanloom.stages.scans.model.images import read_pinhole
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, scale_camera, to_pinhole

RESULT_VERSION = 1

# Number of view pairs, maximum index distance within a pair, maximum image width in pixels, number of
# keypoints.
_PAIR_COUNT, _MAX_INDEX_STEP, _MAX_WIDTH_PX, _KEYPOINT_COUNT = 5, 2, 1200, 2000
# Minimum number of geometrically consistent matches per pair.
_MIN_MATCHES = 24
# Pixels. Another convention must fit below the first value; below the second, the declared convention is
# accepted.
_MAX_FITTING_ERROR_PX, _MAX_SOUND_ERROR_PX = 2.0, 4.0
# Minimum ratio between the errors of the declared and a better convention.
_MIN_ERROR_RATIO = 4.0
# Minimum ratio of matches in front of both cameras; otherwise the convention is rejected.
_MIN_IN_FRONT_RATIO = 0.5

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
            remedy=suggest_pose_convention(min(errors, key=lambda name: errors[name])),
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
    for first, second, one, other, camera in _match_views(posed):
        for name, motion in compute_relative_poses(poses, first, second).items():
            found.setdefault(name, []).append(_compute_epipolar_errors(motion, one, other, camera))
    errors = {name: float(np.median(np.concatenate(each))) for name, each in found.items()}
    if not errors:
        return {}, None
    declared, best = errors[AS_GIVEN], min(errors, key=lambda name: errors[name])
    if (
        declared < max(_MAX_SOUND_ERROR_PX, _MIN_ERROR_RATIO * errors[best])
        or errors[best] > _MAX_FITTING_ERROR_PX
    ):
        return errors, None
    similar = [name for name, error in errors.items() if error < max(_MIN_ERROR_RATIO * errors[best], 1.0)]
    given_text = f"{declared:.0f} px" if np.isfinite(declared) else "points behind the cameras"
    return errors, POSE_CONVENTION_SUSPECT.warning(
        "the poses are probably {alike}: feature matches then agree to {best_px:.1f} px; as given: {given}",
        alike=", or ".join(similar),
        best_px=max(errors[best], 0.1),
        given=given_text,
    )


def _match_views(
    frames: Sequence[Frame],
) -> list[tuple[int, int, Pixels, Pixels, tuple[Camera, Camera]]]:
    """Match features in pairs of neighbouring views.

    Returns
    -------
    Per pair: indices of both views, matched pixels (n, 2) in each, and their cameras.
    """
    count = len(frames)
    starts = sample_evenly(max(count - 1, 0), _PAIR_COUNT)
    places = sorted({int(at) + n for at in starts for n in range(_MAX_INDEX_STEP + 1) if at + n < count})
    threads = get_worker_count()
    features = dict(
        zip(
            places,
            map_ordered(
                lambda at: _detect_features(frames[at]), places, threads=threads, max_pending=threads
            ),
            strict=True,
        )
    )
    view_pairs = []
    for at in starts:
        for second in range(int(at) + 1, min(int(at) + _MAX_INDEX_STEP + 1, count)):
            one, other = features[int(at)], features[second]
            if one is None or other is None:
                continue
            pixels = _find_inlier_matches(one[0], other[0])
            if pixels is not None:
                view_pairs.append((int(at), second, *pixels, (one[1], other[1])))
                break
    return view_pairs


def _detect_features(frame: Frame) -> tuple[Keypoints, Camera] | None:
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
    camera = to_pinhole(frame.camera)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if camera.width > _MAX_WIDTH_PX:
        camera = scale_camera(
            camera, _MAX_WIDTH_PX, max(round(camera.height * _MAX_WIDTH_PX / camera.width), 1)
        )
        grey = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return detect_keypoints(np.asarray(grey, np.uint8), _KEYPOINT_COUNT), camera


def _find_inlier_matches(one: Keypoints, other: Keypoints) -> tuple[Pixels, Pixels] | None:
    """Match the features of two views and keep the epipolar inliers.

    Returns None with fewer than `_MIN_MATCHES` inliers.
    """
    pairs = match_descriptors(one.descriptors, other.descriptors)
    first, second = one.pixels[pairs[:, 0]], other.pixels[pairs[:, 1]]
    good = find_epipolar_inliers(first, second)
    if np.count_nonzero(good) < _MIN_MATCHES:
        return None
    return first[good].astype(np.float64), second[good].astype(np.float64)


def _compute_epipolar_errors(
    second_from_first: Pose, first: Pixels, second: Pixels, cameras: tuple[Camera, Camera]
) -> NDArray[np.float64]:
    """Compute the Sampson distances (n,) of matches (n, 2) in pixels.

    All distances are infinite if too many points are behind a camera.
    """
    rotation, translation = second_from_first[:3, :3], second_from_first[:3, 3]
    rays = [
        _unproject_to_rays(pixels, camera) for pixels, camera in zip((first, second), cameras, strict=True)
    ]
    cross_matrix = np.array(
        [
            [0, -translation[2], translation[1]],
            [translation[2], 0, -translation[0]],
            [-translation[1], translation[0], 0],
        ]
    )
    essential = cross_matrix @ rotation / max(float(np.linalg.norm(translation)), 1e-300)
    lines, others = rays[0] @ essential.T, rays[1] @ essential
    off = np.abs((rays[1] * lines).sum(axis=1))
    # Convert line slopes to pixels; the rays are at focal length 1.
    slopes = (
        np.hypot(*(lines[:, :2] / _get_focal_lengths(cameras[1])).T),
        np.hypot(*(others[:, :2] / _get_focal_lengths(cameras[0])).T),
    )
    distance = off / np.hypot(*slopes).clip(1e-300)
    turned = rays[0] @ rotation.T
    # Signs of the depths where both rays come closest: d1 · turned + shift = d2 · ray.
    normal = np.cross(turned, rays[1])
    depths = [-(np.cross(translation, ray) * normal).sum(axis=1) for ray in (rays[1], turned)]
    in_front = (depths[0] > 0) & (depths[1] > 0)
    if np.count_nonzero(in_front) < _MIN_IN_FRONT_RATIO * len(in_front):
        return np.full(len(first), np.inf)
    return np.asarray(distance)


def _unproject_to_rays(pixels: Pixels, camera: Camera) -> NDArray[np.float64]:
    return np.column_stack(
        [(pixels - (camera.cx, camera.cy)) / _get_focal_lengths(camera), np.ones(len(pixels))]
    )


def _get_focal_lengths(camera: Camera) -> NDArray[np.float64]:
    return np.array([camera.fx, camera.fy])
