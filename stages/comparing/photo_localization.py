"""Localisation of a photo against a textured mesh."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.mesh_rendering import fit_gain_and_bias, render_from_pose
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.rolling_shutter import compute_readout_time
from scanloom.stages.scans.model.scan import Camera, ColorImage, Pose
from scanloom.stages.surface.raycasting import RaycastingSurface

# Feature matching: maximum number of SIFT features, ratio of best to second-best match distance, maximum
# displacement in pixels at the given pose, minimum number of matches for a pose.
_MAX_FEATURES, _MATCH_RATIO, _MAX_DISPLACEMENT_PX, _MIN_MATCHES = 4000, 0.8, 60.0, 12
_REPROJECTION_LIMITS_PX = (12.0, 4.0, 3.0)
# Optical flow: number of refinements, maximum reprojection error in pixels, side of a grid cell in pixels
# (one point is used per cell), minimum squared gradient in levels² for a pixel to be used.
_REFINEMENT_COUNT, _FLOW_REPROJECTION_PX, _CELL_SIDE_PX, _MIN_SQUARED_GRADIENT = 2, 2.0, 6, 400.0
# Pixels. Flow this close to the mesh's outline is unreliable and ignored. Below the minimum number of mesh
# pixels, no flow is computed.
_OUTLINE_MARGIN_PX, _MIN_MESH_PIXELS = 7, 500


def generate_pose_candidates(
    image: ColorImage, camera: Camera, initial_pose: Pose, surface: RaycastingSurface
) -> Iterator[Pose]:
    """Yield candidate poses of a photo.

    They are the given pose, the pose from feature matches, and the pose refined by optical flow. A pose that
    cannot be estimated is omitted.

    Parameters
    ----------
    image : (h, w, 3) uint8, without lens distortion.
    camera : intrinsics of the photo.
    initial_pose : world_from_camera.
    surface : textured mesh to localise against.
    """
    yield initial_pose
    placed = _localize_by_features(image, camera, initial_pose, surface)
    if placed is not None:
        yield placed
    refined = _refine_by_optical_flow(image, camera, initial_pose if placed is None else placed, surface)
    if refined is not None:
        yield refined


def _localize_by_features(
    image: ColorImage, camera: Camera, initial_pose: Pose, surface: RaycastingSurface
) -> Pose | None:
    """Estimate a photo's pose from feature matches with the rendered mesh.

    Returns None with too few matches.
    """
    import cv2

    search = cv2.SIFT.create(_MAX_FEATURES)
    photo_keypoints, photo_descriptors = search.detectAndCompute(
        cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None
    )
    found = None
    for limit in _REPROJECTION_LIMITS_PX:
        rendering = render_from_pose(surface, camera, initial_pose)
        rendered_gray = cv2.cvtColor(rendering.levels.clip(0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        inner = cv2.erode(rendering.hit_mask.astype(np.uint8), np.ones((5, 5), np.uint8)) * 255
        rendered_keypoints, rendered_descriptors = search.detectAndCompute(
            rendered_gray, np.asarray(inner, np.uint8)
        )
        if (
            rendered_descriptors is None
            or photo_descriptors is None
            or min(len(rendered_descriptors), len(photo_descriptors)) < _MIN_MATCHES
        ):
            return found
        pairs = cv2.BFMatcher().knnMatch(rendered_descriptors, photo_descriptors, k=2)
        good = [first for first, second in pairs if first.distance < _MATCH_RATIO * second.distance]
        a = np.array([rendered_keypoints[match.queryIdx].pt for match in good]).reshape(-1, 2)
        b = np.array([photo_keypoints[match.trainIdx].pt for match in good]).reshape(-1, 2)
        near = np.linalg.norm(a - b, axis=1) < _MAX_DISPLACEMENT_PX
        if np.count_nonzero(near) < _MIN_MATCHES:
            return found
        pixels = np.rint(a[near]).astype(np.int64)
        points = rendering.positions[pixels[:, 1], pixels[:, 0]]
        # Surface points are known at whole pixels only; shift the matched photo position by the same
        # rounding.
        b[near] += pixels - a[near]
        better = _solve_pose(points, b[near], camera, limit)
        if better is None:
            return found
        found = initial_pose = better
    return found


def _refine_by_optical_flow(
    image: ColorImage, camera: Camera, pose: Pose, surface: RaycastingSurface
) -> Pose | None:
    """Refine a photo's pose by optical flow from the rendered mesh.

    Feature matches are few and accurate to about a pixel; flow is available wherever the image has gradients.
    Returns None if no pose is found.
    """
    for _ in range(_REFINEMENT_COUNT):
        found = _match_by_optical_flow(image, camera, pose, surface)
        better = None if found is None else _solve_pose(*found, camera, _FLOW_REPROJECTION_PX)
        if better is None:
            return None
        pose = better
    return pose


def estimate_shutter_rotation(
    image: ColorImage, camera: Camera, pose: Pose, surface: RaycastingSurface
) -> NDArray[np.float64] | None:
    """Estimate the rotation of a camera while its photo was read out.

    The estimate uses optical flow from the rendered mesh to the photo.

    Parameters
    ----------
    image : (h, w, 3) uint8, without lens distortion, rows as they were read (rolling shutter).
    camera : intrinsics of the photo.
    pose : approximate world_from_camera of the photo.
    surface : textured mesh to render.

    Returns
    -------
    (3,) rotation vector in camera axes, radians (see `Frame.shutter_turn`); None if too little is visible.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    found = _match_by_optical_flow(image, camera, pose, surface)
    if found is None or len(found[0]) < _MIN_MATCHES:
        return None
    points, pixels = found
    readout_offsets = compute_readout_time(pixels[:, 1:], camera.height)
    to_camera = invert_pose(pose)
    near = points @ to_camera[:3, :3].T + to_camera[:3, 3]

    def compute_residuals(steps: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = Rotation.from_rotvec(steps[:3]).apply(near) + steps[3:6]
        x, y, z = Rotation.from_rotvec(-readout_offsets * steps[6:]).apply(moved).T
        z = np.maximum(z, 1e-6)
        there = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        return np.asarray((there - pixels).ravel())

    return np.asarray(least_squares(compute_residuals, np.zeros(9), loss="soft_l1").x[6:])


def _match_by_optical_flow(
    image: ColorImage, camera: Camera, pose: Pose, surface: RaycastingSurface
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Match surface points (n, 3) to photo pixels (n, 2) by optical flow.

    The flow runs from the rendered mesh to the photo. Returns None if hardly any of the mesh is visible from
    the pose.
    """
    import cv2

    rendering = render_from_pose(surface, camera, pose)
    if np.count_nonzero(rendering.hit_mask) < _MIN_MESH_PIXELS:
        return None
    levels = fit_gain_and_bias(rendering.levels, image.astype(np.float32), rendering.hit_mask)
    photo = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    drawn = cv2.cvtColor(
        np.where(rendering.hit_mask[..., None], levels, image).astype(np.uint8), cv2.COLOR_RGB2GRAY
    )
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = search.calc(drawn, photo, np.zeros((*drawn.shape, 2), np.float32))
    smooth = cv2.GaussianBlur(drawn.astype(np.float32), (0, 0), 1.0)
    detail = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(smooth, cv2.CV_32F, 0, 1) ** 2
    detail[
        cv2.erode(
            rendering.hit_mask.astype(np.uint8), np.ones((_OUTLINE_MARGIN_PX, _OUTLINE_MARGIN_PX), np.uint8)
        )
        == 0
    ] = 0
    rows, columns = _select_strongest_gradients(detail)
    pixels = np.stack([columns, rows], axis=1) + np.asarray(flow)[rows, columns]
    return rendering.positions[rows, columns], pixels.astype(np.float64)


def _select_strongest_gradients(detail: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of the strongest gradient in each grid cell."""
    rows, columns = (count // _CELL_SIDE_PX for count in detail.shape)
    cells = detail[: rows * _CELL_SIDE_PX, : columns * _CELL_SIDE_PX].reshape(
        rows, _CELL_SIDE_PX, columns, _CELL_SIDE_PX
    )
    cells = cells.transpose(0, 2, 1, 3).reshape(rows, columns, _CELL_SIDE_PX**2)
    best = cells.argmax(axis=2)
    row, column = np.nonzero(cells.max(axis=2) > _MIN_SQUARED_GRADIENT)
    within = best[row, column]
    return row * _CELL_SIDE_PX + within // _CELL_SIDE_PX, column * _CELL_SIDE_PX + within % _CELL_SIDE_PX


def _solve_pose(
    points: NDArray[np.float64], pixels: NDArray[np.float64], camera: Camera, max_error_px: float
) -> Pose | None:
    """Solve for the pose from 3-D points and their pixels (PnP with RANSAC).

    Returns None if fewer than `_MIN_MATCHES` points reproject within `max_error_px` pixels.
    """
    import cv2

    if len(points) < _MIN_MATCHES:
        return None
    cv2.setRNGSeed(0)
    matrix, none = camera.matrix, np.zeros(4)
    sound, turn, shift, inliers = cv2.solvePnPRansac(
        points, pixels, matrix, none, reprojectionError=max_error_px, iterationsCount=2000, confidence=0.999
    )
    if not sound or inliers is None or len(inliers) < _MIN_MATCHES:
        return None
    rows = np.asarray(inliers)[:, 0]
    _, turn, shift = cv2.solvePnP(points[rows], pixels[rows], matrix, none)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = cv2.Rodrigues(turn)[0]
    world_to_camera[:3, 3] = np.asarray(shift)[:, 0]
    return invert_pose(world_to_camera)
