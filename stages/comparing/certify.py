"""Proven bounds on how far two meshes are apart, in shape and in colour: never exceeded, at any point.

`compare` measures at samples, and a maximum between them goes unseen. Here every triangle is covered by
pieces that are bounded as a whole, in both directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.errors import MeshError, UsageError
from stages.params import check, param, resolve
from stages.printing import by_figures, table
from stages.progress import Progress, silent
from stages.simplification.kernel_input import attributes_of
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

RESULT_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class CertifyParams:
    """How close the bounds are to come, or what they have to stay within."""

    shape_tolerance: float = param(
        0.05,
        "How much the bound on shape may pass the greatest distance found, relative to that.",
        low=0,
    )
    color_tolerance: float = param(
        0.05,
        "How much the bound on colour may pass the greatest difference found, relative to that.",
        low=0,
    )
    color_floor: float = param(
        1.0, "An excess of the bound on colour that is small enough in any case.", unit="levels", low=0
    )
    max_shape: float | None = param(
        None,
        "Only find out which triangles stay within this distance; with or without max_color. Far faster than "
        "bounds that are close everywhere.",
        unit="m",
        low=0,
    )
    max_color: float | None = param(
        None, "Only find out which triangles stay within this difference of colour.", unit="levels", low=0
    )
    effort: float = param(
        16.0,
        "Pieces a triangle, on average, that may be spent on coming closer. More never makes a bound "
        "greater.",
        low=0,
        high=1e6,
    )
    slack: float | None = param(
        None,
        "Distance within which points count as equally near. None: what vertices and searches in single "
        "precision cannot tell, 2⁻²¹ of the largest coordinate and 2⁻²⁰ of the bounding box's diagonal.",
        unit="m",
        low=0,
    )
    threads: int = param(
        0, "Processors to use; 0 for all. Equal bits for any number.", low=0, high=1024, invalidates=False
    )

    def __post_init__(self) -> None:
        check(self)


class CertifyKeywords(TypedDict, total=False):
    """CertifyParams as keywords of `certify`."""

    shape_tolerance: float
    color_tolerance: float
    color_floor: float
    max_shape: float | None
    max_color: float | None
    effort: float
    slack: float | None
    threads: int


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven. Distances in metres; colours in 8-bit levels, Euclidean norm over the channels.

    Attributes
    ----------
    shape_bound, color_bound : (q,) float64, for each triangle of the result, both ways: no point of it is
        farther from the original, and no point of the original whose nearest point is on it is farther away.
    original_shape_bound, original_color_bound : (m,) float64, for each triangle of the original, from its
        points to the result.
    shape_bound_m, color_bound_levels : the greatest of all. The colour bound also holds for the difference of
        any single channel.
    shape_attained_m, color_attained_levels : the greatest found at a point; the true maximum is between.
    slack_m : triangles within this of the smallest distance count as nearest too, each at its own nearest
        point and at points within this of that: a search in single precision returns any of them. Bounds on
        shape contain it.
    color_slack_levels : contained in the bounds on colour, for interpolation in single precision.
    within_limits : whether all is proven to stay within max_shape and max_color; None without them.
    pieces : how many pieces of triangles were looked at.

    Colour bounds are None unless both meshes have vertex colours, and where max_shape is given alone.
    """

    shape_bound: NDArray[np.float64]
    color_bound: NDArray[np.float64] | None
    original_shape_bound: NDArray[np.float64]
    original_color_bound: NDArray[np.float64] | None
    shape_bound_m: float
    color_bound_levels: float | None
    shape_attained_m: float
    color_attained_levels: float | None
    slack_m: float
    color_slack_levels: float
    within_limits: bool | None
    pieces: int

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON; a bound that is infinite is None."""
        values = {
            "shape_bound_m": self.shape_bound_m,
            "shape_attained_m": self.shape_attained_m,
            "color_bound_levels": self.color_bound_levels,
            "color_attained_levels": self.color_attained_levels,
            "slack_m": self.slack_m,
            "color_slack_levels": self.color_slack_levels,
            "within_limits": self.within_limits,
            "pieces": self.pieces,
        }
        return {name: None if value == np.inf else value for name, value in values.items()}


def certify(
    result: MeshLike,
    original: MeshLike,
    params: CertifyParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CertifyKeywords],
) -> Certificate:
    """Bound the two-sided distance and colour difference between a mesh and the one it came from.

    The colour at a point is compared with the colour at the nearest point of the other mesh, at *every*
    nearest point where there are several. To allow for single precision, triangles no more than `slack`
    farther away count as well, each at its nearest point and within `slack` of that. So the bounds hold
    for whoever samples the two surfaces, however densely, with whatever search: Metro, `compare`, Embree.

    Parameters
    ----------
    result, original : Mesh, Open3D or trimesh mesh, or (vertices, triangles), in metres. Any triangles: they
        need not be manifold, closed or oriented. Vertex colours are linear over each triangle; textures are
        not read.
    params : CertifyParams; single fields can be given by name instead.
    progress : called about ten times a second; raising from it stops the work.

    Returns
    -------
    Certificate
        Where one mesh has no triangles, bounds for the other are infinite.

        Bounds of single triangles are within a fifth of what is attained there, or below 2 % of the greatest
        deviation, unless `effort` runs out. With `max_shape` or `max_color` a triangle that stays within them
        has these as its bounds, and any other more; what has no limit then has no bound.

    Raises
    ------
    MeshError
        For an index out of range or a value that is not finite.
    UsageError
        For a parameter out of range.

    Notes
    -----
    A search in single precision can overlook a needle, a triangle far longer than high, and return what is
    beside it. Of needles (below 1:250) therefore only the longest side counts as near; where that is a
    boundary, so that nothing is beside it, such a search can still pass the bounds by the needle's height.

    References
    ----------
    Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998, for what is
    bounded; Tang, Lee and Kim, "Interactive Hausdorff distance computation for general polygonal models",
    2009, for refining where the bound is greatest.
    """
    params = resolve(CertifyParams, params, changes)
    a, b = as_mesh(result, "result"), as_mesh(original, "original")
    limit = None
    if params.max_shape is not None or params.max_color is not None:
        limit = tuple(np.inf if x is None else float(x) for x in (params.max_shape, params.max_color))
    colored = a.colors is not None and b.colors is not None
    if params.max_color is not None and not colored:
        raise UsageError("max_color is given, but not both meshes have vertex colours.")
    try:
        found = _kernels.certify(
            _soup(a, colored),
            _soup(b, colored),
            tolerance=(params.shape_tolerance, params.color_tolerance),
            absolute_tolerance=(0.0, params.color_floor),
            limit=limit if limit is None else (limit[0], limit[1]),
            effort=params.effort,
            slack=params.slack,
            threads=params.threads,
            progress=progress,
        )
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}.", "mesh") from error
    with_color = colored and (limit is None or params.max_color is not None)
    within = None
    if limit is not None:
        within = found.bound[0] <= limit[0] and (not with_color or found.bound[1] <= limit[1])
    return Certificate(
        shape_bound=found.shape_bound,
        color_bound=found.color_bound if with_color else None,
        original_shape_bound=found.original_shape_bound,
        original_color_bound=found.original_color_bound if with_color else None,
        shape_bound_m=found.bound[0],
        color_bound_levels=found.bound[1] if with_color else None,
        shape_attained_m=found.attained[0],
        color_attained_levels=found.attained[1] if with_color else None,
        slack_m=found.slack,
        color_slack_levels=found.color_slack,
        within_limits=within,
        pieces=found.pieces,
    )


def _soup(mesh: Mesh, colored: bool) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.int32]]:
    return mesh.vertices, attributes_of(mesh if colored else mesh.with_(colors=None)), mesh.triangles
