"""Remeshing: any manifold mesh becomes a normal mesh, even triangles at several levels of detail."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.lod.codes import LEVELS_LEFT_OUT
from scanloom.stages.normal_meshes.codes import (
    LEVELS_BASE_LARGE,
    LEVELS_FOLDED,
    LEVELS_NORMAL_MESH_INEXACT,
    LEVELS_TOO_FINE,
    LEVELS_VERTICES_SPLIT,
)
from scanloom.stages.normal_meshes.normal_mesh import NormalMesh, normal_mesh_of
from scanloom.stages.params import check, param, resolve
from scanloom.stages.progress import Progress, silent
from scanloom.stages.simplification.in_sheets import in_sheets, is_split, joined, sheets_of
from scanloom.stages.simplification.kernel_input import texture_left_out
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface, bounding_box
from scanloom.stages.surface.sheets import Sheets
from scanloom.stages.surface.topology import require_area
from scanloom.stages.surface.traced import Traced

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RemeshKeywords

RESULT_VERSION = 7

# A base mesh so many times as large as wanted makes a result that much larger, which a person should know.
_FAR_FROM_WANTED = 1.5

# Of a base that is made without saying how many levels it will get.
_MOST_LEVELS = 4

# The precision of 32-bit floats, over the diagonal.
_FINEST = 5e-8

# What the kernel says of where a tolerance comes from, in plain words.
_TOLERANCE_SOURCES = {
    "given": "given",
    "distance": "from how far the finest level is from the mesh anyway",
    "noise": "from the mesh's own noise",
    "bound": "from max_error",
    "precision": "the precision of 32-bit floats, as the finest level is as good as exact",
}

_HOW_FAR = "How far"
_HOW = "How"
_FILE = "What the file keeps"


@dataclass(frozen=True, kw_only=True)
class RemeshParams:
    """How many levels a normal mesh gets, of what base, and how exactly they are kept."""

    levels: int | None = param(
        None,
        "Refinements of the base mesh; each makes four triangles of one. Default: as many, from 1 to 4, as "
        "give the finest level about as many triangles as the input; with max_error at most 4.",
        group=_HOW_FAR,
        low=0,
        high=10,
        common=True,
    )
    base_triangles: int | None = param(
        None,
        "Triangles of the base mesh; more are left only where fewer could not be refined. With levels 0, and "
        "without base_error and max_error, the base is the mesh simplified to so many, its vertices where "
        "the file comes nearest to the input. Default, unless base_error is given: so many that the finest "
        "level has about as many as the input, or more, where fewer would be far from it.",
        group=_HOW_FAR,
        low=1,
        common=True,
    )
    base_error: float | None = param(
        None,
        "The base mesh is made as long as no collapse adds more than this to the distance from the input; "
        "with base_triangles, whichever comes first.",
        group=_HOW_FAR,
        unit="m",
        low=0,
        low_open=True,
    )
    max_error: float | None = param(
        None,
        "Stop at the first level whose largest distance from the input, both ways, is found to be no more "
        "than this; at the last if none is.",
        group=_HOW_FAR,
        unit="m",
        low=0,
        low_open=True,
    )
    scheme: str = param(
        "linear",
        "Where new vertices are predicted: in the middle of their edge, or by the modified butterfly, which "
        "makes offsets smaller on smooth shapes.",
        group=_HOW,
        choices=("linear", "butterfly"),
    )
    relaxations: int = param(
        1,
        "How often new vertices move towards the middle of their neighbours, along the surface, before they "
        "get their offsets: evens the triangles out.",
        group=_HOW,
        low=0,
        high=100,
    )
    threads: int | None = param(
        None,
        "Processors to use, with the same result; all if not given.",
        group=_HOW,
        low=1,
        high=256,
        invalidates=False,
    )
    tolerance: float | None = param(
        None,
        "How far rounding may take a vertex from the surface of the input, as a share of the bounding box's "
        "diagonal; of a base that is the simplified mesh, beside how far that is from it. Default: from the "
        "mesh, about a third of the RMS distance of the finest level from it, or half of it where the mesh's "
        "own noise hides that, or three times it for the simplified mesh, which is rounded far better than "
        "to the tolerance; never more than a sixteenth of max_error, nor finer than the precision of 32-bit "
        "floats, 5e-8.",
        group=_FILE,
        low=1e-9,
        high=0.01,
    )
    color_tolerance: float = param(
        2.0,
        "How much rounding may change a channel of a vertex's colour.",
        group=_FILE,
        unit="8-bit levels",
        low=0,
        high=64,
    )

    def __post_init__(self) -> None:
        check(self)

    def wanted_base(self, triangles: int) -> int:
        """Return how many base triangles are wanted for an input of so many; 0 if `base_error` decides."""
        if self.base_triangles is not None:
            return self.base_triangles
        levels = _MOST_LEVELS if self.levels is None else self.levels
        return 0 if self.base_error is not None else max(round(triangles / 4**levels), 1)


def remesh(
    mesh: MeshLike,
    params: RemeshParams | None = None,
    *,
    confidence: ArrayLike | None = None,
    progress: Progress = silent,
    **changes: Unpack[RemeshKeywords],
) -> NormalMesh:
    """Make a normal mesh: a base mesh of original vertices, refined to lie on the original surface.

    Edges collapse into one of their ends until the base mesh is left; a base that gets no levels is the
    mesh as `simplify` makes it. Then each level puts a vertex on every
    edge, predicts where it is, and moves it along the normal to the surface: one number a vertex. Where no
    number leads there, and on boundaries, a vector stands instead. What is returned is what `decode` returns
    of its `data`, to the bit: numbers are rounded before they are used.

    Genus, pieces, boundary loops and orientation are those of the input at every level. Equal input gives
    equal bytes, on any number of threads.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres. Vertices in
        one place are one; where that is no oriented manifold, it is split into sheets with vertices of their
        own, and a warning says so. Vertices without triangles and triangles that name a vertex twice are left
        out.
    params : RemeshParams; single fields can be given by name instead.
    confidence : (n,) finite numbers, carried along as colours are, with 8 bits between the least and the
        greatest.
    progress : called about ten times a second with the levels that are done, those of bases that are only
        tried among them, and those to do at most; raising from it stops the work.

    Returns
    -------
    NormalMesh
        With colours if the input has. Texture and normals are not carried, and a warning says so.
        Its sources are in terms of the input, split or not.

    Raises
    ------
    MeshError
        For an edge with more than two triangles or inconsistent orientation, which `clean` repairs; the
        message names them. For a mesh without a surface, and for confidence that is not one finite number a
        vertex.
    UsageError
        For a parameter out of range.

    References
    ----------
    Li, Li, Xu and Li, "Normal mesh generation based on Laplacian operator", 2002; Guskov, Vidimče, Sweldens
    and Schröder, "Normal meshes", 2000; for the other prediction Zorin, Schröder and Sweldens, "Interpolating
    subdivision for meshes with arbitrary topology", 1996.
    """
    with collecting() as diagnostics:
        params = resolve(RemeshParams, params, changes)
        result = _normal_mesh(as_mesh(mesh), params, confidence, progress)
    return replace(result, diagnostics=tuple(diagnostics))


def _normal_mesh(
    mesh: Mesh, params: RemeshParams, confidence: ArrayLike | None, progress: Progress
) -> NormalMesh:
    values = _confidence(confidence, len(mesh.vertices))
    require_area(mesh, "mesh")
    wanted = params.wanted_base(len(mesh.triangles))
    _require_resolution(mesh, params)
    bare = mesh.with_(texture=None, normals=None, corner_normals=None, part_ids=None)
    start, original = _start(bare, params, progress)
    sheets = joined(start.mesh)
    traced = _traced(start, sheets)
    try:
        found = _remeshed(traced, original, values, params, wanted, progress)
    except _kernels.InvalidMeshError:
        # Few meshes are no manifold: to look only where a mesh is refused saves the others the time.
        sheets = sheets_of(start.mesh)
        traced = _traced(start, sheets)
        found = _remeshed(traced, original, values, params, wanted, progress)
    split = 0 if sheets is None else len(np.unique(sheets.vertex_source[is_split(start.mesh, sheets)]))
    if original is None:
        hits = [traced.triangle_source[found.hit_triangle(level)] for level in range(found.levels + 1)]
    else:
        hits = [_nearest(original, found.vertices(0))]
    _report_left_out(mesh)
    _report(found, params, wanted, split)
    return normal_mesh_of(
        found,
        mesh.diagnostics,
        base_source=traced.vertex_source[found.base_source].astype(np.int32),
        triangle_source=tuple(triangles.astype(np.int32) for triangles in hits),
        max_distances_m=tuple(found.reached),
        folded_by_level=tuple(found.folded),
        **_tolerance(found, traced.mesh),
    )


def _require_resolution(mesh: Mesh, params: RemeshParams) -> None:
    """Refuse a mesh that is a point beside how far it reaches, as one stray vertex makes it."""
    corners = mesh.vertices[mesh.triangles]
    finest = min(params.tolerance or _FINEST, _FINEST) * _diagonal(mesh)
    lengths = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2)
    if np.median(lengths) < finest:
        away = np.linalg.norm(mesh.vertices - np.median(corners.reshape(-1, 3), axis=0), axis=1)
        used = np.unique(mesh.triangles)
        farthest = used[np.argmax(away[used])]
        raise MeshError(
            LEVELS_TOO_FINE,
            (
                "most edges are shorter than {finest:.2g} m, which is all that can be told "
                "apart in a mesh of this size"
            ),
            "mesh",
            remedy="remove what lies far from the rest: vertex {farthest} is {away:.2g} m away.",
            finest=finest,
            farthest=farthest,
            away=away[farthest],
        )


def _diagonal(mesh: Mesh) -> float:
    """Return the diagonal of the bounding box of what triangles there are."""
    return float(np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.triangles)], axis=0)))


def _start(mesh: Mesh, params: RemeshParams, progress: Progress) -> tuple[Traced, Mesh | None]:
    """Return the mesh that becomes the base mesh; and the input, if that is another one.

    A base that is never refined need not be made of vertices of the input: `simplify` comes nearer.
    """
    wanted = params.base_triangles
    bounds = (params.base_error, params.max_error)
    if params.levels != 0 or wanted is None or wanted >= len(mesh.triangles) or any(bounds):
        return Traced.start(mesh), None

    def still(done: int, total: int) -> object:  # noqa: ARG001
        return progress(0, 1)

    with collecting(forward=False):
        light = simplify(
            mesh, method="quadric", triangles=wanted, threads=params.threads, bake=False, progress=still
        )
    # The number of base triangles is a wish.
    emit(*(one for one in light.diagnostics if one.severity != Severity.UNMET))
    sources = light.vertex_source.astype(np.int64), light.triangle_source.astype(np.int64)
    return Traced(light.mesh, *sources), mesh


def _remeshed(
    traced: Traced,
    original: Mesh | None,
    confidence: NDArray[np.float64],
    params: RemeshParams,
    wanted_base: int,
    progress: Progress,
) -> _kernels.NormalMesh:
    mesh = traced.mesh
    return _kernels.remesh(
        mesh.vertices,
        attributes_of(mesh),
        confidence[traced.vertex_source] if len(confidence) else confidence,
        mesh.triangles,
        None if original is None else (original.vertices, original.triangles),
        levels=params.levels,
        base_triangles=wanted_base,
        base_error=np.inf if params.base_error is None else params.base_error,
        at_any_price=params.base_triangles is not None or params.base_error is not None,
        max_error=params.max_error or 0.0,
        butterfly=params.scheme == "butterfly",
        relaxations=params.relaxations,
        tolerance=params.tolerance,
        color_tolerance=params.color_tolerance,
        up=mesh.up,
        threads=params.threads or 0,
        progress=progress,
    )


def _nearest(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.integer[Any]]:
    """Return the triangle that is nearest to each point."""
    box = bounding_box(mesh)
    box = np.stack([np.minimum(box[0], points.min(axis=0)), np.maximum(box[1], points.max(axis=0))])
    return Surface(mesh, box).closest(points).triangles


def _traced(start: Traced, sheets: Sheets | None) -> Traced:
    """Return the mesh, or its sheets."""
    if sheets is None:
        return start
    sources = start.vertex_source[sheets.vertex_source], start.triangle_source[sheets.triangle_source]
    return Traced(in_sheets(start.mesh, sheets), *sources)


def _confidence(values: ArrayLike | None, count: int) -> NDArray[np.float64]:
    if values is None:
        return np.zeros(0)
    array = np.asarray(values)
    if array.shape != (count,) or array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            (
                "confidence is {array_dtype} of shape {array_shape}; a finite number for "
                "each of the {count} vertices is expected."
            ),
            "mesh",
            array_dtype=array.dtype,
            array_shape=array.shape,
            count=count,
        )
    return array.astype(np.float64)


def _tolerance(found: _kernels.NormalMesh, mesh: Mesh) -> dict[str, float | str]:
    """Return the tolerance of the result, over the diagonal and in metres, and where it comes from."""
    if found.tolerance is None or found.tolerance_source is None:
        return {}
    return {
        "tolerance": found.tolerance,
        "tolerance_m": found.tolerance * _diagonal(mesh),
        "tolerance_source": _TOLERANCE_SOURCES[found.tolerance_source],
    }


def _report_left_out(mesh: Mesh) -> None:
    has_normals = mesh.normals is not None or mesh.corner_normals is not None
    lost = {"normals": has_normals or None, "parts": mesh.part_ids}
    names = " and ".join(name for name, value in lost.items() if value is not None)
    if names:
        emit(
            LEVELS_LEFT_OUT.warning(
                "remesh left out: {names}; it carries vertex colours and confidence.", names=names
            )
        )
    if mesh.texture is not None:
        emit(texture_left_out("remesh"))


def _report(found: _kernels.NormalMesh, params: RemeshParams, wanted_base: int, split: int) -> None:
    if split:
        emit(
            LEVELS_VERTICES_SPLIT.warning(
                "{count:,} pinched {were} split, so that each fan of triangles that touched there has its "
                "own.",
                count=split,
                were="vertex was" if split == 1 else "vertices were",
            )
        )
    base = len(found.triangles(0))
    asked = params.base_triangles is not None or params.levels is not None
    if asked and wanted_base and base > _FAR_FROM_WANTED * wanted_base:
        emit(
            LEVELS_BASE_LARGE.warning(
                "the base mesh has {base:,} triangles, not {wanted_base:,}: what is left stands for pieces, "
                "holes and handles, which all stay, or could not be refined well with fewer. The finest "
                "level has {finest:,}; fewer levels have fewer.",
                base=base,
                wanted_base=wanted_base,
                finest=len(found.triangles(found.levels)),
            )
        )
    if sum(found.folded):
        emit(
            LEVELS_FOLDED.warning(
                "{count:,} triangles of all levels, {finest:,} of the finest, are turned against the surface "
                "or have no area.",
                count=sum(found.folded),
                finest=found.folded[-1],
            )
        )
    if params.max_error is not None and found.reached and found.reached[-1] > params.max_error:
        emit(
            LEVELS_NORMAL_MESH_INEXACT.unmet(
                "the finest level is up to {reached:.4g} m from the input, more than max_error "
                "({max_error:g} m)",
                remedy="give more levels or a finer base.",
                reached=found.reached[-1],
                max_error=params.max_error,
            )
        )
