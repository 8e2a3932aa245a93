"""Method `certified` for meshes with corner attributes: proven distance, preserved texture.

Edges collapse as in method `seams`, while samples of the input stay near. The result is then proven. Where
the proof fails, samples around get tighter bounds or are locked, and the simplification is repeated:

    factors of the vertices <- 1
    repeat:
        collapse along seams, each sample within its ratio of the bound
        prove the distance both ways and vertex colours; measure image colours at every texel
        stop if nothing fails
        tighten the factors where the distance proof failed, lock vertices after repeated failures
        lock vertices where colours failed

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
from scanloom.stages.simplification.certified.color_samples import color_samples
from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.certified.effort import (
    LEAST_COLOR,
    PIECES,
    REDUCTION,
    SHARE_OF_VERTICES,
    TOLERANCE,
)
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.certified.unproven import not_proven
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN, SIMPLIFY_COLORS_NOT_COMPARED
from scanloom.stages.simplification.color_weight import balanced_weight
from scanloom.stages.simplification.lines import lost_lines
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.seams.run import simplified
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.color import attributes_of, is_textured
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

# Factor on the bound of samples around a triangle without a proof.
_TIGHTER = 0.6
# Failed proofs around a vertex before the vertex is locked.
_PATIENCE = 4
# Maximum number of passes. The last ones lock every vertex near a failure.
_MOST_PASSES = 24
_NONE = np.zeros(0, np.int64)
# Colour samples per surface if no colour bound is given: enough to report a colour difference.
_GLANCE = 1 << 17


@dataclass(frozen=True, eq=False)
class _Asked:
    """Bounds to prove, and the input they refer to.

    Attributes
    ----------
    task : task of method `seams`, with the progress callback of the proofs.
    shape : maximum distance, metres.
    color : maximum colour difference, levels; infinite without a bound.
    is_image : True if colours come from images. Their difference is measured. Vertex colours are linear and
        their difference is proven.
    ambiguous : (m,) bool, input triangles at positions with several colours.
    surface : (m, 3) int32, input triangles that the proof covers.
    """

    task: Task[Any]
    shape: float
    color: float
    is_image: bool
    ambiguous: NDArray[np.bool_]
    surface: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Found:
    """Result of one pass, and the triangles that violate the bounds.

    Attributes
    ----------
    light : simplified mesh.
    proof : proven bounds of each triangle.
    provable : metres, the bound on distance that can be proven.
    color : largest measured colour difference in levels; None if not measured.
    far : triangles of the simplified mesh and of the input whose distance is not proven.
    discolored : triangles of the simplified mesh and of the input whose colour is out of bounds.
    """

    light: Simplified[SeamsDetails]
    proof: _kernels.Certified
    provable: float
    color: float | None
    far: tuple[Ids, Ids]
    discolored: tuple[Ids, Ids]

    @property
    def holds(self) -> bool:
        return not any(map(len, (*self.far, *self.discolored)))


def run_along_seams(task: Task[CertifiedParams], shape: float) -> Simplified[CertifiedDetails]:
    """Simplify within a proven distance of `shape` metres.

    The colour difference is bounded by `task.max_color`: proven for vertex colours, measured for images.
    """
    mesh = task.mesh
    weight = task.attribute_scale
    if weight is None:
        weight = balanced_weight(mesh, len(mesh.triangles) // REDUCTION, task.threads)
    tell, go_on = _forward_only(task.progress)
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
        partial=task.partial,
        progress=tell,
    )
    asked = _asked(replace(inner, progress=go_on), task.max_color, shape)
    factors = 1 / task.importance if len(task.importance) else np.ones(len(mesh.vertices))
    failures = np.zeros(len(mesh.vertices), np.int64)
    lock = task.lock.copy()
    passes = 0
    hopeless: NDArray[np.bool_] | None = None
    while True:
        found = _pass(replace(inner, lock=lock), asked, factors)
        passes += 1
        if found.holds or found.light.stopped_by == "request" or passes == _MOST_PASSES:
            break
        if hopeless is None:
            hopeless = _hopeless(asked, found.provable)
        around = _around(mesh, found, hopeless)
        discolored = _made_of(mesh, found.light, found.discolored, hopeless)
        if lock[around].all() and lock[discolored].all():
            # All failing regions are locked, so they equal the input.
            break
        failures[around] += 1
        factors[around] *= _TIGHTER
        lock |= failures >= (_PATIENCE if passes < _MOST_PASSES - _PATIENCE else 1)
        lock[discolored] = True
    result = _result(asked, task, found, weight, passes)
    if not asked.ambiguous.any():
        return result
    emit(
        SIMPLIFY_COLORS_NOT_COMPARED.warning(
            "colours are not compared at {count:,} triangles, where surfaces of different "
            "colours coincide in the input.",
            count=np.count_nonzero(asked.ambiguous),
        )
    )
    return result


def _asked(task: Task[Any], max_color: float | None, shape: float) -> _Asked:
    color = math.inf if max_color is None else max_color
    is_image = is_textured(task.mesh)
    ambiguous = np.zeros(len(task.mesh.triangles), bool)
    samples = color_samples(task.mesh, task.mesh) if is_image and color < math.inf else None
    if samples is not None:
        wrong = samples.difference > color
        ambiguous[samples.own_triangle[wrong]] = True
        ambiguous[samples.original_triangle[wrong]] = True
    least = color if is_image else max(color, LEAST_COLOR)
    return _Asked(task, shape, least, is_image, ambiguous, _surface_of(task.mesh))


def _surface_of(mesh: Mesh) -> NDArray[np.int32]:
    """Return the triangles of a mesh that the proof covers.

    Isolated degenerate triangles, which no method keeps, are replaced by another triangle.
    """
    lost = lost_lines(mesh)
    triangles = mesh.triangles.copy()
    if lost.any() and not lost.all():
        triangles[lost] = triangles[np.argmin(lost)]
    return np.asarray(triangles)


def _pass(task: Task[SeamsParams], asked: _Asked, factors: Floats) -> _Found:
    expected = task.triangles or len(task.mesh.triangles) // REDUCTION
    light, provable = simplified(task, expected=expected, within=(asked.shape, SHARE_OF_VERTICES, factors))
    proof = _proof(light.mesh, asked, (provable, math.inf if asked.is_image else asked.color))
    far = (
        np.flatnonzero(proof.shape_bound > provable),
        np.flatnonzero(proof.original_shape_bound > provable),
    )
    if asked.is_image:
        color, discolored = _measured(light, asked) if asked.color < math.inf else (None, (_NONE, _NONE))
        return _Found(light, proof, provable, color, far, discolored)
    discolored = (
        np.flatnonzero(proof.color_bound > asked.color),
        np.flatnonzero(proof.original_color_bound > asked.color),
    )
    return _Found(light, proof, provable, None, far, discolored)


def _proof(light: Mesh, asked: _Asked, limit: tuple[float, float] | None) -> _kernels.Certified:
    def soup(mesh: Mesh, triangles: NDArray[Any]) -> Any:
        colored = mesh.with_(colors=None) if asked.is_image else mesh
        return mesh.vertices, attributes_of(colored), triangles

    given = asked.task.mesh
    return _kernels.certify(
        soup(light, asked.surface if light is given else light.triangles),
        soup(given, asked.surface),
        tolerance=(TOLERANCE, TOLERANCE),
        absolute_tolerance=(0.0, 0.0),
        limit=limit,
        effort=PIECES,
        slack=None,
        threads=asked.task.threads,
        progress=asked.task.progress,
    )


def _measured(light: Simplified[SeamsDetails], asked: _Asked) -> tuple[float, tuple[Ids, Ids]]:
    """Measure the largest colour difference, and find triangles beyond the bound.

    Positions where sheets of different colours coincide are ignored.
    """
    samples = color_samples(light.mesh, asked.task.mesh)
    if samples is None:
        return 0.0, (_NONE, _NONE)
    told = ~asked.ambiguous[samples.original_triangle]
    wrong = told & (samples.difference > asked.color)
    of_light = samples.own_triangle[: samples.of_light][wrong[: samples.of_light]]
    discolored = np.unique(of_light), np.unique(samples.original_triangle[wrong])
    return float(samples.difference[told].max(initial=0.0)), discolored


def _made_of(
    mesh: Mesh, light: Simplified[SeamsDetails], triangles: tuple[Ids, Ids], hopeless: NDArray[np.bool_]
) -> Ids:
    """Return the input vertices behind triangles with colours out of bounds.

    `triangles` are indices into the simplified mesh and into the input.

    Triangles that are not provable anyway are skipped. Locking these vertices restores the input's triangles.
    """
    of_input = np.concatenate([light.triangle_source[triangles[0]], triangles[1]])
    return np.unique(mesh.triangles[of_input[~hopeless[of_input]]])


def _hopeless(asked: _Asked, shape: float) -> NDArray[np.bool_]:
    """Return a mask (m,) of input triangles that can never be proven.

    The mask includes their neighbours.

    Even the unchanged input fails the proof there: triangles are too thin, or one position has several
    colours. Locking vertices would not help.
    """
    mesh = asked.task.mesh
    color = math.inf if asked.is_image else asked.color
    bounds = _proof(mesh, asked, (shape, color))
    fails = (bounds.shape_bound > shape) | (bounds.original_shape_bound > shape)
    if color < math.inf:
        fails |= (bounds.color_bound > color) | (bounds.original_color_bound > color)
    touched = np.zeros(len(mesh.vertices), bool)
    touched[mesh.triangles[fails]] = True
    return np.asarray(fails | touched[mesh.triangles].any(axis=1))


def _around(mesh: Mesh, found: _Found, hopeless: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the input vertices around triangles without a proof.

    Triangles that can never be proven (`hopeless`) are skipped.
    """
    from scipy.spatial import cKDTree

    of_light = found.far[0][~hopeless[found.light.triangle_source[found.far[0]]]]
    near = [mesh.triangles[found.far[1][~hopeless[found.far[1]]]].reshape(-1)]
    if len(of_light):
        corners = found.light.mesh.vertices[found.light.mesh.triangles[of_light]]
        centres = corners.mean(axis=1)
        reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1) + found.provable
        tree = cKDTree(mesh.vertices)
        near += [np.asarray(some, np.int64) for some in tree.query_ball_point(centres, reach)]
        # No vertex may be within reach of a triangle that is smaller than its source triangles.
        near.append(tree.query(centres)[1])
    return np.unique(np.concatenate(near)).astype(np.int64)


