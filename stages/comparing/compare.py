"""Sampled distance and colour error between meshes and point clouds.

Both surfaces are sampled densely. The distances from the samples to the other surface are accumulated in both
directions (Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998). Samples
are uniform over the area, so mean and RMS approximate integrals over the surface. The maximum also includes
every vertex, where simplified surfaces deviate most. Every point of a cloud is a sample, and distances to a
cloud are to its nearest point.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.comparing.comparison_inputs import compute_joint_box, to_mesh_or_cloud
from scanloom.stages.comparing.distance_target import (
    DistanceTarget,
    Levels,
    NearestPoints,
    SampledSurface,
    SamplePoints,
    make_distance_target,
)
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, format_count, format_facts, format_line, render_table
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_bounding_box, iterate_chunks

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CompareKeywords

RESULT_VERSION = 5

# Levels. A smaller colour RMSE is interpolation rounding, not a difference; the PSNR is then infinite.
_MAX_ROUNDING_LEVELS = 1e-4


@dataclass(frozen=True, kw_only=True)
class CompareParams:
    """Sampling density and seed of a comparison."""

    samples: int = param(
        500_000,
        "Points sampled on each surface, uniformly over its area; every vertex also counts for the maximum. "
        "The relative error of mean and RMS falls with the square root of this number.",
        low=1,
        high=100_000_000,
    )
    seed: int = param(0, "Random seed of the sampling; the same seed gives the same result.", low=0)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True)
class Deviation:
    """Distances from one surface to the other, in metres."""

    maximum: float
    mean: float
    rms: float

    def __repr__(self) -> str:
        metrics = {"rms_m": self.rms, "mean_m": self.mean, "maximum_m": self.maximum}
        return format_line(self, format_facts(metrics))

    def to_dict(self, diagonal: float) -> dict[str, float]:
        """Return the distances in metres and relative to the bounding-box diagonal."""
        metrics = {"maximum_m": self.maximum, "mean_m": self.mean, "rms_m": self.rms}
        relative = {
            "maximum_relative": self.maximum / diagonal,
            "mean_relative": self.mean / diagonal,
            "rms_relative": self.rms / diagonal,
        }
        return metrics | relative


@dataclass(frozen=True)
class ColorError:
    """Colour differences at corresponding points, in 8-bit levels.

    Attributes
    ----------
    rmse : root mean square over all samples and the three channels.
    maximum : largest difference of one channel at one point, 0 to 255.
    """

    rmse: float
    maximum: float

    __repr__ = format_by_metrics

    @property
    def psnr(self) -> float:
        """Peak signal-to-noise ratio in dB; infinite for equal colours."""
        return 20 * math.log10(255 / self.rmse) if self.rmse > _MAX_ROUNDING_LEVELS else math.inf

    def to_dict(self) -> dict[str, float | None]:
        """Return the metrics for JSON; an infinite PSNR becomes None."""
        psnr = self.psnr if math.isfinite(self.psnr) else None
        return {"rmse_levels": self.rmse, "psnr_db": psnr, "maximum_levels": self.maximum}


@dataclass(frozen=True)
class CloudStatistics:
    """Point count and spacing of a cloud, for judging distances to it.

    Attributes
    ----------
    point_count : number of points; all are measured.
    spacing_m : median distance to the nearest neighbour, metres. Distances below the spacing are not
        meaningful, because the surface between the points is unknown.
    """

    point_count: int
    spacing_m: float

    __repr__ = format_by_metrics

    def to_dict(self) -> dict[str, float]:
        """Return both values for JSON, with units in the key names."""
        return {"points": self.point_count, "spacing_m": self.spacing_m}


@dataclass(frozen=True)
class Comparison:
    """Two-sided distance and colour error of meshes or clouds A and B.

    Attributes
    ----------
    a_to_b, b_to_a : one-sided distances. They differ if one of the surfaces is incomplete.
    symmetric : both directions with equal weight; its maximum is the sampled Hausdorff distance.
    color_a_to_b, color_b_to_a, color : the same for colour; None unless both A and B have colours.
    diagonal : bounding-box diagonal of A in metres; relative values refer to it.
    samples : number of samples on each surface.
    clouds : cloud statistics of A and of B; None for a mesh.
    """

    a_to_b: Deviation
    b_to_a: Deviation
    symmetric: Deviation
    color_a_to_b: ColorError | None
    color_b_to_a: ColorError | None
    color: ColorError | None
    diagonal: float
    samples: int
    clouds: tuple[CloudStatistics | None, CloudStatistics | None] = (None, None)

    def __repr__(self) -> str:
        distance, color = self.symmetric, self.color
        metrics = {"distance_rms_m": distance.rms, "distance_maximum_m": distance.maximum}
        if color is not None:
            metrics["color_rmse_levels"] = color.rmse
        clouds = [
            f"{name} is a cloud of {format_count(one.point_count, 'point')}"
            for name, one in zip("AB", self.clouds, strict=True)
            if one is not None
        ]
        return format_line(
            self, [*format_facts(metrics), f"{format_count(self.samples, 'sample')} per surface", *clouds]
        )

    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the key names.

        The key `clouds` exists only if A or B is a cloud.
        """
        clouds = {name: one and one.to_dict() for name, one in zip("ab", self.clouds, strict=True)}
        directions = {"a_to_b": self.a_to_b, "b_to_a": self.b_to_a, "symmetric": self.symmetric}
        colors = {"a_to_b": self.color_a_to_b, "b_to_a": self.color_b_to_a, "symmetric": self.color}
        return {
            "diagonal_m": self.diagonal,
            "samples_per_side": self.samples,
            "distance": {name: value.to_dict(self.diagonal) for name, value in directions.items()},
            "color": {name: value and value.to_dict() for name, value in colors.items()}
            if self.color
            else None,
            **({"clouds": clouds} if any(self.clouds) else {}),
        }


