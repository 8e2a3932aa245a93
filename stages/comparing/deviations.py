"""How a mesh deviates from a reference, as metrology tells it: with signs, percentiles and a tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stages.comparing.measurable import measurable
from stages.comparing.needles import WithNeedles
from stages.comparing.palette import PALETTES, colors_of
from stages.comparing.sampling import sampled
from stages.comparing.signed import Sides, sides_of
from stages.params import check, param, resolve
from stages.printing import by_figures, table
from stages.surface.color import color_at, has_color
from stages.surface.convert import MeshLike
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Floats, Located, Surface, bounding_box, chunks, interpolated, is_used
from stages.surface.topology import areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

PERCENTILES = (50, 90, 95, 99)
# As many of the worst places are told, apart by this share of the mesh's size.
_PLACES = 10
_APART = 0.03
# The range of colours, where none is given: this share of the surface is nearer.
_IN_RANGE = 0.99
# And of what is well, where no tolerance is given.
_WELL = 0.1


@dataclass(frozen=True, kw_only=True)
class DeviationParams:
    """How deviations are measured and shown."""

    tolerance: float | None = param(
        None, "What is nearer to the reference is within tolerance.", unit="m", low=0
    )
    signed_samples: int = param(
        200_000, "Points on the mesh that is measured, spread evenly over its area.", low=1, high=100_000_000
    )
    color_range: float | None = param(
        None,
        "Where the last colour of the palette begins. Not given: what 99 % of the surface is within, or "
        "twice the tolerance, if that is more.",
        unit="m",
        low=0,
        low_open=True,
    )
    palette: str = param(
        "metrology",
        "Green within tolerance, red over and blue under it; `safe` for eyes that mix up red and green: "
        "white, orange, blue.",
        choices=PALETTES,
    )

    def __post_init__(self) -> None:
        check(self)


class DeviationKeywords(TypedDict, total=False):
    """DeviationParams as keywords of `deviations`."""

    tolerance: float | None
    signed_samples: int
    color_range: float | None
    palette: str


@dataclass(frozen=True, eq=False)
class Deviations:
    """Distances of a mesh's surface from a reference.

    Attributes
    ----------
    is_signed : whether the reference is oriented; then distances are positive on the side that it looks to.
    samples : (k,) distances at points spread evenly over the mesh's area, metres.
    points : (k, 3) these points.
    at_vertices : (n,) distances at the mesh's vertices, metres; 0 at those without triangles.
    delta_e : (k,) colour differences ΔE2000 at these points; None unless both have colours.
    tolerance : metres, or None.
    within, color_range : metres: what is nearer has the colour of what is well, and where the last begins.
    painted : the mesh in the colours of its deviations.
    """

    is_signed: bool
    samples: Floats
    points: Floats
    at_vertices: Floats
    delta_e: Floats | None
    tolerance: float | None
    within: float
    color_range: float
    painted: Mesh

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what there is to say of them, units in the names."""
        distances, known = np.abs(self.samples), self.is_signed
        extremes = self._all()[1]
        told: dict[str, Any] = {
            "is_signed": known,
            "samples": len(distances),
            "rms_m": float(np.sqrt((distances**2).mean())),
            "mean_m": float(self.samples.mean()) if known else None,
            "standard_deviation_m": float(self.samples.std()) if known else None,
            "lowest_m": float(extremes.min()) if known else None,
            "highest_m": float(extremes.max()) if known else None,
            "absolute_percentiles_m": _percentiles(distances),
            "tolerance_m": self.tolerance,
            "share_within": None,
            "share_over": None,
            "share_under": None,
            "color_range_m": self.color_range,
            "worst": self._worst(),
            "delta_e_2000": None,
        }
        if self.tolerance is not None:
            told["share_within"] = float((distances <= self.tolerance).mean())
            if known:
                told["share_over"] = float((self.samples > self.tolerance).mean())
                told["share_under"] = float((self.samples < -self.tolerance).mean())
        if self.delta_e is not None:
            told["delta_e_2000"] = {
                "mean": float(self.delta_e.mean()),
                "percentiles": _percentiles(self.delta_e),
                "maximum": float(self.delta_e.max()),
            }
        return told

    def _worst(self) -> list[dict[str, Any]]:
        """Return up to ten places where the mesh is farthest off, none beside another."""
        points, distances = self._all()
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        left = np.abs(distances)
        found: list[dict[str, Any]] = []
        while len(found) < _PLACES and left.max() >= 0:
            at = int(left.argmax())
            found.append({"point_m": points[at].tolist(), "distance_m": float(distances[at])})
            left[np.linalg.norm(points - points[at], axis=1) <= _APART * size] = -1
        return found

    def _all(self) -> tuple[Floats, Floats]:
        """Return the points that were spread, and vertices, which stray most; and their distances."""
        used = is_used(self.painted)
        points = np.concatenate([self.points, self.painted.vertices[used]])
        return points, np.concatenate([self.samples, self.at_vertices[used]])


