"""What is missing in a scan: where to go again.

A place is missing where the surface has a hole, where space that frames looked through ends at space that none
did, and where the surface is there but was measured by few frames, only obliquely, or only from far. Places are
told by how much they matter: their area, times how much a kind counts. For each, the frames are told that came
nearest to seeing it, what kept them from it, and from where one should look.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.coverage.evidence import Evidence, Measured, Probes, measured_by, probes_of
from stages.coverage.kinds import KINDS, MISSING, THIN
from stages.coverage.missing import patches_of_holes, patches_of_space
from stages.coverage.nearest import Remembered, looks_at
from stages.coverage.painted import painted, squares
from stages.coverage.params import CoverageKeywords, CoverageParams
from stages.coverage.patches import Patch
from stages.coverage.place import Place, Point
from stages.coverage.rims import caps
from stages.coverage.space import Space
from stages.coverage.standpoints import standpoint
from stages.coverage.thin import Limits, kinds_at, patches_of_thin, vertex_areas
from stages.coverage.views import Floats, View, read_view
from stages.errors import InputError
from stages.params import resolve
from stages.printing import by_figures, table
from stages.progress import Progress, silent
from stages.scans.prefetch import read_ahead, workers
from stages.scans.scan import Frame, Scan, SkippedFrame
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface
from stages.surface.topology import areas, require_area
from stages.surface.vertex_normals import vertex_normals

if TYPE_CHECKING:
    from typing_extensions import Unpack

RESULT_VERSION = 1

# Derived parameters; see CoverageParams.
_FEW, _SHARE_OF_FRAMES = 3, 5
_FAR = 2.5
_LEAST_AREA = 1 / 2000
_PLACE_SIZE = 0.75
_CELL_EDGES = 4.0
# Frames that are told of each place, and of all frames the cameras that a standpoint may be near to.
_NEAREST = 5
_CAMERAS = 500
# Of looks of frames that have a place in their picture: where as many have no depth, that is what is wrong.
_BLANK = 0.5


@dataclass(frozen=True, eq=False)
class Coverage:
    """What is missing in a scan.

    Attributes
    ----------
    places : where to go again, the most important first.
    evidence : what frames have measured of each vertex.
    kinds : (n,) int8, which of `stages.coverage.kinds.THIN` each vertex is; -1 for well seen.
    painted : the mesh in colours of that, and behind its triangles what would close its holes.
    limits : what counted as thin.
    least_area, place_size, spacing : m² and metres, as given or derived.
    frames : how many were looked at.
    skipped : those that were not, and why.
    thin_areas : m² of the surface, by kind.
    missing_areas : m² of places that are not there at all, by kind; also of those that are not told.
    ends_area : m² where the scan ends: nobody looked beyond, and it is open to the other side.
    left_out : how many places are not told, beyond as many as were asked for.
    """

    places: tuple[Place, ...]
    evidence: Evidence
    kinds: NDArray[np.int8]
    painted: Mesh
    limits: Limits
    least_area: float
    place_size: float
    spacing: float
    frames: int
    skipped: tuple[SkippedFrame, ...]
    surface_area: float
    thin_areas: dict[str, float]
    missing_areas: dict[str, float]
    ends_area: float
    left_out: int

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what there is to say, for JSON, units in the names."""
        return {
            "frames_used": self.frames,
            "frames_skipped": [{"frame": one.name, "reason": one.reason} for one in self.skipped],
            "surface_m2": self.surface_area,
            "thin_m2": self.thin_areas,
            "missing_m2": self.missing_areas,
            "scan_ends_m2": self.ends_area,
            "few_frames": self.limits.frames,
            "oblique_deg": float(np.degrees(np.arccos(self.limits.cosine))),
            "far_m": self.limits.distance,
            "least_area_m2": self.least_area,
            "place_size_m": self.place_size,
            "spacing_m": self.spacing,
            "places_left_out": self.left_out,
            "places": [place.figures() for place in self.places],
        }


