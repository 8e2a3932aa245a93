"""Mesh validation: topology, irregular elements and wall thickness."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.codes import CLEAN_CHECK_FAILED
from scanloom.stages.cleaning.regularity import AngleLimits, find_irregular
from scanloom.stages.cleaning.solids.orientation import find_inside_out
from scanloom.stages.cleaning.thickness import measure_thickness
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.edges import Ids, label_components
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import compute_bounding_box
from scanloom.stages.surface.topology import (
    Topology,
    has_repeated_vertex,
    make_topology,
    require_measurable,
)
from scanloom.stages.surface.welding import find_first_equal_rows

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import CheckKeywords

# Default minimum corner angle of Wang, Lu and Pan (2012), in degrees: arcsin(1e-5).
PAPER_CORNER_ANGLE = float(np.degrees(np.arcsin(1e-5)))

# Elements listed per defect class in the statistics.
_LISTED_DEFECTS = 10

ElementKind = Literal["vertex", "edge", "triangle"]
# Table 1 of the paper: a defect class is only reported ("warning"), or `repair` can treat it ("marking").
Treatment = Literal["warning", "marking"]

CLASSES: dict[str, tuple[ElementKind, Treatment, str]] = {
    "border_edges": ("edge", "warning", "edges with only one triangle"),
    "nonmanifold_edges": ("edge", "warning", "edges with more than two triangles"),
    "inconsistent_edges": ("edge", "warning", "edges between triangles of opposite orientation"),
    "singular_vertices": (
        "vertex",
        "warning",
        "vertices whose triangles form more than one fan",
    ),
    "focal_vertices": ("vertex", "warning", "vertices where more than two border edges end"),
    "singular_border_triangles": (
        "triangle",
        "warning",
        "triangles that share no edge at a singular vertex",
    ),
    "degenerate_triangles": (
        "triangle",
        "marking",
        "triangles that use a vertex twice or have no area",
    ),
    "duplicate_triangles": ("triangle", "marking", "triangles with the same vertices as an earlier one"),
    "caps": ("triangle", "marking", "triangles with an angle near 180°"),
    "needles": ("triangle", "marking", "triangles with an angle near 0° and none near 180°"),
    "sharp_edges": ("edge", "marking", "edges along which the surface is folded back onto itself"),
    "spikes": ("vertex", "marking", "inner vertices with a small sum of angles around them"),
    "intersecting_triangles": (
        "triangle",
        "warning",
        "triangles that touch or cross triangles they are not connected to",
    ),
    "thin_triangles": (
        "triangle",
        "warning",
        "triangles behind which the solid is thinner than min_thickness",
    ),
}

PROPERTIES = ("watertight", "closed", "manifold", "oriented", "outward", "one-piece")
# Requirements of 3-D printers, as one word. No thin walls are required if their limit is given.
PRINTABLE = "printable"
# All values that `scanloom check --require` accepts.
REQUIREMENTS = (*PROPERTIES, PRINTABLE, *(f"no-{name.replace('_', '-')}" for name in CLASSES))


@dataclass(frozen=True, kw_only=True)
class CheckParams:
    """Thresholds of the defect classes."""

    corner_angle: float = param(
        1.0,
        "A triangle with a smaller angle is a needle; one with an angle above 180° minus "
        "this is a cap. The paper uses 0.00057.",
        unit="degrees",
        low=0,
        high=30,
    )
    fold_angle: float = param(
        10.0,
        "An edge is sharp if its two triangles are folded onto each other, with a smaller "
        "angle between them.",
        unit="degrees",
        low=0,
        high=90,
    )
    spike_angle: float = param(
        60.0,
        "A vertex is a spike if the angles around it sum to less than this; in a plane they sum to 360.",
        unit="degrees",
        low=0,
        high=180,
    )
    min_thickness: float = param(
        0.0, "Report triangles behind which the solid is thinner; 0 reports none.", unit="m", low=0
    )
    threads: int | None = param(
        None,
        "Number of threads; the result does not depend on it. Default: one per core.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_params(self)


def validate_requirements(requirements: Iterable[str], min_thickness: float) -> None:
    """Reject unknown requirements, and requirements that need an unset parameter.

    Parameters
    ----------
    requirements : names out of REQUIREMENTS.
    min_thickness : metres; "no-thin-triangles" needs a value above 0.

    Raises
    ------
    UsageError
        Naming the first invalid requirement.
    """
    for word in requirements:
        if word not in REQUIREMENTS:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "unknown requirement {word!r}; valid requirements are {requirements}.",
                word=word,
                requirements=", ".join(REQUIREMENTS),
            )
        if word == "no-thin-triangles" and min_thickness == 0:
            raise UsageError(USAGE_OPTIONS_CONFLICT, "no-thin-triangles needs min_thickness above 0.")


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Result of `check`: topology, defects and thickness of a mesh.

    Vertices at equal positions count as one vertex, because files duplicate vertices along texture seams.

    Attributes
    ----------
    topology : element counts and topological properties.
    defects : per class in CLASSES, the defective vertices (k,), edges (k, 2) as vertex pairs, or triangles
        (k,). Indices refer to the given mesh. Duplicate vertices are represented by the first one.
    defect_points : per class, one point (k, 3) per defect, in metres: the vertex, or the centre of the edge
        or
        triangle.
    thickness : (m,) thickness of the solid behind each triangle, metres; NaN where it is undefined.
    min_thickness : metres; triangles below this thickness are reported as thin.
    inside_out_count : number of closed components whose triangles face inwards, except around cavities.
    triangles : (m, 3) triangles of the mesh, with duplicate vertices replaced by the first one.
    """

    topology: Topology
    defects: dict[str, Ids]
    defect_points: dict[str, Vertices]
    thickness: NDArray[np.float64]
    min_thickness: float
    inside_out_count: int
    triangles: Triangles

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def is_watertight(self) -> bool:
        """True if the mesh is closed, manifold and oriented.

        Such a mesh encloses a volume.
        """
        return self.topology.is_closed and self.topology.is_manifold and self.topology.is_oriented

    def find_unmet(self, requirements: Iterable[str]) -> list[Diagnostic]:
        """Return a diagnostic for each requirement that the mesh does not meet.

        The diagnostics are returned, not emitted.

        Parameters
        ----------
        requirements : names out of REQUIREMENTS.

        Raises
        ------
        UsageError
            For an invalid requirement, see `validate_requirements`.
        """
        given = list(requirements)
        validate_requirements(given, self.min_thickness)
        wanted = []
        for name in given:
            wanted += self._list_printable() if name == PRINTABLE else [name]
        return [diagnostic for name in dict.fromkeys(wanted) if (diagnostic := self._diagnose(name))]

    def _list_printable(self) -> list[str]:
        # "outward" includes "watertight", with the same message.
        thin = ["no-thin-triangles"] if self.min_thickness > 0 else []
        return ["outward", "no-intersecting-triangles", *thin]

    def to_dict(self) -> dict[str, Any]:
        """Return metrics for reports: topology, thickness and defects per class."""
        measured = self.thickness[np.isfinite(self.thickness)]
        minimum, low, median = np.percentile(measured, (0, 5, 50)) if len(measured) else (None, None, None)
        return {
            "is_watertight": self.is_watertight,
            **self.topology.to_dict(),
            "inside_out": self.inside_out_count,
            "thickness_min_m": minimum,
            "thickness_5_percent_of_triangles_m": low,
            "thickness_median_m": median,
            "classes": {name: self._summarize_class(name) for name in CLASSES},
        }

    def _summarize_class(self, name: str) -> dict[str, Any]:
        kind, treatment, _ = CLASSES[name]
        first = self.defects[name][:_LISTED_DEFECTS].tolist()
        points = self.defect_points[name][:_LISTED_DEFECTS].tolist()
        return {
            "count": len(self.defects[name]),
            "kind": kind,
            "treatment": treatment,
            "first": [{kind: place, "point_m": point} for place, point in zip(first, points, strict=True)],
        }

    def _diagnose(self, requirement: str) -> Diagnostic | None:
        match requirement:
            case "closed":
                return self._diagnose_classes("border_edges", "nonmanifold_edges") or self._diagnose_empty()
            case "manifold":
                return (
                    self._diagnose_classes("nonmanifold_edges", "singular_vertices")
                    or self._diagnose_repeated_vertices()
                )
            case "oriented":
                return self._diagnose_classes("inconsistent_edges")
            case "watertight":
                return self._diagnose("closed") or self._diagnose("manifold") or self._diagnose("oriented")
            case "outward":
                return self._diagnose("watertight") or self._diagnose_orientation()
            case "one-piece":
                pieces = self.topology.components
                return (
                    None
                    if pieces == 1
                    else _make_diagnostic("it has {count:,} connected components.", count=pieces)
                )
        return self._diagnose_classes(requirement.removeprefix("no-").replace("-", "_"))

    def _diagnose_classes(self, *names: str) -> Diagnostic | None:
        """Return a diagnostic for the first named class that has defects."""
        for name in names:
            if count := len(self.defects[name]):
                x, y, z = self.defect_points[name][0]
                return _make_diagnostic(
                    "it has {what}: {count:,}, the first at ({x:.6g}, {y:.6g}, {z:.6g}) m.",
                    what=CLASSES[name][2],
                    count=count,
                    x=x,
                    y=y,
                    z=z,
                )
        return None

    def _diagnose_orientation(self) -> Diagnostic | None:
        if not self.inside_out_count:
            return None
        return _make_diagnostic(
            "{count:,} of {pieces:,} connected components are oriented inwards.",
            count=self.inside_out_count,
            pieces=self.topology.components,
        )

    def _diagnose_empty(self) -> Diagnostic | None:
        return None if self.topology.is_closed else _make_diagnostic("it has no surface.")

    def _diagnose_repeated_vertices(self) -> Diagnostic | None:
        count = self.topology.repeating
        return (
            _make_diagnostic("it has triangles that use a vertex twice: {count:,}.", count=count)
            if count
            else None
        )


