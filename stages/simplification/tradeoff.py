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

from scanloom.stages.comparing.comparison_inputs import to_measurable_mesh
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_rows, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.codes import (
    SIMPLIFY_COUNT_NOT_REACHED,
    SIMPLIFY_EDGES_BLOCKED,
    SIMPLIFY_SEAM_DRIFT,
    SIMPLIFY_TRADEOFF,
)
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.mesh_files import write_mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    Floats,
    RaycastingSurface,
    compute_bounding_box,
    interpolate_values,
    mask_used_vertices,
)
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color
from scanloom.stages.surface.topology import compute_areas

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TradeoffKeywords

_PERCENT = 95
# A mesh flies apart if it fails one of these tests. Distances must also exceed a ratio of the diagonal of the
# bounding box, because nearly exact meshes differ by large factors.
# Vertices outside the bounding box of the input, relative to the 95 % distance.
_MAX_OVERSHOOT = 2.0
# Maximum distance, relative to the 95 % distance, and to the maximum distance of any smaller mesh.
_MAX_PER_PERCENTILE = 10.0
_MAX_PER_SMALLER = 4.0
_MIN_FLYING_PER_DIAGONAL = 0.01
# Diagnostics that only concern the smallest triangle count.
_COUNT_CODES = (SIMPLIFY_COUNT_NOT_REACHED.name, SIMPLIFY_EDGES_BLOCKED.name, SIMPLIFY_SEAM_DRIFT.name)