def coverage(
    mesh: MeshLike,
    frames: Scan | Iterable[Frame],
    params: CoverageParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[CoverageKeywords],
) -> Coverage:
    """Tell what is missing in a scan, and from where one should look at it.

    Each frame's depth map is read once, whatever its number of frames; some 40 ms a frame of 640×480 pixels on
    one core. Memory beside the mesh is bounded but for 12 kB a frame. Equal input gives an equal result, on any
    number of threads.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world of the poses; an oriented manifold,
        border allowed, as `clean` leaves it, facing the cameras.
    frames : with depth and poses, those that the mesh was made of.
    params : see CoverageParams; single ones can be given by name.
    progress : called after each frame.

    Raises
    ------
    MeshError
        If the mesh is not valid or has no area.
    InputError
        If no frame has a pose and depth.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(CoverageParams, params, changes)
    given = as_mesh(mesh)
    require_area(given, "mesh")
    where = frames.folder if isinstance(frames, Scan) else None
    shown = list(frames.frames if isinstance(frames, Scan) else frames)
    ground = _Ground.of(given, params)
    seen = _looked_at(ground, shown, where, progress)
    evidence = seen.evidence.at(ground.probes.of_vertex)
    limits, usual = _limits(evidence, ground.around, len(seen.frames), params)
    kinds = kinds_at(evidence, limits)
    least = _LEAST_AREA * float(ground.around.sum()) if params.least_area is None else params.least_area
    size = params.place_size or _PLACE_SIZE * usual
    surface = Surface(given)
    holes = patches_of_holes(caps(given, ground.edge, least), ground.space, ground.origin, size)
    frontier = ground.space.frontier()
    hidden, ends = patches_of_space(frontier, holes, ground.space, surface, ground.origin, size)
    missing = [patch for patch in (*holes, *hidden) if patch.area >= least]
    thin = patches_of_thin(
        ground.vertices, ground.normals, given.triangles, ground.around, kinds, size, least
    )
    ranked = sorted((*missing, *thin), key=lambda patch: -KINDS[patch.kind].weight * patch.area)
    cameras = np.array([frame.place - ground.origin for frame in seen.frames])
    cameras = cameras[np.linspace(0, len(cameras) - 1, min(_CAMERAS, len(cameras))).round().astype(int)]
    told: list[tuple[Patch, Place]] = []
    for patch in ranked[: params.places]:
        stand = standpoint(
            patch.points, patch.normal, patch.middle, ground.space, surface, cameras, usual, ground.origin
        )
        looks = looks_at(patch.points, patch.normal, seen.frames, ground.origin, _NEAREST)
        is_blank = patch.kind in ("hole", "unseen") and looks.blank_share > _BLANK
        patch = replace(patch, kind="blank") if is_blank else patch
        told.append((patch, _place(patch, looks.nearest, looks.in_picture, stand, ground.origin)))
    shapes = [
        (patch.kind, squares(patch.points + ground.origin, patch.normals, ground.space.cell))
        for patch, _ in told
        if patch.kind in MISSING
    ]
    return Coverage(
        places=tuple(place for _, place in told),
        evidence=evidence,
        kinds=kinds,
        painted=painted(given, ground.normals, kinds, shapes),
        limits=limits,
        least_area=least,
        place_size=size,
        spacing=ground.space.cell,
        frames=len(seen.frames),
        skipped=tuple(seen.skipped),
        surface_area=float(ground.around.sum()),
        thin_areas={kind: float(ground.around[kinds == i].sum()) for i, kind in enumerate(THIN)},
        missing_areas=_areas_by_kind(missing),
        ends_area=ends,
        left_out=max(len(ranked) - params.places, 0),
    )


@dataclass(frozen=True, eq=False)
class _Ground:
    """A mesh made ready: its vertices from the origin on, points that stand for them, and the space around."""

    origin: Floats
    vertices: Floats
    normals: Floats
    around: Floats
    edge: float
    probes: Probes
    space: Space

    @classmethod
    def of(cls, mesh: Mesh, params: CoverageParams) -> _Ground:
        origin = np.asarray(mesh.vertices.mean(axis=0))
        vertices, normals = mesh.vertices - origin, vertex_normals(mesh)
        ends = vertices[mesh.triangles[:, :2]]
        edge = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
        around = vertex_areas(mesh)
        cell = params.spacing or _CELL_EDGES * edge
        probes = probes_of(vertices, normals, edge, float(around.sum()))
        return cls(
            origin, vertices, normals, around, edge, probes, Space(_samples(vertices, mesh, cell / 2), cell)
        )


@dataclass(frozen=True, eq=False)
class _Seen:
    """What frames have told: of probes, and of themselves."""

    evidence: Evidence
    frames: list[Remembered]
    skipped: list[SkippedFrame]


def _looked_at(ground: _Ground, frames: Sequence[Frame], where: Path | None, progress: Progress) -> _Seen:
    """Read all frames, and add what they tell to the ground's space."""

    def prepared(frame: Frame) -> tuple[View, Measured] | SkippedFrame:
        try:
            view = read_view(frame, ground.origin)
        except InputError as error:
            return SkippedFrame(frame.name, str(error))
        return view, measured_by(view, ground.probes, ground.origin)

    seen = _Seen(Evidence.none(len(ground.probes.points)), [], [])
    threads = workers()
    for number, one in enumerate(read_ahead(prepared, frames, threads=threads, ahead=threads + 1)):
        if isinstance(one, SkippedFrame):
            seen.skipped.append(one)
        else:
            view, measured = one
            seen.evidence.add(measured, view.camera.fx)
            ground.space.see(view)
            seen.frames.append(Remembered.of(number, view))
        progress(number + 1, len(frames))
    if not seen.frames:
        first = f" The first, {seen.skipped[0].name}: {seen.skipped[0].reason}" if seen.skipped else ""
        raise InputError(f"none of the {len(frames)} frames has a camera pose and depth.{first}", where)
    if not seen.evidence.frames.any():
        raise InputError(
            f"none of the {len(seen.frames)} frames measured the mesh: do poses and mesh belong together?", where
        )
    return seen


