"""Weight of colour against shape, in metres per level."""

from __future__ import annotations

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes


def compute_color_weight(mesh: Mesh, triangles: int, threads: int = 1) -> float:
    """Compute the colour weight for a mesh and a target triangle count.

    The result is the balanced weight or a smaller one: the largest tested at which colours increase the shape
    error by at most a fifth. The test simplifies a sample of the mesh with and without colours.

    Parameters
    ----------
    mesh : mesh with colours; without colours the weight is 0.
    triangles : target triangle count, at least 1.
    threads : 0 for one per core; the weight does not depend on it.

    Returns
    -------
    float
        Metres per level (8 bit, Euclidean over the channels).

    Raises
    ------
    _kernels.InvalidMeshError
        For an index out of range or a value that is not finite.
    """
    return _compute_weight(mesh, triangles, threads, is_tested=True)


def compute_balanced_weight(mesh: Mesh, triangles: int, threads: int = 1) -> float:
    """Compute the weight at which shape and colour errors balance.

    Shape gets a slight preference.

    The surface is divided into patches as large as a triangle of the result. Their distance to the best-fit
    plane estimates the shape error. The deviation of their colours from the best linear fit estimates the
    colour error.

    Parameters, result and errors are the same as for `compute_color_weight`.
    """
    return _compute_weight(mesh, triangles, threads, is_tested=False)


def _compute_weight(mesh: Mesh, triangles: int, threads: int, *, is_tested: bool) -> float:
    return _kernels.choose_color_weight(
        mesh.vertices,
        get_vertex_attributes(mesh),
        mesh.triangles,
        target=max(triangles, 1),
        run_trial=is_tested,
        wanted_threads=threads,
    )
