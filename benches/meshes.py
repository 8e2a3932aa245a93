"""The meshes that simplifiers are compared on: real ones, and a globe with a satellite map.

Builders take DATA, the folder that holds `meshes/` and `images/`.
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

# 8 · 96² triangles: the count of the coloured globe in JIA01.
GLOBE_STEPS = 96


def horse(data: Path) -> Mesh:
    """Read a closed model without colours."""
    return clean(read_mesh(data / "meshes/horse.ply")).mesh.with_(normals=None)


def kitchen(data: Path) -> Mesh:
    """Read a room fused at 2 cm, noise, holes and all, made manifold."""
    return scan(data / "meshes/redkitchen_fused_vertexcolor.ply")


def scan(path: Path) -> Mesh:
    """Read any scan with colours, made manifold."""
    return clean(read_mesh(path)).mesh.with_(normals=None)


def painted(data: Path) -> Mesh:
    """Read a photogrammetric model, and paint it with the earth's map."""
    return projected(data / "meshes/sceaux_mvs_scene_mesh.ply", earth(data))


def projected(path: Path, image: Colors) -> Mesh:
    """Read any model, make it manifold, and paint it as if by a slide projector.

    The image is stretched over the box of the first two principal axes; the third is the projector's
    direction.
    """
    mesh = clean(read_mesh(path)).mesh
    centred = mesh.vertices - mesh.vertices.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2][:2]
    # An axis may come out either way round; its largest component decides.
    axes *= np.sign(np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1))
    at = centred @ axes.T
    low, high = at.min(axis=0), at.max(axis=0)
    x, y = ((at - low) / (high - low) * (image.shape[1] - 1, image.shape[0] - 1)).T
    return mesh.with_(colors=bilinear(image, x, y), normals=None, texture=None)


def satellite(data: Path) -> Mesh:
    """Make the unit sphere with the earth's map on it, a colour a vertex."""
    return globe(GLOBE_STEPS, earth(data))


MESHES: dict[str, Callable[[Path], Mesh]] = {
    "horse": horse,
    "globe": satellite,
    "kitchen": kitchen,
    "painted": painted,
}


def earth(data: Path) -> Colors:
    """Read the map: longitude −180° to 180° along the rows, latitude 90° to −90° down."""
    path = data / "images/2k_earth_daymap.jpg"
    image = cv2.imread(str(path))
    if image is None:
        raise InputError(MACHINE_BUG, "it is missing or no image.", path)
    return np.ascontiguousarray(image[:, :, ::-1])


def globe(steps: int, image: Colors, sample: Sampler | None = None) -> Mesh:
    """Make a unit sphere of 8 · steps² triangles, coloured by a map in equal degrees, bilinearly by default.

    The octahedron |x| + |y| + |z| = steps has its subdivision's vertices at whole numbers; each is moved
    along its ray onto the sphere.
    """
    corners, turned = octant(steps)
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    # A mirrored octant is inside out.
    pieces = [(turned if s.prod() < 0 else corners) * s for s in signs]
    lattice, triangles = np.unique(np.concatenate(pieces).reshape(-1, 3), axis=0, return_inverse=True)
    vertices = lattice / np.linalg.norm(lattice, axis=1, keepdims=True)
    height, width = image.shape[:2]
    longitude, latitude = np.arctan2(vertices[:, 1], vertices[:, 0]), np.arcsin(vertices[:, 2])
    x = (longitude / (2 * np.pi) + 0.5) * width - 0.5
    y = (0.5 - latitude / np.pi) * height - 0.5
    around = np.concatenate((image[:, -1:], image, image[:, :1]), axis=1)
    colors = (sample or bilinear)(around, x + 1, y)
    return Mesh(vertices, triangles.reshape(-1, 3).astype(np.int32), colors)


def octant(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the octant's triangles, (steps², 3, 3) whole numbers, and the same inside out."""
    i, j = (a.ravel() for a in np.mgrid[0:steps, 0:steps])
    upward, downward = i + j < steps, i + j < steps - 1

    def triangles(rows: np.ndarray, shifts: tuple[tuple[int, int], ...]) -> np.ndarray:
        at = [(i[rows] + di, j[rows] + dj) for di, dj in shifts]
        return np.stack([np.stack((a, b, steps - a - b), axis=-1) for a, b in at], axis=1)

    corners = np.concatenate(
        (triangles(upward, ((0, 0), (1, 0), (0, 1))), triangles(downward, ((1, 0), (1, 1), (0, 1))))
    )
    return corners, corners[:, ::-1]


def nearest(image: Colors, x: Floats, y: Floats) -> Colors:
    """Return the colours of the pixels nearest to pixel coordinates, centres at whole numbers."""
    row, column = np.rint(y).clip(0, image.shape[0] - 1), np.rint(x).clip(0, image.shape[1] - 1)
    return image[row.astype(int), column.astype(int)]


def bilinear(image: Colors, x: Floats, y: Floats) -> Colors:
    """Return the image's colours at pixel coordinates, centres at whole numbers, its edge beyond it."""
    x, y = x.clip(0, image.shape[1] - 1), y.clip(0, image.shape[0] - 1)
    column, row = x.astype(int).clip(max=image.shape[1] - 2), y.astype(int).clip(max=image.shape[0] - 2)
    u, v = (x - column)[:, None], (y - row)[:, None]
    upper = (1 - u) * image[row, column] + u * image[row, column + 1]
    lower = (1 - u) * image[row + 1, column] + u * image[row + 1, column + 1]
    return np.rint((1 - v) * upper + v * lower).astype(np.uint8)
