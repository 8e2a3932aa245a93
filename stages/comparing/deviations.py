"""Signed deviations of a mesh or cloud from a reference, as in metrology.

They come with percentiles, a tolerance, the worst points and a painted mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.asked import Asked, Levels, Points, Spread, asked
from scanloom.stages.comparing.measurable import box_of, comparable
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.comparing.palette import PALETTES, colors_of
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, chunks, is_used

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DeviationKeywords

PERCENTILES = (50, 90, 95, 99)
# Maximum number of worst points in the JSON metrics, and their minimum distance from each other as ratio of
# the mesh's bounding-box diagonal.
_PLACES = 10
_APART = 0.03
# Maximum number of points searched for the worst ones; of more points, only the farthest count.
_LOOKED_AT = 2_000_000
# Default colour range: the quantile of the absolute distances that the range covers.
_IN_RANGE = 0.99
# Ratio of the colour range that is painted as within tolerance if no tolerance is given.
_WELL = 0.1


@dataclass(frozen=True, kw_only=True)
class DeviationParams:
    """Tolerance, sampling and colours of a deviation measurement."""

    tolerance: float | None = param(
        None,
        "Maximum distance from the reference that is within tolerance.",
        unit="m",
        low=0,
        common=True,
    )
    signed_samples: int = param(
        200_000,
        "Points sampled on the measured mesh, uniformly over its area; for a cloud, all points are used.",
        low=1,
        high=100_000_000,
    )
    color_range: float | None = param(
        None,
        "Distance at which the last colour of the palette begins. Not given: the larger of the 99 % "
        "quantile of the distances and twice the tolerance.",
        unit="m",
        low=0,
        low_open=True,
    )
    palette: str = param(
        "metrology",
        "Colours of the painted mesh. `metrology`: green within tolerance, red above, blue below. `safe`: "
        "white, orange, blue, for readers with red-green colour blindness.",
        choices=PALETTES,
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, eq=False)
class Deviations:
    """Distances of a mesh or cloud from a reference.

    Attributes
    ----------
    is_signed : True if the reference is oriented; distances are then positive in front of it.
    spacing : point spacing of the reference in metres if it is a cloud, else None. Distances below the
        spacing are not meaningful.
    samples : (k,) distances at points uniform over the mesh's area, or at a cloud's points, metres.
    points : (k, 3) positions of these points, metres.
    at_vertices : (n,) distances at the mesh's vertices, metres; 0 at unused vertices.
    delta_e : (k,) colour differences ΔE2000 at `points`; None unless both have colours.
    tolerance : metres, or None.
    within, color_range : metres; distances up to `within` get the in-tolerance colour, distances from
        `color_range` the last colour.
    painted : the measured mesh or cloud, coloured by deviation.
    """

    is_signed: bool
    spacing: float | None
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
        """Return the metrics for JSON, with units in the key names."""
        distances, known = np.abs(self.samples), self.is_signed
        extremes = self._all()[1]
        told: dict[str, Any] = {
            "is_signed": known,
            "is_cloud": is_cloud(self.painted),
            "reference_spacing_m": self.spacing,
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
        """Return up to ten points with the largest absolute distances, spaced apart."""
        points, distances = self._all()
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        left = np.abs(distances)
        if len(left) > _LOOKED_AT:
            rows = np.argpartition(left, -_LOOKED_AT)[-_LOOKED_AT:]
            points, distances, left = points[rows], distances[rows], left[rows]
        found: list[dict[str, Any]] = []
        while len(found) < _PLACES and left.max() >= 0:
            at = int(left.argmax())
            found.append({"point_m": points[at].tolist(), "distance_m": float(distances[at])})
            left[np.linalg.norm(points - points[at], axis=1) <= _APART * size] = -1
        return found

    def _all(self) -> tuple[Floats, Floats]:
        """Return sample points plus used vertices of the mesh, and their distances."""
        if is_cloud(self.painted):
            return self.points, self.samples
        used = is_used(self.painted)
        points = np.concatenate([self.points, self.painted.vertices[used]])
        return points, np.concatenate([self.samples, self.at_vertices[used]])


def deviations(
    reference: MeshLike,
    mesh: MeshLike,
    params: DeviationParams | None = None,
    **changes: Unpack[DeviationKeywords],
) -> Deviations:
    """Measure signed distances and colour differences of a mesh from a reference.

    Distances from a mesh are exact. Distances from a cloud are to its nearest point; the sign comes from that
    point's normal, if the cloud has normals.

    Parameters
    ----------
    reference, mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in one coordinate
        system. Input without triangles is a cloud.
    params : DeviationParams; single fields can be given by name instead.

    Raises
    ------
    MeshError
        If a mesh has no area, or all points of a cloud coincide.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(DeviationParams, params, changes)
    fixed, measured = comparable(reference, "reference"), comparable(mesh, "mesh")
    box = box_of(fixed, measured)
    return _measured(asked(fixed, box), asked(measured, box), params)


