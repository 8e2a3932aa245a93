"""Perspective view of a hierarchy: frustum tests and projected sizes in pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.printing import format_by_fields
from scanloom.stages.rendering.viewpoints import Viewpoint

Floats = NDArray[np.float64]

# Minimum distance from the eye relative to a node's radius, for nodes that contain the eye.
_MIN_DISTANCE_RATIO = 1e-3


@dataclass(frozen=True, eq=False)
class View:
    """Perspective view.

    Attributes
    ----------
    eye : (3,) camera centre, metres.
    look : (3,) target point in the viewing direction, metres.
    up : (3,) direction that is up in the image, as far as the viewing direction allows.
    width, height : image size, pixels.
    field : vertical field of view, degrees, above 0 and below 180.
    near : distance of the near plane, metres, above 0.
    far : distance of the far plane, metres; infinite for none.
    """

    eye: tuple[float, float, float]
    look: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    width: int = 1280
    height: int = 720
    field: float = 50.0
    near: float = 1e-3
    far: float = math.inf

    __repr__ = format_by_fields

    def __post_init__(self) -> None:
        points = (self.eye, self.look, self.up)
        if any(len(p) != 3 or not all(math.isfinite(x) for x in p) for p in points):
            raise UsageError(USAGE_ARGUMENT_INVALID, "eye, look and up must be three finite numbers each.")
        if math.dist(self.eye, self.look) == 0:
            raise UsageError(
                USAGE_ARGUMENT_INVALID,
                "eye and look are the same point",
                remedy="choose another point to look at.",
            )
        if not (self.width >= 1 and self.height >= 1):
            raise UsageError(USAGE_ARGUMENT_INVALID, "width and height of a view must be 1 pixel or more.")
        if not 0 < self.field < 180:
            raise UsageError(USAGE_ARGUMENT_INVALID, "the field of view must be above 0° and below 180°.")
        if not 0 < self.near < self.far:
            raise UsageError(USAGE_ARGUMENT_INVALID, "near must be above 0 and less than far.")

    @staticmethod
    def of(viewpoint: Viewpoint, *, near: float = 1e-3, far: float = math.inf) -> View:
        """Return the view of a viewpoint, ignoring its principal point."""
        camera, pose = viewpoint.camera, np.asarray(viewpoint.world_from_camera, np.float64)
        eye, direction, down = pose[:3, 3], pose[:3, 2], pose[:3, 1]
        field = 2 * math.degrees(math.atan2(0.5 * camera.height, camera.fy))

        def to_tuple(p: Floats) -> tuple[float, float, float]:
            return float(p[0]), float(p[1]), float(p[2])

        return View(
            to_tuple(eye),
            to_tuple(eye + direction),
            to_tuple(-down),
            camera.width,
            camera.height,
            field,
            near,
            far,
        )

    @property
    def direction(self) -> Floats:
        """Viewing direction (3,), unit length."""
        way = np.subtract(self.look, self.eye)
        return np.asarray(way / np.linalg.norm(way))

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.height / math.tan(math.radians(0.5 * self.field))

    def compute_planes(self) -> tuple[Floats, Floats]:
        """Compute the planes of the frustum: outward normals (k, 3) and offsets (k,).

        A point x is inside if normals @ x <= offsets. There are five planes, or six with a finite far plane.
        """
        direction = self.direction
        right = np.cross(direction, self.up)
        length = float(np.linalg.norm(right))
        if length < 1e-9 * float(np.linalg.norm(self.up)):
            # Viewing along the up direction: any horizontal axis will do.
            right = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
            length = float(np.linalg.norm(right))
        right = right / length
        up = np.cross(right, direction)
        half_height = math.tan(math.radians(0.5 * self.field))
        half_width = half_height * self.width / self.height
        sides = [
            right - half_width * direction,
            -right - half_width * direction,
            up - half_height * direction,
            -up - half_height * direction,
        ]
        normals = [side / np.linalg.norm(side) for side in sides] + [-direction]
        eye = np.asarray(self.eye, np.float64)
        offsets = [float(n @ eye) for n in normals[:4]] + [float(-direction @ eye) - self.near]
        if math.isfinite(self.far):
            normals.append(direction)
            offsets.append(float(direction @ eye) + self.far)
        return np.stack(normals), np.asarray(offsets)

    def intersects(self, middle: Floats, radius: Floats) -> NDArray[np.bool_]:
        """Return a mask (n,) of the spheres (n, 3), (n,) that may intersect the frustum."""
        normals, offsets = self.compute_planes()
        return np.asarray((middle @ normals.T - offsets <= radius[:, None]).all(axis=1))

    def project_lengths(self, length: Floats, middle: Floats, radius: Floats) -> Floats:
        """Compute the maximum projected size of lengths (n,) in spheres (n, 3), (n,), pixels."""
        distance = np.linalg.norm(middle - np.asarray(self.eye), axis=1) - radius
        min_distance = np.maximum(self.near, _MIN_DISTANCE_RATIO * radius)
        # At the image border, perspective enlarges a length by the squared secant of the viewing angle.
        half = math.tan(math.radians(0.5 * self.field))
        secant2 = 1 + half**2 * (1 + (self.width / self.height) ** 2)
        depth = np.maximum(distance, min_distance) / math.sqrt(secant2)
        return np.asarray(length * self.focal_px / np.maximum(depth, self.near) * math.sqrt(secant2))
