"""Refinement of a fused mesh with the depth maps it was fused from.

A fused surface has the noise of the sensor, and lies slightly inside of convex shapes. The steps:

1. Measure the standard deviation of each vertex from the noise of the depth maps, and the number and angle of
   its measurements. No vertex moves farther than three standard deviations from its position in the input.
2. Filter the normals of the triangles without mixing normals across creases, and fit the vertices to them.
3. Move the filtered surface to the depth measurements, by a smooth correction along the normals.
4. Make patches planar that are planar within the standard deviation, also several adjacent ones together,
   with straight creases between them.
5. Remove false surface: flaps, which no frame has measured from the front, and skirts, which most frames
   contradict. Smooth the boundary, and move it to the outlines in the depth maps.
6. Close small holes where no frame has seen free space: continue the surface, with the colours of the photos.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.cleaning.clean import CleanParams, clean
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.depth_noise import measure_depth_noise
from scanloom.stages.fusion.fusion_plan import make_depth_limits
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.params import resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.refinement.codes import REFINE_DATA_LEFT_OUT
from scanloom.stages.refinement.depth_frames import MAX_KEPT_BYTES, DepthFrames
from scanloom.stages.refinement.filling_colors import color_fillings
from scanloom.stages.refinement.flaps import mask_flaps
from scanloom.stages.refinement.hole_closing import Filling, close_holes
from scanloom.stages.refinement.params import RefineParams
from scanloom.stages.scans.codes import SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Colors, Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.topology import has_repeated_vertex, require_manifold, require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RefineKeywords

RESULT_VERSION = 6

# Corrections towards the depth measurements. The second one starts from a better surface.
_CORRECTION_COUNT = 2
# Peak memory per triangle beyond the kept depth maps, bytes; 300 were measured on 3.2 million triangles.
_BYTES_PER_TRIANGLE = 350
# Number of fillings in the metrics.
_LISTED_FILLINGS = 10
# Mean edge lengths by which vertices of the boundary may move when it is smoothed: before and after it is
# moved to the outlines.
_MAX_BOUNDARY_MOVES = 0.5, 0.25

Floats = NDArray[np.float64]

_NOT_MEASURED = "no frame has measured this mesh; it may be in other coordinates than the poses"
_NO_NOISE = "the frames do not overlap enough to measure the noise of their depth"


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinementResult:
    """Refined mesh.

    Attributes
    ----------
    mesh : refined mesh, an oriented manifold with the vertex colours of the input. Filled holes have the
        colours of the photos, and of the rim where no photo shows them.
    deviations : (n,) standard deviation of each vertex along its normal, metres; 0 if not refined.
    plane_ids : (n,) int32, the plane of each vertex; −1 for none.
    plane_count : number of planes.
    noise : depth noise of a single measurement (see `DepthNoise`); None if the mesh was not refined.
    moves : (k,) distance of each vertex that stayed from its position in the input, metres.
    removed_triangles : number of triangles of removed flaps and skirts.
    is_filled : (n,) True for the vertices inside of closed holes, which no frame measured.
    fillings : of the closed holes, the largest first.
    reason : why the mesh was left as it is; empty if it was refined.
    skipped : frames that could not be used.
    diagnostics : what was left out.
    """

    mesh: Mesh
    deviations: Floats
    plane_ids: NDArray[np.int32]
    plane_count: int
    noise: DepthNoise | None
    moves: Floats
    removed_triangles: int
    is_filled: NDArray[np.bool_]
    fillings: tuple[Filling, ...] = ()
    reason: str = ""
    skipped: tuple[SkippedFrame, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-ready metrics, with units in the keys."""
        return {
            "vertices": len(self.mesh.vertices),
            "triangles": len(self.mesh.triangles),
            "move_rms_m": float(np.sqrt((self.moves**2).mean())) if len(self.moves) else 0.0,
            "move_max_m": float(self.moves.max(initial=0.0)),
            "deviation_median_m": float(np.median(self.deviations)) if len(self.deviations) else 0.0,
            "planes": self.plane_count,
            "planar_ratio": float((self.plane_ids >= 0).mean()) if len(self.plane_ids) else 0.0,
            "removed_triangles": self.removed_triangles,
            "filled_holes": len(self.fillings),
            "filled_area_m2": sum(filling.area for filling in self.fillings),
            "largest_fillings": [filling.to_dict() for filling in self.fillings[:_LISTED_FILLINGS]],
            "why": self.reason,
            "frames_skipped": [frame.to_dict() for frame in self.skipped],
        }


