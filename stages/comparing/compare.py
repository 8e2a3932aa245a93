"""How far apart two meshes are, in shape and in colour.

Both surfaces are sampled densely, each sample is taken to the nearest point of the other surface, and the
distances are summed up in both directions (Cignoni, Rocchini and Scopigno, "Metro: measuring error on
simplified surfaces", 1998). Samples are spread over the area, so mean and RMS are integrals over the
surface; the maximum also looks at every vertex, where simplified surfaces stray most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stages.comparing.measurable import measurable
from stages.comparing.needles import WithNeedles
from stages.comparing.sampling import sampled
from stages.params import check, param, resolve
from stages.printing import by_figures, counted, facts, line, table
from stages.surface.color import color_at, has_color
from stages.surface.convert import MeshLike
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Floats, Surface, bounding_box, chunks, interpolated
from stages.surface.topology import areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

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


class CompareKeywords(TypedDict, total=False):
    """CompareParams as keywords of `compare`."""

    samples: int
    seed: int


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
class Comparison:
    """The two-sided distance of two meshes A and B.

    Attributes
    ----------
    a_to_b, b_to_a : from each surface to the other. Different where one of them is incomplete.
    symmetric : both together; its maximum is the Hausdorff distance, as far as the samples see it.
    color_a_to_b, color_b_to_a, color : the same for colour; None unless both meshes have colours.
    diagonal : metres, of the bounding box of A; what relative figures refer to.
    samples : on each surface.
    """

    a_to_b: Deviation
    b_to_a: Deviation
    symmetric: Deviation
    color_a_to_b: ColorError | None
    color_b_to_a: ColorError | None
    color: ColorError | None
    diagonal: float
    samples: int

    def __repr__(self) -> str:
        distance, color = self.symmetric, self.color
        figures = {"distance_rms_m": distance.rms, "distance_maximum_m": distance.maximum}
        if color is not None:
            figures["color_rmse_levels"] = color.rmse
        return line(self, [*facts(figures), f"{counted(self.samples, 'sample')} a side"])

    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON, units in the names."""
        directions = {"a_to_b": self.a_to_b, "b_to_a": self.b_to_a, "symmetric": self.symmetric}
        colors = {"a_to_b": self.color_a_to_b, "b_to_a": self.color_b_to_a, "symmetric": self.color}
        return {
            "diagonal_m": self.diagonal,
            "samples_per_side": self.samples,
            "distance": {name: value.figures(self.diagonal) for name, value in directions.items()},
            "color": {name: value and value.figures() for name, value in colors.items()}
            if self.color
            else None,
        }


def compare(
    a: MeshLike, b: MeshLike, params: CompareParams | None = None, **changes: Unpack[CompareKeywords]
) -> Comparison:
    """Measure the two-sided distance and colour error between two meshes.

    Parameters
    ----------
    a, b : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres. Relative distances refer to
        the bounding-box diagonal of `a`, so give the reference first.
    params : see CompareParams; its fields can also be given by name.

    Returns
    -------
    Comparison
        Colours are those of the texture where there is one, else of the vertices; see `color_at`.

    Raises
    ------
    MeshError
        If a mesh has no triangles, or no area to sample.
    """
    params = resolve(CompareParams, params, changes)
    mesh_a, mesh_b = measurable(a, "first mesh"), measurable(b, "second mesh")
    box = bounding_box(mesh_a, mesh_b)
    return compare_surfaces(Surface(mesh_a, box), Surface(mesh_b, box), params)


def compare_surfaces(a: Surface, b: Surface, params: CompareParams) -> Comparison:
    """Do as `compare` does, with surfaces that serve other queries too.

    Their boxes hold both meshes, and both have passed `require_area`.
    """
    box = bounding_box(a.mesh, b.mesh)
    return compare_searched(WithNeedles(a, box), WithNeedles(b, box), params)


def compare_searched(a: WithNeedles, b: WithNeedles, params: CompareParams) -> Comparison:
    """Do as `compare_surfaces` does, with what finds needles too."""
    forward = _one_way(a.mesh, b, params.samples, (params.seed, 0))
    backward = _one_way(b.mesh, a, params.samples, (params.seed, 1))
    both = forward.merged(backward)
    low, high = bounding_box(a.mesh)
    return Comparison(
        a_to_b=forward.deviation(),
        b_to_a=backward.deviation(),
        symmetric=both.deviation(),
        color_a_to_b=forward.color(),
        color_b_to_a=backward.color(),
        color=both.color(),
        diagonal=float(np.linalg.norm(high - low)),
        samples=params.samples,
    )


@dataclass(frozen=True)
class _Sums:
    """What one direction adds up to; colour fields stay None without colours."""

    count: int
    total: float
    squared: float
    maximum: float
    color_squared: float | None
    color_maximum: float

    def merged(self, other: _Sums) -> _Sums:
        colored = self.color_squared is not None and other.color_squared is not None
        return _Sums(
            self.count + other.count,
            self.total + other.total,
            self.squared + other.squared,
            max(self.maximum, other.maximum),
            (self.color_squared or 0) + (other.color_squared or 0) if colored else None,
            max(self.color_maximum, other.color_maximum),
        )

    def deviation(self) -> Deviation:
        return Deviation(self.maximum, self.total / self.count, math.sqrt(self.squared / self.count))

    def color(self) -> ColorError | None:
        if self.color_squared is None:
            return None
        return ColorError(math.sqrt(self.color_squared / (3 * self.count)), self.color_maximum)


def _one_way(mesh: Mesh, other: WithNeedles, count: int, seed: tuple[int, int]) -> _Sums:
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(areas(mesh.vertices, mesh.triangles))
    colored = has_color(mesh) and has_color(other.mesh)
    sums = _Sums(0, 0.0, 0.0, 0.0, 0.0 if colored else None, 0.0)
    for rows in chunks(count):
        at = sampled(cumulative, rows, count, rng)
        colors = color_at(mesh, at.triangles, at.weights) if colored else None
        sums = sums.merged(_measured(interpolated(mesh.vertices, mesh, at), colors, other))
    at_vertices = list(_at_vertices(mesh, other))
    return replace(
        sums,
        maximum=max([sums.maximum, *(one.maximum for one in at_vertices)]),
        color_maximum=max([sums.color_maximum, *(one.color_maximum for one in at_vertices)]),
    )


def _at_vertices(mesh: Mesh, other: WithNeedles) -> Iterator[_Sums]:
    # A corner of each vertex in use: along a seam of a texture it has several colours, and one is looked at.
    used, corners = np.unique(mesh.triangles, return_index=True)
    colored = has_color(mesh) and has_color(other.mesh)
    for rows in chunks(len(used)):
        colors = None
        if colored:
            colors = color_at(mesh, corners[rows] // 3, np.eye(3)[corners[rows] % 3])
        yield _measured(mesh.vertices[used[rows]], colors, other)


def _measured(points: Floats, colors: NDArray[np.floating] | None, other: WithNeedles) -> _Sums:
    nearest = other.closest(points)
    d = nearest.distances
    color_squared, color_maximum = None, 0.0
    if colors is not None:
        seen = color_at(other.mesh, nearest.triangles, nearest.weights)
        difference = np.abs(colors - seen)
        color_squared, color_maximum = float(np.sum(difference**2)), float(difference.max())
    return _Sums(len(d), float(d.sum()), float((d * d).sum()), float(d.max()), color_squared, color_maximum)
