"""Whether a mesh is sound, and where it is not: what to ask first of any mesh."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.codes import CLEAN_CHECK_FAILED
from scanloom.stages.cleaning.regularity import Limits, irregular
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.edges import Ids, components, edges_of
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.raycasting import Surface, bounding_box, chunks
from scanloom.stages.surface.topology import (
    Topology,
    is_degenerate,
    repeats_vertex,
    require_measurable,
    topology,
)
from scanloom.stages.surface.welding import same_rows

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CheckKeywords

# Angles of a triangle below this are what Wang, Lu and Pan (2012) take by default: arcsin(1e-5), in degrees.
PAPERS_CORNER_ANGLE = float(np.degrees(np.arcsin(1e-5)))

# Places that figures name of each class.
_NAMED = 10

# Share of the bounding box's diagonal that a ray begins inside. The ray caster resolves no smaller lengths.
_RAY_START = 1e-6

Kind = Literal["vertex", "edge", "triangle"]
# What is done about a class, as in table 1 of the paper: it is left alone, or it can be repaired.
Treatment = Literal["warning", "marking"]

CLASSES: dict[str, tuple[Kind, Treatment, str]] = {
    "border_edges": ("edge", "warning", "edges of one triangle"),
    "nonmanifold_edges": ("edge", "warning", "edges of more than two triangles"),
    "inconsistent_edges": ("edge", "warning", "edges whose triangles are oriented against each other"),
    "singular_vertices": ("vertex", "warning", "pinched vertices, whose triangles form more than one fan"),
    "focal_vertices": ("vertex", "warning", "vertices where more than two border edges end"),
    "singular_border_triangles": (
        "triangle",
        "warning",
        "triangles that are alone at a singular vertex",
    ),
    "degenerate_triangles": ("triangle", "marking", "triangles that repeat a vertex or have no area"),
    "duplicate_triangles": ("triangle", "marking", "triangles of the vertices of an earlier one"),
    "caps": ("triangle", "marking", "triangles with an angle near 180°"),
    "needles": ("triangle", "marking", "triangles with an angle near 0° and none near 180°"),
    "sharp_edges": ("edge", "marking", "edges where the surface is folded back onto itself"),
    "spikes": ("vertex", "marking", "vertices that stand out like a needle's point"),
    "intersecting_triangles": (
        "triangle",
        "warning",
        "triangles that touch or cross others they are not joined to",
    ),
    "thin_triangles": ("triangle", "warning", "triangles behind which the solid is thinner than asked"),
}

PROPERTIES = ("watertight", "closed", "manifold", "oriented", "outward", "one-piece")
# All that can be required.
REQUIREMENTS = (*PROPERTIES, *(f"no-{name.replace('_', '-')}" for name in CLASSES))


@dataclass(frozen=True, kw_only=True)
class CheckParams:
    """From where on something is irregular."""

    corner_angle: float = param(
        1.0,
        "A triangle with a smaller angle is a needle; one with an angle above 180° less this is a cap. "
        "The paper's is 0.00057.",
        unit="degrees",
        low=0,
        high=30,
    )
    fold_angle: float = param(
        10.0,
        "Two triangles that lie on each other but for less than this make their edge a sharp one.",
        unit="degrees",
        low=0,
        high=90,
    )
    spike_angle: float = param(
        60.0,
        "A vertex around which all angles have less than this in sum is a spike; in a plane it is 360.",
        unit="degrees",
        low=0,
        high=180,
    )
    min_thickness: float = param(0.0, "Where the solid is thinner is told; 0 for nowhere.", unit="m", low=0)
    threads: int | None = param(
        None,
        "Processors to use, with the same result; all if not given.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_params(self)


def require_answerable(requirements: Iterable[str], min_thickness: float) -> None:
    """Refuse words that are no REQUIREMENTS, and what always holds for want of a limit.

    Raises
    ------
    UsageError
        Naming the first such word.
    """
    for word in requirements:
        if word not in REQUIREMENTS:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "there is no requirement {word!r}; there are {requirements}.",
                word=word,
                requirements=", ".join(REQUIREMENTS),
            )
        if word == "no-thin-triangles" and min_thickness == 0:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT, "no-thin-triangles needs min_thickness: without it, nothing is thin."
            )


@dataclass(frozen=True, eq=False)
class Checked:
    """What a mesh is like.

    Attributes
    ----------
    topology : its counts. Vertices of equal position are one: files have several along seams of a texture.
    places : of each class in CLASSES the vertices (k,), the edges (k, 2) by their vertices, or the triangles
        (k,) that belong to it. Numbers are those of the mesh as it was given; of vertices in one place, the
        first.
    points : of each class a point (k, 3) for each place, metres: the vertex, or the middle.
    thickness : (m,) of the solid behind each triangle, metres; NaN where there is none.
    min_thickness : metres, below which a place is thin.
    inside_out : closed pieces whose triangles look inwards.
    triangles : (m, 3) those of the mesh, with one number for vertices in one place.
    """

    topology: Topology
    places: dict[str, Ids]
    points: dict[str, Vertices]
    thickness: NDArray[np.float64]
    min_thickness: float
    inside_out: int
    triangles: Triangles

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def is_watertight(self) -> bool:
        """Whether it is closed, manifold and oriented, and so has an inside."""
        return self.topology.is_closed and self.topology.is_manifold and self.topology.is_oriented

    def unmet(self, requirements: Iterable[str]) -> list[Diagnostic]:
        """Return a diagnostic for each of REQUIREMENTS that does not hold; nothing is emitted.

        Raises
        ------
        UsageError
            As `require_answerable`.
        """
        wanted = list(requirements)
        require_answerable(wanted, self.min_thickness)
        return [diagnostic for name in wanted if (diagnostic := self._unmet(name))]

    def figures(self) -> dict[str, Any]:
        """Return what it is, the counts of all classes, and where the first of each are."""
        measured = self.thickness[np.isfinite(self.thickness)]
        least, low, middle = np.percentile(measured, (0, 5, 50)) if len(measured) else (None, None, None)
        return {
            "is_watertight": self.is_watertight,
            **self.topology.figures(),
            "inside_out": self.inside_out,
            "thickness_least_m": least,
            "thickness_5_percent_of_triangles_m": low,
            "thickness_median_m": middle,
            "classes": {name: self._class_figures(name) for name in CLASSES},
        }

    def _class_figures(self, name: str) -> dict[str, Any]:
        kind, treatment, _ = CLASSES[name]
        first = self.places[name][:_NAMED].tolist()
        points = self.points[name][:_NAMED].tolist()
        return {
            "count": len(self.places[name]),
            "kind": kind,
            "treatment": treatment,
            "first": [{kind: place, "point_m": point} for place, point in zip(first, points, strict=True)],
        }

    def _unmet(self, requirement: str) -> Diagnostic | None:
        match requirement:
            case "closed":
                return self._found("border_edges", "nonmanifold_edges") or self._without_surface()
            case "manifold":
                return self._found("nonmanifold_edges", "singular_vertices") or self._repeating()
            case "oriented":
                return self._found("inconsistent_edges")
            case "watertight":
                return self._unmet("closed") or self._unmet("manifold") or self._unmet("oriented")
            case "outward":
                return self._unmet("watertight") or self._inwards()
            case "one-piece":
                pieces = self.topology.components
                return None if pieces == 1 else _failed("it has {count:,} pieces.", count=pieces)
        return self._found(requirement.removeprefix("no-").replace("-", "_"))

    def _found(self, *names: str) -> Diagnostic | None:
        """Return a diagnostic of the first of some classes that has any."""
        for name in names:
            if count := len(self.places[name]):
                x, y, z = self.points[name][0]
                return _failed(
                    "it has {what}: {count:,}, the first at ({x:.6g}, {y:.6g}, {z:.6g}) m.",
                    what=CLASSES[name][2],
                    count=count,
                    x=x,
                    y=y,
                    z=z,
                )
        return None

    def _inwards(self) -> Diagnostic | None:
        if not self.inside_out:
            return None
        return _failed(
            "{count:,} of {pieces:,} pieces look inwards.",
            count=self.inside_out,
            pieces=self.topology.components,
        )

    def _without_surface(self) -> Diagnostic | None:
        return None if self.topology.is_closed else _failed("it has no surface.")

    def _repeating(self) -> Diagnostic | None:
        count = self.topology.repeating
        return _failed("it has triangles that repeat a vertex: {count:,}.", count=count) if count else None


def _failed(message: str, **values: Any) -> Diagnostic:
    return CLEAN_CHECK_FAILED.unmet(message, **values)


def check(
    mesh: MeshLike,
    params: CheckParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CheckKeywords],
) -> Checked:
    """Find every place where a mesh is irregular, and say what kind of surface it is.

    The classes are those of Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
    hierarchies" (2012, section 2.1.2), in the field's use of their names, and borders, duplicates,
    triangles that intersect and thin ones. Nothing is changed.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    params : CheckParams; single fields can be given by name instead.
    progress : called with (triangles tested for intersections, all).

    Raises
    ------
    MeshError
        If it is no valid mesh, or its coordinates are too large.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(CheckParams, params, changes)
    given = as_mesh(mesh)
    require_measurable(given, "mesh")
    first = same_rows(list(given.vertices.T))
    joined = Mesh(given.vertices, first[given.triangles].astype(np.int32))
    limits = Limits(corner=params.corner_angle, fold=params.fold_angle, spike=params.spike_angle)
    places = irregular(joined.vertices, joined.triangles, limits, params.threads or 0, progress)
    thick = _measure_thickness(joined) if len(joined.triangles) else np.empty(0)
    places["thin_triangles"] = np.flatnonzero(thick < params.min_thickness)
    # Copies of a vertex are no vertices that nothing uses.
    counted = topology(_without_copies(joined, first))
    return Checked(
        topology=counted,
        places=places,
        points={name: _points(joined, CLASSES[name][0], ids) for name, ids in places.items()},
        thickness=thick,
        min_thickness=params.min_thickness,
        inside_out=_inside_out(joined),
        triangles=joined.triangles,
    )


