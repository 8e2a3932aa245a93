"""How many metres one level of colour counts as when a mesh is simplified to a number of triangles."""

from __future__ import annotations

from scanloom.stages import _kernels
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.mesh import Mesh


def color_weight(mesh: Mesh, triangles: int, threads: int = 1) -> float:
    """Return a weight that follows from the mesh and the number of triangles wanted.

    It is the balanced one, or less: on a sample of the mesh that is simplified alike, the error of shape is
    at most a fifth larger than without colours.

    Parameters
    ----------
    mesh : with colours; without them the weight is 0.
    triangles : wanted of the result, at least 1.
    threads : 0 for one a core; the weight is the same.

    Returns
    -------
    float
        Metres a level (8 bit, Euclidean over the channels).

    Raises
    ------
    _kernels.InvalidMeshError
        For an index out of range or a value that is not finite.
    """
    return _weight(mesh, triangles, threads, tried=True)


def balanced_weight(mesh: Mesh, triangles: int, threads: int = 1) -> float:
    """Return the weight at which shape and colour count alike, with some preference for shape.

    Over pieces of surface as large as a triangle of the result, the mesh's distance to its best plane is
    about the error of shape to expect, and its colours' difference to their best linear fit about that of
    colour.

    Parameters, result and errors are those of `color_weight`.
    """
    return _weight(mesh, triangles, threads, tried=False)


def _weight(mesh: Mesh, triangles: int, threads: int, *, tried: bool) -> float:
    return _kernels.color_weight(
        mesh.vertices,
        attributes_of(mesh),
        mesh.triangles,
        target=max(triangles, 1),
        tried=tried,
        wanted_threads=threads,
    )