def _limits(
    evidence: Evidence, around: Floats, frames: int, params: CoverageParams
) -> tuple[Limits, float]:
    """Return what counts as thin, and from how far the median place was measured best, metres."""
    known = (evidence.frames > 0) & (around > 0)
    usual = float(np.median(evidence.distance[known]))
    few = params.few_frames or min(_FEW, max(frames // _SHARE_OF_FRAMES, 1))
    cosine = float(np.cos(np.radians(params.oblique)))
    return Limits(few, cosine, params.far or _FAR * usual), usual


def _samples(vertices: Floats, mesh: Mesh, spacing: float) -> Floats:
    """Return points all over a mesh, about as close as `spacing`: vertices, middles, and more in large triangles."""
    corners = vertices[mesh.triangles]
    counts = np.ceil(2 * areas(mesh.vertices, mesh.triangles) / spacing**2).astype(np.int64)
    large = np.repeat(np.flatnonzero(counts > 1), counts[counts > 1])
    # Chosen by chance, but the same each time.
    shares = np.random.default_rng(0).dirichlet((1, 1, 1), len(large))
    return np.concatenate(
        [vertices[np.unique(mesh.triangles)], corners.mean(axis=1), np.einsum("kc,kcx->kx", shares, corners[large])]
    )


def _place(patch: Patch, looks: Any, towards: int, stand: Any, origin: Floats) -> Place:
    return Place(
        kind=patch.kind,
        point=_point(patch.middle + origin),
        normal=_point(patch.normal),
        area=patch.area,
        extent=patch.extent,
        looks=looks,
        frames_towards=towards,
        stand=stand,
    )


def _point(values: Floats) -> Point:
    x, y, z = (round(float(value), 4) for value in values)
    return x, y, z


def _areas_by_kind(patches: Sequence[Patch]) -> dict[str, float]:
    kinds = ("hole", "hidden", "unseen")
    return {kind: float(sum(patch.area for patch in patches if patch.kind == kind)) for kind in kinds}
