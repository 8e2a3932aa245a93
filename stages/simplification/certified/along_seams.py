"""Method `certified` where corners have attributes of their own: a proven distance, and the texture stays.

Collapses are those of method `seams`, which keep an image whole, as far as samples of the input stay near.
What comes out is proven; where that fails, the samples around may do less, or stay, and all is done again:

    factors of the vertices <- 1
    repeat:
        collapse along seams, every sample within its share of the bound
        prove the distance both ways, and the colours of vertices; measure those of images at every texel
        nothing fails: done
        tighten the factors where the proof failed, lock where it goes on failing; lock where colours failed

What is locked on all sides is the input itself, which is why this ends.
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

# What the share is multiplied with around a triangle without a proof.
_TIGHTER = 0.6
# Proofs that may fail around a vertex before it stays.
_PATIENCE = 4
# After so many times no vertex near a failure moves any more.
_MOST_PASSES = 24
_NONE = np.zeros(0, np.int64)
# Samples of each surface where colours are measured though nobody asked for a bound on them.
_GLANCE = 1 << 17


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is to hold, and how it is told.

    Attributes
    ----------
    shape : metres.
    color : levels; infinite for no bound.
    is_image : colours come from images: they are measured, and else proven, as those of vertices are linear.
    ambiguous : (m,) bool, triangles of the input that several colours are in the place of.
    surface : (m, 3) int32, the triangles of the input that the proof is about.
    """

    task: Task[Any]
    shape: float
    color: float
    is_image: bool
    ambiguous: NDArray[np.bool_]
    surface: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Found:
    """What a pass led to, and what is wrong with it.

    Attributes
    ----------
    provable : metres.
    color : levels that were measured, if they were.
    far : triangles of the light mesh and of the input without a proof of their distance.
    discolored : the same by their colours.
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
    """Simplify within a proven distance of `shape` metres, and a measured difference of colour if given."""
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
            # What fails is the input itself.
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
            "colours are not compared at {count:,} triangles, where the model itself has several colours in "
            "one place.",
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
    """Return the triangles of a mesh, with another one in place of each that no method keeps."""
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
    """Return the greatest difference of colour found, and the triangles where it is too great.

    Nothing is said of places where sheets of different colours lie on each other.
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
    """Return the vertices of the input that these triangles are of, or are left of, where there is hope.

    Where they stay, the triangles are those of the input.
    """
    of_input = np.concatenate([light.triangle_source[triangles[0]], triangles[1]])
    return np.unique(mesh.triangles[of_input[~hopeless[of_input]]])


def _hopeless(asked: _Asked, shape: float) -> NDArray[np.bool_]:
    """Return the triangles of the input (m,) that not even the input is proven near, and their neighbours.

    Where triangles are so thin that only their longest side counts, or several colours are in one place,
    nothing is gained by keeping what is there.
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
    """Return the vertices of the input at triangles without a proof where there may be one."""
    from scipy.spatial import cKDTree

    of_light = found.far[0][~hopeless[found.light.triangle_source[found.far[0]]]]
    near = [mesh.triangles[found.far[1][~hopeless[found.far[1]]]].reshape(-1)]
    if len(of_light):
        corners = found.light.mesh.vertices[found.light.mesh.triangles[of_light]]
        centres = corners.mean(axis=1)
        reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1) + found.provable
        tree = cKDTree(mesh.vertices)
        near += [np.asarray(some, np.int64) for some in tree.query_ball_point(centres, reach)]
        # A triangle smaller than those it is made of may have no vertex near.
        near.append(tree.query(centres)[1])
    return np.unique(np.concatenate(near)).astype(np.int64)


def _result(
    asked: _Asked, task: Task[CertifiedParams], found: _Found, weight: float, passes: int
) -> Simplified[CertifiedDetails]:
    mesh, light, proof = asked.task.mesh, found.light, found.proof
    with_color = mesh.colors is not None and not asked.is_image
    shape_bound, color_bound = proof.shape_bound, proof.color_bound
    (bound, color), (attained, color_attained) = proof.bound, proof.attained
    # Only so is the bound on colour found where none is wanted.
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
                "simplify could not keep colours within max_color; {measured:.3g} levels were measured.",
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
    """Return what tells of passes, and never goes back, and what is called between them.

    The second one tells again how far the first has come, so that whoever raises is heard; as a proof is made
    to its end, it asks for nothing.
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
