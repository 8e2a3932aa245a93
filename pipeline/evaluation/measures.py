"""Measurements and pictures of the meshes of a run.

Both only depend on the meshes and are cached. `scanloom.pipeline.run.document` adds data of the run itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scanloom.pipeline.evaluation.deviations import write_deviations
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.evaluation.photos import write_photos
from scanloom.stages.comparing.compare import CompareParams, compare_searched, compare_surfaces
from scanloom.stages.comparing.deviations import DeviationParams, Deviations, deviations_from
from scanloom.stages.comparing.distance_map import distance_map
from scanloom.stages.comparing.in_pieces import compare_in_pieces
from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.picturing.in_pieces import draw_in_pieces
from scanloom.stages.picturing.render import Model, Viewpoint, viewpoints, write_png
from scanloom.stages.picturing.viewpoints import ENOUGH, viewpoints_around
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.memory import give_back
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.piecewise import Piecewise
from scanloom.stages.surface.raycasting import Floats, Surface, bounding_box
from scanloom.stages.surface.topology import require_area, topology

RESULT_VERSION = 7

# Number of samples for signed deviations.
SIGNED_SAMPLES = 100_000


def measure_and_draw(
    folder: Path,
    meshes: Mapping[str, Mesh | Piecewise],
    frames: Sequence[Frame],
    compared: CompareParams,
    params: ReportParams,
    progress: Progress = silent,
    by_photo: Callable[[], Mesh] | None = None,
    held_out: Sequence[Frame] = (),
) -> dict[str, Any]:
    """Measure the simplified mesh, draw all meshes into `folder`, and return metrics.

    Parameters
    ----------
    meshes : meshes by name: "fused", "clean", "simplified" and, if available, "textured". The first two may
        be chunked.
    frames : frames of the scan, whose poses determine the viewpoints.
    compared : parameters of the comparison.
    by_photo : returns the textured mesh coloured by the photo with the largest weight, which is drawn, too.
    held_out : held-out frames with corrected poses.

    Raises
    ------
    MeshError
        If a mesh has no surface to measure and draw.
    """
    large = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, Piecewise)}
    small = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, Mesh)}
    for name, mesh in small.items():
        require_area(mesh, f"{name}.ply")
    # Measurements and pictures share ray-casting structures, which take longer to build than a picture to
    # draw.
    box = _around(bounding_box(*small.values()), *(one.box for one in large.values()))
    models = {name: cache(partial(_model, mesh, box)) for name, mesh in small.items()}
    # Chunked meshes need the memory, so models are then built one by one when drawn.
    if not large:
        _side_by_side([*models.values()])
    # Release memory freed after loading the meshes.
    give_back()
    of = _Measured(models, large, small, box)
    work: list[Callable[[], Any]] = [
        # Longest task first, for the best use of threads.
        partial(_off_fused, of, compared),
        partial(_off_clean, folder, of, compared),
        partial(measure, small["simplified"]),
        partial(write_photos, folder, frames, params.photos, held_out),
    ]
    drawings: list[_Drawing | _InPieces] = []
    if params.pictures:
        chosen = choose_viewpoints(meshes["fused"], frames, params)
        drawings += (_InPieces(name, one, chosen, box) for name, one in large.items())
        drawings += _drawings(models, chosen, by_photo)
    work += [partial(one.draw, folder) for one in drawings]
    # Chunked meshes are processed one at a time to save memory.
    threads = 1 if large else workers()
    to_fused, (to_clean, deviation), measured, photos, *_ = _side_by_side(work, progress, threads)
    return {
        "mesh": measured | {"to_fused": to_fused, "to_clean": to_clean},
        "deviation": deviation,
        "pictures": [file for one in drawings for file in one.files],
        "photos": photos,
    }


class _Measured(NamedTuple):
    """Meshes to measure.

    Attributes
    ----------
    models : functions that build a model on first use, by mesh name.
    large : chunked meshes by name.
    small : in-memory meshes by name.
    box : (2, 3) common bounding box.
    """

    models: Mapping[str, Callable[[], Model]]
    large: Mapping[str, Piecewise]
    small: Mapping[str, Mesh]
    box: Floats

    def surface(self, name: str) -> Surface:
        return self.models[name]().surface


def _around(*boxes: Floats) -> Floats:
    lows, highs = np.array(boxes).swapaxes(0, 1)
    return np.array([lows.min(axis=0), highs.max(axis=0)])


def _model(mesh: Mesh, box: Floats) -> Model:
    return Model(Surface(mesh, box))


def _side_by_side(
    work: Sequence[Callable[[], Any]], progress: Progress = silent, threads: int | None = None
) -> list[Any]:
    """Run tasks in parallel, started in order, and return their results in order.

    `threads` defaults to the number of cores.
    """
    results = []
    for result in read_ahead(lambda one: one(), work, threads=threads or workers(), ahead=len(work)):
        results.append(result)
        progress(len(results), len(work))
    return results


def _off_fused(of: _Measured, params: CompareParams) -> dict[str, Any]:
    """Measure the two-sided distance between the simplified and the fused mesh.

    From the simplified to the fused mesh (`b_to_a`) it is the error of the result. The other direction is
    dominated by the islands that cleaning removed.
    """
    if "fused" in of.large:
        found, _ = compare_in_pieces(of.large["fused"], of.small["simplified"], params, box=of.box)
        return found.figures()
    return compare_surfaces(of.surface("fused"), of.surface("simplified"), params).figures()


def _off_clean(folder: Path, of: _Measured, params: CompareParams) -> tuple[dict[str, Any], dict[str, Any]]:
    """Measure the two-sided error of simplification, and the signed deviation of the result.

    Both are relative to the clean mesh. Islands are already removed from it, so only simplification
    contributes.
    """
    final = of.small["simplified"]
    result = of.small.get("textured", final)
    fewer = replace(params, samples=math.ceil(params.samples / 4))
    signed = DeviationParams(signed_samples=SIGNED_SAMPLES)
    found: Deviations | None
    if "clean" in of.large:
        compared, found = compare_in_pieces(
            of.large["clean"], final, fewer, box=of.box, signed=(result, signed)
        )
        assert found is not None, "it was asked for"
    else:
        box = bounding_box(of.small["clean"], final, result)
        clean = WithNeedles(of.surface("clean"), box)
        compared = compare_searched(clean, WithNeedles(of.surface("simplified"), box), fewer)
        found = deviations_from(clean, result, signed)
    return compared.figures(), write_deviations(folder, found)


def measure(final: Mesh) -> dict[str, Any]:
    """Return element counts, topology and edge statistics of the simplified mesh."""
    found = topology(final)
    return {
        "vertices": len(final.vertices),
        "triangles": len(final.triangles),
        "manifold": found.is_manifold,
        "oriented": found.is_oriented,
        "boundary_loops": found.boundary_loops,
        "components": found.components,
        "edges": edge_figures(final),
    }


def edge_figures(mesh: Mesh) -> dict[str, Any]:
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
        "length_deviation_m": float(lengths.std()),
        "length_minimum_m": float(lengths.min()),
        "length_maximum_m": float(lengths.max()),
    }


class _Drawing(NamedTuple):
    """Picture to draw, with an optional second picture that also shows the triangles."""

    file: str
    model: Callable[[], Model]
    viewpoint: Viewpoint
    with_triangles: str | None = None

    @property
    def files(self) -> list[str]:
        return [self.file] if self.with_triangles is None else [self.file, self.with_triangles]

    def draw(self, folder: Path) -> None:
        image = self.model().draw(self.viewpoint)
        write_png(folder / self.file, image)
        if self.with_triangles is not None:
            both = np.hstack([image, self.model().draw(self.viewpoint, "edges")])
            write_png(folder / self.with_triangles, both)


class _InPieces(NamedTuple):
    """All pictures of a chunked mesh."""

    name: str
    mesh: Piecewise
    viewpoints: Sequence[Viewpoint]
    box: Floats

    @property
    def files(self) -> list[str]:
        return [_file(self.name, one) for one in self.viewpoints]

    def draw(self, folder: Path) -> None:
        for file, image in zip(self.files, draw_in_pieces(self.mesh, self.viewpoints, self.box), strict=True):
            write_png(folder / file, image)


def _file(name: str, viewpoint: Viewpoint) -> str:
    return f"{name}-{viewpoint.name}.png"


def _drawings(
    models: Mapping[str, Callable[[], Model]],
    chosen: Sequence[Viewpoint],
    by_photo: Callable[[], Mesh] | None,
) -> list[_Drawing]:
    """List the pictures to draw: each mesh from each viewpoint, and two extra pictures.

    Files are `<mesh>-<viewpoint>.png`, `simplified-triangles.png` with the edges of the simplified mesh, and
    `textured-photos.png` with the photo of the largest weight per texel.
    """
    drawings: list[_Drawing] = []
    for name, model in models.items():
        drawings += (_Drawing(_file(name, one), model, one) for one in chosen)
        if name == "simplified":
            drawings[-1] = drawings[-1]._replace(with_triangles="simplified-triangles.png")
        if name == "textured" and by_photo is not None:
            drawings.append(_Drawing("textured-photos.png", partial(_showing, model, by_photo), chosen[-1]))
    return drawings


def _showing(model: Callable[[], Model], colors: Callable[[], Mesh]) -> Model:
    return model().showing(colors())


def choose_viewpoints(
    mesh: Mesh | Piecewise, frames: Sequence[Frame], params: ReportParams
) -> tuple[Viewpoint, ...]:
    """Choose the viewpoints of the pictures from the fused mesh and the frames."""
    # Viewpoints are named after frames. File names are not part of the cache key, so use frame indices
    # instead.
    numbered = [replace(frame, name=f"{i:06d}") for i, frame in enumerate(frames)]
    if isinstance(mesh, Piecewise):
        points = mesh.some_vertices(ENOUGH)
        return viewpoints_around(points, params.viewpoints, frames=numbered, width=params.width)
    return viewpoints(mesh, params.viewpoints, frames=numbered, width=params.width)


def report_levels(
    folder: Path | None,
    original: Mesh,
    levels: Sequence[Mesh],
    viewpoint: Viewpoint,
    compared: CompareParams,
) -> tuple[dict[str, Any], list[str]]:
    """Measure and draw the levels of a normal mesh.

    Each level is drawn with its triangles. The original mesh is coloured by its distance from the last level.

    Parameters
    ----------
    folder : folder for the pictures; None to draw none.
    original : mesh that was remeshed.
    levels : meshes of all levels, coarse to fine.
    viewpoint : viewpoint of the pictures.
    compared : parameters of the comparison; each level gets a quarter of the samples.

    Returns
    -------
    Metrics, and the file names of the pictures: `remeshed-level_<k>.png` and `remeshed-distance.png`. The
    last colour of the latter means `full_scale_m` of the metrics, or more.
    """
    fewer = replace(compared, samples=math.ceil(compared.samples / 4))
    box = bounding_box(original, *levels)
    reference, figures, images = Surface(original, box), [], {}
    for level, mesh in enumerate(levels):
        surface = Surface(mesh, box)
        found = compare_surfaces(reference, surface, fewer)
        counts = {"level": level, "vertices": len(mesh.vertices), "triangles": len(mesh.triangles)}
        figures.append(counts | {"to_simplified": found.figures()})
        if folder is not None:
            images[f"remeshed-level_{level}.png"] = Model(surface).draw(viewpoint, "edges")
    if folder is None:
        return {"levels": figures, "full_scale_m": None}, []
    painted, full_scale = distance_map(original, surface)
    images["remeshed-distance.png"] = Model(Surface(painted, box)).draw(viewpoint)
    for name, image in images.items():
        write_png(folder / name, image)
    return {"levels": figures, "full_scale_m": full_scale}, list(images)
