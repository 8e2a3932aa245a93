"""Error of a mesh as a function of its triangle count.

The collapses of one simplification are recorded and replayed to each count (Hoppe, "Progressive meshes",
1996). Each mesh is compared with the input in both directions, as `compare` does.
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
    SIMPLIFY_EDGES_BLOCKED,
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
# Diagnostics that only concern the smallest triangle count.
_OF_FEWEST = (SIMPLIFY_COUNT_NOT_REACHED.name, SIMPLIFY_EDGES_BLOCKED.name, SIMPLIFY_SEAM_DRIFT.name)


@dataclass(frozen=True, kw_only=True)
class TradeoffParams:
    """Parameters of `tradeoff`."""

    steps: int = param(
        12, "Number of triangle counts to measure, in a geometric progression.", low=2, high=1000
    )
    least: float = param(
        0.01,
        "Smallest triangle count to measure, as a fraction of the input's triangles.",
        low=0,
        high=1,
        low_open=True,
    )
    within: float | None = param(
        None,
        "Suggest the smallest triangle count at which 95 % of both surfaces are within this "
        "distance of the other. Default: suggest the count where the curve of distance over "
        "the logarithm of the count bends most.",
        unit="m",
        low=0,
        common=True,
    )
    samples: int = param(
        100_000,
        "Points sampled on each surface, uniformly by area; the maximum also includes every vertex.",
        low=1,
        high=100_000_000,
    )
    glb_bytes: bool = param(False, "Also report the size of each mesh as a GLB file.")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, kw_only=True)
class TradeoffPoint:
    """Error of the mesh at one triangle count.

    Attributes
    ----------
    triangles : triangle count.
    share : ratio of the input's triangle count.
    rms_m, percentile_95_m, maximum_m : distances over both directions, metres.
    color_rmse_levels : colour difference of corresponding points, 8-bit levels; None without colours.
    glb_bytes : size as a GLB file; None if not requested.
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
        """Return all fields, with units in the names."""
        return asdict(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tradeoff:
    """Error as a function of the triangle count.

    Attributes
    ----------
    method : simplification method.
    points : errors, by decreasing triangle count.
    suggested : triangle count; None if no count is within the requested error, or there are too few counts.
    why : criterion of the suggestion, in words.
    mesh : mesh at the suggested count, or at the smallest one without a suggestion.
    record : collapses, which restore the mesh at any other count.
    diagnostics : warnings of the simplification and of the comparison.
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
        """Return the curve for JSON, with units in the names."""
        return {
            "method": self.method,
            "suggested_triangles": self.suggested,
            "suggested_for": self.why,
            "points": [point.figures() for point in self.points],
        }

    def rows(self) -> list[list[str]]:
        """Return the curve as text rows, header first, without empty columns."""
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
    """Measure a mesh's error at several triangle counts, and suggest one.

    The meshes equal the results of `simplify` with a triangle count, by method `quadric`, or `seams` for
    textured meshes. Only the colour weight differs, because `simplify` derives it from the requested count.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres.
    params : TradeoffParams; single fields can be given as keywords instead.
    counts : triangle counts, instead of `steps` and `least`.
    progress : called with (meshes measured, all meshes).

    Returns
    -------
    Tradeoff

    Raises
    ------
    MeshError
        If the mesh has no area.
    UsageError
        If a parameter is out of range, or a triangle count below 1.

    References
    ----------
    The suggestion follows Satopää, Albrecht, Irwin and Raghavan, "Finding a kneedle in a haystack", 2011.
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
    # The smallest count was not requested by the user, so diagnostics about it alone are dropped.
    emit(*(one for one in light.diagnostics if one.code not in _OF_FEWEST))
    progress(1, len(wanted) + 1)
    record = light.record
    assert record is not None, "it was asked for"
    fewest = len(light.mesh.triangles)
    if fewest > wanted[-1]:
        emit(
            SIMPLIFY_TRADEOFF.warning(
                "no edge can collapse below {fewest:,} triangles, which holes, handles and components need",
                fewest=fewest,
            )
        )
        wanted = [*(count for count in wanted if count > fewest), fewest]
    if record.wedges is not None:
        emit(
            SIMPLIFY_TRADEOFF.info(
                "distances are measured before the final fit, which a record of a textured "
                "mesh cannot repeat; simplify with a triangle count comes closer to the input"
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
    """Return the triangle counts to measure, in decreasing order."""
    if len(counts):
        if min(counts) < 1:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "counts contains {counts}; a triangle count must be at least 1.",
                counts=min(counts),
            )
        return sorted({min(count, before) for count in counts}, reverse=True)
    least = max(round(params.least * before), 1)
    return sorted({round(count) for count in np.geomspace(before, least, params.steps)}, reverse=True)


class _Measure:
    """Measurement of meshes against one reference, whose search structures are built once."""

    def __init__(self, reference: Mesh, samples: int) -> None:
        self._reference, self._samples = reference, samples
        # The box of the reference suffices, because simplified meshes exceed it only slightly.
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
    """Measure distances and mean squared colour differences of points to a surface."""
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
    """Select the suggested point; return its index, or None, and the criterion."""
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
    """Scale values linearly to 0 … 1; all 0 if equal."""
    above = values - values.min()
    return np.asarray(above / max(float(above.max()), np.finfo(np.float64).tiny))
