"""Texel budgets and densities of an atlas, derived from the images it replaces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.detail_size import estimate_triangle_details
from scanloom.stages.texturing.material_classes import BASE_COLOR, MaterialClass, get_image, list_images

# Ratio of the 90th to the 10th percentile of the source texel density. Above, the atlas follows the source
# density; below, it is uniform.
_UNEVEN = 4.0
# Range of a triangle's density relative to the mean.
_MIN_DENSITY, _MAX_DENSITY = 1 / 16, 4.0


@dataclass(frozen=True, eq=False)
class TexelBudget:
    """Maximum number of texels of the new images of one class.

    Attributes
    ----------
    covered : (k,) texels of the finest images of the class under each triangle of the original.
    texels : total texels of these images; None without images.
    max_side : longest side of an image, pixels.
    """

    covered: NDArray[np.float64]
    texels: float | None
    max_side: int


def compute_budgets(
    mesh: Mesh, class_ids: NDArray[np.int32], classes: Sequence[MaterialClass]
) -> list[TexelBudget]:
    """Compute the texel budget of each class.

    Images shared by several classes are divided in proportion to the covered area.
    """
    texture = mesh.texture
    assert texture is not None
    spread = np.abs(compute_signed_areas(texture.uvs))
    shares: dict[int, dict[int, float]] = {}
    images: dict[int, Image] = {}
    for index, one in enumerate(classes):
        for path in (BASE_COLOR, *one.maps):
            for number in one.material_indices:
                image = get_image(texture.materials[number], path) if number >= 0 else None
                if image is not None:
                    images[id(image)] = image
                    shown = float(spread[(class_ids == index) & (texture.material_ids == number)].sum())
                    of_image = shares.setdefault(id(image), {})
                    of_image[index] = of_image.get(index, 0.0) + shown
    vertex_details = estimate_triangle_details(mesh) if mesh.colors is not None else None
    area = compute_areas(mesh.vertices, mesh.triangles)
    budgets = []
    for index, one in enumerate(classes):
        rows = np.flatnonzero(class_ids == index)
        covered, texels, max_side = np.zeros(len(rows)), 0.0, 64
        for path in (BASE_COLOR, *one.maps):
            total, under = 0.0, np.zeros(len(rows))
            for number in one.material_indices:
                image = get_image(texture.materials[number], path) if number >= 0 else None
                if image is not None:
                    height, width = image.pixels.shape[:2]
                    its = texture.material_ids[rows] == number
                    under[its] = spread[rows[its]] * width * height
                    max_side = max(max_side, width, height)
            for image in list_images(texture, one, path):
                of_image = shares[id(image)]
                share = of_image.get(index, 0.0) / max(sum(of_image.values()), 1e-300)
                total += share * image.pixels.shape[0] * image.pixels.shape[1]
            if under.sum() > covered.sum():
                covered, texels = under, total
        if not covered.any() and vertex_details is not None:
            with np.errstate(divide="ignore"):
                covered = np.where(
                    np.isfinite(vertex_details[rows]), area[rows] / vertex_details[rows] ** 2, 0.0
                )
            budgets.append(TexelBudget(covered, None, 4096))
            continue
        budgets.append(TexelBudget(covered, texels, max_side))
    return budgets


def compute_densities(
    mesh: Mesh, original: Mesh, nearest: NDArray[np.int64], covered: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the relative texel density of each triangle of the simplified mesh.

    The density is uniform unless the original's density varies strongly over its surface.

    Parameters
    ----------
    mesh : the simplified mesh.
    original : the original mesh.
    nearest : (m, 3) nearest triangle of the simplified mesh for each corner of the original.
    covered : (m,) texels of each triangle of the original.
    """
    even = np.ones(len(mesh.triangles))
    area = compute_areas(original.vertices, original.triangles)
    density = np.sqrt(np.divide(covered, area, out=np.zeros_like(area), where=area > 0))
    order = np.argsort(density, kind="stable")
    before = np.cumsum(area[order])
    low, high = (density[order][np.searchsorted(before, share * before[-1])] for share in (0.1, 0.9))
    if high <= _UNEVEN * low:
        return even
    count = len(mesh.triangles)
    texels, beneath = (
        np.bincount(nearest.reshape(-1), np.repeat(values, 3), minlength=count) for values in (covered, area)
    )
    corners = mesh.triangles.reshape(-1)
    for _ in range(2):
        # Smooth over neighbours: small triangles of the simplified mesh have hardly any source triangles.
        texels, beneath = (
            np.bincount(corners, np.repeat(values, 3), minlength=len(mesh.vertices))[mesh.triangles].mean(
                axis=1
            )
            for values in (texels, beneath)
        )
    wanted = np.sqrt(texels / np.maximum(beneath, 1e-300))
    own = compute_areas(mesh.vertices, mesh.triangles)
    mean = math.sqrt(float((wanted**2 * own).sum() / own.sum()))
    if mean == 0:
        return even
    # Round to powers of two, because a chart ends where the density changes.
    return np.asarray(2.0 ** np.round(np.log2((wanted / mean).clip(_MIN_DENSITY, _MAX_DENSITY))))
