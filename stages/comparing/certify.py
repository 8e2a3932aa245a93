"""Proven bounds on how far two meshes are apart, in shape and in colour: never exceeded, at any point.

`compare` measures at samples, and a maximum between them goes unseen. Here every triangle is covered by
pieces that are bounded as a whole, in both directions.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CertifyKeywords

RESULT_VERSION = 1

# Vertices, their attributes, triangles.
_Soup: TypeAlias = tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.int32]]


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
        "Also find out whether all stays within this distance; without max_color, colours are not asked for.",
        unit="m",
        low=0,
        common=True,
    )
    max_color: float | None = param(
        None,
        "Also find out whether all stays within this difference of colour.",
        unit="levels",
        low=0,
        common=True,
    )
    only_decide: bool = param(
        False,
        "With max_shape or max_color: end as soon as it is clear whether they are kept, which is far faster. "
        "What stays within them then has these as its bounds, however close it is.",
        common=True,
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
        if self.only_decide and self.max_shape is None and self.max_color is None:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "is for limits",
                Where(parameter="only_decide"),
                remedy="give max_shape, max_color or both.",
            )


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
        deviation, unless `effort` runs out; so they are with `max_shape` or `max_color`, too. With
        `only_decide` a triangle that stays within these has them as its bounds, and any other more; what has
        no limit then has no bound.

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
        shape, color = (np.inf if x is None else float(x) for x in (params.max_shape, params.max_color))
        limit = (shape, color)
    colored = a.colors is not None and b.colors is not None
    if params.max_color is not None and not colored:
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "is given, but not both meshes have vertex colours.",
            Where(parameter="max_color"),
        )
    with_color = colored and (limit is None or params.max_color is not None)
    prove = functools.partial(_proven, _soup(a, colored), _soup(b, colored), params)
    if limit is None:
        return _certificate(prove(None, progress), with_color, None)
    if params.only_decide:
        found = prove(limit, progress)
        return _certificate(found, with_color, _is_within(found.bound, limit, with_color))
    # A decision says no more of what is kept than that; whoever states a limit wants to know how close it is
    # all the same. Where close bounds pass it though nothing was found to, pieces are spent on the question.
    close = prove(None, progress)
    within = _is_within(close.bound, limit, with_color)
    if within or not _is_within(close.attained, limit, with_color):
        return _certificate(close, with_color, within)
    decided = prove(limit, _finishing(progress))
    within = _is_within(decided.bound, limit, with_color)
    return _closer(*(_certificate(found, with_color, within) for found in (close, decided)))


def _proven(
    result: _Soup,
    original: _Soup,
    params: CertifyParams,
    limit: tuple[float, float] | None,
    progress: Progress,
) -> _kernels.Certified:
    try:
        return _kernels.certify(
            result,
            original,
            tolerance=(params.shape_tolerance, params.color_tolerance),
            absolute_tolerance=(0.0, params.color_floor),
            limit=limit,
            effort=params.effort,
            slack=params.slack,
            threads=params.threads,
            progress=progress,
        )
    except _kernels.InvalidMeshError as error:
        raise MeshError(MESH_NO_SURFACE, "{error}.", "mesh", error=error) from error


def _is_within(found: tuple[float, float], limit: tuple[float, float], with_color: bool) -> bool:
    return found[0] <= limit[0] and (not with_color or found[1] <= limit[1])


def _certificate(found: _kernels.Certified, with_color: bool, within: bool | None) -> Certificate:
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


def _closer(a: Certificate, b: Certificate) -> Certificate:
    """Return two proofs of the same meshes as one: each bound is the lesser one."""

    def least(name: str) -> Any:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None else np.minimum(one, other)

    def greatest(name: str) -> Any:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None else max(one, other)

    return Certificate(
        shape_bound=least("shape_bound"),
        color_bound=least("color_bound"),
        original_shape_bound=least("original_shape_bound"),
        original_color_bound=least("original_color_bound"),
        shape_bound_m=min(a.shape_bound_m, b.shape_bound_m),
        color_bound_levels=least("color_bound_levels"),
        shape_attained_m=greatest("shape_attained_m"),
        color_attained_levels=greatest("color_attained_levels"),
        slack_m=a.slack_m,
        color_slack_levels=a.color_slack_levels,
        within_limits=b.within_limits,
        pieces=a.pieces + b.pieces,
    )


def _finishing(progress: Progress) -> Progress:
    """Keep telling that all is looked at, while some of it is looked at once more."""
    return lambda done, total: progress(total, total)  # noqa: ARG005


def _soup(mesh: Mesh, colored: bool) -> _Soup:
    return mesh.vertices, attributes_of(mesh if colored else mesh.with_(colors=None)), mesh.triangles
