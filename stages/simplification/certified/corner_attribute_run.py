"""Method `certified` for meshes with corner attributes: proven distance, preserved texture.

Edges collapse as in method `seams`, while samples of the input stay near. The result is then proven. Where
the proof fails, samples around get tighter bounds or are locked, and the simplification is repeated:

    factors of the vertices <- 1 repeat:
        collapse along seams, each sample within its ratio of the bound prove the distance both ways and
        vertex colours; measure image colours at every texel stop if nothing fails tighten the factors where
        the distance proof failed, lock vertices after repeated failures lock vertices where colours failed

The loop terminates, because a region locked on all sides equals the input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.certified.color_samples import sample_color_differences
from scanloom.stages.simplification.certified.constants import (
    EXPECTED_REDUCTION,
    MAX_SUBDIVISIONS,
    MIN_COLOR_BOUND,
    PROOF_TOLERANCE,
    VERTEX_BOUND_RATIO,
)
from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.certified.unproven_warning import create_unproven_warning
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN, SIMPLIFY_COLORS_NOT_COMPARED
from scanloom.stages.simplification.color_weight import compute_balanced_weight
from scanloom.stages.simplification.isolated_triangles import find_isolated_degenerates
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.seams.run import simplify_in_order
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes, is_textured

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# Factor on the bound of samples around a triangle without a proof.
_TIGHTENING_FACTOR = 0.6
# Failed proofs around a vertex before the vertex is locked.
_MAX_FAILURES = 4
# Maximum number of passes. The last ones lock every vertex near a failure.
_MAX_PASSES = 24
_NO_INDICES = np.zeros(0, np.int64)
# Colour samples per surface if no colour bound is given: enough to report a colour difference.
_UNBOUNDED_SAMPLES = 1 << 17


@dataclass(frozen=True, eq=False)
class _ProofTarget:
    """Bounds to prove, and the input they refer to.

    Attributes
    ----------
    task : task of method `seams`, with the progress callback of the proofs.
    max_shape : maximum distance, metres.
    max_color : maximum colour difference, levels; infinite without a bound.
    has_image_colors : True if colours come from images. Their difference is measured. Vertex colours are
        linear and
        their difference is proven.
    is_ambiguous : (m,) bool, input triangles at positions with several colours.
    surface : (m, 3) int32, input triangles that the proof covers.
    """

    task: Task[Any]
    max_shape: float
    max_color: float
    has_image_colors: bool
    is_ambiguous: NDArray[np.bool_]
    surface: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _PassResult:
    """Result of one pass, and the triangles that violate the bounds.

    Attributes
    ----------
    simplified : simplified mesh.
    proof : proven bounds of each triangle.
    provable : metres, the bound on distance that can be proven.
    measured_color : largest measured colour difference in levels; None if not measured.
    distance_failures : triangles of the simplified mesh and of the input whose distance is not proven.
    color_failures : triangles of the simplified mesh and of the input whose colour is out of bounds.
    """

    simplified: SimplificationResult[SeamsDetails]
    proof: _kernels.CertifyResult
    provable: float
    measured_color: float | None
    distance_failures: tuple[Ids, Ids]
    color_failures: tuple[Ids, Ids]

    @property
    def is_within_bounds(self) -> bool:
        return not any(map(len, (*self.distance_failures, *self.color_failures)))


def run_with_corner_attributes(
    task: Task[CertifiedParams], shape: float
) -> SimplificationResult[CertifiedDetails]:
    """Simplify within `shape` metres of the input, with proof.

    The colour difference is bounded by `task.max_color`: proven for vertex colours, measured for images.
    """
    mesh = task.mesh
    weight = task.attribute_scale
    if weight is None:
        weight = compute_balanced_weight(mesh, len(mesh.triangles) // EXPECTED_REDUCTION, task.threads)
    report_pass, report_proof = _make_monotonic_progress(task.progress)
    inner = Task(
        mesh=mesh,
        params=SeamsParams(),
        max_shape=None,
        max_color=None,
        attribute_scale=weight if mesh.colors is not None else None,
        fit=True,
        triangles=task.triangles,
        lock=task.lock,
        importance=np.zeros(0),
        threads=task.threads,
        record=task.record,
        keep_on_interrupt=task.keep_on_interrupt,
        progress=report_pass,
    )
    target = _make_proof_target(replace(inner, progress=report_proof), task.max_color, shape)
    factors = 1 / task.importance if len(task.importance) else np.ones(len(mesh.vertices))
    failures = np.zeros(len(mesh.vertices), np.int64)
    lock = task.lock.copy()
    passes = 0
    is_unprovable: NDArray[np.bool_] | None = None
    while True:
        found = _run_pass(replace(inner, lock=lock), target, factors)
        passes += 1
        if found.is_within_bounds or found.simplified.stopped_by == "request" or passes == _MAX_PASSES:
            break
        if is_unprovable is None:
            is_unprovable = _find_unprovable(target, found.provable)
        around = _find_failing_vertices(mesh, found, is_unprovable)
        discolored = _find_source_vertices(mesh, found.simplified, found.color_failures, is_unprovable)
        if lock[around].all() and lock[discolored].all():
            # All failing regions are locked, so they equal the input.
            break
        failures[around] += 1
        factors[around] *= _TIGHTENING_FACTOR
        lock |= failures >= (_MAX_FAILURES if passes < _MAX_PASSES - _MAX_FAILURES else 1)
        lock[discolored] = True
    result = _build_result(target, task, found, weight, passes)
    if not target.is_ambiguous.any():
        return result
    emit(
        SIMPLIFY_COLORS_NOT_COMPARED.warning(
            "colours are not compared at {count:,} triangles, where surfaces of different "
            "colours coincide in the input.",
            count=np.count_nonzero(target.is_ambiguous),
        )
    )
    return result


def _make_proof_target(task: Task[Any], max_color: float | None, shape: float) -> _ProofTarget:
    color = math.inf if max_color is None else max_color
    is_image = is_textured(task.mesh)
    ambiguous = np.zeros(len(task.mesh.triangles), bool)
    samples = sample_color_differences(task.mesh, task.mesh) if is_image and color < math.inf else None
    if samples is not None:
        wrong = samples.difference > color
        ambiguous[samples.own_triangle[wrong]] = True
        ambiguous[samples.original_triangle[wrong]] = True
    color_limit = color if is_image else max(color, MIN_COLOR_BOUND)
    return _ProofTarget(task, shape, color_limit, is_image, ambiguous, _get_provable_triangles(task.mesh))


def _get_provable_triangles(mesh: Mesh) -> NDArray[np.int32]:
    """Return the triangles of a mesh that the proof covers.

    Isolated degenerate triangles, which no method keeps, are replaced by another triangle.
    """
    lost = find_isolated_degenerates(mesh)
    triangles = mesh.triangles.copy()
    if lost.any() and not lost.all():
        triangles[lost] = triangles[np.argmin(lost)]
    return np.asarray(triangles)


def _run_pass(task: Task[SeamsParams], target: _ProofTarget, factors: Floats) -> _PassResult:
    expected = task.triangles or len(task.mesh.triangles) // EXPECTED_REDUCTION
    light, provable = simplify_in_order(
        task, expected_triangles=expected, distance_bound=(target.max_shape, VERTEX_BOUND_RATIO, factors)
    )
    proof = _prove_bounds(
        light.mesh, target, (provable, math.inf if target.has_image_colors else target.max_color)
    )
    far = (
        np.flatnonzero(proof.shape_bound > provable),
        np.flatnonzero(proof.original_shape_bound > provable),
    )
    if target.has_image_colors:
        color, discolored = (
            _measure_colors(light, target)
            if target.max_color < math.inf
            else (None, (_NO_INDICES, _NO_INDICES))
        )
        return _PassResult(light, proof, provable, color, far, discolored)
    discolored = (
        np.flatnonzero(proof.color_bound > target.max_color),
        np.flatnonzero(proof.original_color_bound > target.max_color),
    )
    return _PassResult(light, proof, provable, None, far, discolored)


def _prove_bounds(
    light: Mesh, target: _ProofTarget, limit: tuple[float, float] | None
) -> _kernels.CertifyResult:
    def make_arrays(mesh: Mesh, triangles: NDArray[Any]) -> Any:
        colored = mesh.with_(colors=None) if target.has_image_colors else mesh
        return mesh.vertices, get_vertex_attributes(colored), triangles

    given = target.task.mesh
    return _kernels.certify(
        make_arrays(light, target.surface if light is given else light.triangles),
        make_arrays(given, target.surface),
        tolerance=(PROOF_TOLERANCE, PROOF_TOLERANCE),
        absolute_tolerance=(0.0, 0.0),
        limit=limit,
        effort=MAX_SUBDIVISIONS,
        slack=None,
        threads=target.task.threads,
        progress=target.task.progress,
    )


def _measure_colors(
    light: SimplificationResult[SeamsDetails], target: _ProofTarget
) -> tuple[float, tuple[Ids, Ids]]:
    """Measure the largest colour difference, and find triangles beyond the bound.

    Positions where sheets of different colours coincide are ignored.
    """
    samples = sample_color_differences(light.mesh, target.task.mesh)
    if samples is None:
        return 0.0, (_NO_INDICES, _NO_INDICES)
    is_compared = ~target.is_ambiguous[samples.original_triangle]
    wrong = is_compared & (samples.difference > target.max_color)
    of_light = samples.own_triangle[: samples.simplified_count][wrong[: samples.simplified_count]]
    discolored = np.unique(of_light), np.unique(samples.original_triangle[wrong])
    return float(samples.difference[is_compared].max(initial=0.0)), discolored


def _find_source_vertices(
    mesh: Mesh,
    light: SimplificationResult[SeamsDetails],
    triangles: tuple[Ids, Ids],
    is_unprovable: NDArray[np.bool_],
) -> Ids:
    """Return the input vertices of triangles whose colours exceed the bound.

    `triangles` are indices into the simplified mesh and into the input. Triangles that are unprovable in the
    input, too, are skipped. Locking these vertices restores the input's triangles.
    """
    of_input = np.concatenate([light.triangle_source[triangles[0]], triangles[1]])
    return np.unique(mesh.triangles[of_input[~is_unprovable[of_input]]])


def _find_unprovable(target: _ProofTarget, shape: float) -> NDArray[np.bool_]:
    """Return a mask (m,) of input triangles that can never be proven.

    The mask includes their neighbours.

    Even the unchanged input fails the proof there: triangles are too thin, or one position has several
    colours. Locking vertices would not help.
    """
    mesh = target.task.mesh
    color = math.inf if target.has_image_colors else target.max_color
    bounds = _prove_bounds(mesh, target, (shape, color))
    fails = (bounds.shape_bound > shape) | (bounds.original_shape_bound > shape)
    if color < math.inf:
        fails |= (bounds.color_bound > color) | (bounds.original_color_bound > color)
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.triangles[fails]] = True
    return np.asarray(fails | touched[mesh.triangles].any(axis=1))


def _find_failing_vertices(
    mesh: Mesh, result: _PassResult, is_unprovable: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the input vertices around triangles without a proof.

    Triangles that can never be proven (`is_unprovable`) are skipped.
    """
    from scipy.spatial import cKDTree

    of_light = result.distance_failures[0][
        ~is_unprovable[result.simplified.triangle_source[result.distance_failures[0]]]
    ]
    near = [
        mesh.triangles[result.distance_failures[1][~is_unprovable[result.distance_failures[1]]]].reshape(-1)
    ]
    if len(of_light):
        corners = result.simplified.mesh.vertices[result.simplified.mesh.triangles[of_light]]
        centres = corners.mean(axis=1)
        reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1) + result.provable
        tree = cKDTree(mesh.vertices)
        near += [np.asarray(some, np.int64) for some in tree.query_ball_point(centres, reach)]
        # No vertex may be within reach of a triangle that is smaller than its source triangles.
        near.append(tree.query(centres)[1])
    return np.unique(np.concatenate(near)).astype(np.int64)


