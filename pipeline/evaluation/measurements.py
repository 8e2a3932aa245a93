"""Measurements and pictures of the meshes of a run.

Both only depend on the meshes and are cached. `scanloom.pipeline.run.report_document` adds data of the run
itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.evaluation.camera_photos import write_photos
from scanloom.pipeline.evaluation.filled_surface import (
    FILLED_CAPTION,
    FILLED_PICTURE,
    choose_filled_viewpoint,
    mark_filled_surface,
)
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.evaluation.stored_deviations import write_deviations
from scanloom.stages.comparing.chunked_comparison import compare_chunked
from scanloom.stages.comparing.compare import CompareParams, compare_needle_safe, compare_surfaces
from scanloom.stages.comparing.deviations import DeviationParams, Deviations, measure_deviations_from
from scanloom.stages.comparing.distance_map import paint_distances
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.rendering.annotations import draw_caption
from scanloom.stages.rendering.chunked_rendering import draw_chunked
from scanloom.stages.rendering.render import RenderModel, Shading, Viewpoint, viewpoints, write_png
from scanloom.stages.rendering.viewpoints import MAX_FRAMED_POINTS, choose_viewpoints_around
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.topology import require_area, topology

RESULT_VERSION = 10

# Number of samples for signed deviations.
SIGNED_SAMPLES = 100_000

# Ratio of the samples of `compare`. It is enough for means; bounds are proven elsewhere.
_SAMPLE_RATIO = 0.25


def measure_and_draw(
    folder: Path,
    meshes: Mapping[str, Mesh | ChunkedMesh],
    frames: Sequence[Frame],
    compare_params: CompareParams,
    params: ReportParams,
    progress: Progress = ignore_progress,
    color_by_photo: Callable[[], Mesh] | None = None,
    held_out: Sequence[Frame] = (),
    is_filled: NDArray[np.bool_] | None = None,
) -> dict[str, Any]:
    """Measure the simplified mesh, draw all meshes into `folder`, and return metrics.

    Parameters
    ----------
    meshes : meshes by name: "fused", "refined", "simplified" and, if available, "textured". The first two may
        be chunked.
    frames : frames of the scan, whose poses determine the viewpoints.
    compare_params : parameters of the comparison.
    color_by_photo : returns the textured mesh with a colour per photo, for an additional picture. Each face
        is coloured by the photo with the largest weight.
    held_out : held-out frames with corrected poses.
    is_filled : (n,) True for the vertices of the refined mesh inside of filled holes, which get an additional
        picture. None if the refined mesh is chunked.

    Raises
    ------
    MeshError
        If a mesh has no surface to measure and draw.
    """
    compare_params = replace(compare_params, samples=math.ceil(_SAMPLE_RATIO * compare_params.samples))
    large = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, ChunkedMesh)}
    small = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, Mesh)}
    for name, mesh in small.items():
        require_area(mesh, f"{name}.ply")
    # Measurements and pictures share ray-casting structures, which take longer to build than a picture to
    # draw.
    box = _merge_boxes(compute_bounding_box(*small.values()), *(one.box for one in large.values()))
    models = {name: cache(partial(_make_model, mesh, box)) for name, mesh in small.items()}
    # Chunked meshes need the memory, so models are then built one by one when drawn.
    if not large:
        _run_parallel([*models.values()])
    # Release memory freed after loading the meshes.
    release_free_memory()
    measured_meshes = _MeasuredMeshes(models, large, small, box)
    tasks: list[Callable[[], Any]] = [
        # Longest task first, for the best use of threads.
        partial(_measure_from_fused, measured_meshes, compare_params),
        partial(_measure_from_refined, folder, measured_meshes, compare_params),
        partial(measure_simplified, small["simplified"]),
        partial(write_photos, folder, frames, params.photos, held_out),
    ]
    drawings: list[_Drawing | _ChunkedDrawing] = []
    if params.pictures:
        chosen = choose_viewpoints(meshes["fused"], frames, params)
        drawings += (_ChunkedDrawing(name, one, chosen, box) for name, one in large.items())
        drawings += _list_drawings(models, chosen, color_by_photo)
        if "refined" in models and is_filled is not None and is_filled.any():
            drawings.append(_make_filled_drawing(models["refined"], small["refined"], is_filled, chosen))
    tasks += [partial(one.draw, folder) for one in drawings]
    # Chunked meshes are processed one at a time to save memory.
    threads = 1 if large else get_worker_count()
    to_fused, (to_refined, deviation), measured, photos, *_ = _run_parallel(tasks, progress, threads)
    return {
        "mesh": measured | {"to_fused": to_fused, "to_refined": to_refined},
        "deviation": deviation,
        "pictures": [file for one in drawings for file in one.files],
        "photos": photos,
    }


class _MeasuredMeshes(NamedTuple):
    """Meshes to measure.

    Attributes
    ----------
    models : functions that build a model on first use, by mesh name.
    large : chunked meshes by name.
    small : in-memory meshes by name.
    box : (2, 3) common bounding box.
    """

    models: Mapping[str, Callable[[], RenderModel]]
    large: Mapping[str, ChunkedMesh]
    small: Mapping[str, Mesh]
    box: Floats

    def get_surface(self, name: str) -> RaycastingSurface:
        return self.models[name]().surface


def _merge_boxes(*boxes: Floats) -> Floats:
    lows, highs = np.array(boxes).swapaxes(0, 1)
    return np.array([lows.min(axis=0), highs.max(axis=0)])


def _make_model(mesh: Mesh, box: Floats) -> RenderModel:
    return RenderModel(RaycastingSurface(mesh, box))


def _run_parallel(
    tasks: Sequence[Callable[[], Any]], progress: Progress = ignore_progress, threads: int | None = None
) -> list[Any]:
    """Run tasks in parallel, started in order, and return their results in order.

    `threads` defaults to the number of cores.
    """
    results = []
    for result in map_ordered(
        lambda one: one(), tasks, threads=threads or get_worker_count(), max_pending=len(tasks)
    ):
        results.append(result)
        progress(len(results), len(tasks))
    return results


def _measure_from_fused(meshes: _MeasuredMeshes, params: CompareParams) -> dict[str, Any]:
    """Measure the two-sided distance between the simplified and the fused mesh.

    From the simplified to the fused mesh (`b_to_a`) it is the error of the result. The other direction is
    dominated by the islands that cleaning removed.
    """
    if "fused" in meshes.large:
        found, _ = compare_chunked(meshes.large["fused"], meshes.small["simplified"], params, box=meshes.box)
        return found.to_dict()
    return compare_surfaces(meshes.get_surface("fused"), meshes.get_surface("simplified"), params).to_dict()


def _measure_from_refined(
    folder: Path, meshes: _MeasuredMeshes, params: CompareParams
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Measure the two-sided error of simplification, and the signed deviation of the result.

    Both are relative to the refined mesh. Islands are already removed from it, so only simplification
    contributes.
    """
    final = meshes.small["simplified"]
    result = meshes.small.get("textured", final)
    signed = DeviationParams(signed_samples=SIGNED_SAMPLES)
    found: Deviations | None
    if "refined" in meshes.large:
        compared, found = compare_chunked(
            meshes.large["refined"], final, params, box=meshes.box, signed=(result, signed)
        )
        assert found is not None, "it was asked for"
    else:
        box = compute_bounding_box(meshes.small["refined"], final, result)
        refined = NeedleSafeSurface(meshes.get_surface("refined"), box)
        compared = compare_needle_safe(
            refined, NeedleSafeSurface(meshes.get_surface("simplified"), box), params
        )
        found = measure_deviations_from(refined, result, signed)
    return compared.to_dict(), write_deviations(folder, found)


