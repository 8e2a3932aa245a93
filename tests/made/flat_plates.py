"""Scans of flat plates with exact depth, for tests of coverage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)


def plate(corner: Sequence[float], u: Sequence[float], v: Sequence[float], spacing: float = 0.01) -> Mesh:
    """Make a rectangle spanned by u and v, with triangles of edge length `spacing` that face u × v."""
    start, first, second = (np.array(values, np.float64) for values in (corner, u, v))
    i, j = (round(float(np.linalg.norm(side)) / spacing) + 1 for side in (first, second))
    s, t = (a.reshape(-1, 1) for a in np.meshgrid(np.linspace(0, 1, i), np.linspace(0, 1, j), indexing="ij"))
    row, column = (a.ravel() for a in np.meshgrid(np.arange(i - 1), np.arange(j - 1), indexing="ij"))
    a, b, c, d = row * j + column, (row + 1) * j + column, (row + 1) * j + column + 1, row * j + column + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(start + s * first + t * second, triangles.astype(np.int32))


def join_meshes(meshes: Iterable[Mesh]) -> Mesh:
    """Concatenate meshes without merging vertices."""
    vertices, triangles, count = [], [], 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        triangles.append(mesh.triangles + count)
        count += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))


def remove_triangles(mesh: Mesh, is_removed: Callable[[np.ndarray], np.ndarray]) -> Mesh:
    """Remove the triangles whose centres (m, 3) satisfy a predicate."""
    left = ~is_removed(mesh.vertices[mesh.triangles].mean(axis=1))
    used, triangles = np.unique(mesh.triangles[left], return_inverse=True)
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32))


def look_at(eye: Sequence[float], target: Sequence[float]) -> np.ndarray:
    """Compute the pose of a level camera at `eye` that faces `target`; z is up."""
    start = np.array(eye, np.float64)
    forward = np.array(target, np.float64) - start
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1) if abs(forward[2]) < 0.99 else (0, 1, 0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, start], axis=1)
    return pose


def render_depth(surface: RaycastingSurface, pose: np.ndarray) -> np.ndarray:
    """Render the depth map (h, w) float32 of a camera, 0 without a hit."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    hits = surface.cast_rays(pose[:3, 3], rays.reshape(-1, 3) @ pose[:3, :3].T)
    depth = np.zeros(u.size, np.float32)
    depth[hits.rays] = hits.distances
    return depth.reshape(u.shape)


def render_frames(world: Mesh, viewpoints: Iterable[tuple[Sequence[float], Sequence[float]]]) -> list[Frame]:
    """Render a frame for each pair of eye and target."""
    surface = RaycastingSurface(world, np.array([[-6, -6, -6], [6, 6, 6]], np.float64))
    poses = [look_at(eye, target) for eye, target in viewpoints]
    return [
        Frame(f"{number}", CAMERA, depth=render_depth(surface, pose), world_from_camera=pose)
        for number, pose in enumerate(poses)
    ]
