"""How many pairs of neighbouring triangles are flat, from some of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Edges that are looked at, or fewer.
_SAMPLE = 20_000

# Spreads numbers of edges, so that those taken follow no pattern of the mesh (Knuth: multiplicative hashing).
_SPREAD = np.uint64(0x9E3779B97F4A7C15)


def fewest_patches(vertices: NDArray[np.float64], triangles: NDArray[np.int32], bound: float) -> float:
    """Estimate how many patches a mesh has at least whose triangles lie in their neighbours' planes.

    A patch in one piece has an edge within it for each triangle but the first. So there are at least as many
    as triangles less such edges, which are counted among a sample: always the same one.

    Parameters
    ----------
    vertices : (n, 3) float64, metres.
    triangles : (m, 3) int32.
    bound : metres that a vertex may be off its neighbour's plane.

    Returns
    -------
    float
        0 where the edges would do for a single patch.
    """
    opposite = triangles[:, [2, 0, 1]].reshape(-1)
    a, b = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    key = a.astype(np.uint64) * np.uint64(len(vertices)) + b.astype(np.uint64)
    every = max(1, len(key) // 2 // _SAMPLE)
    picked = np.flatnonzero((key * _SPREAD >> np.uint64(32)) % np.uint64(every) == 0)
    picked = picked[np.argsort(key[picked], kind="stable")]
    one = np.flatnonzero(key[picked][1:] == key[picked][:-1])
    sides, others = picked[one], opposite[picked[one + 1]]
    start, along, across, beyond = (
        vertices[a[sides]],
        vertices[b[sides]],
        vertices[opposite[sides]],
        vertices[others],
    )
    normals = np.cross(along - start, across - start)
    lengths = np.linalg.norm(normals, axis=1)
    heights = np.abs(np.einsum("ij,ij->i", normals, beyond - start))
    within = every * int((heights <= bound * lengths).sum())
    return max(0.0, float(len(triangles) - within))
