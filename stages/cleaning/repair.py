"""Repair of irregular elements within a proven distance; everything else stays unchanged.

The operations follow Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies"
(2012, table 1). They flip the longest edge of caps and folded edges, collapse the shortest edge of needles,
and smooth spikes. Non-manifold regions are left alone.

    apply every repair that creates no new defect, in rounds
    repeat:
        prove the two-sided distance of all changed triangles, and undo those beyond max_shape
        compare the defects of all classes with the input, and undo repairs that created new ones
    until nothing is undone
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.cleaning.check import CLASSES, CheckParams
from scanloom.stages.cleaning.codes import CLEAN_NOT_REPAIRED
from scanloom.stages.cleaning.regularity import Limits, irregular
from scanloom.stages.cleaning.repairs.comparing import difference
from scanloom.stages.cleaning.repairs.edited import GONE, Edited, repaired_mesh
from scanloom.stages.cleaning.repairs.neighbourhood import grown
from scanloom.stages.cleaning.repairs.operations import FINE, HELPLESS, REASONS, SEAM, TOO_FAR, WORSE
from scanloom.stages.cleaning.repairs.places import REPAIRABLE, edge_keys
from scanloom.stages.cleaning.repairs.rounds import Account, repair_all
from scanloom.stages.comparing.certify import certify
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.params import check as check_params
from scanloom.stages.params import described, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Vertices
from scanloom.stages.surface.topology import repeats_vertex, require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RepairKeywords

# Default `max_shape` as a ratio of the median edge length. A needle of 1° with edges of median length is
# 0.017 edges wide.
SHAPE_SHARE = 0.05

# Elements listed per defect class in the statistics.
_NAMED = 10
_STEPS = 3
# Rings of triangles around changed ones that take part in the proof, because the nearest point may lie there.
_PROOF_RINGS = 1
# Subdivisions per triangle in a proof. More do not tighten the bounds, because needles dominate them.
_PROOF_EFFORT = 1.0
_DEGENERATE = REPAIRABLE.index("degenerate_triangles")
_CHECKED = described(CheckParams)


def _as_checked(name: str) -> Any:
    """Declare a parameter identical to the one of `check`."""
    about = _CHECKED[name]
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
    corner_angle: float = _as_checked("corner_angle")
    fold_angle: float = _as_checked("fold_angle")
    spike_angle: float = _as_checked("spike_angle")
    threads: int | None = _as_checked("threads")

    def __post_init__(self) -> None:
        check_params(self)


@dataclass(frozen=True, eq=False)
class Repaired:
    """Result of `repair`: the mesh, and what was and was not repaired.

    Indices of elements refer to the input mesh.

    Attributes
    ----------
    mesh : repaired mesh; regular elements are unchanged.
    vertex_source : (n,) input vertex of each vertex.
    triangle_source : (m,) input triangle that each triangle replaces.
    found : defects of the input: per class in `scanloom.stages.cleaning.check.CLASSES` except thin triangles,
        vertices (k,), edges (k, 2) or triangles (k,).
    repaired : defects that no longer exist; some disappear through repairs of others.
    left : defects that remain.
    why : reason in words for each remaining defect.
    points : per class, a point (k, 3) per remaining defect, metres: the vertex, or the centre.
    rolled_back : per class, the number of repairs that were made and undone.
    bound_m : proven two-sided distance between input and result, metres.
    max_shape_m : applied distance limit, metres.
    diagnostics : warnings about remaining defects.
    """

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids
    found: dict[str, Ids]
    repaired: dict[str, Ids]
    left: dict[str, Ids]
    why: dict[str, list[str]]
    points: dict[str, Vertices]
    rolled_back: dict[str, int]
    bound_m: float
    max_shape_m: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return statistics for reports, with remaining defects per class."""
        return {
            "bound_m": self.bound_m,
            "max_shape_m": self.max_shape_m,
            "classes": {name: self._class_figures(name) for name in self.found},
        }

    def _class_figures(self, name: str) -> dict[str, Any]:
        kind, treatment, _ = CLASSES[name]
        left, points = self.left[name][:_NAMED].tolist(), self.points[name][:_NAMED].tolist()
        first = zip(left, points, self.why[name][:_NAMED], strict=True)
        return {
            "treatment": treatment,
            "found": len(self.found[name]),
            "repaired": len(self.repaired[name]),
            "left": len(self.left[name]),
            "rolled_back": self.rolled_back[name],
            "reasons": dict(Counter(self.why[name]).most_common()),
            "first": [{kind: place, "point_m": point, "reason": reason} for place, point, reason in first],
        }


