"""Ball or box on a round table, seen from a ring of cameras.

The table is above a floor; z is up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, Frame

Floats = NDArray[np.float64]

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
TABLE = 0.45  # radius of the table, whose top is at z = 0, metres
FLOOR = -0.6
BALL = 0.12  # radius of the ball on the table, metres
BOX_HALF_SIZE = np.array([0.2, 0.16, 0.09])  # of the box on the table, metres
OBJECT_POSITION = np.array([0.03, -0.02])  # centre of the ball or the box on the table
FRAMES = 16


def pose(angle: float, *, distance: float = 1.0, lift: float = 0.6, roll: float = 0.0) -> Floats:
    """Compute the world-from-camera pose of a camera that faces the object; angles in degrees."""
    turn, tilt = np.radians(angle), lift
    aim = np.array([*OBJECT_POSITION, 0.08])
    back = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    x = np.array([-np.sin(turn), np.cos(turn), 0.0])
    y = np.cross(-back, x)
    r = np.radians(roll)
    result = np.eye(4)
    result[:3, 0], result[:3, 1] = np.cos(r) * x + np.sin(r) * y, np.cos(r) * y - np.sin(r) * x
    result[:3, 2], result[:3, 3] = -back, aim + distance * back
    return result


def render_depth(world_from_camera: Floats, thing: str, *, table: float = TABLE) -> Floats:
    """Render the depth map (h, w) of a `ball`, a `box` or `nothing` on the table above the floor."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    way, eye = rays @ world_from_camera[:3, :3].T, world_from_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        top = -eye[2] / way[..., 2]
        top[np.linalg.norm((eye + way * top[..., None])[..., :2], axis=-1) > table] = np.inf
        floor = (FLOOR - eye[2]) / way[..., 2]
        floor[np.linalg.norm((eye + way * floor[..., None])[..., :2], axis=-1) > 1.2] = np.inf
        found = [np.where(depth > 0, depth, np.inf) for depth in (top, floor)]
        if thing == "ball":
            a, o = (way**2).sum(-1), eye - [*OBJECT_POSITION, BALL]
            b = way @ o
            root = b**2 - a * (o @ o - BALL**2)
            found.append(np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf))
        elif thing == "box":
            one, other = (
                (corner * BOX_HALF_SIZE + [*OBJECT_POSITION, BOX_HALF_SIZE[2]] - eye) / way
                for corner in (-1, 1)
            )
            near, far = np.minimum(one, other).max(-1), np.maximum(one, other).min(-1)
            found.append(np.where(near < far, near, np.inf))
    depth = np.min(found, axis=0)
    return np.where(np.isfinite(depth), depth, 0)


def frames(thing: str, *, noise: float = 0.001, table: float = TABLE, roll: float = 0.0) -> list[Frame]:
    """Make the ring of frames with depth noise in metres; pixels of the object are red."""
    draw = np.random.default_rng(7)
    made = []
    for k in range(FRAMES):
        there = pose(360 * k / FRAMES, lift=(0.5, 0.75)[k % 2], roll=roll)
        depth = render_depth(there, thing, table=table)
        bare = render_depth(there, "nothing", table=table)
        color = np.where((depth < bare)[..., None], np.uint8([200, 40, 30]), np.uint8([120, 130, 140]))
        noisy = np.where(depth > 0, depth + noise * draw.standard_normal(depth.shape), 0)
        made.append(
            Frame(f"{k:02}", CAMERA, color=color, depth=noisy.astype(np.float32), world_from_camera=there)
        )
    return made
