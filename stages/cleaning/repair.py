"""Repair of irregular elements within a proven distance; everything else stays unchanged.

The operations follow Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies"
(2012, table 1). They flip the longest edge of caps and folded edges, collapse the shortest edge of needles,
and smooth spikes. Non-manifold regions are left alone.

    apply every repair that creates no new defect, in rounds repeat:
        prove the two-sided distance of all changed triangles, and undo those beyond max_shape compare the
        defects of all classes with the input, and undo repairs that created new ones
    until nothing is undone
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.cleaning.check import CLASSES, CheckParams
from scanloom.stages.cleaning.codes import CLEAN_NOT_REPAIRED
from scanloom.stages.cleaning.regularity import AngleLimits, find_irregular
from scanloom.stages.cleaning.repairs.defect_comparison import compare_defects
from scanloom.stages.cleaning.repairs.defect_indices import REPAIRABLE, compute_edge_keys
from scanloom.stages.cleaning.repairs.editable_mesh import GONE, EditableMesh, build_repaired_mesh
from scanloom.stages.cleaning.repairs.iterative_repair import RepairLog, repair_all
from scanloom.stages.cleaning.repairs.neighbourhood import grow_rings
from scanloom.stages.cleaning.repairs.operations import (
    ACCEPTED,
    NEW_DEFECT,
    NO_OPERATION,
    REASONS,
    SEAM,
    TOO_FAR,
)
from scanloom.stages.comparing.certify import certify
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.params import check_parameters as check_params
from scanloom.stages.params import describe_own, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.topology import has_repeated_vertex, require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RepairKeywords

# Default `max_shape` as a ratio of the median edge length. A needle of 1° with edges of median length is
# 0.017 edges wide.
MAX_SHAPE_RATIO = 0.05

# Elements listed per defect class in the statistics.
_LISTED_DEFECTS = 10
_STEP_COUNT = 3
# Rings of triangles around changed ones that take part in the proof, because the nearest point may lie there.
_PROOF_RINGS = 1
# Subdivisions per triangle in a proof. More do not tighten the bounds, because needles dominate them.
_PROOF_EFFORT = 1.0
_DEGENERATE_CLASS = REPAIRABLE.index("degenerate_triangles")
_CHECK_PARAMS = describe_own(CheckParams)


def _copy_check_param(name: str) -> Any:
    """Declare a parameter identical to the one of `check`."""
    about = _CHECK_PARAMS[name]
    return param(
        CheckParams.__dataclass_fields__[name].default,
        about.text,
        unit=about.unit,
        low=about.low,
        high=about.high,
        invalidates=about.invalidates,
    )


@dataclass(frozen=True, kw_only=True)
class RepairParams:
    """Thresholds of the defect classes, and the distance limit of repairs."""

    max_shape: float | None = param(
        None,
        "Maximum distance by which the surface may move, which is proven. Default: a "
        "twentieth of the median edge length.",
        unit="m",
        low=0,
    )
    corner_angle: float = _copy_check_param("corner_angle")
    fold_angle: float = _copy_check_param("fold_angle")
    spike_angle: float = _copy_check_param("spike_angle")
    threads: int | None = _copy_check_param("threads")

    def __post_init__(self) -> None:
        check_params(self)


@dataclass(frozen=True, eq=False)
class RepairResult:
    """Result of `repair`: the mesh, and what was and was not repaired.

    Indices of elements refer to the input mesh.

    Attributes
    ----------
    mesh : repaired mesh; regular elements are unchanged.
    vertex_source : (n,) input vertex of each vertex.
    triangle_source : (m,) input triangle that each triangle replaces.
    found_defects : defects of the input: per class in `scanloom.stages.cleaning.check.CLASSES` except thin
        triangles,
        vertices (k,), edges (k, 2) or triangles (k,).
    repaired_defects : defects that no longer exist; some disappear through repairs of others.
    remaining_defects : defects that remain.
    remaining_reasons : reason in words for each remaining defect.
    remaining_points : per class, a point (k, 3) per remaining defect, metres: the vertex, or the centre.
    rollback_counts : per class, the number of repairs that were made and undone.
    bound_m : proven two-sided distance between input and result, metres.
    max_shape_m : applied distance limit, metres.
    diagnostics : warnings about remaining defects.
    """

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids
    found_defects: dict[str, Ids]
    repaired_defects: dict[str, Ids]
    remaining_defects: dict[str, Ids]
    remaining_reasons: dict[str, list[str]]
    remaining_points: dict[str, Vertices]
    rollback_counts: dict[str, int]
    bound_m: float
    max_shape_m: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return statistics for reports, with remaining defects per class."""
        return {
            "bound_m": self.bound_m,
            "max_shape_m": self.max_shape_m,
            "classes": {name: self._summarize_class(name) for name in self.found_defects},
        }

    def _summarize_class(self, name: str) -> dict[str, Any]:
        kind, treatment, _ = CLASSES[name]
        left, points = (
            self.remaining_defects[name][:_LISTED_DEFECTS].tolist(),
            self.remaining_points[name][:_LISTED_DEFECTS].tolist(),
        )
        first = zip(left, points, self.remaining_reasons[name][:_LISTED_DEFECTS], strict=True)
        return {
            "treatment": treatment,
            "found": len(self.found_defects[name]),
            "repaired": len(self.repaired_defects[name]),
            "left": len(self.remaining_defects[name]),
            "rolled_back": self.rollback_counts[name],
            "reasons": dict(Counter(self.remaining_reasons[name]).most_common()),
            "first": [{kind: place, "point_m": point, "reason": reason} for place, point, reason in first],
        }


