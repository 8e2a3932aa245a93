"""The difference of colour between two textured surfaces, at samples as dense as the images' texels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import color_at, has_color, pixels_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Located, Surface, bounding_box, chunks, interpolated
from scanloom.stages.surface.texture import signed_areas

# Samples of each of the two surfaces, about; with more texels than that, each sample stands for several.
MOST_SAMPLES = 1 << 20
# Rows of samples in a triangle, at least and at most.
_LEAST_ROWS, _MOST_ROWS = 2, 256


@dataclass(frozen=True, eq=False)
class ColorSamples:
    """What was found at the samples of both surfaces.

    Attributes
    ----------
    difference : (k,) float64, levels, Euclidean over the channels, between the colour at a sample and that at
        the nearest point of the other surface.
    original_triangle : (k,) int64, the triangle of the original that the sample is on, or nearest to.
    own_triangle : (k,) int64, the triangle that the sample is on, of whichever surface.
    of_light : samples of the light mesh, which come first.
    """

    difference: NDArray[np.float64]
    original_triangle: NDArray[np.int64]
    own_triangle: NDArray[np.int64]
    of_light: int

    @property
    def largest(self) -> float:
        """The greatest difference in levels; 0 without samples."""
        return float(self.difference.max(initial=0.0))


def color_samples(light: Mesh, original: Mesh, *, most: int = MOST_SAMPLES) -> ColorSamples | None:
    """Compare the colours of two surfaces texel by texel, both ways; None where one has no colour.

    `most` samples of each are looked at, about.
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
    """Return the differences at samples of a mesh, and the nearest triangle of the other one."""
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
    """Return samples inside all triangles, in rows as far apart as the texels there."""
    texels = _texels(mesh)
    # A triangle with n rows has n² samples, at the centres of the small triangles it can be cut into.
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
    """Return the barycentric weights (rows², 3) of the centres of the parts of a triangle cut into rows."""
    i, j = np.divmod(np.arange(rows * rows), rows)
    upright = i + j < rows
    # Those beyond the long side, mirrored, are the parts that stand on their heads.
    u = np.where(upright, i + 1 / 3, rows - i - 1 / 3) / rows
    v = np.where(upright, j + 1 / 3, rows - j - 1 / 3) / rows
    return np.stack([u, v, 1 - u - v], axis=1)


def _texels(mesh: Mesh) -> NDArray[np.float64]:
    """Return how many texels each triangle shows (m,); none where it has no image."""
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