def repair(
    mesh: MeshLike,
    params: RepairParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[RepairKeywords],
) -> Repaired:
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
    Repaired

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


def _repair(given: Mesh, params: RepairParams, progress: Progress) -> Repaired:
    require_measurable(given, "mesh")
    progress(0, _STEPS)
    threads = params.threads or 0
    limits = Limits(corner=params.corner_angle, fold=params.fold_angle, spike=params.spike_angle)
    edited = Edited.start(given)
    joined = edited.triangles.astype(np.int32)
    found = irregular(given.vertices, joined, limits, threads, silent)
    progress(1, _STEPS)
    max_shape = _default_max_shape(given) if params.max_shape is None else params.max_shape
    account = Account()
    _drop_repeating(edited, account)
    repair_all(edited, _rows_of(joined, found), limits, account, lambda: progress(1, _STEPS))
    progress(2, _STEPS)
    while True:
        far, bound = _find_unproven(edited, max_shape, threads)
        if len(far):
            _undo(edited, account, far, TOO_FAR)
            continue
        changes_made = difference(edited, limits, found["intersecting_triangles"], threads)
        if len(changes_made.guilty) == 0:
            break
        _undo(edited, account, changes_made.guilty, WORSE)
        progress(2, _STEPS)
    result = _told(edited, found, changes_made.gone, account, (bound, max_shape))
    progress(_STEPS, _STEPS)
    return result


def _default_max_shape(mesh: Mesh) -> float:
    if len(mesh.triangles) == 0:
        return 0.0
    corners = mesh.vertices[mesh.triangles]
    return SHAPE_SHARE * float(np.median(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)))


def _drop_repeating(edited: Edited, account: Account) -> None:
    """Delete triangles that use a vertex index twice, which leaves no T-junction."""
    given = edited.mesh.triangles
    (rows,) = np.nonzero(repeats_vertex(given))
    number = np.arange(len(rows))
    none = np.zeros(0, np.int64)
    gone = np.full((len(rows), 3), GONE)
    edited.make((number, rows), (number, rows, gone), (none, none, np.zeros((0, 3))), len(rows))
    account.made += [(_DEGENERATE, int(row)) for row in rows]
    # Triangles with two vertices at one position stay: deleting them could leave a T-junction at a seam.
    for row in np.flatnonzero(repeats_vertex(edited.first[given]) & ~repeats_vertex(given)):
        account.refused[_DEGENERATE, int(row)] = SEAM


def _rows_of(triangles: Ids, found: dict[str, Ids]) -> Ids:
    """Return the triangles at repairable defects."""
    vertices = np.zeros(triangles.max(initial=-1) + 1, bool)
    rows = np.zeros(len(triangles), bool)
    for name in REPAIRABLE:
        marked = rows if CLASSES[name][0] == "triangle" else vertices
        marked[found[name]] = True
    return np.flatnonzero(rows | vertices[triangles].any(axis=1))


def _find_unproven(edited: Edited, limit: float, threads: int) -> tuple[Ids, float]:
    """Find changed triangles whose distance is not proven within `limit`.

    An unchanged triangle has distance zero to itself. So only changed triangles are certified, against their
    neighbourhood before or after the repairs. The distance to part of a surface is an upper bound of the
    distance to the complete surface.

    Returns
    -------
    far : triangles without a proof, in either direction.
    bound : metres, the bound proven for all changed triangles.
    """
    changed = edited.changed()
    if len(changed) == 0:
        return changed, 0.0
    given = edited.given_triangles()
    old = grown(given, len(edited.first), changed, _PROOF_RINGS)
    new = old[edited.is_there(old)]
    proof = certify(
        _used_mesh(edited.places, edited.triangles[new]),
        _used_mesh(edited.mesh.vertices, given[old]),
        max_shape=limit,
        effort=_PROOF_EFFORT,
        threads=threads,
    )
    far, bound = [], 0.0
    for rows, bounds in ((new, proof.shape_bound), (old, proof.original_shape_bound)):
        written = np.isin(rows, changed)
        far.append(rows[written & (bounds > limit)])
        bound = max(bound, float(bounds[written].max(initial=0.0)))
    return np.union1d(*far), bound