def repair(
    mesh: MeshLike,
    params: RepairParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[RepairKeywords],
) -> RepairResult:
    """Repair caps, needles, folds, spikes, degenerate and duplicate triangles.

    A repair is made only if it creates no new defect in any class of `check`. It must not flip a triangle, in
    3-D or in the texture. Borders, seams, materials and parts do not change. A repair is kept only if the
    two-sided distance to the input is proven to be within `max_shape`. All other elements stay bit-identical
    and in order. The result is deterministic.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    params : RepairParams; single fields can be given as keywords instead.
    progress : called with (steps done, all steps).

    Returns
    -------
    RepairResult

    Raises
    ------
    MeshError
        If the mesh is invalid, or its coordinates are too large.
    UsageError
        If a parameter is out of range.

    References
    ----------
    Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies", 2012: defect
    classes and repair operations.
    """
    with collecting() as diagnostics:
        repaired = _repair(as_mesh(mesh), resolve(RepairParams, params, changes), progress)
    return replace(repaired, diagnostics=tuple(diagnostics))


def _repair(given: Mesh, params: RepairParams, progress: Progress) -> RepairResult:
    require_measurable(given, "mesh")
    progress(0, _STEP_COUNT)
    threads = params.threads or 0
    limits = AngleLimits(
        corner_deg=params.corner_angle, fold_deg=params.fold_angle, spike_deg=params.spike_angle
    )
    edited = EditableMesh.start(given)
    joined = edited.triangles.astype(np.int32)
    found, _ = find_irregular(given.vertices, joined, limits, threads, ignore_progress)
    progress(1, _STEP_COUNT)
    max_shape = _compute_default_max_shape(given) if params.max_shape is None else params.max_shape
    log = RepairLog()
    _remove_repeated_vertices(edited, log)
    repair_all(edited, _find_defect_triangles(joined, found), limits, log, lambda: progress(1, _STEP_COUNT))
    progress(2, _STEP_COUNT)
    while True:
        unproven, bound = _find_unproven(edited, max_shape, threads)
        if len(unproven):
            _undo(edited, log, unproven, TOO_FAR)
            continue
        changes_made = compare_defects(edited, limits, found["intersecting_triangles"], threads)
        if len(changes_made.responsible) == 0:
            break
        _undo(edited, log, changes_made.responsible, NEW_DEFECT)
        progress(2, _STEP_COUNT)
    result = _build_result(edited, found, changes_made.resolved, log, (bound, max_shape))
    progress(_STEP_COUNT, _STEP_COUNT)
    return result


