"""Signed deviations of a mesh or cloud from a reference, as in metrology.

They come with percentiles, a tolerance, the worst points and a painted mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.comparison_inputs import compute_joint_box, to_mesh_or_cloud
from scanloom.stages.comparing.deviation_palette import PALETTES, colorize_distances
from scanloom.stages.comparing.distance_target import (
    DistanceTarget,
    Levels,
    SampledSurface,
    SamplePoints,
    make_distance_target,
)
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.raycasting import Floats, iterate_chunks, mask_used_vertices

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DeviationKeywords

PERCENTILES = (50, 90, 95, 99)
# Maximum number of worst points in the JSON metrics, and their minimum distance from each other as ratio of
# the mesh's bounding-box diagonal.
_MAX_WORST_POINTS = 10
_MIN_WORST_SPACING_RATIO = 0.03
# Maximum number of points searched for the worst ones; of more points, only the farthest count.
_MAX_SEARCHED_POINTS = 2_000_000
# Default colour range: the quantile of the absolute distances that the range covers.
_COLOR_RANGE_QUANTILE = 0.99
# Ratio of the colour range that is painted as within tolerance if no tolerance is given.
_DEFAULT_TOLERANCE_RATIO = 0.1


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
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class Deviations:
    """Distances of a mesh or cloud from a reference.

    Attributes
    ----------
    is_signed : True if the reference is oriented; distances are then positive in front of it.
    spacing : point spacing of the reference in metres if it is a cloud, else None. Distances below the
        spacing are not meaningful.
    sample_distances : (k,) distances at points uniform over the mesh's area, or at a cloud's points, metres.
    sample_points : (k, 3) positions of these points, metres.
    vertex_distances : (n,) distances at the mesh's vertices, metres; 0 at unused vertices.
    delta_e : (k,) colour differences ΔE2000 at `sample_points`; None unless both have colours.
    tolerance : metres, or None.
    in_tolerance_limit, color_range : metres; distances up to `in_tolerance_limit` get the in-tolerance
        colour, distances from
        `color_range` the last colour.
    painted_mesh : the measured mesh or cloud, coloured by deviation.
    """

    is_signed: bool
    spacing: float | None
    sample_distances: Floats
    sample_points: Floats
    vertex_distances: Floats
    delta_e: Floats | None
    tolerance: float | None
    in_tolerance_limit: float
    color_range: float
    painted_mesh: Mesh

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for JSON, with units in the key names."""
        distances, is_signed = np.abs(self.sample_distances), self.is_signed
        extremes = self._collect_points()[1]
        metrics: dict[str, Any] = {
            "is_signed": is_signed,
            "is_cloud": is_cloud(self.painted_mesh),
            "reference_spacing_m": self.spacing,
            "samples": len(distances),
            "rms_m": float(np.sqrt((distances**2).mean())),
            "mean_m": float(self.sample_distances.mean()) if is_signed else None,
            "standard_deviation_m": float(self.sample_distances.std()) if is_signed else None,
            "lowest_m": float(extremes.min()) if is_signed else None,
            "highest_m": float(extremes.max()) if is_signed else None,
            "absolute_percentiles_m": _compute_percentiles(distances),
            "tolerance_m": self.tolerance,
            "within_ratio": None,
            "over_ratio": None,
            "under_ratio": None,
            "color_range_m": self.color_range,
            "worst": self._find_worst_points(),
            "delta_e_2000": None,
        }
        if self.tolerance is not None:
            metrics["within_ratio"] = float((distances <= self.tolerance).mean())
            if is_signed:
                metrics["over_ratio"] = float((self.sample_distances > self.tolerance).mean())
                metrics["under_ratio"] = float((self.sample_distances < -self.tolerance).mean())
        if self.delta_e is not None:
            metrics["delta_e_2000"] = {
                "mean": float(self.delta_e.mean()),
                "percentiles": _compute_percentiles(self.delta_e),
                "maximum": float(self.delta_e.max()),
            }
        return metrics

    def _find_worst_points(self) -> list[dict[str, Any]]:
        """Return up to ten points with the largest absolute distances, spaced apart."""
        points, distances = self._collect_points()
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        remaining = np.abs(distances)
        if len(remaining) > _MAX_SEARCHED_POINTS:
            rows = np.argpartition(remaining, -_MAX_SEARCHED_POINTS)[-_MAX_SEARCHED_POINTS:]
            points, distances, remaining = points[rows], distances[rows], remaining[rows]
        found: list[dict[str, Any]] = []
        while len(found) < _MAX_WORST_POINTS and remaining.max() >= 0:
            at = int(remaining.argmax())
            found.append({"point_m": points[at].tolist(), "distance_m": float(distances[at])})
            remaining[np.linalg.norm(points - points[at], axis=1) <= _MIN_WORST_SPACING_RATIO * size] = -1
        return found

    def _collect_points(self) -> tuple[Floats, Floats]:
        """Return sample points plus used vertices of the mesh, and their distances."""
        if is_cloud(self.painted_mesh):
            return self.sample_points, self.sample_distances
        used = mask_used_vertices(self.painted_mesh)
        points = np.concatenate([self.sample_points, self.painted_mesh.vertices[used]])
        return points, np.concatenate([self.sample_distances, self.vertex_distances[used]])


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
    fixed, measured = to_mesh_or_cloud(reference, "reference"), to_mesh_or_cloud(mesh, "mesh")
    box = compute_joint_box(fixed, measured)
    return _measure_deviations(make_distance_target(fixed, box), make_distance_target(measured, box), params)


