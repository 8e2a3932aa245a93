"""Small preview image of a mesh for notebooks.

It uses no ray caster, whose import alone takes seconds. The view is orthographic, from 30° above, with y up.
The nearest triangle at each pixel centre is drawn. `scanloom.stages.rendering` renders full pictures.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.rasterization import CoveredPixels, rasterize_triangles
from scanloom.stages.surface.texture import Texture

WIDTH, HEIGHT = 240, 180
# Samples per pixel along each axis, averaged for antialiasing.
_SAMPLES_PER_PIXEL_SIDE = 2
_MARGIN = 0.94
# Larger meshes take too long to draw for an interactive notebook.
_MAX_TRIANGLES = 1_000_000
_VIEW_DIRECTION = np.array((-0.5, 0.5, 0.7071))
_BACKGROUND, _CLAY_COLOR = 244.0, (214.0, 212.0, 207.0)
_AMBIENT = 0.35


def render_thumbnail(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    colors: NDArray[np.uint8] | None,
    texture: Texture | None,
) -> NDArray[np.uint8] | None:
    """Render a preview (HEIGHT, WIDTH, 3) RGB; None without triangles or above a million."""
    if not 0 < len(triangles) <= _MAX_TRIANGLES:
        return None
    right = np.array((_VIEW_DIRECTION[2], 0, -_VIEW_DIRECTION[0]))
    axes = np.stack([right, np.cross(_VIEW_DIRECTION, right), _VIEW_DIRECTION])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    seen = vertices @ axes.T
    corners = seen[triangles]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    height, width = HEIGHT * _SAMPLES_PER_PIXEL_SIDE, WIDTH * _SAMPLES_PER_PIXEL_SIDE
    extent = high - low
    if not np.isfinite(extent).all() or extent.max() == 0:
        return None
    scale = _MARGIN * min(width / max(extent[0], 1e-300), height / max(extent[1], 1e-300))
    flat = (corners[:, :, :2] - (low + high)[:2] / 2) * (scale, -scale) + (width / 2, height / 2)
    nearest = _keep_nearest(rasterize_triangles(flat, (0, height), width), corners[:, :, 2], width)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[nearest.triangles]
    # Headlight, two-sided: many meshes are seen from behind.
    facing = np.abs(normals[:, 2]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    image = np.full((height, width, 3), _BACKGROUND)
    lit = _AMBIENT + (1 - _AMBIENT) * facing
    image[nearest.rows, nearest.columns] = _shade_pixels(nearest, triangles, colors, texture) * lit[:, None]
    smaller = image.reshape(HEIGHT, _SAMPLES_PER_PIXEL_SIDE, WIDTH, _SAMPLES_PER_PIXEL_SIDE, 3).mean(
        axis=(1, 3)
    )
    return np.asarray(np.rint(smaller), np.uint8)


def _keep_nearest(found: CoveredPixels, heights: NDArray[np.float64], width: int) -> CoveredPixels:
    """Keep the triangle nearest to the viewer at each pixel."""
    height = (found.weights * heights[found.triangles]).sum(axis=1)
    place = found.rows * width + found.columns
    order = np.lexsort((-height, place))
    first = order[np.diff(place[order], prepend=-1) > 0]
    return CoveredPixels(
        found.rows[first], found.columns[first], found.triangles[first], found.weights[first]
    )


def _shade_pixels(
    at: CoveredPixels, triangles: NDArray[np.int32], colors: NDArray[np.uint8] | None, texture: Texture | None
) -> NDArray[np.float64]:
    """Return colours (k, 3): from the texture, else vertex colours, else clay."""
    if colors is None:
        found = np.tile(np.array(_CLAY_COLOR), (len(at.triangles), 1))
    else:
        found = np.einsum("kc,kcx->kx", at.weights, colors[triangles[at.triangles]].astype(np.float64))
    for number, material in enumerate(() if texture is None else texture.materials):
        assert texture is not None
        (rows,) = np.nonzero(texture.material_ids[at.triangles] == number)
        if material.image is not None and len(rows):
            pixels = material.image.pixels
            uvs = np.einsum("kc,kcx->kx", at.weights[rows], texture.uvs[at.triangles[rows]])
            size = np.array(pixels.shape[1::-1])
            x, y = ((uvs * (1, -1) % 1) * size).astype(np.int64).clip(0, size - 1).T
            found[rows] = pixels[y, x, :3]
        elif material.base_color is not None and colors is None:
            found[rows] = 255 * np.array(material.base_color[:3])
    return found