def measure_simplified(final: Mesh) -> dict[str, Any]:
    """Return element counts, topology and edge statistics of the simplified mesh."""
    found = topology(final)
    return {
        "vertices": len(final.vertices),
        "triangles": len(final.triangles),
        "manifold": found.is_manifold,
        "oriented": found.is_oriented,
        "boundary_loops": found.boundary_loops,
        "components": found.components,
        "edges": edge_metrics(final),
    }


def edge_metrics(mesh: Mesh) -> dict[str, Any]:
    """Return statistics of edge lengths; each edge counts once."""
    ends = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    count = len(mesh.vertices)
    # Encode each edge as one integer: sorting integers is several times faster than sorting rows.
    edges = np.unique(ends[:, 0] * count + ends[:, 1])
    lengths = np.linalg.norm(mesh.vertices[edges // count] - mesh.vertices[edges % count], axis=1)
    if len(lengths) == 0:
        return {"count": 0}
    return {
        "count": len(edges),
        "length_mean_m": float(lengths.mean()),
        "length_std_m": float(lengths.std()),
        "length_min_m": float(lengths.min()),
        "length_max_m": float(lengths.max()),
    }


class _Drawing(NamedTuple):
    """Picture to draw, with an optional second picture that also shows the triangles."""

    file: str
    model: Callable[[], RenderModel]
    viewpoint: Viewpoint
    with_triangles: str | None = None
    caption: str = ""
    shading: Shading = "color"

    @property
    def files(self) -> list[str]:
        return [self.file] if self.with_triangles is None else [self.file, self.with_triangles]

    def draw(self, folder: Path) -> None:
        image = self.model().draw(self.viewpoint, self.shading)
        write_png(folder / self.file, draw_caption(image, self.caption) if self.caption else image)
        if self.with_triangles is not None:
            both = np.hstack([image, self.model().draw(self.viewpoint, "edges")])
            write_png(folder / self.with_triangles, both)


class _ChunkedDrawing(NamedTuple):
    """All pictures of a chunked mesh."""

    name: str
    mesh: ChunkedMesh
    viewpoints: Sequence[Viewpoint]
    box: Floats

    @property
    def files(self) -> list[str]:
        return [_make_file_name(self.name, one) for one in self.viewpoints]

    def draw(self, folder: Path) -> None:
        for file, image in zip(self.files, draw_chunked(self.mesh, self.viewpoints, self.box), strict=True):
            write_png(folder / file, image)


def _make_file_name(name: str, viewpoint: Viewpoint) -> str:
    return f"{name}-{viewpoint.name}.png"


def _list_drawings(
    models: Mapping[str, Callable[[], RenderModel]],
    viewpoint_list: Sequence[Viewpoint],
    color_by_photo: Callable[[], Mesh] | None,
) -> list[_Drawing]:
    """List the pictures to draw: each mesh from each viewpoint, and two extra pictures.

    Files are `<mesh>-<viewpoint>.png`, `simplified-triangles.png` with the edges of the simplified mesh, and
    `textured-photos.png` with the photo of the largest weight per texel.
    """
    drawings: list[_Drawing] = []
    for name, model in models.items():
        # With a texture, the colours of the simplified vertices are far apart and do not matter.
        shading: Shading = "plain" if name == "simplified" and "textured" in models else "color"
        drawings += (
            _Drawing(_make_file_name(name, one), model, one, shading=shading) for one in viewpoint_list
        )
        if name == "simplified":
            drawings[-1] = drawings[-1]._replace(with_triangles="simplified-triangles.png")
        if name == "textured" and color_by_photo is not None:
            drawings.append(
                _Drawing(
                    "textured-photos.png", partial(_recolor_model, model, color_by_photo), viewpoint_list[-1]
                )
            )
    return drawings


def _make_filled_drawing(
    model: Callable[[], RenderModel],
    refined: Mesh,
    is_filled: NDArray[np.bool_],
    viewpoint_list: Sequence[Viewpoint],
) -> _Drawing:
    """Return the picture `refined-filled.png`: the refined mesh with its filled holes in a signal colour."""
    return _Drawing(
        FILLED_PICTURE,
        partial(_recolor_model, model, partial(mark_filled_surface, refined, is_filled)),
        choose_filled_viewpoint(refined, is_filled, viewpoint_list),
        caption=FILLED_CAPTION,
    )


def _recolor_model(model: Callable[[], RenderModel], colors: Callable[[], Mesh]) -> RenderModel:
    return model().replace_colors(colors())


def choose_viewpoints(
    mesh: Mesh | ChunkedMesh, frames: Sequence[Frame], params: ReportParams
) -> tuple[Viewpoint, ...]:
    """Choose the viewpoints of the pictures from the fused mesh and the frames."""
    # Viewpoints are named after frames. File names are not part of the cache key, so use frame indices
    # instead.
    numbered = [replace(frame, name=f"{i:06d}") for i, frame in enumerate(frames)]
    if isinstance(mesh, ChunkedMesh):
        points = mesh.sample_vertices(MAX_FRAMED_POINTS)
        return choose_viewpoints_around(points, params.viewpoints, frames=numbered, width=params.width)
    return viewpoints(mesh, params.viewpoints, frames=numbered, width=params.width)


def measure_and_draw_levels(
    folder: Path | None,
    original: Mesh,
    levels: Sequence[Mesh],
    viewpoint: Viewpoint,
    compare_params: CompareParams,
) -> tuple[dict[str, Any], list[str]]:
    """Measure and draw the levels of a normal mesh.

    Each level is drawn with its triangles. The original mesh is coloured by its distance from the last level.

    Parameters
    ----------
    folder : folder for the pictures; None to draw none.
    original : mesh that was remeshed.
    levels : meshes of all levels, coarse to fine.
    viewpoint : viewpoint of the pictures.
    compare_params : parameters of the comparison; each level gets a quarter of the samples.

    Returns
    -------
    Metrics, and the file names of the pictures: `remeshed-level_<k>.png` and `remeshed-distance.png`. The
    last colour of the latter means `full_scale_m` of the metrics, or more.
    """
    fewer = replace(compare_params, samples=math.ceil(compare_params.samples / 4))
    box = compute_bounding_box(original, *levels)
    reference, metrics, images = RaycastingSurface(original, box), [], {}
    for level, mesh in enumerate(levels):
        surface = RaycastingSurface(mesh, box)
        found = compare_surfaces(reference, surface, fewer)
        counts = {"level": level, "vertices": len(mesh.vertices), "triangles": len(mesh.triangles)}
        metrics.append(counts | {"to_simplified": found.to_dict()})
        if folder is not None:
            images[f"remeshed-level_{level}.png"] = RenderModel(surface).draw(viewpoint, "edges")
    if folder is None:
        return {"levels": metrics, "full_scale_m": None}, []
    painted, full_scale = paint_distances(original, surface)
    images["remeshed-distance.png"] = RenderModel(RaycastingSurface(painted, box)).draw(viewpoint)
    for name, image in images.items():
        write_png(folder / name, image)
    return {"levels": metrics, "full_scale_m": full_scale}, list(images)
