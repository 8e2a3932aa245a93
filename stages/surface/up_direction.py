"""Up direction of a mesh, given or estimated.

Estimates use the surface and the camera poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.codes import SCALE_UP_CONTRADICTED
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Candidate directions on the sphere, about 3° apart.
_CANDIDATE_COUNT = 4000
# Degrees. Maximum angle of a normal to a candidate to support it: a scanned floor is not flat.
_MAX_NORMAL_ANGLE_DEG = 8.0
# Degrees. Maximum error of the initial guess.
_MAX_GUESS_ERROR_DEG = 60.0
# Minimum ratio of the surface area that must support a direction.
_MIN_AREA_RATIO = 0.03
# A smaller area is a floor if it is at the bottom of the scene: minimum ratio of the surface area, height
# of the layer that contains the floor, as ratio of the scene's size, and maximum ratio of the area below it.
_MIN_FLOOR_RATIO, _FLOOR_LAYER_RATIO, _MAX_BELOW_RATIO = 0.005, 0.02, 0.02
# Degrees. Maximum error of the initial guess for such a floor.
_MAX_FLOOR_ERROR_DEG = 45.0
# Candidate directions, those with the largest support, that are examined for a floor.
_FLOOR_CANDIDATE_COUNT = 60
# Triangles sampled to estimate the up direction.
_MAX_SAMPLED_TRIANGLES = 40_000
# Degrees. An up direction this close to a coordinate axis is snapped to it.
_SNAP_ANGLE_DEG = 1.0
# Degrees. Maximum difference between known and estimated up direction; generous, because people hold cameras
# loosely.
_MAX_CONTRADICTION_DEG = 30.0
# Minimum length of the mean up axis if all cameras were held the same way.
_MIN_MEAN_UP_LENGTH = 0.5
# Cameras rolled by 90° that orbit an object: their mean -y axis is at most 0.6 long, and one direction has at
# least 0.7 of the summed squares of their x axes. Both also hold for cameras that look down by 30°. A camera
# that is tilted but not rolled comes close only on an orbit of more than 200°.
_MAX_ROLLED_UP_LENGTH, _MIN_ROLLED_AXIS_RATIO = 0.6, 0.7
_AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
# Exact rotations of each axis to +z.
_ROTATIONS_TO_Z = {
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
_Y_UP_FROM_Z_UP = np.array(((1, 0, 0), (0, 0, 1), (0, -1, 0)), np.float64)


def parse_up_direction(up: str) -> Floats | None:
    """Parse an up direction: an axis such as "+z", three numbers, or "none".

    Returns
    -------
    Unit vector (3,), or None for "none".

    Raises
    ------
    UsageError
        If the text has none of these forms, or the vector is zero or not finite.
    """
    if up == "none":
        return None
    if up in _AXES:
        return np.array(_AXES[up])
    try:
        direction = np.array([float(word) for word in up.split()])
    except ValueError:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {up!r}; it must be one of {names}, or three numbers.",
            DiagnosticLocation(parameter="up"),
            up=up,
            names=", ".join((*_AXES, "none")),
        ) from None
    length = float(np.linalg.norm(direction))
    if len(direction) != 3 or not 0 < length < math.inf:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {up!r}; a direction is three numbers, not all of them 0.",
            DiagnosticLocation(parameter="up"),
            up=up,
        )
    return direction / length


def rotate_to_z(up: Floats | None) -> Floats:
    """Return a rotation (3, 3) of a unit vector (3,) to +z; identity for None."""
    if up is None:
        return np.eye(3)
    for name, axis in _AXES.items():
        if np.array_equal(up, axis):
            return np.array(_ROTATIONS_TO_Z[name], np.float64)
    # The coordinate axis farthest from `up` gives a well-conditioned cross product.
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up])


def rotate_to_y(up: Floats) -> Floats:
    """Return a rotation (3, 3) of a unit vector (3,) to +y, the up axis of glTF."""
    if np.array_equal(up, _AXES["+y"]):
        return np.eye(3)
    # Adding 0 turns −0 into +0.
    return np.asarray(_Y_UP_FROM_Z_UP @ rotate_to_z(up) + 0.0)


@dataclass(frozen=True, eq=False)
class UpEstimate:
    """Up direction of a scanned scene.

    Attributes
    ----------
    direction : (3,) float64 unit vector.
    source : origin of the direction: `surface`, `plane_normal`, `cameras`, or the source of a known
        direction.
    """

    direction: Floats
    source: str


def estimate_up_of_scene(
    mesh: Mesh,
    poses: Floats,
    known_up: tuple[ArrayLike, str] | None = None,
    plane_normal: ArrayLike | None = None,
) -> UpEstimate:
    """Estimate the up direction of a scanned scene.

    A known direction has priority; a warning is emitted if it contradicts both the surface and the cameras.
    Otherwise the surface decides, or the cameras if the surface has no dominant direction. A direction within
    1° of a coordinate axis is snapped to that axis: gravity-aligned worlds have one there, and a floor is not
    measured more accurately.

    Parameters
    ----------
    mesh : the scene, in world coordinates of the poses.
    poses : (n, 4, 4) camera-to-world, n >= 1.
    known_up : unit vector (3,) and its source.
    plane_normal : unit normal (3,), pointing up, of a table or floor removed from the mesh; replaces the
        estimate
        from the
        surface.
    """
    camera_up = estimate_up_from_cameras(poses)
    surface_up = (
        estimate_up_from_surface(mesh, camera_up)
        if plane_normal is None
        else np.asarray(plane_normal, np.float64)
    )
    if known_up is None:
        surface_source = "surface" if plane_normal is None else "plane"
        direction, source = (camera_up, "cameras") if surface_up is None else (surface_up, surface_source)
        return UpEstimate(_snap_to_axis(direction), source)
    up = np.asarray(known_up[0], np.float64)
    _warn_contradicted_up(up, known_up[1], surface_up, poses)
    return UpEstimate(_snap_to_axis(up), known_up[1])


def _snap_to_axis(up: Floats) -> Floats:
    nearest = max(_AXES.values(), key=lambda axis: float(np.dot(axis, up)))
    return np.array(nearest) if np.dot(nearest, up) > math.cos(math.radians(_SNAP_ANGLE_DEG)) else up


def _warn_contradicted_up(up: Floats, source: str, found: Floats | None, poses: Floats) -> None:
    """Warn if a known up direction contradicts both the surface and the cameras."""
    by_cameras = min(_measure_angle_deg(up, held) for held in _estimate_up_for_each_roll(poses))
    by_surface = math.inf if found is None else _measure_angle_deg(up, found)
    if min(by_cameras, by_surface) <= _MAX_CONTRADICTION_DEG:
        return
    surface = "" if found is None else f" and by {by_surface:.0f}° from the main direction of the surface"
    emit(
        SCALE_UP_CONTRADICTED.warning(
            "the up direction from {source} differs by {off:.0f}° from the cameras' up direction{surface}",
            remedy="set upright.up=AXIS if it is wrong",
            source=source,
            off=by_cameras,
            surface=surface,
        )
    )


def _measure_angle_deg(first: Floats, second: Floats) -> float:
    return math.degrees(math.acos(float(np.clip(first @ second, -1, 1))))


def _estimate_up_for_each_roll(poses: Floats) -> list[Floats]:
    """Return the cameras' up direction, also for cameras rolled by ±90°, if consistent.

    Phones in portrait orientation store all images rolled by 90°. A roll of 180° is not considered, because a
    wrong axis convention is more likely.
    """
    sides = [estimate_up_from_level_cameras(poses)]
    for sine in (1, -1):
        turned = poses[:, :3, :3] @ np.array(((0, -sine, 0), (sine, 0, 0), (0, 0, 1)), np.float64)
        if np.linalg.norm(turned[:, :, 1].mean(axis=0)) > _MIN_MEAN_UP_LENGTH:
            sides.append(estimate_up_from_level_cameras(turned))
    return sides


def estimate_up_from_level_cameras(poses: Floats) -> Floats:
    """Estimate the up direction (3,) from level cameras.

    People hold cameras level, so `up` is orthogonal to the x axes and on the side of the -y axes. If all x
    axes are parallel, as in a car, the mean -y axis decides; it has a lower weight.

    Parameters
    ----------
    poses : (n, 4, 4) camera-to-world, n >= 1, or their rotations (n, 3, 3).
    """
    sideways = poses[:, :3, 0]
    upward = -poses[:, :3, 1].mean(axis=0)
    spread = sideways.T @ sideways / len(poses) - 0.1 * np.outer(upward, upward)
    up = np.linalg.eigh(spread)[1][:, 0]
    return np.asarray(up if up @ upward >= 0 else -up)


def estimate_up_from_cameras(poses: Floats) -> Floats:
    """Estimate the up direction (3,) from cameras that can be rolled by 90°.

    Phones and orbiting arms are used that way around an object. The roll can be in either direction, so the
    sign of `up` follows from the assumption that cameras look down rather than up. Other cameras are passed
    to `estimate_up_from_level_cameras`.

    Parameters
    ----------
    poses : (n, 4, 4) camera-to-world, n >= 1.
    """
    sideways = poses[:, :3, 0]
    along, axes = np.linalg.eigh(sideways.T @ sideways / len(poses))
    upper = np.linalg.norm(poses[:, :3, 1].mean(axis=0))
    if along[2] < _MIN_ROLLED_AXIS_RATIO or upper > _MAX_ROLLED_UP_LENGTH:
        return estimate_up_from_level_cameras(poses)
    axis = axes[:, 2]
    return np.asarray(-axis if axis @ poses[:, :3, 2].mean(axis=0) > 0 else axis)


def estimate_up_from_surface(mesh: Mesh, guess: Floats) -> Floats | None:
    """Estimate the up direction (3,) from floors and table tops; None without them.

    Among the directions within 60° of the guess, the result maximises the supporting area times the cosine of
    the angle to the guess. If hardly any surface is level, a small floor counts if it is the bottom of the
    scene, because cameras are seldom level in a room with little visible floor.

    Parameters
    ----------
    mesh : the scene.
    guess : approximate up direction (3,), unit vector.
    """
    chosen = mesh.triangles[:: 1 + len(mesh.triangles) // _MAX_SAMPLED_TRIANGLES]
    corners = mesh.vertices[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    given_area = np.linalg.norm(normals, axis=1)
    normals = normals[given_area > 0] / given_area[given_area > 0, None]
    area = given_area[given_area > 0] / max(float(given_area.sum()), np.finfo(np.float64).tiny)
    candidates = _sample_sphere(_CANDIDATE_COUNT)
    candidates = candidates[candidates @ guess >= math.cos(math.radians(_MAX_GUESS_ERROR_DEG))]
    support_ratios = np.array([_is_near_direction(normals, direction) @ area for direction in candidates])
    best = int(np.argmax(support_ratios * (candidates @ guess)))
    if support_ratios[best] < _MIN_AREA_RATIO:
        centers = corners[given_area > 0].mean(axis=1)
        possible = np.argsort(-support_ratios, kind="stable")[:_FLOOR_CANDIDATE_COUNT]
        return _find_floor(centers, normals, area, candidates[possible], guess)
    mean = (_is_near_direction(normals, candidates[best]) * area) @ normals
    return np.asarray(mean / np.linalg.norm(mean))


def _find_floor(
    centers: Floats, normals: Floats, area_ratios: Floats, candidates: Floats, guess: Floats
) -> Floats | None:
    """Find the normal (3,) of a small floor at the bottom of the scene; None without a floor.

    Parameters
    ----------
    centers, normals, area_ratios : (n, 3), (n, 3) and (n,), of the triangles; ratios sum to 1.
    candidates : (k, 3) directions that might be up.
    guess : approximate up direction (3,), unit vector.
    """
    if not len(centers):
        return None
    size = float(np.linalg.norm(np.ptp(centers, axis=0)))
    layer = max(_FLOOR_LAYER_RATIO * size, np.finfo(np.float64).tiny)
    best, largest = None, 0.0
    for direction in candidates[candidates @ guess >= math.cos(math.radians(_MAX_FLOOR_ERROR_DEG))]:
        heights = centers @ direction
        index = ((heights - heights.min()) / layer).astype(np.intp)
        is_level = _is_near_direction(normals, direction)
        bins = int(index.max()) + 1
        level = np.bincount(index, area_ratios * is_level, bins)
        # A floor may lie across the border of two bins.
        level[:-1] += level[1:]
        below = np.concatenate([[0.0], np.cumsum(np.bincount(index, area_ratios, bins))[:-1]])
        level[below > _MAX_BELOW_RATIO] = 0
        lowest = int(np.argmax(level))
        if level[lowest] >= _MIN_FLOOR_RATIO and level[lowest] > largest:
            largest = float(level[lowest])
            is_floor = is_level & (index >= lowest) & (index <= lowest + 1)
            best = (is_floor * area_ratios) @ normals
    return None if best is None else np.asarray(best / np.linalg.norm(best))


def _is_near_direction(normals: Floats, direction: Floats) -> NDArray[np.bool_]:
    return np.asarray(normals @ direction >= math.cos(math.radians(_MAX_NORMAL_ANGLE_DEG)))


def _sample_sphere(count: int) -> Floats:
    """Return evenly distributed directions (n, 3): a golden-angle spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * math.pi * (3 - math.sqrt(5))
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
