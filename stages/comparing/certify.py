"""Proven bounds on the distance and colour difference between two meshes.

The bounds are valid at every point; `compare` only measures at samples and can miss the maximum between them.
Here every triangle is subdivided into pieces, and each piece is bounded as a whole, in both directions.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CertifyKeywords

RESULT_VERSION = 1

# Vertices (n, 3), vertex attributes (n, k), triangles (m, 3).
_TriangleSoup: TypeAlias = tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.int32]]


@dataclass(frozen=True, kw_only=True)
class CertifyParams:
    """Required tightness of the bounds, and limits to check."""

    shape_tolerance: float = param(
        0.05,
        "Maximum excess of the shape bound over the largest distance found, relative to that distance.",
        low=0,
    )
    color_tolerance: float = param(
        0.05,
        "Maximum excess of the colour bound over the largest colour difference found, relative to it.",
        low=0,
    )
    color_floor: float = param(
        1.0, "Excess of the colour bound that is always accepted.", unit="levels", low=0
    )
    max_shape: float | None = param(
        None,
        "Also check that no distance exceeds this limit. Without max_color, colours are not checked.",
        unit="m",
        low=0,
        common=True,
    )
    max_color: float | None = param(
        None,
        "Also check that no colour difference exceeds this limit.",
        unit="levels",
        low=0,
        common=True,
    )
    check_only: bool = param(
        False,
        "With max_shape or max_color: stop as soon as it is decided whether the limits hold, which is much "
        "faster. Bounds are then no tighter than the limits.",
        common=True,
    )
    effort: float = param(
        16.0,
        "Average number of pieces per triangle that may be evaluated to tighten the bounds. More effort "
        "never loosens a bound.",
        low=0,
        high=1e6,
    )
    slack: float | None = param(
        None,
        "Distance within which points count as equally near. None: the error of coordinates and searches "
        "in single precision, 2⁻²¹ of the largest coordinate and 2⁻²⁰ of the bounding-box diagonal.",
        unit="m",
        low=0,
    )
    threads: int = param(
        0,
        "Number of threads; 0 for all processors. The result is bit-identical for any number.",
        low=0,
        high=1024,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.check_only and self.max_shape is None and self.max_color is None:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "requires a limit",
                DiagnosticLocation(parameter="check_only"),
                remedy="set max_shape, max_color or both.",
            )


@dataclass(frozen=True, eq=False)
class Certificate:
    """Proven bounds on shape and colour deviation.

    Distances are in metres. Colour differences are in 8-bit levels, Euclidean norm over the channels. Colour
    bounds exist only if both meshes have vertex colours, and not where only `max_shape` is given.

    Attributes
    ----------
    shape_bound, color_bound : (q,) float64, per triangle of the result, in both directions. No point of the
        triangle is farther from the original. No point of the original whose nearest point is on the triangle
        is farther away.
    original_shape_bound, original_color_bound : (m,) float64, per triangle of the original, from its points
        to the result.
    shape_bound_m, color_bound_levels : maximum over all triangles. The colour bound also holds for the
        difference of each single channel. With `check_only`, infinite if it is not proven to be within its
        limit.
    shape_attained_m, color_attained_levels : largest values found at a point. The true maximum is between
        attained value and bound.
    slack_m : distance within which points count as equally near, because a search in single precision can
        return any of them. Shape bounds include the slack.
    color_slack_levels : allowance for interpolation in single precision, included in the colour bounds.
    within_limits : True if everything is proven to be within `max_shape` and `max_color`; None without
        limits.
    pieces : number of triangle pieces that were evaluated.
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

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return everything except the arrays for JSON; an infinite bound becomes None."""
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
    progress: Progress = ignore_progress,
    **changes: Unpack[CertifyKeywords],
) -> Certificate:
    """Prove bounds on the deviation of a mesh from its original.

    The bounds cover the distance in both directions and the colour difference. The colour at a point is
    compared with the colour at every nearest point of the other mesh. To allow for single precision,
    triangles up to `slack` farther away count as nearest, too, each at its nearest point and within `slack`
    of that point. The bounds therefore hold for any sampling density and any search: Metro, `compare`,
    Embree.

    Parameters
    ----------
    result, original : Mesh, Open3D or trimesh mesh, or (vertices, triangles), in metres. Meshes need not be
        manifold, closed or oriented. Vertex colours are interpolated linearly over each triangle; textures
        are ignored.
    params : CertifyParams; single fields can be given by name instead.
    progress : called about ten times a second; an exception from it stops the work.

    Returns
    -------
    Certificate
        If one mesh has no triangles, bounds for the other are infinite.

        The bound of a single triangle is within a fifth of its attained value, or below 2 % of the maximum
        deviation, unless `effort` runs out. The same holds with `max_shape` or `max_color`. With
        `check_only`, a triangle within the limits has the limits as its bounds, and any other triangle has
        larger bounds. A quantity without a limit is then not bounded.

    Raises
    ------
    MeshError
        For an index out of range or a non-finite value.
    UsageError
        For a parameter out of range.

    Notes
    -----
    A search in single precision can miss a needle (a triangle far longer than high) and return a neighbouring
    triangle. Only the longest side of a needle (height below 1:250 of its length) therefore counts as near.
    If that side is a boundary and has no neighbour, such a search can exceed the bounds by the needle's
    height.

    References
    ----------
    Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998, for the bounded
    quantities; Tang, Lee and Kim, "Interactive Hausdorff distance computation for general polygonal models",
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
            "requires vertex colours on both meshes.",
            DiagnosticLocation(parameter="max_color"),
        )
    with_color = colored and (limit is None or params.max_color is not None)
    prove = functools.partial(
        _run_certifier, _to_triangle_soup(a, colored), _to_triangle_soup(b, colored), params
    )
    if limit is None:
        return _make_certificate(prove(None, progress), with_color, None)
    if params.check_only:
        found = prove(limit, progress)
        within = _is_within(found.bound, limit, with_color)
        return _drop_loose_bounds(_make_certificate(found, with_color, within), limit)
    # Checking a limit yields no bound tighter than that limit, but a user who gives a limit also wants the
    # actual deviation. So tight bounds are computed first. The limits are checked separately only if the
    # tight bounds exceed them and the attained values do not.
    tight = prove(None, progress)
    within = _is_within(tight.bound, limit, with_color)
    if within or not _is_within(tight.attained, limit, with_color):
        return _make_certificate(tight, with_color, within)
    decided = prove(limit, _report_finished_progress(progress))
    within = _is_within(decided.bound, limit, with_color)
    return _combine_certificates(
        *(_make_certificate(found, with_color, within) for found in (tight, decided))
    )


