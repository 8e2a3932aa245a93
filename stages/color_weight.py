"""How many metres one level of colour counts as when a mesh is simplified to a number of triangles."""

from __future__ import annotations

import numpy as np

from stages import _kernels
from stages.centred import attributes_of
from stages.mesh import Mesh
from stages.progress import Progress, silent

# Share of the balanced weight. With it, the shape error of two scans and a globe is at most a sixth larger
# than without colours (`benches/simplify.py`, default against default × 0).
_SHARE = 0.4

# On a flat mesh any weight above rounding lets colours decide.
_LEAST_PER_DIAGONAL = 1e-7


def color_weight(mesh: Mesh, triangles: int, threads: int = 1, progress: Progress = silent) -> float:
    """Return a weight that follows from the mesh and the number of triangles wanted.

    It is the balanced one, or less: on a sample of the mesh that is simplified alike, the error of shape is
    at most a fifth larger than without colours.

    Parameters
    ----------
    mesh : with colours; without them the weight is 0.
    triangles : wanted of the result, at least 1.
    threads : 0 for one a core; the weight is the same.
    progress : raising from it stops the work.

    Returns
    -------
    float
        Metres a level (8 bit, Euclidean over the channels).
    """
    weight = balanced_weight(mesh, triangles, threads)
    if weight == 0:
        return 0.0
    return _kernels.affordable_weight(
        mesh.vertices,
        attributes_of(mesh),
        mesh.triangles,
        target=max(triangles, 1),
        weight=weight,
        wanted_threads=threads,
        progress=progress,
    )


def balanced_weight(mesh: Mesh, triangles: int, threads: int = 1) -> float:
    """Return the weight at which shape and colour count alike, with some preference for shape.

    Over pieces of surface as large as a triangle of the result, the mesh's distance to its best plane is
    about the error of shape to expect, and its colours' difference to their best linear fit about that of
    colour.

    Parameters and result are those of `color_weight`.
    """
    if mesh.colors is None:
        return 0.0
    # A column at a time: reducing over rows of three is several times slower.
    extent = [np.ptp(column) for column in mesh.vertices.T] if len(mesh.vertices) else [0.0]
    diagonal = float(np.linalg.norm(extent))
    errors = _kernels.residuals(
        mesh.vertices,
        mesh.colors,
        mesh.triangles,
        target=max(triangles, 1),
        wanted_threads=threads,
    )
    if errors is None:
        # Too small to tell: a level counts as a hundredth of a percent of the extent.
        return diagonal / 1e4
    shape, color = errors
    return max(_SHARE * shape / color, _LEAST_PER_DIAGONAL * diagonal)
