"""What triangles buy: how far a mesh is off at any number of them, from one simplification.

The collapses of one run are kept, and replayed to each number on the way (Hoppe, "Progressive meshes", 1996);
each mesh is measured against the input both ways, as `compare` does it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.measurable import measurable
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.comparing.sampling import sampled
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, rows_table, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.simplification.codes import (
    SIMPLIFY_COUNT_NOT_REACHED,
    SIMPLIFY_CROWDED,
    SIMPLIFY_SEAM_DRIFT,
    SIMPLIFY_TRADEOFF,
)
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.color import color_at, has_color
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import write_mesh
from scanloom.stages.surface.raycasting import Floats, Located, Surface, bounding_box, interpolated, is_used
from scanloom.stages.surface.topology import areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TradeoffKeywords

_PERCENT = 95
# Codes of diagnostics about a number of triangles alone.
_OF_FEWEST = (SIMPLIFY_COUNT_NOT_REACHED.name, SIMPLIFY_CROWDED.name, SIMPLIFY_SEAM_DRIFT.name)


@dataclass(frozen=True, kw_only=True)
class TradeoffParams:
    """At which numbers of triangles a mesh is measured, and which of them is suggested."""

    steps: int = param(
        12, "How many numbers of triangles, each the same share of the one before.", low=2, high=1000
    )
    least: float = param(
        0.01, "The smallest of them, as a share of the input's triangles.", low=0, high=1, low_open=True
    )
    within: float | None = param(
        None,
        "Suggest the smallest number at which 95 % of both surfaces are this near to the other. Not given: "
        "the one where the curve of the distance over the logarithm of the number bends most.",
        unit="m",
        low=0,
        common=True,
    )
    samples: int = param(
        100_000,
        "Points sampled on each surface, spread evenly over its area; every vertex counts besides, for the "
        "maximum.",
        low=1,
        high=100_000_000,
    )
    glb_bytes: bool = param(False, "Also tell how large each is as a GLB file.")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, kw_only=True)
class TradeoffPoint:
    """A mesh on the way, and how far it is from the input.

    Attributes
    ----------
    triangles : of it; share, of the input's.
    rms_m, percentile_95_m, maximum_m : distances, both ways together, metres.
    color_rmse_levels : colour difference of corresponding points, 8-bit levels; None without colours.
    glb_bytes : of its GLB file; None if that was not asked for.
    """

    triangles: int
    share: float
    rms_m: float
    percentile_95_m: float
    maximum_m: float
    color_rmse_levels: float | None
    glb_bytes: int | None

    __repr__ = by_figures

    def figures(self) -> dict[str, Any]:
        """Return all of it, units in the names."""
        return asdict(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tradeoff:
    """The curve of error against triangles.

    Attributes
    ----------
    method : of simplification, whose collapses were kept.
    points : from most triangles to fewest.
    suggested : triangles; None where no number is within what was asked for, or there are too few to tell.
    why : what that number is suggested for.
    mesh : with so many triangles, or else with the fewest.
    record : replays to any other number.
    diagnostics : of the simplification and of the figures.
    """

    method: str
    points: tuple[TradeoffPoint, ...]
    suggested: int | None
    why: str
    mesh: Mesh
    record: CollapseRecord
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures

    def figures(self) -> dict[str, Any]:
        """Return the curve for JSON, units in the names."""
        return {
            "method": self.method,
            "suggested_triangles": self.suggested,
            "suggested_for": self.why,
            "points": [point.figures() for point in self.points],
        }

    def rows(self) -> list[list[str]]:
        """Return the curve as words, a heading first; columns that say nothing are left out."""
        head = ["triangles", "share", "RMS m", "95 % m", "maximum m", "colour levels", "GLB bytes"]
        rows = [
            [
                f"{point.triangles:,}",
                f"{100 * point.share:.3g} %",
                *(f"{value:.3g}" for value in (point.rms_m, point.percentile_95_m, point.maximum_m)),
                "" if point.color_rmse_levels is None else f"{point.color_rmse_levels:.3g}",
                "" if point.glb_bytes is None else f"{point.glb_bytes:,}",
            ]
            for point in self.points
        ]
        told = [any(column) for column in zip(*rows, strict=True)]
        return [[word for word, shown in zip(row, told, strict=True) if shown] for row in (head, *rows)]

    def _repr_html_(self) -> str:
        return table(self) + rows_table(self.rows())


def tradeoff(
    mesh: MeshLike,
    params: TradeoffParams | None = None,
    *,
    counts: Sequence[int] = (),
    progress: Progress = silent,
    **changes: Unpack[TradeoffKeywords],
) -> Tradeoff:
    """Measure how far a mesh is off at each of several numbers of triangles, and suggest one of them.

    What `simplify` gives out for a number alone, by method `quadric` or, with texture, `seams`: the same
    but for the weight of colours, which it derives from the number that is asked for.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres.
    params : TradeoffParams; single fields can be given by name instead.
    counts : numbers of triangles, in place of `steps` and `least`.
    progress : told of meshes that are measured.

    Raises
    ------
    MeshError
        If the mesh has no area.
    UsageError
        If a parameter is out of range, or a number of triangles below 1.

    References
    ----------
    The bend after Satopää, Albrecht, Irwin and Raghavan, "Finding a kneedle in a haystack", 2011.
    """
    with collecting() as diagnostics:
        found = _tradeoff(mesh, resolve(TradeoffParams, params, changes), counts, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _tradeoff(mesh: MeshLike, params: TradeoffParams, counts: Sequence[int], progress: Progress) -> Tradeoff:
    reference = measurable(mesh, "mesh")
    before = len(reference.triangles)
    wanted = _wanted(before, params, counts)
    progress(0, len(wanted) + 1)
    with collecting(forward=False):
        light = simplify(reference, triangles=wanted[-1], record=True)
    # Nobody asked for the fewest triangles, so that nothing about them alone counts.
    emit(*(one for one in light.diagnostics if one.code not in _OF_FEWEST))
    progress(1, len(wanted) + 1)
    record = light.record
    assert record is not None, "it was asked for"
    fewest = len(light.mesh.triangles)
    if fewest > wanted[-1]:
        emit(
            SIMPLIFY_TRADEOFF.warning(
                "no edge may collapse any more at {fewest:,} triangles, which holes and pieces need",
                fewest=fewest,
            )
        )
        wanted = [*(count for count in wanted if count > fewest), fewest]
    if record.wedges is not None:
        emit(
            SIMPLIFY_TRADEOFF.info(
                "distances are those before the fit that simplify ends with, which a record of textured "
                "meshes cannot repeat: simplify to a number comes nearer"
            )
        )
    measure = _Measure(reference, params.samples)
    points, meshes = [], []
    for done, count in enumerate(wanted, 2):
        with collecting(forward=False):
            meshes.append(record.replay(triangles=count, fit=record.wedges is None).mesh)
        points.append(measure.point(meshes[-1], before, with_bytes=params.glb_bytes))
        progress(done, len(wanted) + 1)
    at, why = _suggested(points, params.within)
    return Tradeoff(
        method=light.method,
        points=tuple(points),
        suggested=None if at is None else points[at].triangles,
        why=why,
        mesh=meshes[-1 if at is None else at],
        record=record,
    )


def _wanted(before: int, params: TradeoffParams, counts: Sequence[int]) -> list[int]:
    """Return numbers of triangles, from most to fewest."""
    if len(counts):
        if min(counts) < 1:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "counts has {counts}; a number of triangles must be at least 1.",
                counts=min(counts),
            )
        return sorted({min(count, before) for count in counts}, reverse=True)
    least = max(round(params.least * before), 1)
    return sorted({round(count) for count in np.geomspace(before, least, params.steps)}, reverse=True)


class _Measure:
    """Distances and colour differences from a mesh, whose surface is made ready once for all."""

    def __init__(self, reference: Mesh, samples: int) -> None:
        self._reference, self._samples = reference, samples
        # Simplified meshes may stand out of the box by as little as they are off.
        self._box = bounding_box(reference)
        self._surface = WithNeedles(Surface(reference, self._box), self._box)
        self._points = _spread(reference, samples, 0)

    def point(self, mesh: Mesh, before: int, *, with_bytes: bool) -> TradeoffPoint:
        surface = WithNeedles(Surface(mesh, self._box), self._box)
        ways = (
            (self._reference, self._points, surface),
            (mesh, _spread(mesh, self._samples, 1), self._surface),
        )
        found = [_differences(one, at, other) for one, at, other in ways]
        distances = np.concatenate([distance for distance, _ in found])
        vertices = [other.closest(one.vertices[is_used(one)]).distances.max() for one, _, other in ways]
        colors = [color for _, color in found if color is not None]
        return TradeoffPoint(
            triangles=len(mesh.triangles),
            share=len(mesh.triangles) / before,
            rms_m=float(np.sqrt((distances**2).mean())),
            percentile_95_m=float(np.percentile(distances, _PERCENT)),
            maximum_m=float(max(distances.max(), *vertices)),
            color_rmse_levels=float(np.sqrt(np.mean(colors))) if colors else None,
            glb_bytes=_glb_bytes(mesh) if with_bytes else None,
        )


def _spread(mesh: Mesh, count: int, seed: int) -> Located:
    cumulative = np.cumsum(areas(mesh.vertices, mesh.triangles))
    return sampled(cumulative, slice(0, count), count, np.random.default_rng((0, seed)))


def _differences(mesh: Mesh, at: Located, other: WithNeedles) -> tuple[Floats, Floats | None]:
    """Return the distances of points from a surface, and the mean squared differences of colour there."""
    nearest = other.closest(interpolated(mesh.vertices, mesh, at))
    if not (has_color(mesh) and has_color(other.mesh)):
        return nearest.distances, None
    own = color_at(mesh, at.triangles, at.weights)
    seen = color_at(other.mesh, nearest.triangles, nearest.weights)
    return nearest.distances, ((own - seen) ** 2).mean(axis=1)


def _glb_bytes(mesh: Mesh) -> int:
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        path = Path(folder) / "mesh.glb"
        write_mesh(path, mesh)
        return path.stat().st_size


def _suggested(points: Sequence[TradeoffPoint], within: float | None) -> tuple[int | None, str]:
    """Return which point to take, and why."""
    if within is not None:
        near = [k for k, point in enumerate(points) if point.percentile_95_m <= within]
        return (near[-1] if near else None), f"95 % of the surface within {within:g} m"
    why = "more triangles gain little, fewer lose much"
    if len(points) < 3:
        return None, why
    along = -np.log([point.triangles for point in points])
    error = np.array([point.rms_m for point in points])
    below = _share_of(along) - _share_of(error)
    return int(below.argmax()), why


def _share_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each value is from the least to the greatest; 0 where all are equal."""
    above = values - values.min()
    return np.asarray(above / max(float(above.max()), np.finfo(np.float64).tiny))