def _build_result(
    target: _ProofTarget, task: Task[CertifiedParams], found: _PassResult, weight: float, passes: int
) -> SimplificationResult[CertifiedDetails]:
    mesh, light, proof = target.task.mesh, found.simplified, found.proof
    with_color = mesh.colors is not None and not target.has_image_colors
    shape_bound, color_bound = proof.shape_bound, proof.color_bound
    (bound, color), (attained, color_attained) = proof.bound, proof.attained
    # Without a limit, the proof yields the bound on colour even if none was requested.
    if task.params.tight_bounds or (with_color and target.max_color == math.inf):
        tight = _prove_bounds(light.mesh, target, None)
        shape_bound = np.minimum(shape_bound, tight.shape_bound)
        bound, attained = min(bound, tight.bound[0]), max(attained, tight.attained[0])
        color_bound, color, color_attained = tight.color_bound, tight.bound[1], tight.attained[1]
    proven = bound <= found.provable and not (with_color and color > target.max_color)
    measured = found.measured_color
    if target.has_image_colors and measured is None:
        samples = sample_color_differences(light.mesh, mesh, max_samples=_UNBOUNDED_SAMPLES)
        measured = None if samples is None else samples.max_difference
    too_far = measured is not None and measured > target.max_color
    stopped_by = light.stopped_by if target.task.triangles or light.stopped_by == "request" else "bounds"
    if not proven:
        fails = shape_bound > found.provable
        if with_color:
            fails |= color_bound > target.max_color
        emit(create_unproven_warning(light.mesh, fails, shape_bound, (bound, color if with_color else None)))
    if too_far:
        emit(
            SIMPLIFY_BOUND_NOT_PROVEN.warning(
                "simplify could not keep colours within max_color; the largest measured "
                "difference is {measured:.3g} levels.",
                measured=measured,
            )
        )
    if (not proven or too_far) and stopped_by != "request":
        stopped_by = "unproven"
    without = [
        len(np.union1d(a, b)) for a, b in zip(found.distance_failures, found.color_failures, strict=True)
    ]
    return SimplificationResult(
        mesh=light.mesh,
        vertex_source=light.vertex_source,
        triangle_source=light.triangle_source,
        method="certified",
        stopped_by=stopped_by,
        refused=light.refused,
        collapses=light.collapses,
        attempts=light.attempts,
        triangles_before=light.triangles_before,
        details=CertifiedDetails(
            attribute_scale_m_per_level=weight,
            shape_bound=shape_bound,
            color_bound=color_bound if with_color else None,
            shape_bound_m=bound,
            color_bound_levels=color if with_color else None,
            shape_attained_m=attained,
            color_attained_levels=color_attained if with_color else None,
            color_measured_levels=measured,
            slack_m=proof.slack,
            color_slack_levels=proof.color_slack,
            proven=proven,
            unproven_triangles=(0, 0) if proven else (without[0], without[1]),
            iterations=passes,
            max_shape_m=target.max_shape,
            max_color_levels=task.max_color,
            seam_drift=light.details.seam_drift,
        ),
        record=light.record,
    )


def _make_monotonic_progress(progress: Progress) -> tuple[Progress, Progress]:
    """Create monotonic progress callbacks for passes and for proofs between passes.

    The second callback repeats the latest state, so that exceptions from `progress` are raised. It ignores
    requests to stop, because a proof always runs to its end.
    """
    farthest, total_count = 0, 0

    def report_pass(done: int, total: int) -> object:
        nonlocal farthest, total_count
        farthest, total_count = max(farthest, done), total
        return progress(min(farthest, total), total)

    def report_proof(done: int, total: int) -> object:  # noqa: ARG001 - as all progress is called
        progress(min(farthest, total_count), total_count)
        return True

    return report_pass, report_proof
