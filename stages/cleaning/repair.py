"""Repair what is irregular, as far as the surface provably stays where it is, and leave all else untouched.

The repairs are those of Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
hierarchies" (2012, table 1): the longest side of a cap is flipped, the shortest of a needle collapsed, an
edge the surface is folded along flipped, a spike smoothed. Where the surface is no manifold, nothing is done.

    make every repair after which nothing new is irregular, in rounds
    repeat:
        prove the distance of all that was written, both ways, and undo what passes max_shape
        compare what is irregular with what was, in all classes, and undo what made something so
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

# Of the median edge: what a repair may move the surface by default. A needle of one degree that is as long as
# an edge is 0.017 of it wide.
SHAPE_SHARE = 0.05

# Places that figures name of each class.
_NAMED = 10
_STEPS = 3
# Rings around written triangles that are part of their proof; a nearest point may lie there.
_PROOF_RINGS = 1
# Pieces per triangle in a proof. More do not tighten bounds, which are limited by what needles add.
_PROOF_EFFORT = 1.0
_DEGENERATE = REPAIRABLE.index("degenerate_triangles")
_CHECKED = described(CheckParams)


def _as_checked(name: str) -> Any:
    """Return a parameter that is that of `check`."""
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
    """From where on something is irregular, and how far the surface may move."""

    max_shape: float | None = param(
        None,
        "How far the surface may move, which is proven; by default a twentieth of the median edge.",
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
    """A repaired mesh, and what was and was not done.

    Attributes
    ----------
    mesh : the mesh; what was not irregular is as it was.
    vertex_source : (n,) vertex of the input each vertex was.
    triangle_source : (m,) triangle of the input in whose place each one is.
    found : of each class in `scanloom.stages.cleaning.check.CLASSES` that looks at neighbours or
        intersections, the vertices (k,), edges (k, 2) or triangles (k,) that belong to it, by their numbers
        in the input.
    repaired : of those, the ones that are no longer irregular; some may have gone with others.
    left : of those, the ones that still are; why : in words, for each.
    points : of what is left, a point (k, 3) for each, metres: the vertex, or the middle.
    rolled_back : of each class the places where a repair was made and undone.
    bound_m : what is proven: no point of either surface is farther from the other, metres.
    max_shape_m : metres, as used.
    diagnostics : what is left.
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
        """Return the counts of all classes, why something is left, and the first of these places."""
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
    """Repair caps, needles, folds, spikes, degenerate and duplicate triangles where nothing is lost by it.

    A repair is made only if nothing is irregular after it that was not before, in any class of `check`, no
    triangle is turned over, on the surface or in a texture, and no border, seam, material or part changes.
    It stays only if the surface around is proven to be within `max_shape` of what it was, both ways. All
    else keeps its bits, numbers and order, but for the numbers that removed ones leave. The same input gives
    the same bytes.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    params : RepairParams; single fields can be given by name instead.
    progress : called with (steps done, all).

    Raises
    ------
    MeshError
        If it is no valid mesh, or its coordinates are too large.
    UsageError
        If a parameter is out of range.

    References
    ----------
    Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies", 2012, for the
    classes and their repairs.
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
    """Leave triangles out that repeat a vertex: nothing hangs on them."""
    given = edited.mesh.triangles
    (rows,) = np.nonzero(repeats_vertex(given))
    number = np.arange(len(rows))
    none = np.zeros(0, np.int64)
    gone = np.full((len(rows), 3), GONE)
    edited.make((number, rows), (number, rows, gone), (none, none, np.zeros((0, 3))), len(rows))
    account.made += [(_DEGENERATE, int(row)) for row in rows]
    # Of others it is two vertices that are in one place: something may hang on these.
    for row in np.flatnonzero(repeats_vertex(edited.first[given]) & ~repeats_vertex(given)):
        account.refused[_DEGENERATE, int(row)] = SEAM


def _rows_of(triangles: Ids, found: dict[str, Ids]) -> Ids:
    """Return the triangles at places that have a repair."""
    vertices = np.zeros(triangles.max(initial=-1) + 1, bool)
    rows = np.zeros(len(triangles), bool)
    for name in REPAIRABLE:
        marked = rows if CLASSES[name][0] == "triangle" else vertices
        marked[found[name]] = True
    return np.flatnonzero(rows | vertices[triangles].any(axis=1))


def _find_unproven(edited: Edited, limit: float, threads: int) -> tuple[Ids, float]:
    """Return the triangles whose distance is not proven to be within a limit, and the bound proven for all.

    A triangle that no edit wrote is at distance zero from itself. So only written triangles are certified,
    each against its surroundings before or after: the distance to part of a surface bounds the distance to
    the entire surface.

    Both are in metres, and the proof holds in both directions.
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
    """Undo what wrote some triangles, and what rests on it."""
    edits, restored = edited.undo(edited.writers(rows))
    places = [account.made[edit] for edit in edits]
    account.refused |= dict.fromkeys(places, reason)
    account.undone.update(places)
    # What else had gone with these is back, too.
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
                "found, and nothing is done about it: {warned}.", warned=", ".join(warned)
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
    """Return why a place is left: what spoke against its repair last, or undid what it had gone with."""
    if name not in REPAIRABLE:
        return HELPLESS
    of_triangle = CLASSES[name][0] == "triangle"
    other = account.restored.get(key, HELPLESS) if of_triangle else HELPLESS
    return max(account.refused.get((REPAIRABLE.index(name), key), other), FINE) or HELPLESS


def _keys(edited: Edited, places: Ids) -> Ids:
    return edge_keys(places, len(edited.first)) if places.ndim == 2 else places


def _points(edited: Edited, name: str, places: Ids) -> Vertices:
    """Return a point (k, 3) of the given mesh for each vertex, edge or triangle."""
    vertices = edited.mesh.vertices
    if CLASSES[name][0] == "vertex":
        return vertices[places]
    corners = places if CLASSES[name][0] == "edge" else edited.mesh.triangles[places]
    return np.asarray(vertices[corners].mean(axis=1))


def _report_left(name: str, found: int, why: list[str], points: Vertices) -> None:
    x, y, z = points[0]
    emit(
        CLEAN_NOT_REPAIRED.warning(
            "{left:,} of {found:,} {what} left: {reasons}; the first at ({x:.6g}, {y:.6g}, {z:.6g}) m.",
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
    """Return whether to warn of a class without a repair; a border is what every open scan has."""
    return name not in REPAIRABLE and name != "border_edges"


def _spoken(name: str) -> str:
    return name.replace("_", " ")