def _used_mesh(vertices: Vertices, triangles: Ids) -> Mesh:
    used, index = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], index.reshape(-1, 3).astype(np.int32))


def _undo(edited: Edited, account: Account, rows: Ids, reason: int) -> None:
    """Undo the edits that wrote some triangles, and dependent edits."""
    edits, restored = edited.undo(edited.writers(rows))
    places = [account.made[edit] for edit in edits]
    account.refused |= dict.fromkeys(places, reason)
    account.undone.update(places)
    # Defects that disappeared as a side effect of these edits exist again.
    account.restored |= dict.fromkeys(restored.tolist(), reason)


def _told(
    edited: Edited,
    found: dict[str, Ids],
    gone: dict[str, Ids],
    account: Account,
    shape: tuple[float, float],
) -> Repaired:
    repaired, left, why, points = {}, {}, {}, {}
    for name, places in found.items():
        keys = _keys(edited, places)
        is_over = np.isin(keys, _keys(edited, gone[name]))
        repaired[name], left[name] = places[is_over], places[~is_over]
        why[name] = [REASONS[_reason(account, name, int(key))] for key in keys[~is_over]]
        points[name] = _points(edited, name, left[name])
    for name in REPAIRABLE:
        if why[name]:
            _report_left(name, len(found[name]), why[name], points[name])
    warned = [f"{len(left[name]):,} {_spoken(name)}" for name in left if _is_told(name) and why[name]]
    if warned:
        emit(
            CLEAN_NOT_REPAIRED.warning(
                "found defects that repair does not treat: {warned}.", warned=", ".join(warned)
            )
        )
    mesh, vertex_source, triangle_source = repaired_mesh(edited)
    return Repaired(
        mesh=mesh,
        vertex_source=vertex_source,
        triangle_source=triangle_source,
        found=found,
        repaired=repaired,
        left=left,
        why=why,
        points=points,
        rolled_back={name: sum(REPAIRABLE[kind] == name for kind, _ in account.undone) for name in found},
        bound_m=shape[0],
        max_shape_m=shape[1],
    )


def _reason(account: Account, name: str, key: int) -> int:
    """Return the reason code of a remaining defect.

    This is the last rejection of its repair, or the reason for undoing a repair that had removed it.
    """
    if name not in REPAIRABLE:
        return HELPLESS
    of_triangle = CLASSES[name][0] == "triangle"
    other = account.restored.get(key, HELPLESS) if of_triangle else HELPLESS
    return max(account.refused.get((REPAIRABLE.index(name), key), other), FINE) or HELPLESS


def _keys(edited: Edited, places: Ids) -> Ids:
    return edge_keys(places, len(edited.first)) if places.ndim == 2 else places


def _points(edited: Edited, name: str, places: Ids) -> Vertices:
    """Compute an input point (k, 3) for each vertex, edge or triangle.

    Edges and triangles are represented by their centre.
    """
    vertices = edited.mesh.vertices
    if CLASSES[name][0] == "vertex":
        return vertices[places]
    corners = places if CLASSES[name][0] == "edge" else edited.mesh.triangles[places]
    return np.asarray(vertices[corners].mean(axis=1))


def _report_left(name: str, found: int, why: list[str], points: Vertices) -> None:
    x, y, z = points[0]
    emit(
        CLEAN_NOT_REPAIRED.warning(
            "{left:,} of {found:,} {what} not repaired: {reasons}; the first at ({x:.6g}, "
            "{y:.6g}, {z:.6g}) m.",
            left=len(why),
            found=found,
            what=_spoken(name),
            reasons=", ".join(f"{count:,} {reason}" for reason, count in Counter(why).most_common()),
            x=x,
            y=y,
            z=z,
        )
    )


def _is_told(name: str) -> bool:
    """Return True for classes without a repair that need a warning.

    Borders need none, because every open scan has them.
    """
    return name not in REPAIRABLE and name != "border_edges"


def _spoken(name: str) -> str:
    return name.replace("_", " ")
