"""Smooth surfaces over holes: solutions of the Laplace and the bi-Laplace equation with a fixed rim.

Source: Botsch and Kobbelt, "An intuitive framework for real-time freeform modeling", 2004. Cotangent weights
reproduce planes exactly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.cap_remeshing import Floats, compute_cotangents, compute_normals
from scanloom.stages.surface.edges import Ids, step_to_next_corner

# Limit of a cotangent, for needles: an angle of 1°.
_MAX_COTANGENT = 57.0


def interpolate_values(points: Floats, triangles: Ids, free: Ids, values: NDArray[Any]) -> Floats:
    """Interpolate values of free vertices from the others; none exceeds the range of its rim.

    Parameters
    ----------
    triangles : (m, 3) triangles of the caps.
    free : (k,) vertices whose values are computed.
    values : (n, c) values of all vertices.

    Returns
    -------
    Values (k, c) of the free vertices.
    """
    laplacian = _build_laplacian(points, triangles, lowest=0.1)
    return _solve(laplacian[free][:, free], -_apply_to_others(laplacian[free], free, values))


def fair(points: Floats, triangles: Ids, rim: Ids, free: Ids) -> Floats:
    """Continue a surface smoothly: minimise the squared Laplacian at free and rim vertices.

    Parameters
    ----------
    triangles : (m, 3) triangles of the caps, and of the mesh around the rim.
    rim : (r,) vertices of the rim.
    free : (k,) vertices that move.

    Returns
    -------
    Positions (k, 3) of the free vertices.
    """
    from scipy.sparse import diags

    rows = np.concatenate([free, rim])
    laplacian = _build_laplacian(points, triangles, lowest=-_MAX_COTANGENT)[rows]
    areas = np.zeros(len(points))
    np.add.at(areas, triangles, np.linalg.norm(compute_normals(points, triangles), axis=1)[:, None] / 6)
    to_free = laplacian[:, free]
    weighted = to_free.T @ diags(1 / areas[rows])
    return _solve(weighted @ to_free, -weighted @ _apply_to_others(laplacian, free, points))


def _build_laplacian(points: Floats, triangles: Ids, lowest: float) -> Any:
    """Build the cotangent Laplacian (n, n); cotangents are limited, from below to `lowest`."""
    from scipy.sparse import csr_matrix

    corners = triangles.reshape(-1)
    heads = corners[step_to_next_corner(np.arange(len(corners)))]
    weights = compute_cotangents(points, triangles).clip(lowest, _MAX_COTANGENT) / 2
    rows = np.concatenate([corners, heads, corners, heads])
    columns = np.concatenate([heads, corners, corners, heads])
    values = np.concatenate([-weights, -weights, weights, weights])
    return csr_matrix((values, (rows, columns)), shape=(len(points), len(points)))


def _apply_to_others(laplacian: Any, free: Ids, values: Floats) -> NDArray[Any]:
    """Multiply a matrix with the values of all vertices except the free ones."""
    fixed = values.astype(np.float64)
    fixed[free] = 0
    return np.asarray(laplacian @ fixed)


def _solve(matrix: Any, values: Floats) -> Floats:
    from scipy.sparse.linalg import splu

    return np.asarray(splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(values))
