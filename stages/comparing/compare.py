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

from scanloom.stages.comparing.asked import Asked, Levels, Nearest, Points, Spread, asked
from scanloom.stages.comparing.measurable import box_of, comparable
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, counted, facts, line, table
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.raycasting import Floats, Surface, bounding_box, chunks

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CompareKeywords

RESULT_VERSION = 5

# Levels. A smaller colour RMSE is interpolation rounding, not a difference; the PSNR is then infinite.
_EQUAL = 1e-4


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
        check(self)


@dataclass(frozen=True)
class Deviation:
    """Distances from one surface to the other, in metres."""

    maximum: float
    mean: float
    rms: float

    def __repr__(self) -> str:
        figures = {"rms_m": self.rms, "mean_m": self.mean, "maximum_m": self.maximum}
        return line(self, facts(figures))

    def figures(self, diagonal: float) -> dict[str, float]:
        """Return the distances in metres and relative to the bounding-box diagonal."""
        figures = {"maximum_m": self.maximum, "mean_m": self.mean, "rms_m": self.rms}
        relative = {
            "maximum_relative": self.maximum / diagonal,
            "mean_relative": self.mean / diagonal,
            "rms_relative": self.rms / diagonal,
        }
        return figures | relative


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

    __repr__ = by_figures

    @property
    def psnr(self) -> float:
        """Peak signal-to-noise ratio in dB; infinite for equal colours."""
        return 20 * math.log10(255 / self.rmse) if self.rmse > _EQUAL else math.inf

    def figures(self) -> dict[str, float | None]:
        """Return the metrics for JSON; an infinite PSNR becomes None."""
        psnr = self.psnr if math.isfinite(self.psnr) else None
        return {"rmse_levels": self.rmse, "psnr_db": psnr, "maximum_levels": self.maximum}


@dataclass(frozen=True)
class CloudFacts:
    """Point count and spacing of a cloud, for judging distances to it.

    Attributes
    ----------
    points : number of points; all are measured.
    spacing : median distance to the nearest neighbour, metres. Distances below the spacing are not
        meaningful, because the surface between the points is unknown.
    """

    points: int
    spacing: float

    __repr__ = by_figures

    def figures(self) -> dict[str, float]:
        """Return both values for JSON, with units in the key names."""
        return {"points": self.points, "spacing_m": self.spacing}


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
    clouds: tuple[CloudFacts | None, CloudFacts | None] = (None, None)

    def __repr__(self) -> str:
        distance, color = self.symmetric, self.color
        figures = {"distance_rms_m": distance.rms, "distance_maximum_m": distance.maximum}
        if color is not None:
            figures["color_rmse_levels"] = color.rmse
        clouds = [
            f"{name} is a cloud of {counted(one.points, 'point')}"
            for name, one in zip("AB", self.clouds, strict=True)
            if one is not None
        ]
        return line(self, [*facts(figures), f"{counted(self.samples, 'sample')} per surface", *clouds])

    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the key names.

        The key `clouds` exists only if A or B is a cloud.
        """
        clouds = {name: one and one.figures() for name, one in zip("ab", self.clouds, strict=True)}
        directions = {"a_to_b": self.a_to_b, "b_to_a": self.b_to_a, "symmetric": self.symmetric}
        colors = {"a_to_b": self.color_a_to_b, "b_to_a": self.color_b_to_a, "symmetric": self.color}
        return {
            "diagonal_m": self.diagonal,
            "samples_per_side": self.samples,
            "distance": {name: value.figures(self.diagonal) for name, value in directions.items()},
            "color": {name: value and value.figures() for name, value in colors.items()}
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
        Colours come from the texture if the mesh has one, else from its vertices (see `color_at`). For a
        cloud, the colour of the nearest point counts.

    Raises
    ------
    MeshError
        If a mesh has no area to sample, or all points of a cloud coincide.
    """
    params = resolve(CompareParams, params, changes)
    mesh_a, mesh_b = comparable(a, "first mesh"), comparable(b, "second mesh")
    box = box_of(mesh_a, mesh_b)
    return _compared(asked(mesh_a, box), asked(mesh_b, box), params)


def compare_surfaces(a: Surface, b: Surface, params: CompareParams) -> Comparison:
    """Compare two surfaces whose search structures already exist; see `compare`.

    Parameters
    ----------
    a, b : surfaces built for a box around both meshes. Both meshes have passed `require_area`.
    params : sampling density and seed.
    """
    box = bounding_box(a.mesh, b.mesh)
    return compare_searched(WithNeedles(a, box), WithNeedles(b, box), params)


def compare_searched(a: WithNeedles, b: WithNeedles, params: CompareParams) -> Comparison:
    """Compare two surfaces with needle-safe search structures that already exist; see `compare_surfaces`."""
    box = bounding_box(a.mesh, b.mesh)
    return _compared(asked(a.mesh, box, a), asked(b.mesh, box, b), params)