@dataclass(frozen=True, kw_only=True)
class TradeoffParams:
    """Parameters of `tradeoff`."""

    steps: int = param(
        12, "Number of triangle counts to measure, in a geometric progression.", low=2, high=1000
    )
    min_ratio: float = param(
        0.01,
        "Smallest triangle count to measure, as a fraction of the input's triangles.",
        low=0,
        high=1,
        low_open=True,
    )
    max_distance: float | None = param(
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
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class TradeoffPoint:
    """Error of the mesh at one triangle count.

    Attributes
    ----------
    triangles : triangle count.
    ratio : ratio of the input's triangle count.
    rms_m, percentile_95_m, maximum_m : distances over both directions, metres.
    color_rmse_levels : colour difference of corresponding points, 8-bit levels; None without colours.
    glb_bytes : size as a GLB file; None if not requested.
    """

    triangles: int
    ratio: float
    rms_m: float
    percentile_95_m: float
    maximum_m: float
    color_rmse_levels: float | None
    glb_bytes: int | None

    __repr__ = format_by_metrics

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, with units in the names."""
        return asdict(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tradeoff:
    """Error as a function of the triangle count.

    Attributes
    ----------
    method : simplification method.
    points : errors, by decreasing triangle count.
    suggested_triangles : triangle count that `simplify` reaches; None if no count is within the requested
        error, or there are too few counts.
    criterion : criterion of the suggestion, in words.
    bounded : error of the mesh of `simplify` with `max_shape` of the requested distance; None without a
        requested distance, with given counts, or if no triangle can be removed within it.
    mesh : mesh at the suggested count, or at the smallest one without a suggestion.
    record : collapses, which restore the mesh at any other count.
    diagnostics : warnings of the simplification and of the comparison.
    """

    method: str
    points: tuple[TradeoffPoint, ...]
    suggested_triangles: int | None
    criterion: str
    mesh: Mesh
    record: CollapseRecord
    bounded: TradeoffPoint | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics

    def to_dict(self) -> dict[str, Any]:
        """Return the curve for JSON, with units in the names."""
        return {
            "method": self.method,
            "suggested_triangles": self.suggested_triangles,
            "suggested_for": self.criterion,
            "bounded": None if self.bounded is None else self.bounded.to_dict(),
            "points": [point.to_dict() for point in self.points],
        }

    def to_rows(self) -> list[list[str]]:
        """Return the curve as text rows, header first, without empty columns."""
        head = ["triangles", "ratio", "RMS m", "95 % m", "maximum m", "colour levels", "GLB bytes"]
        rows = [
            [
                f"{point.triangles:,}",
                f"{100 * point.ratio:.3g} %",
                *(f"{value:.3g}" for value in (point.rms_m, point.percentile_95_m, point.maximum_m)),
                "" if point.color_rmse_levels is None else f"{point.color_rmse_levels:.3g}",
                "" if point.glb_bytes is None else f"{point.glb_bytes:,}",
            ]
            for point in self.points
        ]
        has_values = [any(column) for column in zip(*rows, strict=True)]
        return [[word for word, shown in zip(row, has_values, strict=True) if shown] for row in (head, *rows)]

    def _repr_html_(self) -> str:
        return render_table(self) + render_rows(self.to_rows())


def tradeoff(
    mesh: MeshLike,
    params: TradeoffParams | None = None,
    *,
    counts: Sequence[int] = (),
    progress: Progress = ignore_progress,
    **changes: Unpack[TradeoffKeywords],
) -> Tradeoff:
    """Measure a mesh's error at several triangle counts, and suggest one.

    The meshes equal the results of `simplify` with a triangle count, by method `quadric`, or `seams` for
    textured meshes. Only the colour weight differs, because `simplify` derives it from the requested count.
    If a mesh flies apart, `simplify` makes the mesh of that count anew, by the method it selects. If the new
    mesh flies apart, too, a warning names the count, and the count is not suggested.

    With `max_distance`, and without `counts`, `simplify` also makes the mesh within `max_shape` of that
    distance. This mesh is suggested if it has fewer triangles than any measured count within the distance.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres.
    params : TradeoffParams; single fields can be given as keywords instead.
    counts : triangle counts, instead of `steps` and `min_ratio`.
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
    reference = to_measurable_mesh(mesh, "mesh")
    before = len(reference.triangles)
    counts_to_measure = _select_counts(before, params, counts)
    progress(0, len(counts_to_measure) + 1)
    with collecting(forward=False):
        light = simplify(reference, triangles=counts_to_measure[-1], record=True)
    # The smallest count was not requested by the user, so diagnostics about it alone are dropped.
    emit(*(one for one in light.diagnostics if one.code not in _COUNT_CODES))
    progress(1, len(counts_to_measure) + 1)
    record = light.record
    assert record is not None, "it was asked for"
    fewest = len(light.mesh.triangles)
    if fewest > counts_to_measure[-1]:
        emit(
            SIMPLIFY_TRADEOFF.warning(
                "no edge can collapse below {fewest:,} triangles, which holes, handles and components need",
                fewest=fewest,
            )
        )
        counts_to_measure = [*(count for count in counts_to_measure if count > fewest), fewest]
    if record.wedges is not None:
        emit(
            SIMPLIFY_TRADEOFF.info(
                "distances are measured before the final fit, which a record of a textured "
                "mesh cannot repeat; simplify with a triangle count comes closer to the input"
            )
        )
    measure = _ErrorMeasurement(reference, params.samples)
    points, meshes, overshoots = [], [], []
    for done, count in enumerate(counts_to_measure, 2):
        with collecting(forward=False):
            meshes.append(record.replay(triangles=count, fit=record.wedges is None).mesh)
        points.append(measure.measure_point(meshes[-1], before, with_bytes=params.glb_bytes))
        overshoots.append(measure.measure_overshoot(meshes[-1]))
        progress(done, len(counts_to_measure) + 1)
    is_flying = _find_flying(points, overshoots, measure.diagonal)
    for k in np.flatnonzero(is_flying).tolist():
        with collecting(forward=False):
            meshes[k] = simplify(
                reference,
                triangles=points[k].triangles,
                # The weight of colours depends on the count; here it is that of the other points.
                attribute_scale=light.details.attribute_scale_m_per_level,
            ).mesh
        points[k] = measure.measure_point(meshes[k], before, with_bytes=params.glb_bytes)
        overshoots[k] = measure.measure_overshoot(meshes[k])
    if is_flying.any():
        is_flying = _find_flying(points, overshoots, measure.diagonal)
        _report_flying(points, is_flying)
    at, why = _suggest_point(points, params.max_distance, is_flying)
    suggested, mesh = (None, meshes[-1]) if at is None else (points[at].triangles, meshes[at])
    bounded = None
    if params.max_distance and not len(counts):
        with collecting(forward=False):
            result = simplify(reference, max_shape=params.max_distance)
        if len(result.mesh.triangles) < before:
            bounded = measure.measure_point(result.mesh, before, with_bytes=params.glb_bytes)
            is_proven = not any(one.severity == Severity.UNMET for one in result.diagnostics)
            if is_proven and bounded.triangles < (suggested or before):
                suggested, mesh = bounded.triangles, result.mesh
                why = f"simplify with max_shape={params.max_distance:g} m proves it for the whole surface"
    return Tradeoff(
        method=light.method,
        points=tuple(points),
        suggested_triangles=suggested,
        criterion=why,
        mesh=mesh,
        record=record,
        bounded=bounded,
    )


def _select_counts(before: int, params: TradeoffParams, counts: Sequence[int]) -> list[int]:
    """Return the triangle counts to measure, in decreasing order."""
    if len(counts):
        if min(counts) < 1:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "counts contains {counts}; a triangle count must be at least 1.",
                counts=min(counts),
            )
        return sorted({min(count, before) for count in counts}, reverse=True)
    min_count = max(round(params.min_ratio * before), 1)
    return sorted({round(count) for count in np.geomspace(before, min_count, params.steps)}, reverse=True)


