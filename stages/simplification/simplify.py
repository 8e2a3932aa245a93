"""Colour-preserving mesh simplification to a triangle count or within bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.bake_planning import (
    choose_texture,
    derive_max_shape,
    exceeds_count,
    has_few_seams,
    has_texture_images,
    is_better_baked,
    is_visibly_different,
    plan_baking,
)
from scanloom.stages.simplification.codes import (
    SIMPLIFY_ATTRIBUTES_LOST,
    SIMPLIFY_COORDINATES_UNUSABLE,
    SIMPLIFY_IMAGES_KEPT,
    SIMPLIFY_IMAGES_REBAKED,
)
from scanloom.stages.simplification.corner_attributes import has_corner_attributes
from scanloom.stages.simplification.isolated_triangles import report_isolated_degenerates
from scanloom.stages.simplification.kernel_input import create_texture_warning
from scanloom.stages.simplification.method_selection import has_no_goal, require_supported, select_method
from scanloom.stages.simplification.noise_bound import check_deviations, derive_noise_bound
from scanloom.stages.simplification.params import AUTO, SimplifyParams
from scanloom.stages.simplification.regions import Region, resolve_vertex_control
from scanloom.stages.simplification.requirements import report_unmet_requirements
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.small_feature_removal import remove_small_features
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.topology import require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import SimplifyKeywords
    from scanloom.stages.simplification import keywords
    from scanloom.stages.simplification.certified.details import CertifiedDetails
    from scanloom.stages.simplification.jia01.details import Jia01Details
    from scanloom.stages.simplification.planar.details import PlanarDetails
    from scanloom.stages.simplification.quadric.details import QuadricDetails
    from scanloom.stages.simplification.seams.details import SeamsDetails

__all__ = ["RESULT_VERSION", "SimplificationResult", "SimplifyParams", "simplify"]

RESULT_VERSION = 15


@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    method: Literal["quadric"],
    **changes: Unpack[keywords.QuadricCall],
) -> SimplificationResult[QuadricDetails]: ...
@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    method: Literal["certified"],
    **changes: Unpack[keywords.CertifiedCall],
) -> SimplificationResult[CertifiedDetails]: ...
@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    method: Literal["seams"],
    **changes: Unpack[keywords.SeamsCall],
) -> SimplificationResult[SeamsDetails]: ...
@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    method: Literal["jia01"],
    **changes: Unpack[keywords.Jia01Call],
) -> SimplificationResult[Jia01Details]: ...
@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    method: Literal["planar"],
    **changes: Unpack[keywords.PlanarCall],
) -> SimplificationResult[PlanarDetails]: ...
# With method `auto`, the type of the details is known only at run time.
@overload
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    lock: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    regions: Sequence[Region] = (),
    deviations: ArrayLike | None = None,
    record: bool = False,
    keep_on_interrupt: bool = False,
    progress: Progress = ignore_progress,
    **changes: Unpack[SimplifyKeywords],
) -> SimplificationResult[Any]: ...
def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    lock: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    regions: Sequence[Region] = (),
    deviations: ArrayLike | None = None,
    record: bool = False,
    keep_on_interrupt: bool = False,
    progress: Progress = ignore_progress,
    **changes: Unpack[SimplifyKeywords],
) -> SimplificationResult[Any]:
    """Simplify a mesh to a triangle count or within error bounds.

    The result has the topology, the border loops and the orientation of the input. Borders shrink only along
    themselves, and no triangle flips. The result is bit-identical for any number of threads. The methods are
    listed in `scanloom.stages.simplification.methods`; each is described in its package, such as
    `scanloom.stages.simplification.certified`.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres. Vertices at equal
        positions are welded. A non-manifold surface is split into sheets with a warning; it stays unchanged
        where sheets touch. Unused vertices and triangles that use a vertex twice are removed.
    params : SimplifyParams; single fields can be given as keywords instead, and fields of one method as a
        dict: `planar={"crease_angle": 30}`. The target is `triangles` or `ratio`, and the bounds `max_shape`
        (metres) and `max_color` (8-bit levels); whichever is reached first stops the simplification.
        `drop_below` (metres) removes small components and holes first, reported as `dropped` of the result. A
        record then begins with the mesh after the removal.
    lock : (n,) bool or vertex indices: these vertices stay bit-identical. Others may collapse into them.
    importance : (n,) float above 0, factor on the squared error around each vertex. With proven bounds it
        must be at least 1, and divides them.
    regions : `scanloom.Sphere` and `scanloom.Box`, which lock their vertices or give them importance.
    deviations : (n,) standard deviation of each vertex in metres, as `refine` measures it. Without a target,
        each vertex may then deviate by `noise_factor` standard deviations, but at most by as many times
        their median, which is proven (`default_max_shape` of the result). Ignored with a target or a method.
    record : record all collapses, so that every intermediate mesh can be restored.
    keep_on_interrupt : on Ctrl-C, return the mesh simplified so far instead of raising KeyboardInterrupt.
    progress : called about ten times per second with the numbers of removed triangles and of triangles to
        remove. If it returns False, the mesh simplified so far is returned; an exception stops the
        simplification.

    Returns
    -------
    SimplificationResult
        With `details` of the method's type. Images of the input are baked again (`baked`, see
        `scanloom.stages.simplification.bake_planning`), unless `keep_uv` or a method that preserves them is
        given. Without images, the mesh has vertex colours if the input has. `diagnostics` contain lost
        attributes and unmet requirements: a triangle count without a bound, and bounds that are not proven.

    Raises
    ------
    MeshError
        For an index out of range or a value that is not finite.
    UsageError
        For a parameter out of range or of another method, or a request that the method does not support for
        this mesh.
    """
    with collecting() as diagnostics:
        params = resolve(SimplifyParams, params, dict(changes))
        mesh = as_mesh(mesh)
        require_measurable(mesh, "mesh")
        control = _Control(
            *resolve_vertex_control(mesh, lock, importance, regions), record, keep_on_interrupt, progress
        )
        bound = None
        if deviations is not None and has_no_goal(params):
            bound, factors = derive_noise_bound(
                check_deviations(deviations, len(mesh.vertices)), params.noise_factor
            )
            params = resolve(SimplifyParams, params, {"max_shape": bound})
            own = control.importance if len(control.importance) else 1.0
            control = replace(control, importance=factors * own)
        found = _simplify_validated(mesh, params, control)
        if bound is not None:
            found = replace(found, default_max_shape=bound)
        report_unmet_requirements(params, found.to_dict())
    return replace(found, diagnostics=tuple(diagnostics))


@dataclass(frozen=True, eq=False)
class _Control:
    """Arguments of `simplify` other than mesh and parameters, after validation.

    Attributes
    ----------
    lock : (n,) bool.
    importance : (n,) float64; (0,) if it is 1 everywhere.
    record, keep_on_interrupt, progress : see `simplify`.
    """

    lock: NDArray[np.bool_]
    importance: NDArray[np.float64]
    record: bool
    keep_on_interrupt: bool
    progress: Progress


def _simplify_validated(mesh: Mesh, params: SimplifyParams, control: _Control) -> SimplificationResult[Any]:
    """Simplify with validated arguments, without reporting unmet requirements."""
    if params.drop_below is not None:
        return _simplify_remaining(mesh, params, params.drop_below, control)
    plan, reason = plan_baking(mesh, params, record=control.record)
    bound = None
    if has_no_goal(params) and has_texture_images(mesh):
        bound = derive_max_shape(mesh)
        params = resolve(SimplifyParams, params, {"max_shape": bound})
    if plan is not None and params.max_shape is not None:
        # The bound is proven for the shape with joined duplicates. Reducing it by their shift makes it hold
        # for the given mesh.
        params = resolve(
            SimplifyParams, params, {"max_shape": max(params.max_shape - plan.max_displacement, 0.0)}
        )
    # The result of an attempt may be discarded, and its diagnostics with it.
    with collecting(forward=False) as diagnostics:
        report_isolated_degenerates(mesh)
        if reason is not None:
            emit(reason)
        shape = mesh if plan is None else plan.shape
        if params.bake is False and not params.keep_uv and has_texture_images(mesh) and params.method == AUTO:
            shape = mesh.with_(texture=None)
            emit(create_texture_warning("simplify"))
        target = params.compute_target_count(len(mesh.triangles))
        found = replace(_run_method(shape, params, target, control), default_max_shape=bound)

    def report_end(done: int, total: int) -> object:  # noqa: ARG001 - as all progress is called
        return control.progress(found.collapses, found.collapses)

    def simplify_again(**changes: bool) -> SimplificationResult[Any]:
        again = replace(control, record=False, progress=report_end)
        return _simplify_validated(mesh, resolve(SimplifyParams, params, changes), again)

    if plan is None:
        is_missed = target is not None and exceeds_count(found, target) and found.stopped_by == "bounds"
        if reason is None or not is_missed or params.max_shape is not None:
            emit(*diagnostics)
            return found
        try:
            with collecting(forward=False) as of_remade:
                remade = simplify_again(bake=True)
        except MeshError:
            emit(*diagnostics)
            return found
        if not is_better_baked(mesh, remade, found):
            emit(*diagnostics)
            return found
        emit(
            *of_remade,
            SIMPLIFY_IMAGES_REBAKED.warning(
                "new images are baked: with its own images, the model would keep {count:,} "
                "triangles along texture seams and differ more from the input",
                remedy="keep_uv=True keeps the old images.",
                count=len(found.mesh.triangles),
            ),
        )
        return remade
    baked: SimplificationResult[Any] | None = None
    failure: Diagnostic | None = None
    try:
        with collecting(forward=False) as of_baking:
            baked = plan.bake(found)
        diagnostics += of_baking
    except MeshError as error:
        if params.bake:
            raise
        if params.method != AUTO:
            emit(
                *diagnostics,
                SIMPLIFY_ATTRIBUTES_LOST.warning(
                    "the images are discarded, because new ones could not be baked: {reason}",
                    reason=str(error),
                ),
            )
            return found
        failure = SIMPLIFY_IMAGES_KEPT.warning(
            "the images are kept with their seams, because new ones could not be baked: {reason}",
            reason=str(error),
        )
    if baked is not None and not _has_alternative(mesh, params, baked):
        emit(*diagnostics)
        return baked
    try:
        with collecting(forward=False) as of_kept:
            kept = simplify_again(keep_uv=True)
    except MeshError:
        # Invalid texture coordinates only matter if the images are kept.
        if baked is None:
            raise
        emit(*diagnostics)
        return baked
    if baked is not None:
        better = choose_texture(mesh, baked, kept)
        emit(*(diagnostics if better.kept_images is None else of_kept))
        return better
    emit(*of_kept)
    if failure is not None:
        emit(failure)
    return replace(kept, default_max_shape=bound)


def _simplify_remaining(
    mesh: Mesh, params: SimplifyParams, size: float, control: _Control
) -> SimplificationResult[Any]:
    """Simplify after removing components and holes smaller than `size` metres."""
    remainder = remove_small_features(mesh, size, control.lock)
    remainder.removal_counts.report()
    target = params.compute_target_count(len(mesh.triangles))
    remaining_params = resolve(
        SimplifyParams,
        params,
        {"drop_below": None, "triangles": None if target is None else max(target, 1), "ratio": None},
    )
    source, importance = remainder.vertex_source, control.importance
    own = resolve_vertex_control(
        remainder.mesh, control.lock[source], importance[source] if len(importance) else None, ()
    )
    found = _simplify_validated(
        remainder.mesh, remaining_params, replace(control, lock=own[0], importance=own[1])
    )
    return replace(
        found,
        vertex_source=remainder.vertex_source[found.vertex_source],
        triangle_source=remainder.triangle_source[found.triangle_source],
        triangles_before=len(mesh.triangles),
        dropped=remainder.removal_counts,
    )


def _run_method(
    mesh: Mesh, params: SimplifyParams, target: int | None, control: _Control
) -> SimplificationResult[Any]:
    """Simplify with the given method, or the one that `auto` selects."""
    method = select_method(params, has_corner_attributes=has_corner_attributes(mesh))
    require_supported(
        method,
        lock=bool(control.lock.any()),
        importance=len(control.importance) > 0,
        record=control.record,
        keep_on_interrupt=control.keep_on_interrupt,
    )
    task = Task(
        mesh=mesh,
        params=method.get_own_params(params),
        triangles=target,
        lock=control.lock,
        importance=control.importance,
        max_shape=params.max_shape,
        max_color=params.max_color,
        attribute_scale=params.attribute_scale,
        fit=params.fit,
        threads=params.threads or 0,
        record=control.record,
        keep_on_interrupt=control.keep_on_interrupt,
        progress=_stop_on_interrupt(control.progress) if control.keep_on_interrupt else control.progress,
    )
    try:
        found = method.run(task)
    except _kernels.InvalidMeshError as error:
        if method.capabilities.texture:
            raise MeshError(
                SIMPLIFY_COORDINATES_UNUSABLE,
                (
                    "{error}: texture coordinates or normals are too large or too small to "
                    "be weighted against the shape"
                ),
                "mesh",
                remedy="create a new texture, or remove them.",
                error=error,
            ) from error
        raise MeshError(MESH_NO_SURFACE, "{error}.", "mesh", error=error) from error
    found.details.report(found)
    return found


def _has_alternative(mesh: Mesh, params: SimplifyParams, baked: SimplificationResult[Any]) -> bool:
    """Return True if simplifying with the original images may beat baking.

    This requires method `auto`, a target triangle count without a shape bound, a visibly different baked
    result, and a mesh with few texture seams.
    """
    is_count = params.triangles is not None or params.ratio is not None
    is_open = params.method == AUTO and params.bake is None
    is_bounded = params.max_shape is not None
    is_done = baked.stopped_by != "request"
    if not (is_open and is_count and not is_bounded and is_done and is_visibly_different(baked)):
        return False
    return has_few_seams(mesh, len(baked.mesh.triangles))


def _stop_on_interrupt(progress: Progress) -> Progress:
    """Make Ctrl-C during progress callbacks a request to stop early."""

    def tell(done: int, total: int) -> object:
        try:
            return progress(done, total)
        except KeyboardInterrupt:
            return False

    return tell