def _run_certifier(
    result: _TriangleSoup,
    original: _TriangleSoup,
    params: CertifyParams,
    limit: tuple[float, float] | None,
    progress: Progress,
) -> _kernels.CertifyResult:
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


def _make_certificate(
    found: _kernels.CertifyResult, with_color: bool, is_within_limits: bool | None
) -> Certificate:
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
        within_limits=is_within_limits,
        pieces=found.pieces,
    )


def _drop_loose_bounds(decided: Certificate, limit: tuple[float, float]) -> Certificate:
    """Return the certificate without overall bounds beyond the limits.

    The search ends at the first point beyond a limit. By then the bounds are still as loose as the bounding
    boxes, and say nothing about the deviation.
    """
    shape, color = decided.shape_bound_m, decided.color_bound_levels
    return replace(
        decided,
        shape_bound_m=shape if shape <= limit[0] < np.inf else np.inf,
        color_bound_levels=None if color is None else color if color <= limit[1] < np.inf else np.inf,
    )


def _combine_certificates(a: Certificate, b: Certificate) -> Certificate:
    """Combine two certificates of the same meshes.

    Each bound is the smaller of the two, each attained value the larger.
    """

    def take_minimum(name: str) -> Any:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None else np.minimum(one, other)

    def take_maximum(name: str) -> Any:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None else max(one, other)

    return Certificate(
        shape_bound=take_minimum("shape_bound"),
        color_bound=take_minimum("color_bound"),
        original_shape_bound=take_minimum("original_shape_bound"),
        original_color_bound=take_minimum("original_color_bound"),
        shape_bound_m=min(a.shape_bound_m, b.shape_bound_m),
        color_bound_levels=take_minimum("color_bound_levels"),
        shape_attained_m=take_maximum("shape_attained_m"),
        color_attained_levels=take_maximum("color_attained_levels"),
        slack_m=a.slack_m,
        color_slack_levels=a.color_slack_levels,
        within_limits=b.within_limits,
        pieces=a.pieces + b.pieces,
    )


def _report_finished_progress(progress: Progress) -> Progress:
    """Return a callback that reports complete progress during the second pass."""
    return lambda done, total: progress(total, total)  # noqa: ARG005


def _to_triangle_soup(mesh: Mesh, colored: bool) -> _TriangleSoup:
    return mesh.vertices, get_vertex_attributes(mesh if colored else mesh.with_(colors=None)), mesh.triangles