def _compared(a: Asked, b: Asked, params: CompareParams) -> Comparison:
    forward = one_way(a, b, params.samples, (params.seed, 0))
    backward = one_way(b, a, params.samples, (params.seed, 1))
    clouds = _facts_of(a), _facts_of(b)
    return comparison_of(forward, backward, box_of(a.mesh), params.samples, clouds)


def comparison_of(
    forward: Sums,
    backward: Sums,
    box: Floats,
    samples: int,
    clouds: tuple[CloudFacts | None, CloudFacts | None] = (None, None),
) -> Comparison:
    """Combine the sums of both directions into a comparison.

    `box` (2, 3) is the bounding box of A.
    """
    both = forward.merged(backward.counted_as(forward.count))
    low, high = box
    return Comparison(
        a_to_b=forward.deviation(),
        b_to_a=backward.deviation(),
        symmetric=both.deviation(),
        color_a_to_b=forward.color(),
        color_b_to_a=backward.color(),
        color=both.color(),
        diagonal=float(np.linalg.norm(high - low)),
        samples=samples,
        clouds=clouds,
    )


def _facts_of(one: Asked) -> CloudFacts | None:
    return None if one.spacing is None else CloudFacts(len(one.mesh.vertices), one.spacing)


@dataclass(frozen=True)
class Sums:
    """Accumulated distances (metres) and colour differences (levels) of one direction.

    `color_squared` : None without colours.
    """

    count: int
    total: float
    squared: float
    maximum: float
    color_squared: float | None
    color_maximum: float

    def counted_as(self, count: int) -> Sums:
        """Rescale the sums to a point count, to weight both directions equally."""
        factor = count / self.count
        color = None if self.color_squared is None else factor * self.color_squared
        return replace(
            self, count=count, total=factor * self.total, squared=factor * self.squared, color_squared=color
        )

    def merged(self, other: Sums) -> Sums:
        """Add the sums of another set of points."""
        colored = self.color_squared is not None and other.color_squared is not None
        return Sums(
            self.count + other.count,
            self.total + other.total,
            self.squared + other.squared,
            max(self.maximum, other.maximum),
            (self.color_squared or 0) + (other.color_squared or 0) if colored else None,
            max(self.color_maximum, other.color_maximum),
        )

    def deviation(self) -> Deviation:
        """Return maximum, mean and RMS of the distances."""
        return Deviation(self.maximum, self.total / self.count, math.sqrt(self.squared / self.count))

    def color(self) -> ColorError | None:
        """Return RMSE and maximum of the colour differences; None without colours."""
        if self.color_squared is None:
            return None
        return ColorError(math.sqrt(self.color_squared / (3 * self.count)), self.color_maximum)


def one_way(source: Spread, target: Asked, wanted: int, seed: tuple[int, int]) -> Sums:
    """Accumulate distances and colour differences from samples of `source` to `target`."""
    rng = np.random.default_rng(seed)
    colored = source.has_color and target.has_color
    count = source.samples(wanted)
    return all_sums(
        colored,
        (_measured(source.spread(rows, count, rng, colored=colored), target) for rows in chunks(count)),
        (_measured(points, target) for points in source.corners(colored=colored)),
    )


def sampled_color_error(source: Spread, target: Asked, wanted: int) -> ColorError | None:
    """Measure the colour error from samples of one surface to another.

    Returns None unless both have colours.
    """
    if not (source.has_color and target.has_color):
        return None
    rng = np.random.default_rng((0, 0))
    count = source.samples(wanted)
    parts = (_measured(source.spread(rows, count, rng, colored=True), target) for rows in chunks(count))
    return all_sums(True, parts, ()).color()


def all_sums(colored: bool, of_samples: Iterable[Sums], of_corners: Iterable[Sums]) -> Sums:
    """Accumulate the sums over samples; `of_corners` count only for the maximum."""
    sums = Sums(0, 0.0, 0.0, 0.0, 0.0 if colored else None, 0.0)
    for one in of_samples:
        sums = sums.merged(one)
    at_corners = list(of_corners)
    return replace(
        sums,
        maximum=max([sums.maximum, *(one.maximum for one in at_corners)]),
        color_maximum=max([sums.color_maximum, *(one.color_maximum for one in at_corners)]),
    )


def _measured(points: Points, target: Asked) -> Sums:
    return sums_of(points.colors, target.nearest(points.places, colored=points.colors is not None))


def sums_of(colors: Levels | None, nearest: Nearest) -> Sums:
    """Compute the sums for query points with colours (k, 3) and their nearest points."""
    d = nearest.distances
    color_squared, color_maximum = None, 0.0
    if colors is not None and nearest.colors is not None:
        difference = np.abs(colors - nearest.colors)
        color_squared, color_maximum = float(np.sum(difference**2)), float(difference.max())
    return Sums(len(d), float(d.sum()), float((d * d).sum()), float(d.max()), color_squared, color_maximum)