def _compute_default_max_shape(mesh: Mesh) -> float:
    if len(mesh.triangles) == 0:
        return 0.0
    corners = mesh.vertices[mesh.triangles]
    return MAX_SHAPE_RATIO * float(np.median(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)))


def _remove_repeated_vertices(edited: EditableMesh, log: RepairLog) -> None:
    """Delete triangles that use a vertex index twice, which leaves no T-junction."""
    given = edited.mesh.triangles
    (rows,) = np.nonzero(has_repeated_vertex(given))
    number = np.arange(len(rows))
    no_indices = np.zeros(0, np.int64)
    gone = np.full((len(rows), 3), GONE)
    edited.apply_edits(
        (number, rows), (number, rows, gone), (no_indices, no_indices, np.zeros((0, 3))), len(rows)
    )
    log.edit_defects += [(_DEGENERATE_CLASS, int(row)) for row in rows]
    # Triangles with two vertices at one position stay: deleting them could leave a T-junction at a seam.
    for row in np.flatnonzero(has_repeated_vertex(edited.first_vertex[given]) & ~has_repeated_vertex(given)):
        log.rejections[_DEGENERATE_CLASS, int(row)] = SEAM


def _find_defect_triangles(triangles: Ids, found: dict[str, Ids]) -> Ids:
    """Return the triangles at repairable defects."""
    vertices = np.zeros(triangles.max(initial=-1) + 1, bool)
    rows = np.zeros(len(triangles), bool)
    for name in REPAIRABLE:
        marked = rows if CLASSES[name][0] == "triangle" else vertices
        marked[found[name]] = True
    return np.flatnonzero(rows | vertices[triangles].any(axis=1))


def _find_unproven(edited: EditableMesh, limit: float, threads: int) -> tuple[Ids, float]:
    """Find changed triangles whose distance is not proven within `limit`.

    An unchanged triangle has distance zero to itself. So only changed triangles are certified, against their
    neighbourhood before or after the repairs. The distance to part of a surface is an upper bound of the
    distance to the complete surface.

    Returns
    -------
    far : triangles without a proof, in either direction.
    bound : metres, the bound proven for all changed triangles.
    """
    changed = edited.find_changed()
    if len(changed) == 0:
        return changed, 0.0
    given = edited.get_input_triangles()
    input_rows = grow_rings(given, len(edited.first_vertex), changed, _PROOF_RINGS)
    present_rows = input_rows[edited.is_present(input_rows)]
    proof = certify(
        _extract_mesh(edited.positions, edited.triangles[present_rows]),
        _extract_mesh(edited.mesh.vertices, given[input_rows]),
        max_shape=limit,
        effort=_PROOF_EFFORT,
        threads=threads,
    )
    unproven, bound = [], 0.0
    for rows, bounds in ((present_rows, proof.shape_bound), (input_rows, proof.original_shape_bound)):
        written = np.isin(rows, changed)
        unproven.append(rows[written & (bounds > limit)])
        bound = max(bound, float(bounds[written].max(initial=0.0)))
    return np.union1d(*unproven), bound


def _extract_mesh(vertices: Vertices, triangles: Ids) -> Mesh:
    used, index = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], index.reshape(-1, 3).astype(np.int32))


def _undo(edited: EditableMesh, log: RepairLog, rows: Ids, reason: int) -> None:
    """Undo the edits that wrote some triangles, and dependent edits."""
    edits, restored = edited.undo(edited.find_writers(rows))
    places = [log.edit_defects[edit] for edit in edits]
    log.rejections |= dict.fromkeys(places, reason)
    log.undone_defects.update(places)
    # Defects that disappeared as a side effect of these edits exist again.
    log.restored_triangles |= dict.fromkeys(restored.tolist(), reason)


