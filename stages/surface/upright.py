"""What is up in a mesh of a place, found from where most of its surface looks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Directions that are tried, about 3° apart.
_TRIED = 4000
# Normals as near as this to a direction count for it, degrees: a scanned floor is not flat.
_NEAR = 8.0
# A guess is off by no more than this, degrees.
_WITHIN = 60.0
# Less surface than this share does not tell.
_LEAST_SHARE = 0.03
# As many triangles tell it.
_ENOUGH = 40_000


def up_of_surface(mesh: Mesh, guess: Floats) -> Floats | None:
    """Return the direction (3,) of length 1 that floors and tops of tables look to; None if there is none.

    Of the directions within 60° of the guess it is the one that most of the surface looks to, the more so the
    nearer it is to the guess.

    Parameters
    ----------
    guess : (3,) of length 1, what is roughly up.
    """
    chosen = mesh.triangles[:: 1 + len(mesh.triangles) // _ENOUGH]
    corners = mesh.vertices[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    normals = normals[area > 0] / area[area > 0, None]
    area = area[area > 0] / max(float(area.sum()), np.finfo(np.float64).tiny)
    tried = _all_around(_TRIED)
    tried = tried[tried @ guess >= math.cos(math.radians(_WITHIN))]
    share = np.array([_near(normals, direction) @ area for direction in tried])
    best = int(np.argmax(share * (tried @ guess)))
    if share[best] < _LEAST_SHARE:
        return None
    mean = (_near(normals, tried[best]) * area) @ normals
    return np.asarray(mean / np.linalg.norm(mean))


def _near(normals: Floats, direction: Floats) -> NDArray[np.bool_]:
    return np.asarray(normals @ direction >= math.cos(math.radians(_NEAR)))


def _all_around(count: int) -> Floats:
    """Return directions (n, 3) spread evenly: a spiral of golden angles."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * math.pi * (3 - math.sqrt(5))
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
