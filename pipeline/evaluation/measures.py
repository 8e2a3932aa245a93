"""Measurements on the meshes of a run, and pictures of them.

Both depend on the meshes alone and are cached. `scanloom.pipeline.run.document` adds what belongs to one run.
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

# Points on the result that are measured with signs.
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
    """Measure the simplified mesh, write pictures of all into `folder`, and return the figures.

    Parameters
    ----------
    meshes : "fused", "clean" and "simplified", and "textured", if it was; the first two may be in pieces.
    frames : of the scan, whose poses say where to look from.
    by_photo : gives the textured mesh in colours of the photos that count most, which is drawn, too.
    held_out : frames that no stage saw, placed like their neighbours.

    Raises
    ------
    MeshError
        If a mesh has no surface to measure and draw.
    """
    large = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, Piecewise)}
    small = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, Mesh)}
    for name, mesh in small.items():
        require_area(mesh, f"{name}.ply")
    # Distances and pictures ask the same surfaces: to make one takes longer than to draw it.
    box = _around(bounding_box(*small.values()), *(one.box for one in large.values()))
    models = {name: cache(partial(_model, mesh, box)) for name, mesh in small.items()}
    # Beside pieces there is no room for what is drawn, before it is.
    if not large:
        _side_by_side([*models.values()])
    # What they were read and made ready with has left holes.
    give_back()
    of = _Measured(models, large, small, box)
    work: list[Callable[[], Any]] = [
        # The longest first.
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
    # Of pieces, there is room for one.
    threads = 1 if large else workers()
    to_fused, (to_clean, deviation), measured, photos, *_ = _side_by_side(work, progress, threads)
    return {
        "mesh": measured | {"to_fused": to_fused, "to_clean": to_clean},
        "deviation": deviation,
        "pictures": [file for one in drawings for file in one.files],
        "photos": photos,
    }


class _Measured(NamedTuple):
    """What is measured: models, made when asked for, meshes in pieces and others, the box (2, 3) of all."""

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
    """Return what pieces of work return, done in their order, on all cores if not told otherwise."""
    results = []
    for result in read_ahead(lambda one: one(), work, threads=threads or workers(), ahead=len(work)):
        results.append(result)
        progress(len(results), len(work))
    return results


def _off_fused(of: _Measured, params: CompareParams) -> dict[str, Any]:
    """Measure how far the simplified mesh and the fused one are apart.

    From the simplified mesh to the fused one (`b_to_a`) is the error of what is there. The other way is
    mostly how far off the islands were that cleaning removed.
    """
    if "fused" in of.large:
        found, _ = compare_in_pieces(of.large["fused"], of.small["simplified"], params, box=of.box)
        return found.figures()
    return compare_surfaces(of.surface("fused"), of.surface("simplified"), params).figures()


def _off_clean(folder: Path, of: _Measured, params: CompareParams) -> tuple[dict[str, Any], dict[str, Any]]:
    """Measure how far simplification has moved the clean mesh, both ways, and the result from it, with signs.

    The clean mesh has no islands that were removed: the error is of simplification alone.
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
    """Return the simplified mesh's counts, and what its edges are like."""
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
    """Return mean and spread of the edges' lengths; every edge counts once."""
    ends = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    count = len(mesh.vertices)
    # An edge as one number: sorting numbers is several times faster than sorting rows.
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
    """A picture to draw; and perhaps another one, of the same with its triangles beside it."""

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
    """All pictures of a mesh in pieces."""

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
    """Return what is drawn: each mesh from each viewpoint, the simplified one with its triangles beside it.

    The files are `<mesh>-<viewpoint>.png`, `simplified-triangles.png`, and `textured-photos.png`, with the
    photo that counts most where.
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
    """Return where the meshes of a run are drawn from; `mesh` is the fused one."""
    # A viewpoint is named after its frame; numbers, because the names of files decide nothing here.
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

    Each level is drawn with its triangles. The original is painted by its distance from the last level.

    Parameters
    ----------
    folder : for the pictures; None to draw none.
    original : the mesh that was remeshed.
    compared : as for the whole mesh; each level gets a quarter of the samples.

    Returns
    -------
    Figures, and the names of the pictures: `remeshed-level_<k>.png` and `remeshed-distance.png`. In the
    latter, the last colour stands for `full_scale_m` of the figures, or more.
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
