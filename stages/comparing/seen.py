"""Mesh rendering from a camera, and colour fit to a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.projection import unproject
from scanloom.stages.scans.model.scan import Camera, Pose
from scanloom.stages.surface.color import color_at
from scanloom.stages.surface.raycasting import Surface

Levels = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Seen:
    """Mesh rendered from a camera.

    Attributes
    ----------
    levels : (h, w, 3) float32 colours, 0 to 255.
    hit : (h, w) mask of the pixels that show the mesh.
    places : (h, w, 3) surface points in world coordinates, metres; 0 outside `hit`.
    """

    levels: Levels
    hit: NDArray[np.bool_]
    places: NDArray[np.float64]


def seen_from(surface: Surface, camera: Camera, pose: Pose) -> Seen:
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
    hits = surface.cast(pose[:3, 3], directions)
    levels = np.zeros((rows.size, 3), np.float32)
    places = np.zeros((rows.size, 3))
    hit = np.zeros(rows.size, np.bool_)
    levels[hits.rays] = color_at(surface.mesh, hits.triangles, hits.weights)
    corners = surface.mesh.triangles.take(hits.triangles, axis=0)
    # One corner at a time: several times faster than all at once.
    places[hits.rays] = sum(
        surface.mesh.vertices.take(corners[:, k], axis=0) * hits.weights[:, k, None] for k in range(3)
    )
    hit[hits.rays] = True
    return Seen(levels.reshape(*rows.shape, 3), hit.reshape(rows.shape), places.reshape(*rows.shape, 3))


def fitted(levels: Levels, photo: Levels, counted: NDArray[np.bool_]) -> Levels:
    """Fit the colours of a rendering to a photo by gain and bias.

    The fit is per channel, over the pixels `counted`. Returns the fitted levels (h, w, 3), 0 to 255.
    """
    fitted = np.empty_like(levels)
    for k in range(3):
        a, b = (image[..., k][counted].astype(np.float64) for image in (levels, photo))
        gain = float(np.mean((a - a.mean()) * (b - b.mean()))) / max(float(a.var()), 1e-9)
        fitted[..., k] = gain * (levels[..., k] - a.mean()) + b.mean()
    return fitted.clip(0, 255)