def estimate_memory(triangles: int) -> int:
    """Estimate the memory that `refine` needs for a triangle count, bytes.

    The libraries themselves are not included.
    """
    return MAX_KEPT_BYTES + _BYTES_PER_TRIANGLE * triangles


def refine(
    mesh: MeshLike,
    frames: Scan | Iterable[Frame],
    params: RefineParams | None = None,
    *,
    progress: Progress = ignore_progress,
    has_matched_depth: bool = False,
    **changes: Unpack[RefineKeywords],
) -> RefinementResult:
    """Remove the noise of the sensor from a mesh fused from depth maps.

    Creases, corners and thin parts stay; patches that are planar within the noise become planar. The result
    is the same for any number of threads.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world coordinates of the poses: an
        oriented manifold, as `clean` returns it.
    frames : frames with depth and poses that the mesh was fused from. Each is read up to five times. Photos
        colour filled holes.
    params, **changes : see RefineParams.
    progress : called after each frame.
    has_matched_depth : the depth was computed by image matching, whose windows blur outlines. Boundaries do
        not move to the outlines then.

    Raises
    ------
    MeshError
        If the mesh is invalid or not an oriented manifold.
    InputError
        If no frame has both pose and depth.
    UsageError
        If a parameter is out of range.

    References
    ----------
    Zheng, Fu, Au and Tai 2011 (normals); Sun, Rosin, Martin and Langbein 2007 (vertices); Chen and Qin
    (patches).
    """
    params = resolve(RefineParams, params, changes)
    given = as_mesh(mesh)
    require_measurable(given, "mesh")
    folder = frames.folder if isinstance(frames, Scan) else None
    given_frames = list(frames.frames if isinstance(frames, Scan) else frames)
    usable = [frame for frame in given_frames if frame.depth is not None]
    with collecting() as diagnostics:
        noise = DepthNoise() if params.strength == 0 else _measure_noise(usable, folder)
        if noise == DepthNoise():
            refined = _keep_mesh(given, "strength is 0" if params.strength == 0 else _NO_NOISE)
        else:
            depth_frames = DepthFrames(usable, make_depth_limits(FuseParams()))
            refined = _refine(
                given, given_frames, depth_frames, noise, params, progress, has_outlines=not has_matched_depth
            )
    return replace(refined, diagnostics=tuple(diagnostics))


def _measure_noise(frames: Sequence[Frame], folder: Path | None) -> DepthNoise:
    if not frames:
        raise InputError(SCAN_FRAMES_SKIPPED, "no frame has a depth map, which `refine` requires.", folder)
    return measure_depth_noise(frames, folder).noise


def _keep_mesh(mesh: Mesh, reason: str) -> RefinementResult:
    """Return the mesh as it is, as the result of a refinement that changes nothing."""
    count = len(mesh.vertices)
    return RefinementResult(
        mesh=mesh,
        deviations=np.zeros(count),
        plane_ids=np.full(count, -1, np.int32),
        plane_count=0,
        noise=None,
        moves=np.zeros(count),
        removed_triangles=0,
        is_filled=np.zeros(count, bool),
        reason=reason,
    )