def _result(
    asked: _Asked, task: Task[CertifiedParams], found: _Found, weight: float, passes: int
) -> Simplified[CertifiedDetails]:
    mesh, light, proof = asked.task.mesh, found.light, found.proof
    with_color = mesh.colors is not None and not asked.is_image
    shape_bound, color_bound = proof.shape_bound, proof.color_bound
    (bound, color), (attained, color_attained) = proof.bound, proof.attained
    # Without a limit, the proof yields the bound on colour even if none was requested.
    if task.params.close_bounds or (with_color and asked.color == math.inf):
        close = _proof(light.mesh, asked, None)
        shape_bound = np.minimum(shape_bound, close.shape_bound)
        bound, attained = min(bound, close.bound[0]), max(attained, close.attained[0])
        color_bound, color, color_attained = close.color_bound, close.bound[1], close.attained[1]
    proven = bound <= found.provable and not (with_color and color > asked.color)
    measured = found.color
    if asked.is_image and measured is None:
        samples = color_samples(light.mesh, mesh, most=_GLANCE)
        measured = None if samples is None else samples.largest
    too_far = measured is not None and measured > asked.color
    stopped_by = light.stopped_by if asked.task.triangles or light.stopped_by == "request" else "bounds"
    if not proven:
        fails = shape_bound > found.provable
        if with_color:
            fails |= color_bound > asked.color
        emit(not_proven(light.mesh, fails, shape_bound, (bound, color if with_color else None)))
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
    without = [len(np.union1d(a, b)) for a, b in zip(found.far, found.discolored, strict=True)]
    return Simplified(
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
            max_shape_m=asked.shape,
            max_color_levels=task.max_color,
            seam_drift=light.details.seam_drift,
        ),
        record=light.record,
    )


def _forward_only(progress: Progress) -> tuple[Progress, Progress]:
    """Create monotonic progress callbacks for passes and for proofs between passes.

    The second callback repeats the latest state, so that exceptions from `progress` are raised. It ignores
    requests to stop, because a proof always runs to its end.
    """
    farthest, all_of_it = 0, 0

    def tell(done: int, total: int) -> object:
        nonlocal farthest, all_of_it
        farthest, all_of_it = max(farthest, done), total
        return progress(min(farthest, total), total)

    def go_on(done: int, total: int) -> object:  # noqa: ARG001 - as all progress is called
        progress(min(farthest, all_of_it), all_of_it)
        return True

    return tell, go_on
