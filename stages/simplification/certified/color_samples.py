"""Colour difference between two textured surfaces, sampled per texel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    RaycastingSurface,
    compute_bounding_box,
    interpolate_values,
    iterate_chunks,
)
from scanloom.stages.surface.surface_color import compute_surface_colors, decode_material_image, has_color
from scanloom.stages.surface.texture import compute_signed_areas

# Approximate maximum of samples per surface. With more texels, each sample represents several.
MAX_SAMPLES = 1 << 20
# Limits on the rows of samples in a triangle.
_MIN_ROWS, _MAX_ROWS = 2, 256


@dataclass(frozen=True, eq=False)
class ColorSamples:
    """Colour differences at samples of both surfaces.

    Attributes
    ----------
    difference : (k,) float64, levels, Euclidean over the channels, between a sample and the nearest point of
        the other surface.
    original_triangle : (k,) int64, triangle of the original that contains the sample or its nearest point.
    own_triangle : (k,) int64, triangle that contains the sample, on either surface.
    simplified_count : number of samples on the simplified mesh, which come first.
    """

    difference: NDArray[np.float64]
    original_triangle: NDArray[np.int64]
    own_triangle: NDArray[np.int64]
    simplified_count: int

    @property
    def max_difference(self) -> float:
        """Largest difference in levels; 0 without samples."""
        return float(self.difference.max(initial=0.0))


def sample_color_differences(
    simplified: Mesh, original: Mesh, *, max_samples: int = MAX_SAMPLES
) -> ColorSamples | None:
    """Measure colour differences between two surfaces in both directions.

    Parameters
    ----------
    simplified, original : simplified and original mesh.
    max_samples : approximate maximum of samples per surface.

    Returns
    -------
    ColorSamples, or None if one of the meshes has no colour or no triangle.
    """
    if not (
        len(simplified.triangles)
        and len(original.triangles)
        and has_color(simplified)
        and has_color(original)
    ):
        return None
    box = compute_bounding_box(simplified, original)
    surfaces = RaycastingSurface(simplified, box), RaycastingSurface(original, box)
    simplified_samples, original_samples = (
        _sample_triangles(simplified, max_samples),
        _sample_triangles(original, max_samples),
    )
    forward, nearest = _measure_one_way(simplified, simplified_samples, surfaces[1])
    backward, _ = _measure_one_way(original, original_samples, surfaces[0])
    return ColorSamples(
        np.concatenate([forward, backward]),
        np.concatenate([nearest, original_samples.triangles]),
        np.concatenate([simplified_samples.triangles, original_samples.triangles]),
        len(simplified_samples.triangles),
    )


def _measure_one_way(
    mesh: Mesh, at: ClosestPoints, other: RaycastingSurface
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Measure differences at samples of a mesh to another mesh.

    Returns the differences in levels, and the nearest triangles of the other mesh.
    """
    difference, nearest = np.empty(len(at.triangles)), np.empty(len(at.triangles), np.int64)
    for rows in iterate_chunks(len(at.triangles)):
        some = ClosestPoints(at.triangles[rows], at.weights[rows], at.distances[rows])
        found = other.find_closest_points(interpolate_values(mesh.vertices, mesh, some))
        own_color = compute_surface_colors(mesh, some.triangles, some.weights)
        other_color = compute_surface_colors(other.mesh, found.triangles, found.weights)
        difference[rows] = np.linalg.norm(np.asarray(own_color, np.float64) - other_color, axis=1)
        nearest[rows] = found.triangles
    return difference, nearest


def _sample_triangles(mesh: Mesh, max_samples: int) -> ClosestPoints:
    """Sample all triangles as densely as their texels."""
    texels = _count_texels(mesh)
    # A triangle with n rows has n² samples, at the centres of its n² congruent subtriangles.
    share = min(1.0, max_samples / max(float(texels.sum()), 1.0))
    rows = np.ceil(np.sqrt(texels * share)).clip(_MIN_ROWS, _MAX_ROWS).astype(np.int64)
    triangles, weights = [], []
    for count in np.unique(rows):
        (chosen,) = np.nonzero(rows == count)
        grid = _compute_subtriangle_centres(int(count))
        triangles.append(np.repeat(chosen, len(grid)))
        weights.append(np.tile(grid, (len(chosen), 1)))
    at = np.concatenate(triangles)
    return ClosestPoints(at, np.concatenate(weights), np.zeros(len(at)))


def _compute_subtriangle_centres(rows: int) -> NDArray[np.float64]:
    """Compute the barycentric centres (rows², 3) of the subtriangles of a triangle."""
    i, j = np.divmod(np.arange(rows * rows), rows)
    upright = i + j < rows
    # Cells beyond the diagonal are mirrored to give the upside-down subtriangles.
    u = np.where(upright, i + 1 / 3, rows - i - 1 / 3) / rows
    v = np.where(upright, j + 1 / 3, rows - j - 1 / 3) / rows
    return np.stack([u, v, 1 - u - v], axis=1)


def _count_texels(mesh: Mesh) -> NDArray[np.float64]:
    """Count the texels that each triangle covers (m,); 0 without an image."""
    texture = mesh.texture
    count = np.zeros(len(mesh.triangles))
    if texture is None:
        return count
    area = np.abs(compute_signed_areas(texture.uvs))
    area[~np.isfinite(area)] = 0.0
    for number, material in enumerate(texture.materials):
        pixels = decode_material_image(material)
        if pixels is not None:
            count += np.where(texture.material_ids == number, area, 0.0) * pixels.shape[0] * pixels.shape[1]
    return count