def _refine(
    mesh: Mesh,
    frames: Sequence[Frame],
    depth_frames: DepthFrames,
    noise: DepthNoise,
    params: RefineParams,
    progress: Progress,
    *,
    has_outlines: bool,
) -> RefinementResult:
    _report_data_left_out(mesh)
    refiner = _make_refiner(mesh, params.strength)
    # The last passes find the outlines, look for free space, and colour the fillings.
    passes = 3 + has_outlines + _CORRECTION_COUNT

    def show(observer: _kernels.SurfaceRefiner | _kernels.BoundaryAligner, number: int) -> None:
        def observe(view: PosedDepth) -> None:
            camera = view.camera
            pinhole = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
            pose = np.ascontiguousarray(view.pose, np.float64)
            observer.observe((pinhole, pose), view.surface.depth, (noise.constant, noise.quadratic))

        depth_frames.show_all(observe, partial(_report_pass, progress, number, passes, len(depth_frames)))

    for number in range(1 + _CORRECTION_COUNT):
        show(refiner, number)
        refiner.filter() if number == 0 else refiner.correct()
    if params.planes:
        refiner.flatten()
    (vertices, triangles, sources, ends, shares), values = refiner.finish()
    release_free_memory()
    moves, deviations, best_cosines, is_contradicted, plane_ids, plane_count = values
    if not best_cosines.any():
        return replace(_keep_mesh(mesh, _NOT_MEASURED), skipped=tuple(depth_frames.skipped.values()))
    colors = None if mesh.colors is None else _interpolate_colors(mesh.colors, sources, ends, shares)
    is_flap = mask_flaps(triangles, best_cosines, is_contradicted)
    kept = clean(
        Mesh(vertices, triangles[~is_flap], colors, up=mesh.up), CleanParams(min_island_area=0, stitch=False)
    )
    # The mesh can have many million triangles: earlier ones are not kept in memory.
    del vertices, triangles, colors
    release_free_memory()
    bounded = _smooth_boundaries(kept.mesh, _MAX_BOUNDARY_MOVES[0])
    if has_outlines:
        aligner = _kernels.BoundaryAligner(bounded.vertices, bounded.triangles, wanted_threads=0)
        show(aligner, 1 + _CORRECTION_COUNT)
        bounded = _smooth_boundaries(bounded.with_(vertices=aligner.finish()), _MAX_BOUNDARY_MOVES[1])
    report_depth, report_photo = (
        partial(_report_pass, progress, number, passes, len(depth_frames)) for number in range(passes)[-2:]
    )
    closed = close_holes(
        bounded,
        plane_ids[kept.vertex_source],
        deviations[kept.vertex_source],
        noise,
        lambda test: depth_frames.show_all(test.observe, report_depth),
        params.fill_holes,
    )
    filled_colors = color_fillings(
        closed.mesh,
        closed.is_filled,
        frames,
        # Frames without depth may have photos, too.
        lambda done: report_photo(min(done, len(depth_frames))),
    )
    progress(passes * len(depth_frames), passes * len(depth_frames))
    return RefinementResult(
        mesh=closed.mesh.with_(colors=filled_colors),
        deviations=closed.deviations,
        plane_ids=closed.plane_ids,
        plane_count=plane_count,
        noise=noise,
        moves=moves[: len(sources)],
        removed_triangles=int(np.count_nonzero(is_flap)),
        is_filled=closed.is_filled,
        fillings=closed.fillings,
        skipped=tuple(depth_frames.skipped.values()),
    )


def _make_refiner(mesh: Mesh, strength: float) -> _kernels.SurfaceRefiner:
    try:
        if not has_repeated_vertex(mesh.triangles).any():
            return _kernels.SurfaceRefiner(mesh.vertices, mesh.triangles, strength=strength, wanted_threads=0)
    except _kernels.InvalidMeshError:
        require_manifold(mesh)
        raise
    require_manifold(mesh)
    raise AssertionError("has_repeated_vertex and require_manifold disagree")


def _smooth_boundaries(mesh: Mesh, max_move_ratio: float) -> Mesh:
    vertices = _kernels.smooth_boundaries(
        mesh.vertices, mesh.triangles, max_move_ratio=max_move_ratio, wanted_threads=0
    )
    return mesh.with_(vertices=vertices)


def _report_pass(progress: Progress, number: int, passes: int, frame_count: int, done: int) -> None:
    """Report progress in one of several passes over all frames."""
    progress(number * frame_count + done, passes * frame_count)


def _interpolate_colors(
    colors: Colors, sources: NDArray[np.uint32], ends: NDArray[np.uint32], shares: Floats
) -> Colors:
    """Return the colours of the vertices that stayed, and of those on split edges."""
    stayed = colors[sources]
    first, second = (stayed[ends[:, end]].astype(np.float64) for end in (0, 1))
    created = np.rint(first + shares[:, None] * (second - first)).astype(np.uint8)
    return np.concatenate([stayed, created])


def _report_data_left_out(mesh: Mesh) -> None:
    found = [
        name
        for name, value in (
            ("texture", mesh.texture),
            ("normals", mesh.normals if mesh.corner_normals is None else mesh.corner_normals),
            ("parts", mesh.part_ids),
        )
        if value is not None
    ]
    if found:
        emit(
            REFINE_DATA_LEFT_OUT.warning(
                "{data} of the mesh {are} left out; refine the mesh before it gets a texture.",
                data=" and ".join(found),
                are="are" if len(found) > 1 or found[0] != "texture" else "is",
            )
        )