def deviations_from(surface: WithNeedles, measured: Mesh, params: DeviationParams) -> Deviations:
    """Measure deviations from a surface whose search structure already exists; see `deviations`.

    The box of `surface` contains both meshes, and both have passed `require_area`.
    """
    box = box_of(surface.mesh, measured)
    return _measured(asked(surface.mesh, box, surface), asked(measured, box), params)


def _measured(target: Asked, source: Asked, params: DeviationParams) -> Deviations:
    measured = source.mesh
    points = points_of(source, params, colored=target.has_color and source.has_color)
    samples, seen = _distances(points.places, target, colored=points.colors is not None)
    if is_cloud(measured):
        at_vertices = samples
    else:
        at_vertices = np.zeros(len(measured.vertices))
        used = np.unique(measured.triangles)
        at_vertices[used], _ = _distances(measured.vertices[used], target, colored=False)
    found = Found(target.is_oriented, target.spacing, samples, seen, at_vertices)
    return deviations_of(measured, points, found, params)


@dataclass(frozen=True, eq=False)
class Found:
    """Measured distances and colours before evaluation; see `Deviations`.

    `seen` are the reference's colours (k, 3) at the nearest points, or None.
    """

    is_signed: bool
    spacing: float | None
    samples: Floats
    seen: Levels | None
    at_vertices: Floats


def points_of(source: Spread, params: DeviationParams, *, colored: bool) -> Points:
    """Draw the points at which a mesh or cloud is measured."""
    count = source.samples(params.signed_samples)
    return source.spread(slice(0, count), count, np.random.default_rng(0), colored=colored)


def deviations_of(measured: Mesh, points: Points, found: Found, params: DeviationParams) -> Deviations:
    """Evaluate measured distances and colours, and paint the mesh by deviation."""
    delta_e = None
    if points.colors is not None and found.seen is not None:
        parts = [_delta_e(points.colors[rows], found.seen[rows]) for rows in chunks(len(found.samples))]
        delta_e = np.concatenate(parts)
    most = params.color_range or _range_of(found.samples, params.tolerance)
    within = params.tolerance if params.tolerance is not None else _WELL * most
    painted = measured.with_(colors=colors_of(found.at_vertices, within, most, params.palette), texture=None)
    return Deviations(
        is_signed=found.is_signed,
        spacing=found.spacing,
        samples=found.samples,
        points=points.places,
        at_vertices=found.at_vertices,
        delta_e=delta_e,
        tolerance=params.tolerance,
        within=within,
        color_range=most,
        painted=painted,
    )


def _distances(points: Floats, target: Asked, *, colored: bool) -> tuple[Floats, NDArray[np.floating] | None]:
    """Query the distances (k,) from points to a target, and its colours (k, 3).

    Distances are signed if the target is oriented.
    """
    found = [target.nearest(points[rows], colored=colored, signed=True) for rows in chunks(len(points))]
    distances = np.concatenate([one.distances for one in found])
    colors = [one.colors for one in found if one.colors is not None]
    return distances, np.concatenate(colors) if colors else None


def _range_of(samples: Floats, tolerance: float | None) -> float:
    most = float(np.quantile(np.abs(samples), _IN_RANGE))
    return max(most, 2 * (tolerance or 0.0), float(np.finfo(np.float64).tiny))


def _percentiles(values: Floats) -> dict[str, float]:
    return {f"{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


def _delta_e(a: NDArray[np.floating], b: NDArray[np.floating]) -> Floats:
    """Return ΔE2000 (Sharma, Wu and Dalal, 2005) between sRGB colours (k, 3), 0 to 255."""
    import skimage.color

    color: Any = skimage.color

    one, two = (color.rgb2lab(np.clip(np.asarray(c, np.float64) / 255, 0, 1)[None])[0] for c in (a, b))
    return np.asarray(color.deltaE_ciede2000(one, two), np.float64)