def _make_diagnostic(message: str, **values: Any) -> Diagnostic:
    return CLEAN_CHECK_FAILED.unmet(message, **values)


def check(
    mesh: MeshLike,
    params: CheckParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[CheckKeywords],
) -> CheckResult:
    """Find the irregular elements of a mesh, and determine its topological properties.

    The defect classes follow Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
    hierarchies" (2012, section 2.1.2). Cap and needle have their usual meaning. Borders, duplicate triangles,
    intersecting triangles and thin triangles are reported in addition. The mesh is not changed.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    params : CheckParams; single fields can be given as keywords instead.
    progress : called with (triangles tested for intersections, all triangles).

    Returns
    -------
    CheckResult

    Raises
    ------
    MeshError
        If the mesh is invalid, or its coordinates are too large.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(CheckParams, params, changes)
    given = as_mesh(mesh)
    require_measurable(given, "mesh")
    first = find_first_equal_rows(list(given.vertices.T))
    welded = Mesh(given.vertices, first[given.triangles].astype(np.int32))
    limits = AngleLimits(
        corner_deg=params.corner_angle, fold_deg=params.fold_angle, spike_deg=params.spike_angle
    )
    places, counts = find_irregular(welded.vertices, welded.triangles, limits, params.threads or 0, progress)
    thickness = measure_thickness(welded, places["degenerate_triangles"])
    # Duplicate vertices must not count as unused vertices.
    vertices = int(np.count_nonzero(first == np.arange(len(first))))
    counted = make_topology(vertices, len(welded.triangles), places, counts)
    inside_out = _count_inside_out(welded, places)
    places["thin_triangles"] = np.flatnonzero(thickness < params.min_thickness)
    return CheckResult(
        topology=counted,
        defects=places,
        defect_points={name: _compute_points(welded, CLASSES[name][0], ids) for name, ids in places.items()},
        thickness=thickness,
        min_thickness=params.min_thickness,
        inside_out_count=inside_out,
        triangles=welded.triangles,
    )


def _compute_points(mesh: Mesh, kind: ElementKind, ids: Ids) -> Vertices:
    """Compute a point (k, 3) for each vertex, edge or triangle.

    Edges and triangles are represented by their centre.
    """
    if kind == "vertex":
        return mesh.vertices[ids]
    corners = ids if kind == "edge" else mesh.triangles[ids]
    return np.asarray(mesh.vertices[corners].mean(axis=1))


def _count_inside_out(mesh: Mesh, places: Mapping[str, Ids]) -> int:
    """Count the closed components that face inwards, except around cavities."""
    triangles = mesh.triangles[~has_repeated_vertex(mesh.triangles)]
    count, labels = label_components(
        len(mesh.vertices), triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
    )
    component = labels[triangles[:, 0]]
    is_open = np.zeros(count, bool)
    for name in ("border_edges", "nonmanifold_edges", "inconsistent_edges"):
        is_open[labels[places[name][:, 0]]] = True
    if is_open[component].all():
        return 0
    # Relative to the centre, to avoid cancellation far from the origin.
    a, b, c = (mesh.vertices[triangles] - compute_bounding_box(mesh).mean(axis=0)).transpose(1, 0, 2)
    volumes = np.bincount(component, np.einsum("ij,ij->i", a, np.cross(b, c)), count)
    signed = np.where(is_open, 0.0, volumes.astype(np.float64))
    return int(np.count_nonzero(find_inside_out(Mesh(mesh.vertices, triangles), component, signed)))
