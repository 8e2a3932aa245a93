"""Mesh rendering from a camera, and colour fit to a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.projection import unproject
from scanloom.stages.scans.model.scan import Camera, Pose
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.surface_color import compute_surface_colors

Levels = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MeshRendering:
    """Mesh rendered from a camera.

    Attributes
    ----------
    levels : (h, w, 3) float32 colours, 0 to 255.
    hit_mask : (h, w) mask of the pixels that show the mesh.
    positions : (h, w, 3) surface points in world coordinates, metres; 0 outside `hit_mask`.
    """

    levels: Levels
    hit_mask: NDArray[np.bool_]
    positions: NDArray[np.float64]


def render_from_pose(surface: RaycastingSurface, camera: Camera, pose: Pose) -> MeshRendering:
    """Render a mesh as seen by an undistorted camera.

    Parameters
    ----------
    surface : mesh with colours, ready for ray casting.
    camera : intrinsics without lens distortion.
    pose : world_from_camera.
    """
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = unproject(columns, rows, 1, camera)
    directions = (rays.reshape(-1, 3) @ pose[:3, :3].T).astype(np.float32)
    hits = surface.cast_rays(pose[:3, 3], directions)
    levels = np.zeros((rows.size, 3), np.float32)
    places = np.zeros((rows.size, 3))
    hit = np.zeros(rows.size, np.bool_)
    levels[hits.rays] = compute_surface_colors(surface.mesh, hits.triangles, hits.weights)
    corners = surface.mesh.triangles.take(hits.triangles, axis=0)
    # One corner at a time: several times faster than all at once.
    places[hits.rays] = sum(
        surface.mesh.vertices.take(corners[:, k], axis=0) * hits.weights[:, k, None] for k in range(3)
    )
    hit[hits.rays] = True
    return MeshRendering(
        levels.reshape(*rows.shape, 3), hit.reshape(rows.shape), places.reshape(*rows.shape, 3)
    )


def fit_gain_and_bias(levels: Levels, photo: Levels, mask: NDArray[np.bool_]) -> Levels:
    """Fit the colours of a rendering to a photo by gain and bias.

    The fit is per channel, over the pixels `mask`. Returns the fitted levels (h, w, 3), 0 to 255.
    """
    fitted = np.empty_like(levels)
    for k in range(3):
        a, b = (image[..., k][mask].astype(np.float64) for image in (levels, photo))
        gain = float(np.mean((a - a.mean()) * (b - b.mean()))) / max(float(a.var()), 1e-9)
        fitted[..., k] = gain * (levels[..., k] - a.mean()) + b.mean()
    return fitted.clip(0, 255)
