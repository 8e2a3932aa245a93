"""Pictures of a mesh without a window, a GPU or OpenGL: rays cast by Open3D, shaded in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from stages.convert import MeshLike, as_mesh
from stages.errors import InputError
from stages.mesh import Mesh
from stages.raycasting import Floats, Located, Surface, chunks, interpolated
from stages.scan import Camera, ColorImage
from stages.viewpoints import View, viewpoints

__all__ = ["Shading", "View", "render", "render_all", "viewpoints", "write_png"]

Shading = Literal["color", "plain", "edges"]

# A pixel that differs from a neighbour by more than _CONTRAST levels becomes the mean of _FINER² rays.
_CONTRAST, _FINER = 20, 3
_CLAY = (214.0, 212.0, 207.0)
_CLAY_BEHIND = (150.0, 165.0, 190.0)
_EDGE = np.array((38.0, 52.0, 74.0))
# A cool grey: scans are full of white paper and walls, which must not melt into it.
_BACKGROUND_TOP, _BACKGROUND_BOTTOM = np.array((242.0, 244.0, 247.0)), np.array((212.0, 217.0, 224.0))
# Towards the light, in camera axes: from behind the viewer's left shoulder.
_LIGHT = np.array((-0.35, -0.55, -0.75)) / np.linalg.norm((-0.35, -0.55, -0.75))
# A ray that starts on a surface culled before begins this share of its length later.
_STEP = 1e-5
_MAX_CULLED = 16


def render(mesh: MeshLike, view: View, *, shading: Shading = "color") -> ColorImage:
    """Draw a mesh from one view.

    Parameters
    ----------
    mesh : in metres.
    view : see View and `viewpoints`.
    shading : "color" for the vertex colours under a soft light (clay where there are none), "plain" for
        clay alone, which shows the shape, "edges" for flat clay with the triangles' edges drawn. Triangles
        seen from behind are bluish in "plain" and "edges".

    Returns
    -------
    (h, w, 3) uint8 RGB, of the view's size, on a light background.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    """
    return render_all(mesh, [view], shading=shading)[0]


def render_all(mesh: MeshLike, views: Sequence[View], *, shading: Shading = "color") -> list[ColorImage]:
    """Draw a mesh from several views; see `render`."""
    mesh = as_mesh(mesh)
    if len(mesh.triangles) == 0:
        raise InputError("the mesh has no triangles; there is nothing to draw.")
    surface = Surface(mesh)
    frames = _TriangleFrames(mesh)
    return [_drawn(surface, frames, view, shading) for view in views]


def write_png(path: Path, image: ColorImage) -> None:
    """Write an RGB picture as PNG."""
    import cv2

    _, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    Path(path).write_bytes(data.tobytes())


class _TriangleFrames:
    """Normals and heights of a mesh's triangles, the same for all views."""

    def __init__(self, mesh: Mesh) -> None:
        a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
        cross = np.cross(b - a, c - a)
        doubled_area = np.linalg.norm(cross, axis=1)
        self.normals = cross / np.maximum(doubled_area, np.finfo(np.float64).tiny)[:, None]
        lengths = np.stack([np.linalg.norm(e, axis=1) for e in (c - b, a - c, b - a)], axis=1)
        # Height over the edge opposite each corner: a weight times it is the distance from that edge.
        self.heights = doubled_area[:, None] / np.maximum(lengths, np.finfo(np.float64).tiny)
        self.vertex_normals = np.zeros_like(mesh.vertices)
        for corner in range(3):
            for axis in range(3):  # bincount, not add.at: an order of magnitude faster
                self.vertex_normals[:, axis] += np.bincount(
                    mesh.triangles[:, corner], cross[:, axis], minlength=len(mesh.vertices)
                )