def measure_deviations_from(
    surface: NeedleSafeSurface, measured: Mesh, params: DeviationParams
) -> Deviations:
    """Measure deviations from a surface whose search structure already exists; see `deviations`.

    The box of `surface` contains both meshes, and both have passed `require_area`.
    """
    box = compute_joint_box(surface.mesh, measured)
    return _measure_deviations(
        make_distance_target(surface.mesh, box, surface), make_distance_target(measured, box), params
    )


def _measure_deviations(
    target: DistanceTarget, source: DistanceTarget, params: DeviationParams
) -> Deviations:
    measured = source.mesh
    points = draw_measurement_points(source, params, colored=target.has_color and source.has_color)
    samples, seen = _query_distances(points.positions, target, colored=points.colors is not None)
    if is_cloud(measured):
        at_vertices = samples
    else:
        at_vertices = np.zeros(len(measured.vertices))
        used = np.unique(measured.triangles)
        at_vertices[used], _ = _query_distances(measured.vertices[used], target, colored=False)
    found = MeasuredDistances(target.is_oriented, target.spacing, samples, seen, at_vertices)
    return evaluate_deviations(measured, points, found, params)


@dataclass(frozen=True, eq=False)
class MeasuredDistances:
    """Measured distances and colours before evaluation; see `Deviations`.

    `target_colors` are the reference's colours (k, 3) at the nearest points, or None.
    """

    is_signed: bool
    spacing: float | None
    sample_distances: Floats
    target_colors: Levels | None
    vertex_distances: Floats


def draw_measurement_points(
    source: SampledSurface, params: DeviationParams, *, colored: bool
) -> SamplePoints:
    """Draw the points at which a mesh or cloud is measured."""
    count = source.count_samples(params.signed_samples)
    return source.draw_points(slice(0, count), count, np.random.default_rng(0), colored=colored)


def evaluate_deviations(
    measured: Mesh, points: SamplePoints, distances: MeasuredDistances, params: DeviationParams
) -> Deviations:
    """Evaluate measured distances and colours, and paint the mesh by deviation."""
    delta_e = None
    if points.colors is not None and distances.target_colors is not None:
        parts = [
            _compute_delta_e(points.colors[rows], distances.target_colors[rows])
            for rows in iterate_chunks(len(distances.sample_distances))
        ]
        delta_e = np.concatenate(parts)
    color_range = params.color_range or _derive_color_range(distances.sample_distances, params.tolerance)
    within = params.tolerance if params.tolerance is not None else _DEFAULT_TOLERANCE_RATIO * color_range
    painted = measured.with_(
        colors=colorize_distances(distances.vertex_distances, within, color_range, params.palette),
        texture=None,
    )
    return Deviations(
        is_signed=distances.is_signed,
        spacing=distances.spacing,
        sample_distances=distances.sample_distances,
        sample_points=points.positions,
        vertex_distances=distances.vertex_distances,
        delta_e=delta_e,
        tolerance=params.tolerance,
        in_tolerance_limit=within,
        color_range=color_range,
        painted_mesh=painted,
    )


def _query_distances(
    points: Floats, target: DistanceTarget, *, colored: bool
) -> tuple[Floats, NDArray[np.floating] | None]:
    """Query the distances (k,) from points to a target, and its colours (k, 3).

    Distances are signed if the target is oriented.
    """
    found = [
        target.find_nearest(points[rows], colored=colored, signed=True)
        for rows in iterate_chunks(len(points))
    ]
    distances = np.concatenate([one.distances for one in found])
    colors = [one.colors for one in found if one.colors is not None]
    return distances, np.concatenate(colors) if colors else None


def _derive_color_range(distances: Floats, tolerance: float | None) -> float:
    max_distance = float(np.quantile(np.abs(distances), _COLOR_RANGE_QUANTILE))
    return max(max_distance, 2 * (tolerance or 0.0), float(np.finfo(np.float64).tiny))


def _compute_percentiles(values: Floats) -> dict[str, float]:
    return {f"{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}


def _compute_delta_e(a: NDArray[np.floating], b: NDArray[np.floating]) -> Floats:
    """Return ΔE2000 (Sharma, Wu and Dalal, 2005) between sRGB colours (k, 3), 0 to 255."""
    import skimage.color

    color: Any = skimage.color

    one, two = (color.rgb2lab(np.clip(np.asarray(c, np.float64) / 255, 0, 1)[None])[0] for c in (a, b))
    return np.asarray(color.deltaE_ciede2000(one, two), np.float64)
