"""Downscaling of source images that are finer than the baked image can show.

A texture that repeats thousands of times would otherwise require the largest image and many samples. Each
texel would still get the colour of a few random points.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import decode_material_image
from scanloom.stages.surface.texture import Image, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas


def downscale_images(mesh: Mesh, texel_size: float, max_ratio: float) -> Mesh:
    """Downscale images more than `max_ratio` times as fine as the texel size.

    Such an image is averaged down to the texel size. An image that repeats within a texel becomes its mean.

    Parameters
    ----------
    texel_size : metres on the mesh.
    max_ratio : maximum linear ratio of the texel size to the size of the image's texels.
    """
    texture = mesh.texture
    if texture is None:
        return mesh
    uv_areas = np.abs(compute_signed_areas(texture.uvs))
    area = np.where(uv_areas > 0, compute_areas(mesh.vertices, mesh.triangles), 0.0)
    materials = list(texture.materials)
    # Sums per material; the first entry is for triangles without a material (index −1).
    sum_by_material = partial(np.bincount, texture.material_ids + 1, minlength=len(materials) + 1)
    sums = zip(sum_by_material(weights=area)[1:], sum_by_material(weights=uv_areas)[1:], strict=True)
    for number, (its_area, its_spread) in enumerate(sums):
        pixels = decode_material_image(materials[number])
        if pixels is None or not (its_area > 0 and its_spread > 0):
            continue
        # Number of target texels along one side of the image as mapped on the mesh.
        texels = math.sqrt(its_area / its_spread) / texel_size
        if math.sqrt(pixels.shape[0] * pixels.shape[1]) > max_ratio * texels:
            materials[number] = replace(materials[number], image=Image(given=_average_image(pixels, texels)))
    if all(new is old for new, old in zip(materials, texture.materials, strict=True)):
        return mesh
    return mesh.with_(texture=replace(texture, materials=tuple(materials)))


def _average_image(pixels: NDArray[np.uint8], texels: float) -> NDArray[np.uint8]:
    """Average an image down to about `texels`² pixels, at least one."""
    require_opencv()
    import cv2

    scale = texels / math.sqrt(pixels.shape[0] * pixels.shape[1])
    height, width = (max(int(scale * size), 1) for size in pixels.shape[:2])
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