class _ErrorMeasurement:
    """Measurement of meshes against one reference, whose search structures are built once."""

    def __init__(self, reference: Mesh, samples: int) -> None:
        self._reference, self._samples = reference, samples
        # The box of the reference suffices, because simplified meshes exceed it only slightly.
        self._box = compute_bounding_box(reference)
        self._surface = NeedleSafeSurface(RaycastingSurface(reference, self._box), self._box)
        self._points = _sample_surface(reference, samples, 0)

    @property
    def diagonal(self) -> float:
        """Diagonal of the reference's bounding box, metres."""
        return float(np.linalg.norm(np.ptp(self._get_used_vertices(self._reference), axis=0)))

    def measure_overshoot(self, mesh: Mesh) -> float:
        """Measure how far vertices are outside the reference's bounding box, metres."""
        inside, points = self._get_used_vertices(self._reference), self._get_used_vertices(mesh)
        beyond = np.maximum(inside.min(axis=0) - points, points - inside.max(axis=0))
        return float(beyond.max(initial=0.0))

    @staticmethod
    def _get_used_vertices(mesh: Mesh) -> Floats:
        return np.asarray(mesh.vertices[mask_used_vertices(mesh)])

    def measure_point(self, mesh: Mesh, before: int, *, with_bytes: bool) -> TradeoffPoint:
        surface = NeedleSafeSurface(RaycastingSurface(mesh, self._box), self._box)
        ways = (
            (self._reference, self._points, surface),
            (mesh, _sample_surface(mesh, self._samples, 1), self._surface),
        )
        found = [_measure_differences(one, at, other) for one, at, other in ways]
        distances = np.concatenate([distance for distance, _ in found])
        vertices = [
            other.find_closest_points(one.vertices[mask_used_vertices(one)]).distances.max()
            for one, _, other in ways
        ]
        colors = [color for _, color in found if color is not None]
        return TradeoffPoint(
            triangles=len(mesh.triangles),
            ratio=len(mesh.triangles) / before,
            rms_m=float(np.sqrt((distances**2).mean())),
            percentile_95_m=float(np.percentile(distances, _PERCENT)),
            maximum_m=float(max(distances.max(), *vertices)),
            color_rmse_levels=float(np.sqrt(np.mean(colors))) if colors else None,
            glb_bytes=_measure_glb_bytes(mesh) if with_bytes else None,
        )


