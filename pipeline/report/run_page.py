"""Pages of a mesh file, and of the output folder of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom import stages
from scanloom.pipeline.artifacts.file_names import PICTURES, TEXTURE_MAPS
from scanloom.pipeline.evaluation.codes import REPORT_INCOMPLETE
from scanloom.pipeline.evaluation.deviations import FIGURES, Kept, kept_of, read_deviations
from scanloom.pipeline.evaluation.measures import SIGNED_SAMPLES
from scanloom.pipeline.report.file_names import REPORT
from scanloom.pipeline.report.page.packing import Paint, Shown, packed_page, turn_of_page
from scanloom.pipeline.report.page_cameras import as_runs_write, cameras_of
from scanloom.pipeline.report.page_coarse import coarsely
from scanloom.pipeline.report.page_coverage import missing_of
from scanloom.pipeline.report.page_paints import confidence_paint, deviation_paint
from scanloom.pipeline.report.page_told import at, deviation_tables, skipped_in, told_of
from scanloom.stages import Mesh
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_json
from scanloom.stages.surface.formats.ply_format import promised
from scanloom.stages.surface.mesh_files import standing
from scanloom.stages.surface.pieces import is_many

_RESULTS = ("textured.glb", "simplified.glb", "simplified.ply")
# Camera distance after flying to a location, as a ratio of the model size.
_NEAR = 0.25
# Maximum distance between corresponding vertices of two files of the same mesh, as a ratio of its size.
_SAME = 1e-5


def page_of_mesh(name: str, mesh: Mesh, most_bytes: int) -> bytes:
    """Make the page of a mesh, of at most `most_bytes` if possible."""
    return packed_page(name, {name: Shown(mesh)}, most_bytes)


def page_of_run(folder: Path, most_bytes: int) -> bytes:
    """Make the page of an output folder, of at most `most_bytes` if possible.

    Measurements of the report are used; without a report, deviations are computed.

    Raises
    ------
    InputError
        If the folder has no result, or files that were not written by a run.
    """
    name = next((name for name in _RESULTS if (folder / name).is_file()), None)
    if name is None:
        known = ", ".join(_RESULTS)
        raise InputError(
            REPORT_INCOMPLETE,
            "the folder has none of {known}, nor tiles",
            folder,
            remedy="give a mesh file, or the output folder of a run.",
            known=known,
        )
    result = standing(folder / name, stages.read_mesh(folder / name))
    turn = turn_of_page(result)
    report, told = _reported(folder / REPORT)
    paints: dict[str, Paint] = {}
    models = {}
    kept = None
    is_metric = at(report, "scan", "metric", otherwise=True)
    if (folder / "clean.ply").is_file():
        if is_many(promised(folder / "clean.ply", "face")):
            clean = None
            models["clean mesh"] = coarsely(
                folder / "clean.ply", result.up, "before simplification", is_metric=is_metric
            )
        else:
            clean = stages.read_mesh(folder / "clean.ply").with_(up=result.up)
            models["clean mesh"] = Shown(clean, "before simplification")
        kept = _deviations(folder / PICTURES, clean, result)
    if kept is not None:
        bound, proven = _bounds(folder / REPORT, report)
        away = _NEAR * _size(result)
        with as_runs_write(folder / PICTURES / FIGURES):
            paints["deviation"] = deviation_paint(kept, bound, is_metric=is_metric)
            places = [
                {"target": (turn @ np.array(one["point_m"])).tolist(), "away": away}
                for one in kept.figures["worst"]
            ]
            within = None if bound is None else kept.share_within(-bound, bound)
            figures = {**kept.figures, "tolerance_m": bound, "share_within": within}
            told["tables"] = [
                *deviation_tables(figures, proven, places, is_metric=is_metric),
                *told.get("tables", ()),
            ]
    missing = missing_of(folder, result.up, turn, is_metric=is_metric)
    if missing is not None:
        models["coverage"] = missing.shown
        told["tables"] = [missing.table, *told.get("tables", ())]
    confidence = confidence_paint(result, folder / TEXTURE_MAPS)
    if confidence is not None:
        paints["confidence"] = confidence
    models = {"result": Shown(_with_vertex_colors(folder, result), name, paints=paints), **models}
    cameras = cameras_of(folder / PICTURES, turn, skipped_in(report))
    return packed_page(folder.resolve().name, models, most_bytes, told, cameras)


def _deviations(pictures: Path, clean: Mesh | None, result: Mesh) -> Kept | None:
    """Return the deviations of the result, stored or computed."""
    with as_runs_write(pictures):
        kept = read_deviations(pictures)
    if kept is not None and _is_same(kept.vertices, result):
        return kept
    if clean is not None:
        return kept_of(stages.deviations(clean, result, signed_samples=SIGNED_SAMPLES))
    return None if kept is None else _of_other_file(kept, result)


def _of_other_file(kept: Kept, result: Mesh) -> Kept | None:
    """Transfer deviations to the same mesh with reordered vertices.

    Returns None if the mesh differs.
    """
    from scipy.spatial import cKDTree

    away, rows = cKDTree(kept.vertices).query(result.vertices, workers=-1)
    if len(away) == 0 or away.max() > _SAME * _size(result):
        return None
    return replace(kept, vertices=result.vertices, at_vertices=kept.at_vertices[rows])


def _bounds(path: Path, report: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the requested and the proven shape bound in metres, each or None."""
    asked = at(report, "stages", "simplify", "params", "simplify", "max_shape")
    proven = at(report, "stages", "simplify", "figures", "details", "shape_bound_m")
    with as_runs_write(path):
        return (None if asked is None else float(asked)), (None if proven is None else float(proven))


def _with_vertex_colors(folder: Path, result: Mesh) -> Mesh:
    """Add the vertex colours of simplified.ply to a textured result."""
    light = folder / "simplified.ply"
    if result.texture is None or result.colors is not None or not light.is_file():
        return result
    plain = stages.read_mesh(light)
    return result.with_(colors=plain.colors) if _is_same(plain.vertices, result) else result


def _is_same(vertices: np.ndarray, mesh: Mesh) -> bool:
    if vertices.shape != mesh.vertices.shape or len(vertices) == 0:
        return False
    return bool(np.abs(vertices - mesh.vertices).max() <= _SAME * _size(mesh))


def _size(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _reported(path: Path) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Read report.json and convert it to report data of the page; empty if missing."""
    if not path.is_file():
        return {}, {}
    with as_runs_write(path):
        report = dict(read_json(path))  # type: ignore[call-overload]
        return report, told_of(report)
