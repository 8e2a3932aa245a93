"""Localisation of a photo against a textured mesh."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.seen import fitted, seen_from
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.rolling_shutter import late_at
from scanloom.stages.scans.model.scan import Camera, ColorImage, Pose
from scanloom.stages.surface.raycasting import Surface

# Feature matching: maximum number of SIFT features, ratio of best to second-best match distance, maximum
# displacement in pixels at the given pose, minimum number of matches for a pose.
_POINTS, _RATIO, _NEAR, _LEAST_POINTS = 4000, 0.8, 60.0, 12
_REPROJECTION = (12.0, 4.0, 3.0)
# Optical flow: number of refinements, maximum reprojection error in pixels, side of a grid cell in pixels
# (one point is used per cell), minimum squared gradient in levels² for a pixel to be used.
_REFINEMENTS, _FLOW_REPROJECTION, _CELL, _LEAST_DETAIL = 2, 2.0, 6, 400.0
# Pixels. Flow this close to the mesh's outline is unreliable and ignored. Below the minimum number of mesh
# pixels, no flow is computed.
_BORDER, _LEAST_PIXELS = 7, 500


def poses_of(image: ColorImage, camera: Camera, given: Pose, surface: Surface) -> Iterator[Pose]:
    """Yield candidate poses of a photo.

    They are the given pose, the pose from feature matches, and the pose refined by optical flow. A pose that
    cannot be estimated is left out.

    Parameters
    ----------
    image : (h, w, 3) uint8, without lens distortion.
    camera : intrinsics of the photo.
    given : world_from_camera.
    surface : textured mesh to localise against.
    """
    yield given
    placed = _placed(image, camera, given, surface)
    if placed is not None:
        yield placed
    refined = _refined(image, camera, given if placed is None else placed, surface)
    if refined is not None:
        yield refined


def _placed(image: ColorImage, camera: Camera, pose: Pose, surface: Surface) -> Pose | None:
    """Estimate a photo's pose from feature matches with the rendered mesh.

    Returns None with too few matches.
    """
    import cv2

    search = cv2.SIFT.create(_POINTS)
    there, described = search.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
    found = None
    for limit in _REPROJECTION:
        seen = seen_from(surface, camera, pose)
        drawn = cv2.cvtColor(seen.levels.clip(0, 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        inner = cv2.erode(seen.hit.astype(np.uint8), np.ones((5, 5), np.uint8)) * 255
        here, description = search.detectAndCompute(drawn, np.asarray(inner, np.uint8))
        if description is None or described is None or min(len(description), len(described)) < _LEAST_POINTS:
            return found
        pairs = cv2.BFMatcher().knnMatch(description, described, k=2)
        good = [first for first, second in pairs if first.distance < _RATIO * second.distance]
        a = np.array([here[match.queryIdx].pt for match in good]).reshape(-1, 2)
        b = np.array([there[match.trainIdx].pt for match in good]).reshape(-1, 2)
        near = np.linalg.norm(a - b, axis=1) < _NEAR
        if np.count_nonzero(near) < _LEAST_POINTS:
            return found
        pixels = np.rint(a[near]).astype(np.int64)
        points = seen.places[pixels[:, 1], pixels[:, 0]]
        # Surface points are known at whole pixels only; shift the matched photo position by the same
        # rounding.
        b[near] += pixels - a[near]
        better = _from_points(points, b[near], camera, limit)
        if better is None:
            return found
        found = pose = better
    return found


def _refined(image: ColorImage, camera: Camera, pose: Pose, surface: Surface) -> Pose | None:
    """Refine a photo's pose by optical flow from the rendered mesh.

    Feature matches are few and accurate to about a pixel; flow is available wherever the image has gradients.
    Returns None if no pose is found.
    """
    for _ in range(_REFINEMENTS):
        found = _followed(image, camera, pose, surface)
        better = None if found is None else _from_points(*found, camera, _FLOW_REPROJECTION)
        if better is None:
            return None
        pose = better
    return pose


def turn_seen(image: ColorImage, camera: Camera, pose: Pose, surface: Surface) -> NDArray[np.float64] | None:
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

    found = _followed(image, camera, pose, surface)
    if found is None or len(found[0]) < _LEAST_POINTS:
        return None
    points, pixels = found
    late = late_at(pixels[:, 1:], camera.height)
    to_camera = inverted(pose)
    near = points @ to_camera[:3, :3].T + to_camera[:3, 3]

    def off(steps: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = Rotation.from_rotvec(steps[:3]).apply(near) + steps[3:6]
        x, y, z = Rotation.from_rotvec(-late * steps[6:]).apply(moved).T
        z = np.maximum(z, 1e-6)
        there = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=1)
        return np.asarray((there - pixels).ravel())

    return np.asarray(least_squares(off, np.zeros(9), loss="soft_l1").x[6:])


def _followed(
    image: ColorImage, camera: Camera, pose: Pose, surface: Surface
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Match surface points (n, 3) to photo pixels (n, 2) by optical flow.

    The flow runs from the rendered mesh to the photo. Returns None if hardly any of the mesh is visible from
    the pose.
    """
    import cv2

    seen = seen_from(surface, camera, pose)
    if np.count_nonzero(seen.hit) < _LEAST_PIXELS:
        return None
    levels = fitted(seen.levels, image.astype(np.float32), seen.hit)
    photo = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    drawn = cv2.cvtColor(np.where(seen.hit[..., None], levels, image).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = search.calc(drawn, photo, np.zeros((*drawn.shape, 2), np.float32))
    smooth = cv2.GaussianBlur(drawn.astype(np.float32), (0, 0), 1.0)
    detail = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(smooth, cv2.CV_32F, 0, 1) ** 2
    detail[cv2.erode(seen.hit.astype(np.uint8), np.ones((_BORDER, _BORDER), np.uint8)) == 0] = 0
    rows, columns = _strongest(detail)
    pixels = np.stack([columns, rows], axis=1) + np.asarray(flow)[rows, columns]
    return seen.places[rows, columns], pixels.astype(np.float64)


def _strongest(detail: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of the strongest gradient in each grid cell."""
    rows, columns = (count // _CELL for count in detail.shape)
    cells = detail[: rows * _CELL, : columns * _CELL].reshape(rows, _CELL, columns, _CELL)
    cells = cells.transpose(0, 2, 1, 3).reshape(rows, columns, _CELL**2)
    best = cells.argmax(axis=2)
    row, column = np.nonzero(cells.max(axis=2) > _LEAST_DETAIL)
    within = best[row, column]
    return row * _CELL + within // _CELL, column * _CELL + within % _CELL


def _from_points(
    points: NDArray[np.float64], pixels: NDArray[np.float64], camera: Camera, limit: float
) -> Pose | None:
    """Solve for the pose from 3-D points and their pixels (PnP with RANSAC).

    Returns None if fewer than `_LEAST_POINTS` points reproject within `limit` pixels.
    """
    import cv2

    if len(points) < _LEAST_POINTS:
        return None
    cv2.setRNGSeed(0)
    matrix, none = camera.matrix, np.zeros(4)
    sound, turn, shift, inliers = cv2.solvePnPRansac(
        points, pixels, matrix, none, reprojectionError=limit, iterationsCount=2000, confidence=0.999
    )
    if not sound or inliers is None or len(inliers) < _LEAST_POINTS:
        return None
    rows = np.asarray(inliers)[:, 0]
    _, turn, shift = cv2.solvePnP(points[rows], pixels[rows], matrix, none)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = cv2.Rodrigues(turn)[0]
    world_to_camera[:3, 3] = np.asarray(shift)[:, 0]
    return inverted(world_to_camera)