def compare(
    a: MeshLike, b: MeshLike, params: CompareParams | None = None, **changes: Unpack[CompareKeywords]
) -> Comparison:
    """Measure the distance and colour error between two meshes or clouds.

    Parameters
    ----------
    a, b : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres. Input without triangles is a cloud.
        Relative distances refer to the bounding-box diagonal of `a`, so give the reference first.
    params : see CompareParams; its fields can also be given by name.

    Returns
    -------
    Comparison
        Colours come from the texture if the mesh has one, else from its vertices (see
        `compute_surface_colors`). For a cloud, the colour of the nearest point counts.

    Raises
    ------
    MeshError
        If a mesh has no area to sample, or all points of a cloud coincide.
    """
    params = resolve(CompareParams, params, changes)
    mesh_a, mesh_b = to_mesh_or_cloud(a, "first mesh"), to_mesh_or_cloud(b, "second mesh")
    box = compute_joint_box(mesh_a, mesh_b)
    return _compare_targets(make_distance_target(mesh_a, box), make_distance_target(mesh_b, box), params)


def compare_surfaces(a: RaycastingSurface, b: RaycastingSurface, params: CompareParams) -> Comparison:
    """Compare two surfaces whose search structures already exist; see `compare`.

    Parameters
    ----------
    a, b : surfaces built for a box around both meshes. Both meshes have passed `require_area`.
    params : sampling density and seed.
    """
    box = compute_bounding_box(a.mesh, b.mesh)
    return compare_needle_safe(NeedleSafeSurface(a, box), NeedleSafeSurface(b, box), params)


def compare_needle_safe(a: NeedleSafeSurface, b: NeedleSafeSurface, params: CompareParams) -> Comparison:
    """Compare two surfaces with needle-safe search structures that already exist; see `compare_surfaces`."""
    box = compute_bounding_box(a.mesh, b.mesh)
    return _compare_targets(
        make_distance_target(a.mesh, box, a), make_distance_target(b.mesh, box, b), params
    )


def _compare_targets(a: DistanceTarget, b: DistanceTarget, params: CompareParams) -> Comparison:
    forward = accumulate_one_way(a, b, params.samples, (params.seed, 0))
    backward = accumulate_one_way(b, a, params.samples, (params.seed, 1))
    clouds = _collect_cloud_statistics(a), _collect_cloud_statistics(b)
    return combine_directions(forward, backward, compute_joint_box(a.mesh), params.samples, clouds)


def combine_directions(
    forward: DistanceSums,
    backward: DistanceSums,
    box: Floats,
    samples: int,
    clouds: tuple[CloudStatistics | None, CloudStatistics | None] = (None, None),
) -> Comparison:
    """Combine the sums of both directions into a comparison.

    `box` (2, 3) is the bounding box of A.
    """
    both = forward.merge(backward.rescale_to(forward.count))
    low, high = box
    return Comparison(
        a_to_b=forward.compute_deviation(),
        b_to_a=backward.compute_deviation(),
        symmetric=both.compute_deviation(),
        color_a_to_b=forward.compute_color_error(),
        color_b_to_a=backward.compute_color_error(),
        color=both.compute_color_error(),
        diagonal=float(np.linalg.norm(high - low)),
        samples=samples,
        clouds=clouds,
    )


