"""Surfaces of revolution with the point counts of Chen and Qin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh


def revolve_profile(
    profile: NDArray[np.float64], steps: int, *, has_poles: tuple[bool, bool] = (True, True)
) -> Mesh:
    """Revolve a profile about the z axis.

    Parameters
    ----------
    profile : (k, 2) radius and height; the outside is on its right.
    steps : number of steps about the axis.
    has_poles : the first and the last point are on the axis and become one vertex each.
    """
    first, last = has_poles
    ring = profile[int(first) : len(profile) - int(last)]
    angle = np.arange(steps) / steps * 2 * np.pi
    turned = np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = np.concatenate(
        [ring[:, None, :1] * turned, np.broadcast_to(ring[:, None, 1:], (len(ring), steps, 1))], axis=2
    ).reshape(-1, 3)
    poles = [[0.0, 0.0, profile[i, 1]] for i, there in ((0, first), (-1, last)) if there]
    vertices = np.concatenate([rings, np.reshape(poles, (-1, 3))])
    index = np.arange(steps)
    next_index = (index + 1) % steps
    triangles = []
    for row in range(len(ring) - 1):
        a, b = row * steps + index, row * steps + next_index
        c, d = a + steps, b + steps
        triangles += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
    if first:
        triangles.append(np.stack([np.full(steps, len(rings)), next_index, index], 1))
    if last:
        pole, top = len(rings) + int(first), (len(ring) - 1) * steps
        triangles.append(np.stack([np.full(steps, pole), top + index, top + next_index], 1))
    return Mesh(vertices, np.concatenate(triangles).astype(np.int32))


def cone() -> Mesh:
    """Make an open cone of 1,441 points.

    It has an apex and 36 rings of 40 points.
    """
    along = np.linspace(0, 1, 37)
    return revolve_profile(np.stack([1 - along, 2 * along], 1), 40, has_poles=(False, True))


def cup() -> Mesh:
    """Make a cup of 1,800 points, open below.

    It has 45 rings of 40 points. The profile goes up the outside, over the rim, and down the inside.
    """
    outside = [(0.6 + 0.4 * np.sin(1.4 * h), 2 * h) for h in np.linspace(0, 1, 23)]
    inside = [(0.9 * (0.6 + 0.4 * np.sin(1.4 * h)), 2 * h) for h in np.linspace(1, 0.1, 22)]
    return revolve_profile(np.array(outside + inside), 40, has_poles=(False, False))


def bottle() -> Mesh:
    """Make a bottle of 2,772 points, open at both ends.

    It has 63 rings of 44 points.
    """
    height = np.linspace(0, 3, 63)
    radius = 0.25 + 0.55 / (1 + np.exp((height - 1.9) * 9)) - 0.1 * np.exp(-((height - 0.05) ** 2) / 0.01)
    return revolve_profile(np.stack([radius, height], 1), 44, has_poles=(False, False))


# Generator, point count, and the paper's two reductions in percent.
REDUCTIONS = {
    "cone": (cone, 1441, 91.0, 95.0),
    "cup": (cup, 1800, 62.5, 70.0),
    "bottle": (bottle, 2772, 55.0, 61.0),
}