def _without_copies(mesh: Mesh, first: Ids) -> Mesh:
    kept = first == np.arange(len(first))
    number = np.cumsum(kept) - 1
    return Mesh(mesh.vertices[kept], number[mesh.triangles].astype(np.int32))


def _points(mesh: Mesh, kind: Kind, ids: Ids) -> Vertices:
    """Return a point (k, 3) for each vertex, edge or triangle."""
    if kind == "vertex":
        return mesh.vertices[ids]
    corners = ids if kind == "edge" else mesh.triangles[ids]
    return np.asarray(mesh.vertices[corners].mean(axis=1))


def _inside_out(mesh: Mesh) -> int:
    """Count the pieces that are closed and enclose a negative volume."""
    triangles = mesh.triangles[~repeats_vertex(mesh.triangles)]
    if len(triangles) == 0:
        return 0
    edges = edges_of(triangles, len(mesh.vertices))
    _, labels = components(len(mesh.vertices), edges.ends[:, 0], edges.ends[:, 1])
    is_open = np.zeros(labels.max(initial=-1) + 1, bool)
    is_open[labels[edges.ends[(edges.count != 2) | (edges.forward != 1), 0]]] = True
    # About the middle, so that nothing is lost far from the origin.
    a, b, c = (mesh.vertices[triangles] - bounding_box(mesh).mean(axis=0)).transpose(1, 0, 2)
    volumes = np.bincount(labels[triangles[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c)), len(is_open))
    return int(np.count_nonzero(~is_open & (volumes < 0)))


def _measure_thickness(mesh: Mesh) -> NDArray[np.float64]:
    """Return the thickness (m,) of the solid behind each triangle, in metres, by rays along inward normals.

    NaN where a ray meets nothing or first an outside, or the triangle has no area. The error is about 1e-6 of
    the bounding box's diagonal. A mesh without a closed component has no inside, and so no thickness.
    """
    found = np.full(len(mesh.triangles), np.nan)
    (proper,) = np.nonzero(~is_degenerate(mesh.vertices, mesh.triangles))
    if len(proper) == 0:
        return found
    surface = Surface(mesh)
    start = _RAY_START * float(np.linalg.norm(np.diff(bounding_box(mesh), axis=0)))
    for rows in chunks(len(proper)):
        triangles = proper[rows]
        corners = mesh.vertices[mesh.triangles[triangles]]
        inwards = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
        inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
        hits = surface.cast(corners.mean(axis=1) + start * inwards, inwards)
        leaves = np.einsum("ij,ij->i", hits.normals, inwards[hits.rays]) > 0
        found[triangles[hits.rays[leaves]]] = hits.distances[leaves] + start
    return found
