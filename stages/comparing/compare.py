"""How far apart two meshes are, or a mesh and a cloud of points, in shape and in colour.

Both surfaces are sampled densely, each sample is taken to the nearest point of the other surface, and the
distances are summed up in both directions (Cignoni, Rocchini and Scopigno, "Metro: measuring error on
simplified surfaces", 1998). Samples are spread over the area, so mean and RMS are integrals over the
surface; the maximum also looks at every vertex, where simplified surfaces stray most. Of a cloud every point
is a sample, and distances to it are to its nearest point.
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

# A colour error below this (levels) is the rounding of interpolation, not a difference.
_EQUAL = 1e-4


@dataclass(frozen=True, kw_only=True)
class CompareParams:
    """How densely two meshes are compared."""

    samples: int = param(
        500_000,
        "Points sampled on each surface, spread evenly over its area; every vertex counts besides, for the "
        "maximum. The relative error of mean and RMS falls with the square root of it.",
        low=1,
        high=100_000_000,
    )
    seed: int = param(0, "Seed of the sampling; the same seed gives the same figures.", low=0)

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
        """Return the distances in metres, and relative to the bounding-box diagonal."""
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
    rmse : over all samples and the three channels.
    maximum : the largest difference of one channel at one point, 0 to 255.
    """

    rmse: float
    maximum: float

    __repr__ = by_figures

    @property
    def psnr(self) -> float:
        """Return the peak signal-to-noise ratio in dB for a peak of 255 levels; inf for equal colours."""
        return 20 * math.log10(255 / self.rmse) if self.rmse > _EQUAL else math.inf

    def figures(self) -> dict[str, float | None]:
        """Return RMSE and maximum in levels and the PSNR in dB (None, not infinity, for equal colours)."""
        psnr = self.psnr if math.isfinite(self.psnr) else None
        return {"rmse_levels": self.rmse, "psnr_db": psnr, "maximum_levels": self.maximum}


@dataclass(frozen=True)
class CloudFacts:
    """What there is to know of a cloud to read distances to it.

    Attributes
    ----------
    points : all of them are measured.
    spacing : metres from a point to its nearest neighbour, the median. Less than this a distance to the cloud
        says little: between its points, nothing tells where the surface is.
    """

    points: int
    spacing: float

    __repr__ = by_figures

    def figures(self) -> dict[str, float]:
        """Return both, units in the names."""
        return {"points": self.points, "spacing_m": self.spacing}


@dataclass(frozen=True)
class Comparison:
    """The two-sided distance of two meshes or clouds A and B.

    Attributes
    ----------
    a_to_b, b_to_a : from each surface to the other. Different where one of them is incomplete.
    symmetric : both together, each as much as the other; its maximum is the Hausdorff distance, as far as the
        samples see it.
    color_a_to_b, color_b_to_a, color : the same for colour; None unless both meshes have colours.
    diagonal : metres, of the bounding box of A; what relative figures refer to.
    samples : on each surface.
    clouds : of A and B, what there is to know of it where it is a cloud.
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
            f"{name} a cloud of {counted(one.points, 'point')}"
            for name, one in zip("AB", self.clouds, strict=True)
            if one is not None
        ]
        return line(self, [*facts(figures), f"{counted(self.samples, 'sample')} a surface", *clouds])

    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON, units in the names; those of clouds only where there are any."""
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
    """Measure the two-sided distance and colour error between two meshes, or a mesh and a cloud.

    Parameters
    ----------
    a, b : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres. Without triangles it is a cloud.
        Relative distances refer to the bounding-box diagonal of `a`, so give the reference first.
    params : see CompareParams; its fields can also be given by name.

    Returns
    -------
    Comparison
        Colours are those of the texture where there is one, else of the vertices; see `color_at`. Those of a
        cloud are of its nearest point.

    Raises
    ------
    MeshError
        If a mesh has no area to sample, or a cloud is all in one place.
    """
    params = resolve(CompareParams, params, changes)
    mesh_a, mesh_b = comparable(a, "first mesh"), comparable(b, "second mesh")
    box = box_of(mesh_a, mesh_b)
    return _compared(asked(mesh_a, box), asked(mesh_b, box), params)


def compare_surfaces(a: Surface, b: Surface, params: CompareParams) -> Comparison:
    """Do as `compare` does, with surfaces that serve other queries too.

    Their boxes hold both meshes, and both have passed `require_area`.
    """
    box = bounding_box(a.mesh, b.mesh)
    return compare_searched(WithNeedles(a, box), WithNeedles(b, box), params)


def compare_searched(a: WithNeedles, b: WithNeedles, params: CompareParams) -> Comparison:
    """Do as `compare_surfaces` does, with what finds needles too."""
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
    """Return what both directions come to; `box` (2, 3) is that of A."""
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
    """What one direction adds up to; colour fields stay None without colours."""

    count: int
    total: float
    squared: float
    maximum: float
    color_squared: float | None
    color_maximum: float

    def counted_as(self, count: int) -> Sums:
        """Return the sums as of so many points, so that a cloud of many weighs no more than a surface."""
        factor = count / self.count
        color = None if self.color_squared is None else factor * self.color_squared
        return replace(
            self, count=count, total=factor * self.total, squared=factor * self.squared, color_squared=color
        )

    def merged(self, other: Sums) -> Sums:
        """Return the sums over both."""
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
        """Return the distances they tell."""
        return Deviation(self.maximum, self.total / self.count, math.sqrt(self.squared / self.count))

    def color(self) -> ColorError | None:
        """Return the differences of colour they tell."""
        if self.color_squared is None:
            return None
        return ColorError(math.sqrt(self.color_squared / (3 * self.count)), self.color_maximum)


def one_way(source: Spread, target: Asked, wanted: int, seed: tuple[int, int]) -> Sums:
    """Measure from points of one to the other."""
    rng = np.random.default_rng(seed)
    colored = source.has_color and target.has_color
    count = source.samples(wanted)
    return all_sums(
        colored,
        (_measured(source.spread(rows, count, rng, colored=colored), target) for rows in chunks(count)),
        (_measured(points, target) for points in source.corners(colored=colored)),
    )


def sampled_color_error(source: Spread, target: Asked, wanted: int) -> ColorError | None:
    """Measure the difference of colour from samples of one surface to the other; None without colours."""
    if not (source.has_color and target.has_color):
        return None
    rng = np.random.default_rng((0, 0))
    count = source.samples(wanted)
    parts = (_measured(source.spread(rows, count, rng, colored=True), target) for rows in chunks(count))
    return all_sums(True, parts, ()).color()


def all_sums(colored: bool, of_samples: Iterable[Sums], of_corners: Iterable[Sums]) -> Sums:
    """Return the sums over samples; corners count for the maximum alone."""
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
    """Return what points of these colours (k, 3) add up to."""
    d = nearest.distances
    color_squared, color_maximum = None, 0.0
    if colors is not None and nearest.colors is not None:
        difference = np.abs(colors - nearest.colors)
        color_squared, color_maximum = float(np.sum(difference**2)), float(difference.max())
    return Sums(len(d), float(d.sum()), float((d * d).sum()), float(d.max()), color_squared, color_maximum)