def _sample_surface(mesh: Mesh, count: int, seed: int) -> ClosestPoints:
    cumulative = np.cumsum(compute_areas(mesh.vertices, mesh.triangles))
    return sample_stratified(cumulative, slice(0, count), count, np.random.default_rng((0, seed)))


def _measure_differences(
    mesh: Mesh, at: ClosestPoints, other: NeedleSafeSurface
) -> tuple[Floats, Floats | None]:
    """Measure distances and mean squared colour differences of points to a surface."""
    nearest = other.find_closest_points(interpolate_values(mesh.vertices, mesh, at))
    if not (has_color(mesh) and has_color(other.mesh)):
        return nearest.distances, None
    own = compute_surface_colors(mesh, at.triangles, at.weights)
    seen = compute_surface_colors(other.mesh, nearest.triangles, nearest.weights)
    return nearest.distances, ((own - seen) ** 2).mean(axis=1)


def _measure_glb_bytes(mesh: Mesh) -> int:
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        path = Path(folder) / "mesh.glb"
        write_mesh(path, mesh)
        return path.stat().st_size


def _find_flying(
    points: Sequence[TradeoffPoint], overshoots: Sequence[float], diagonal: float
) -> NDArray[np.bool_]:
    """Return a mask of the points whose mesh flies apart."""
    percentile, maximum = (
        np.array([getattr(point, name) for point in points]) for name in ("percentile_95_m", "maximum_m")
    )
    # The minimum over all smaller meshes, which should be worse.
    smaller = np.minimum.accumulate(np.append(maximum, np.inf)[::-1])[::-1][1:]
    overshoot = np.array(overshoots)
    min_distance = _MIN_FLYING_PER_DIAGONAL * diagonal
    is_outside = overshoot > np.maximum(_MAX_OVERSHOOT * percentile, min_distance)
    is_large = (maximum > _MAX_PER_PERCENTILE * percentile) | (maximum > _MAX_PER_SMALLER * smaller)
    return np.asarray(is_outside | (is_large & (maximum > min_distance)))


def _report_flying(points: Sequence[TradeoffPoint], is_flying: NDArray[np.bool_]) -> None:
    chosen = [point for point, flying in zip(points, is_flying, strict=True) if flying]
    if not chosen:
        return
    worst = max(chosen, key=lambda point: point.maximum_m)
    emit(
        SIMPLIFY_TRADEOFF.warning(
            "single places of the mesh fly apart at {counts} triangles: up to {far:.3g} m off, while 95 % of "
            "the surface is within {near:.3g} m. These counts are not suggested",
            remedy="simplify with max_shape, which bounds every place.",
            counts=", ".join(f"{point.triangles:,}" for point in chosen),
            far=worst.maximum_m,
            near=worst.percentile_95_m,
        )
    )


def _suggest_point(
    points: Sequence[TradeoffPoint], max_distance: float | None, is_flying: NDArray[np.bool_]
) -> tuple[int | None, str]:
    """Select the suggested point; return its index, or None, and the criterion."""
    sound = np.flatnonzero(~is_flying).tolist()
    if max_distance is not None:
        near = [k for k in sound if points[k].percentile_95_m <= max_distance]
        return (near[-1] if near else None), f"95 % of the surface within {max_distance:g} m"
    criterion = "more triangles gain little, fewer lose much"
    if len(sound) < 3:
        return None, criterion
    along = -np.log([points[k].triangles for k in sound])
    error = np.array([points[k].rms_m for k in sound])
    below = _normalize_values(along) - _normalize_values(error)
    return sound[int(below.argmax())], criterion


def _normalize_values(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale values linearly to 0 … 1; all 0 if equal."""
    above = values - values.min()
    return np.asarray(above / max(float(above.max()), np.finfo(np.float64).tiny))