def deviations(
    reference: MeshLike,
    mesh: MeshLike,
    params: DeviationParams | None = None,
    **changes: Unpack[DeviationKeywords],
) -> Deviations:
    """Measure how far a mesh is from a reference, on which side of it, and how its colours differ.

    Parameters
    ----------
    reference, mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in one place.
    params : DeviationParams; single fields can be given by name instead.

    Raises
    ------
    MeshError
        If a mesh has no area.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(DeviationParams, params, changes)
    fixed, measured = measurable(reference, "reference"), measurable(mesh, "mesh")
    box = bounding_box(fixed, measured)
    return deviations_from(WithNeedles(Surface(fixed, box), box), measured, params)


def deviations_from(surface: WithNeedles, measured: Mesh, params: DeviationParams) -> Deviations:
    """Do as `deviations` does, from a surface that serves other queries too.

    Its box holds both meshes, and both have passed `require_area`.
    """
    fixed = surface.mesh
    sides = sides_of(fixed)
    count = params.signed_samples
    cumulative = np.cumsum(areas(measured.vertices, measured.triangles))
    at = sampled(cumulative, slice(0, count), count, np.random.default_rng(0))
    points = interpolated(measured.vertices, measured, at)
    colored = has_color(fixed) and has_color(measured)
    samples, delta_e = np.empty(len(points)), np.empty(len(points)) if colored else None
    for rows in chunks(len(points)):
        samples[rows], nearest = _distances(surface, sides, points[rows])
        if delta_e is not None:
            own = color_at(measured, at.triangles[rows], at.weights[rows])
            delta_e[rows] = _delta_e(own, color_at(fixed, nearest.triangles, nearest.weights))
    at_vertices = np.zeros(len(measured.vertices))
    used = np.unique(measured.triangles)
    for rows in chunks(len(used)):
        at_vertices[used[rows]], _ = _distances(surface, sides, measured.vertices[used[rows]])
    most = params.color_range or _range_of(samples, params.tolerance)
    within = params.tolerance if params.tolerance is not None else _WELL * most
    painted = measured.with_(colors=colors_of(at_vertices, within, most, params.palette), texture=None)
    return Deviations(
        sides is not None, samples, points, at_vertices, delta_e, params.tolerance, within, most, painted
    )


def _distances(surface: WithNeedles, sides: Sides | None, points: Floats) -> tuple[Floats, Located]:
    nearest = surface.closest(points)
    signs = 1.0 if sides is None else sides.signs(points, nearest)
    return nearest.distances * signs, nearest


def _range_of(samples: Floats, tolerance: float | None) -> float:
    most = float(np.quantile(np.abs(samples), _IN_RANGE))
    return max(most, 2 * (tolerance or 0.0), float(np.finfo(np.float64).tiny))


def _percentiles(values: Floats) -> dict[str, float]:
    return {f"{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


def _delta_e(a: NDArray[np.floating], b: NDArray[np.floating]) -> Floats:
    """Return ΔE2000 (Sharma, Wu and Dalal, 2005) of colours (k, 3), 0 to 255, as displayed."""
    import skimage.color

    color: Any = skimage.color

    one, two = (color.rgb2lab(np.clip(np.asarray(c, np.float64) / 255, 0, 1)[None])[0] for c in (a, b))
    return np.asarray(color.deltaE_ciede2000(one, two), np.float64)