def _collect_cloud_statistics(one: DistanceTarget) -> CloudStatistics | None:
    return None if one.spacing is None else CloudStatistics(len(one.mesh.vertices), one.spacing)


@dataclass(frozen=True)
class DistanceSums:
    """Accumulated distances (metres) and colour differences (levels) of one direction.

    `color_squared_total` : None without colours.
    """

    count: int
    total: float
    squared_total: float
    maximum: float
    color_squared_total: float | None
    color_maximum: float

    def rescale_to(self, count: int) -> DistanceSums:
        """Rescale the sums to a point count, to weight both directions equally."""
        factor = count / self.count
        color = None if self.color_squared_total is None else factor * self.color_squared_total
        return replace(
            self,
            count=count,
            total=factor * self.total,
            squared_total=factor * self.squared_total,
            color_squared_total=color,
        )

    def merge(self, other: DistanceSums) -> DistanceSums:
        """Add the sums of another set of points."""
        colored = self.color_squared_total is not None and other.color_squared_total is not None
        return DistanceSums(
            self.count + other.count,
            self.total + other.total,
            self.squared_total + other.squared_total,
            max(self.maximum, other.maximum),
            (self.color_squared_total or 0) + (other.color_squared_total or 0) if colored else None,
            max(self.color_maximum, other.color_maximum),
        )

    def compute_deviation(self) -> Deviation:
        """Return maximum, mean and RMS of the distances."""
        return Deviation(self.maximum, self.total / self.count, math.sqrt(self.squared_total / self.count))

    def compute_color_error(self) -> ColorError | None:
        """Return RMSE and maximum of the colour differences; None without colours."""
        if self.color_squared_total is None:
            return None
        return ColorError(math.sqrt(self.color_squared_total / (3 * self.count)), self.color_maximum)


def accumulate_one_way(
    source: SampledSurface, target: DistanceTarget, sample_count: int, seed: tuple[int, int]
) -> DistanceSums:
    """Accumulate distances and colour differences from samples of `source` to `target`."""
    rng = np.random.default_rng(seed)
    colored = source.has_color and target.has_color
    count = source.count_samples(sample_count)
    return merge_sums(
        colored,
        (
            _measure_points(source.draw_points(rows, count, rng, colored=colored), target)
            for rows in iterate_chunks(count)
        ),
        (_measure_points(points, target) for points in source.iterate_extra_points(colored=colored)),
    )


def measure_color_error(
    source: SampledSurface, target: DistanceTarget, sample_count: int
) -> ColorError | None:
    """Measure the colour error from samples of one surface to another.

    Returns None unless both have colours.
    """
    if not (source.has_color and target.has_color):
        return None
    rng = np.random.default_rng((0, 0))
    count = source.count_samples(sample_count)
    parts = (
        _measure_points(source.draw_points(rows, count, rng, colored=True), target)
        for rows in iterate_chunks(count)
    )
    return merge_sums(True, parts, ()).compute_color_error()


def merge_sums(
    is_colored: bool, sample_sums: Iterable[DistanceSums], extra_sums: Iterable[DistanceSums]
) -> DistanceSums:
    """Accumulate the sums over samples; `extra_sums` count only for the maximum."""
    sums = DistanceSums(0, 0.0, 0.0, 0.0, 0.0 if is_colored else None, 0.0)
    for one in sample_sums:
        sums = sums.merge(one)
    at_corners = list(extra_sums)
    return replace(
        sums,
        maximum=max([sums.maximum, *(one.maximum for one in at_corners)]),
        color_maximum=max([sums.color_maximum, *(one.color_maximum for one in at_corners)]),
    )


def _measure_points(points: SamplePoints, target: DistanceTarget) -> DistanceSums:
    return compute_sums(
        points.colors, target.find_nearest(points.positions, colored=points.colors is not None)
    )


def compute_sums(colors: Levels | None, nearest: NearestPoints) -> DistanceSums:
    """Sum up the distances and colour differences of query points.

    `colors` (k, 3) are the colours of the query points.
    """
    d = nearest.distances
    color_squared, color_maximum = None, 0.0
    if colors is not None and nearest.colors is not None:
        difference = np.abs(colors - nearest.colors)
        color_squared, color_maximum = float(np.sum(difference**2)), float(difference.max())
    return DistanceSums(
        len(d), float(d.sum()), float((d * d).sum()), float(d.max()), color_squared, color_maximum
    )