def _drawn(surface: Surface, frames: _TriangleFrames, view: View, shading: Shading) -> ColorImage:
    """Cast one ray a pixel, and more where the picture is not smooth: on outlines and in fine patterns."""
    import cv2

    def colors(u: Floats, v: Floats) -> Floats:
        parts = [_colors(surface, frames, view, shading, u[rows], v[rows]) for rows in chunks(len(u))]
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    height, width = view.camera.height, view.camera.width
    v, u = np.indices((height, width), np.float64).reshape(2, -1)
    image = colors(u, v)
    plain = image.astype(np.float32).reshape(height, width, 3)
    contrast = cv2.morphologyEx(plain, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).max(axis=2)
    rough = np.flatnonzero(contrast > _CONTRAST)
    steps = (np.arange(_FINER) + 0.5) / _FINER - 0.5
    finer = [colors(u[rough] + du, v[rough] + dv) for du in steps for dv in steps]
    image[rough] = np.mean(finer, axis=0)
    return np.asarray(np.rint(image).clip(0, 255), np.uint8).reshape(height, width, 3)


def _colors(
    surface: Surface, frames: _TriangleFrames, view: View, shading: Shading, u: Floats, v: Floats
) -> Floats:
    """Return what is seen at image positions, (k, 3) levels."""
    camera = view.camera
    in_camera = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=1)
    rotation, origin = view.world_from_camera[:3, :3], view.world_from_camera[:3, 3]
    directions = _unit(in_camera) @ rotation.T
    seen = _cast(surface, frames.normals, origin, directions, view.cull)
    down = ((v + 0.5) / camera.height)[:, None]
    colors = _BACKGROUND_TOP + (_BACKGROUND_BOTTOM - _BACKGROUND_TOP) * down
    hit = np.flatnonzero(seen.triangles >= 0)
    at = Located(seen.triangles[hit], seen.weights[hit], seen.distances[hit])
    colors[hit] = _shaded(surface.mesh, frames, at, directions[hit], rotation, camera, shading)
    return np.asarray(colors)


def _cast(surface: Surface, normals: Floats, origin: Floats, directions: Floats, cull: bool) -> Located:
    """Return first hits; with `cull` those on triangles that face the viewer, as into a doll's house."""
    seen = surface.cast(origin, directions)
    if not cull:
        return seen
    for _ in range(_MAX_CULLED):
        facing_away = np.einsum("kx,kx->k", normals[seen.triangles], directions) > 0
        behind = np.flatnonzero((seen.triangles >= 0) & facing_away)
        if len(behind) == 0:
            break
        again = surface.cast(origin, directions[behind], seen.distances[behind] * (1 + _STEP))
        seen.triangles[behind], seen.weights[behind] = again.triangles, again.weights
        seen.distances[behind] = again.distances
    return seen


def _shaded(
    mesh: Mesh,
    frames: _TriangleFrames,
    at: Located,
    directions: Floats,
    rotation: Floats,
    camera: Camera,
    shading: Shading,
) -> Floats:
    flat = frames.normals[at.triangles]
    behind = np.einsum("kx,kx->k", flat, directions) > 0
    normals = flat if shading == "edges" else _unit(interpolated(frames.vertex_normals, mesh, at))
    normals = np.where(behind[:, None], -normals, normals)
    light = (normals @ (rotation @ _LIGHT)).clip(0, 1)
    head = np.abs(np.einsum("kx,kx->k", normals, directions))
    if shading == "color" and mesh.colors is not None:
        # Scanned colours hold the room's light already; more than a hint of our own would count it twice.
        lit: Floats = interpolated(mesh.colors, mesh, at) * (0.84 + 0.12 * light + 0.12 * head)[:, None]
        return lit
    clay: Floats = (
        np.where(behind[:, None], _CLAY_BEHIND, _CLAY) * (0.44 + 0.48 * light + 0.26 * head)[:, None]
    )
    if shading != "edges":
        return clay
    pixel = (at.distances / camera.fx)[:, None]
    heights = frames.heights[at.triangles]
    line = (1.2 - at.weights * heights / pixel).max(axis=1).clip(0, 1)
    # Triangles of few pixels would drown in their own edges.
    line *= 0.75 * ((heights.min(axis=1) / pixel[:, 0] - 1) / 6).clip(0.08, 1)
    return np.asarray(clay + line[:, None] * (_EDGE - clay))


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(np.float64).tiny))
