"""Wall with tags of known size, and photos with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from scanloom.stages.scans.model.scan import Camera, Frame

CAMERA = Camera(640, 480, 520.0, 520.0, 318.0, 241.0)
# Resolution of the wall's picture in pixels per metre; oversampling of rendered photos.
_PIXELS_PER_METRE, _OVERSAMPLING = 1500, 3


@dataclass(frozen=True)
class Tag:
    """Tag on the wall z = 0: number, centre (x, y) and edge of its black square, metres."""

    number: int
    middle: tuple[float, float]
    edge: float
    family: int = cv2.aruco.DICT_APRILTAG_36h11


TAGS = (Tag(3, (-0.3, 0.1), 0.12), Tag(7, (0.25, -0.15), 0.12))


def wall(tags: Sequence[Tag], width: float = 2.0) -> np.ndarray:
    """Draw a square picture of the wall, centred at the origin, y down."""
    side = round(width * _PIXELS_PER_METRE)
    noise = np.random.default_rng(2).uniform(150, 210, (side // 40, side // 40)).astype(np.float32)
    picture = cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)
    for tag in tags:
        known = cv2.aruco.getPredefinedDictionary(tag.family)
        cells = known.markerSize + 2
        drawn = np.pad(cv2.aruco.generateImageMarker(known, tag.number, cells), 1, constant_values=255)
        edge = round(tag.edge / cells * (cells + 2) * _PIXELS_PER_METRE)
        at = [round((one + width / 2) * _PIXELS_PER_METRE - edge / 2) for one in tag.middle]
        picture[at[1] : at[1] + edge, at[0] : at[0] + edge] = cv2.resize(
            drawn, (edge, edge), interpolation=cv2.INTER_NEAREST
        )
    return picture


def photo(picture: np.ndarray, world_from_camera: np.ndarray, camera: Camera = CAMERA) -> np.ndarray:
    """Render a photo (h, w, 3) of the wall with a camera's blur and noise."""
    camera_from_world = np.linalg.inv(world_from_camera)
    half = picture.shape[0] / 2
    world_from_picture = (
        np.array([[1, 0, -half + 0.5], [0, 1, -half + 0.5], [0, 0, _PIXELS_PER_METRE]]) / _PIXELS_PER_METRE
    )
    fine = camera.matrix * _OVERSAMPLING
    fine[:2, 2] += (_OVERSAMPLING - 1) / 2
    fine[2, 2] = 1
    seen = fine @ np.column_stack([camera_from_world[:3, :2], camera_from_world[:3, 3]]) @ world_from_picture
    size = (camera.width * _OVERSAMPLING, camera.height * _OVERSAMPLING)
    large = cv2.warpPerspective(picture, seen, size, flags=cv2.INTER_LINEAR, borderValue=90)
    # Lens and pixels integrate linear light; photos store it with a gamma of 2.2.
    light = ((large / 255.0) ** 2.2).astype(np.float32)
    small = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    levels = 255 * cv2.GaussianBlur(small, (0, 0), 0.6).astype(np.float64) ** (1 / 2.2)
    levels += np.random.default_rng(1).normal(0, 2, levels.shape)
    return np.repeat(levels.clip(0, 255).round().astype(np.uint8)[..., None], 3, axis=2)


def poses(count: int = 6, distance: float = 1.3) -> list[np.ndarray]:
    """Compute world-from-camera poses on an arc that face the centre of the wall."""
    found = []
    for angle, lift in zip(np.linspace(-0.5, 0.5, count), np.cos(np.arange(count) * 2.1), strict=True):
        centre = distance * np.array((np.sin(angle), 0.25 * lift, -np.cos(angle)))
        z = -centre / np.linalg.norm(centre)
        x = np.cross((0, 1, 0), z)
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose[:3, 3] = centre
        found.append(pose)
    return found


def frames(
    tags: Sequence[Tag] = TAGS, *, metres_per_unit: float = 1.0, count: int = 6, camera: Camera = CAMERA
) -> list[Frame]:
    """Render views of the wall; their poses are in units of `metres_per_unit`."""
    picture, made = wall(tags), []
    for number, pose in enumerate(poses(count)):
        stated = pose.copy()
        stated[:3, 3] /= metres_per_unit
        image = photo(picture, pose, camera)
        made.append(Frame(f"{number:04d}", camera, color=image, world_from_camera=stated))
    return made
