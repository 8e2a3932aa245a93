"""Meshes for comparing simplifiers: real models and a textured globe.

Functions take DATA, the folder that holds `meshes/` and `images/`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.mesh import Colors, Mesh
from scanloom.stages.surface.mesh_files import read_mesh

Floats = np.ndarray
Sampler = Callable[[Colors, Floats, Floats], Colors]

# Gives 8 · 96² triangles, as the coloured globe in JIA01 has.
GLOBE_STEPS = 96


def read_horse(data: Path) -> Mesh:
    """Read a closed model without colours."""
    return clean(read_mesh(data / "meshes/horse.ply")).mesh.with_(normals=None)


def read_kitchen(data: Path) -> Mesh:
    """Read a room fused at 2 cm, cleaned to a manifold.

    Noise and holes are kept.
    """
    return read_colored_scan(data / "meshes/redkitchen_fused_vertexcolor.ply")


def read_colored_scan(path: Path) -> Mesh:
    """Read a coloured scan and clean it to a manifold."""
    return clean(read_mesh(path)).mesh.with_(normals=None)


def read_painted_model(data: Path) -> Mesh:
    """Read a photogrammetric model and project the earth's map onto it."""
    return read_projected(data / "meshes/sceaux_mvs_scene_mesh.ply", read_earth_map(data))


def read_projected(path: Path, image: Colors) -> Mesh:
    """Read a model, clean it, and project an image onto its vertices.

    The image is stretched over the bounding rectangle of the first two principal axes and projected along the
    third.
    """
    mesh = clean(read_mesh(path)).mesh
    centred = mesh.vertices - mesh.vertices.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2]
    # The sign of a singular vector is arbitrary: make its largest component positive.
    axes *= np.sign(np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1))
    at = centred @ axes.T
    low, high = at.min(axis=0), at.max(axis=0)
    x, y = ((at - low) / (high - low) * (image.shape[1] - 1, image.shape[0] - 1)).T
    return mesh.with_(colors=sample_bilinear(image, x, y), normals=None, texture=None)


def make_satellite_globe(data: Path) -> Mesh:
    """Make the unit sphere with the earth's map as vertex colours."""
    return make_globe(GLOBE_STEPS, read_earth_map(data))


MESHES: dict[str, Callable[[Path], Mesh]] = {
    "horse": read_horse,
    "globe": make_satellite_globe,
    "kitchen": read_kitchen,
    "painted": read_painted_model,
}


def read_earth_map(data: Path) -> Colors:
    """Read the earth's map.

    Rows run from latitude 90° to −90°, columns from longitude −180° to 180°.
    """
    path = data / "images/2k_earth_daymap.jpg"
    image = cv2.imread(str(path))
    if image is None:
        raise InputError(MACHINE_BUG, "the image is missing or cannot be decoded.", path)
    return np.ascontiguousarray(image[:, :, ::-1])


def make_globe(steps: int, image: Colors, sample: Sampler | None = None) -> Mesh:
    """Make a unit sphere coloured by a map.

    The sphere has 8 · steps² triangles. The vertices of the subdivided octahedron |x| + |y| + |z| = steps are
    integers; they are projected radially onto the sphere.

    Parameters
    ----------
    image : equirectangular map (h, w, 3).
    sample : samples the map at vertices; bilinear by default.
    """
    corners, turned = make_octant(steps)
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    # Mirroring an octant flips the orientation of its triangles.
    pieces = [(turned if s.prod() < 0 else corners) * s for s in signs]
    lattice, triangles = np.unique(np.concatenate(pieces).reshape(-1, 3), axis=0, return_inverse=True)
    vertices = lattice / np.linalg.norm(lattice, axis=1, keepdims=True)
    height, width = image.shape[:2]
    longitude, latitude = np.arctan2(vertices[:, 1], vertices[:, 0]), np.arcsin(vertices[:, 2])
    x = (longitude / (2 * np.pi) + 0.5) * width - 0.5
    y = (0.5 - latitude / np.pi) * height - 0.5
    around = np.concatenate((image[:, -1:], image, image[:, :1]), axis=1)
    colors = (sample or sample_bilinear)(around, x + 1, y)
    return Mesh(vertices, triangles.reshape(-1, 3).astype(np.int32), colors)


def make_octant(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Make the integer corners (steps², 3, 3) of one octant's triangles.

    Returns them in both orientations.
    """
    i, j = (a.ravel() for a in np.mgrid[0:steps, 0:steps])
    upward, downward = i + j < steps, i + j < steps - 1

    def make_triangles(rows: np.ndarray, shifts: tuple[tuple[int, int], ...]) -> np.ndarray:
        at = [(i[rows] + di, j[rows] + dj) for di, dj in shifts]
        return np.stack([np.stack((a, b, steps - a - b), axis=-1) for a, b in at], axis=1)

    corners = np.concatenate(
        (make_triangles(upward, ((0, 0), (1, 0), (0, 1))), make_triangles(downward, ((1, 0), (1, 1), (0, 1))))
    )
    return corners, corners[:, ::-1]


def sample_nearest(image: Colors, x: Floats, y: Floats) -> Colors:
    """Sample the nearest pixels; pixel centres have integer coordinates."""
    row, column = np.rint(y).clip(0, image.shape[0] - 1), np.rint(x).clip(0, image.shape[1] - 1)
    return image[row.astype(int), column.astype(int)]


def sample_bilinear(image: Colors, x: Floats, y: Floats) -> Colors:
    """Sample an image bilinearly; pixel centres have integer coordinates.

    Coordinates outside the image are clamped to its edge.
    """
    x, y = x.clip(0, image.shape[1] - 1), y.clip(0, image.shape[0] - 1)
    column, row = x.astype(int).clip(max=image.shape[1] - 2), y.astype(int).clip(max=image.shape[0] - 2)
    u, v = (x - column)[:, None], (y - row)[:, None]
    upper = (1 - u) * image[row, column] + u * image[row, column + 1]
    lower = (1 - u) * image[row + 1, column] + u * image[row + 1, column + 1]
    return np.rint((1 - v) * upper + v * lower).astype(np.uint8)
