"""Colour difference between two textured surfaces, sampled per texel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import color_at, has_color, pixels_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Located, Surface, bounding_box, chunks, interpolated
from scanloom.stages.surface.texture import signed_areas

# Approximate maximum of samples per surface. With more texels, each sample represents several.
MOST_SAMPLES = 1 << 20
# Limits on the rows of samples in a triangle.
_LEAST_ROWS, _MOST_ROWS = 2, 256


@dataclass(frozen=True, eq=False)
class ColorSamples:
    """Colour differences at samples of both surfaces.

    Attributes
    ----------
    difference : (k,) float64, levels, Euclidean over the channels, between a sample and the nearest point of
        the other surface.
    original_triangle : (k,) int64, triangle of the original that contains the sample or its nearest point.
    own_triangle : (k,) int64, triangle that contains the sample, on either surface.
    of_light : number of samples on the simplified mesh, which come first.
    """

    difference: NDArray[np.float64]
    original_triangle: NDArray[np.int64]
    own_triangle: NDArray[np.int64]
    of_light: int

    @property
    def largest(self) -> float:
        """Largest difference in levels; 0 without samples."""
        return float(self.difference.max(initial=0.0))


def color_samples(light: Mesh, original: Mesh, *, most: int = MOST_SAMPLES) -> ColorSamples | None:
    """Measure colour differences between two surfaces in both directions.

    Parameters
    ----------
    light, original : simplified and original mesh.
    most : approximate maximum of samples per surface.

    Returns
    -------
    ColorSamples, or None if one of the meshes has no colour or no triangle.
    """
    if not (len(light.triangles) and len(original.triangles) and has_color(light) and has_color(original)):
        return None
    box = bounding_box(light, original)
    surfaces = Surface(light, box), Surface(original, box)
    of_light, of_original = _samples(light, most), _samples(original, most)
    there, nearest = _one_way(light, of_light, surfaces[1])
    back, _ = _one_way(original, of_original, surfaces[0])
    return ColorSamples(
        np.concatenate([there, back]),
        np.concatenate([nearest, of_original.triangles]),
        np.concatenate([of_light.triangles, of_original.triangles]),
        len(of_light.triangles),
    )


def _one_way(mesh: Mesh, at: Located, other: Surface) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Measure differences at samples of a mesh to another mesh.

    Returns the differences in levels, and the nearest triangles of the other mesh.
    """
    difference, nearest = np.empty(len(at.triangles)), np.empty(len(at.triangles), np.int64)
    for rows in chunks(len(at.triangles)):
        some = Located(at.triangles[rows], at.weights[rows], at.distances[rows])
        found = other.closest(interpolated(mesh.vertices, mesh, some))
        own = color_at(mesh, some.triangles, some.weights)
        seen = color_at(other.mesh, found.triangles, found.weights)
        difference[rows] = np.linalg.norm(np.asarray(own, np.float64) - seen, axis=1)
        nearest[rows] = found.triangles
    return difference, nearest


def _samples(mesh: Mesh, most: int) -> Located:
    """Sample all triangles as densely as their texels."""
    texels = _texels(mesh)
    # A triangle with n rows has n² samples, at the centres of its n² congruent subtriangles.
    share = min(1.0, most / max(float(texels.sum()), 1.0))
    rows = np.ceil(np.sqrt(texels * share)).clip(_LEAST_ROWS, _MOST_ROWS).astype(np.int64)
    triangles, weights = [], []
    for count in np.unique(rows):
        (chosen,) = np.nonzero(rows == count)
        grid = _centres(int(count))
        triangles.append(np.repeat(chosen, len(grid)))
        weights.append(np.tile(grid, (len(chosen), 1)))
    at = np.concatenate(triangles)
    return Located(at, np.concatenate(weights), np.zeros(len(at)))


def _centres(rows: int) -> NDArray[np.float64]:
    """Compute the barycentric centres (rows², 3) of the subtriangles of a triangle."""
    i, j = np.divmod(np.arange(rows * rows), rows)
    upright = i + j < rows
    # Cells beyond the diagonal are mirrored to give the upside-down subtriangles.
    u = np.where(upright, i + 1 / 3, rows - i - 1 / 3) / rows
    v = np.where(upright, j + 1 / 3, rows - j - 1 / 3) / rows
    return np.stack([u, v, 1 - u - v], axis=1)


def _texels(mesh: Mesh) -> NDArray[np.float64]:
    """Count the texels that each triangle covers (m,); 0 without an image."""
    texture = mesh.texture
    count = np.zeros(len(mesh.triangles))
    if texture is None:
        return count
    area = np.abs(signed_areas(texture.uvs))
    area[~np.isfinite(area)] = 0.0
    for number, material in enumerate(texture.materials):
        pixels = pixels_of(material)
        if pixels is not None:
            count += np.where(texture.material_ids == number, area, 0.0) * pixels.shape[0] * pixels.shape[1]
    return count