def _build_result(
    edited: EditableMesh,
    found: dict[str, Ids],
    resolved: dict[str, Ids],
    log: RepairLog,
    bound_and_limit: tuple[float, float],
) -> RepairResult:
    repaired, left, why, points = {}, {}, {}, {}
    for name, places in found.items():
        keys = _to_keys(edited, places)
        is_resolved = np.isin(keys, _to_keys(edited, resolved[name]))
        repaired[name], left[name] = places[is_resolved], places[~is_resolved]
        why[name] = [REASONS[_find_reason(log, name, int(key))] for key in keys[~is_resolved]]
        points[name] = _compute_points(edited, name, left[name])
    for name in REPAIRABLE:
        if why[name]:
            _report_left(name, len(found[name]), why[name], points[name])
    untreated = [
        f"{len(left[name]):,} {_format_class_name(name)}"
        for name in left
        if _needs_warning(name) and why[name]
    ]
    if untreated:
        emit(
            CLEAN_NOT_REPAIRED.warning(
                "found defects that repair does not treat: {warned}.", warned=", ".join(untreated)
            )
        )
    mesh, vertex_source, triangle_source = build_repaired_mesh(edited)
    return RepairResult(
        mesh=mesh,
        vertex_source=vertex_source,
        triangle_source=triangle_source,
        found_defects=found,
        repaired_defects=repaired,
        remaining_defects=left,
        remaining_reasons=why,
        remaining_points=points,
        rollback_counts={
            name: sum(REPAIRABLE[kind] == name for kind, _ in log.undone_defects) for name in found
        },
        bound_m=bound_and_limit[0],
        max_shape_m=bound_and_limit[1],
    )


def _find_reason(log: RepairLog, name: str, key: int) -> int:
    """Return the reason code of a remaining defect.

    This is the last rejection of its repair, or the reason for undoing a repair that had removed it.
    """
    if name not in REPAIRABLE:
        return NO_OPERATION
    of_triangle = CLASSES[name][0] == "triangle"
    other = log.restored_triangles.get(key, NO_OPERATION) if of_triangle else NO_OPERATION
    return max(log.rejections.get((REPAIRABLE.index(name), key), other), ACCEPTED) or NO_OPERATION


def _to_keys(edited: EditableMesh, places: Ids) -> Ids:
    return compute_edge_keys(places, len(edited.first_vertex)) if places.ndim == 2 else places


def _compute_points(edited: EditableMesh, name: str, places: Ids) -> Vertices:
    """Compute an input point (k, 3) for each vertex, edge or triangle.

    Edges and triangles are represented by their centre.
    """
    vertices = edited.mesh.vertices
    if CLASSES[name][0] == "vertex":
        return vertices[places]
    corners = places if CLASSES[name][0] == "edge" else edited.mesh.triangles[places]
    return np.asarray(vertices[corners].mean(axis=1))


def _report_left(name: str, found: int, reasons: list[str], points: Vertices) -> None:
    x, y, z = points[0]
    emit(
        CLEAN_NOT_REPAIRED.warning(
            "{left:,} of {found:,} {what} not repaired: {reasons}; the first at ({x:.6g}, "
            "{y:.6g}, {z:.6g}) m.",
            left=len(reasons),
            found=found,
            what=_format_class_name(name),
            reasons=", ".join(f"{count:,} {reason}" for reason, count in Counter(reasons).most_common()),
            x=x,
            y=y,
            z=z,
        )
    )


def _needs_warning(name: str) -> bool:
    """Return True for classes without a repair that need a warning.

    Borders need none, because every open scan has them.
    """
    return name not in REPAIRABLE and name != "border_edges"


def _format_class_name(name: str) -> str:
    return name.replace("_", " ")
