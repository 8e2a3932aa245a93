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
from scanloom.pipeline.evaluation.measurements import SIGNED_SAMPLES
from scanloom.pipeline.evaluation.stored_deviations import (
    FIGURES,
    StoredDeviations,
    make_stored_deviations,
    read_deviations,
)
from scanloom.pipeline.report.coarse_model import coarsen_mesh
from scanloom.pipeline.report.file_names import REPORT
from scanloom.pipeline.report.page.packing import (
    PageModelSource,
    VertexColormap,
    compute_page_rotation,
    make_packed_page,
)
from scanloom.pipeline.report.page.page_header import (
    PageFact,
    describe_mesh,
    format_file_size,
    make_page_header,
)
from scanloom.pipeline.report.page_cameras import convert_parse_errors, read_cameras
from scanloom.pipeline.report.page_colormaps import make_deviation_colormap, make_photo_count_colormap
from scanloom.pipeline.report.page_coverage import read_coverage
from scanloom.pipeline.report.page_fillings import make_fillings_table, read_filled_colormap
from scanloom.pipeline.report.report_summary import (
    get_nested,
    list_skipped_frames,
    make_deviation_tables,
    make_noise_table,
    summarize_report,
)
from scanloom.pipeline.report.run_header import make_run_header
from scanloom.stages import Mesh
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_json
from scanloom.stages.surface.chunked_ply import exceeds_chunk_limit
from scanloom.stages.surface.formats.ply_format import read_row_count
from scanloom.stages.surface.mesh_files import set_default_up

_RESULT_FILES = ("textured.glb", "simplified.glb", "simplified.ply")
# Camera distance after flying to a location, as a ratio of the model size.
_FLY_DISTANCE_RATIO = 0.25
# Maximum distance between corresponding vertices of two files of the same mesh, as a ratio of its size.
_SAME_VERTEX_RATIO = 1e-5


def make_mesh_page(file: Path, mesh: Mesh, max_bytes: int) -> bytes:
    """Create the page of a mesh file; at most `max_bytes` if possible."""
    name = file.resolve().stem
    facts = [
        *describe_mesh(mesh, compute_page_rotation(mesh)),
        PageFact("File", format_file_size(file.stat().st_size), file.name),
    ]
    report_data = {"header": make_page_header(facts)}
    return make_packed_page(name, {name: PageModelSource(mesh)}, max_bytes, report_data)


def make_run_page(folder: Path, max_bytes: int) -> bytes:
    """Create the page of an output folder; at most `max_bytes` if possible.

    Uses the measurements of the report; without a report, computes the deviations.

    Raises
    ------
    InputError
        If the folder has no result, or files that were not written by a run.
    """
    name = next((name for name in _RESULT_FILES if (folder / name).is_file()), None)
    if name is None:
        known = ", ".join(_RESULT_FILES)
        raise InputError(
            REPORT_INCOMPLETE,
            "the folder has none of {known}, nor tiles",
            folder,
            remedy="give a mesh file, or the output folder of a run.",
            known=known,
        )
    result = set_default_up(folder / name, stages.read_mesh(folder / name))
    rotation = compute_page_rotation(result)
    report, report_data = _read_report(folder / REPORT)
    colormaps: dict[str, VertexColormap] = {}
    models = {}
    stored = None
    is_metric = get_nested(report, "scan", "metric", default=True)
    if (folder / "refined.ply").is_file():
        if exceeds_chunk_limit(read_row_count(folder / "refined.ply", "face")):
            refined = None
            models["refined mesh"] = coarsen_mesh(
                folder / "refined.ply", result.up, "before simplification", is_metric=is_metric
            )
        else:
            refined = stages.read_mesh(folder / "refined.ply").with_(up=result.up)
            filled = read_filled_colormap(folder / "refined.ply", refined)
            models["refined mesh"] = PageModelSource(
                refined, "before simplification", colormaps={} if filled is None else {"filled holes": filled}
            )
        stored = _load_deviations(folder / PICTURES, refined, result)
    away = _FLY_DISTANCE_RATIO * _compute_size(result)
    with convert_parse_errors(folder / REPORT):
        fillings = make_fillings_table(report, rotation, away, is_metric=is_metric)
    if fillings is not None:
        report_data["tables"] = [fillings, *report_data.get("tables", ())]
    max_deviation = None
    if stored is not None:
        bound, proven = _read_bounds(folder / REPORT, report)
        with convert_parse_errors(folder / PICTURES / FIGURES):
            colormaps["deviation"] = make_deviation_colormap(stored, bound, is_metric=is_metric)
            targets = [
                {"target": (rotation @ np.array(one["point_m"])).tolist(), "away": away}
                for one in stored.metrics["worst"]
            ]
            within = None if bound is None else stored.compute_ratio_within(-bound, bound)
            metrics = {**stored.metrics, "tolerance_m": bound, "within_ratio": within}
            error, largest = make_deviation_tables(metrics, proven, targets, is_metric=is_metric)
            report_data["tables"] = [error, largest | {"folded": True}, *report_data.get("tables", ())]
            max_deviation = max((abs(one["distance_m"]) for one in stored.metrics["worst"]), default=0.0)
    with convert_parse_errors(folder / REPORT):
        noise = make_noise_table(report, is_metric=is_metric)
        header = make_run_header(
            folder / name, result, rotation, report, report_data.get("warnings", ()), max_deviation
        )
    report_data["header"] = header
    if noise is not None:
        report_data["tables"] = [noise, *report_data.get("tables", ())]
    coverage = read_coverage(folder, result.up, rotation, is_metric=is_metric)
    if coverage is not None:
        models["coverage"] = coverage.source
        report_data["tables"] = [coverage.table, *report_data.get("tables", ())]
    confidence = make_photo_count_colormap(result, folder / TEXTURE_MAPS)
    if confidence is not None:
        colormaps["confidence"] = confidence
    models = {
        "result": PageModelSource(_add_vertex_colors(folder, result), name, colormaps=colormaps),
        **models,
    }
    cameras = read_cameras(folder / PICTURES, rotation, list_skipped_frames(report))
    return make_packed_page(folder.resolve().name, models, max_bytes, report_data, cameras)


def _load_deviations(pictures: Path, refined: Mesh | None, result: Mesh) -> StoredDeviations | None:
    """Return the deviations of the result, stored or computed."""
    with convert_parse_errors(pictures):
        stored = read_deviations(pictures)
    if stored is not None and _is_same(stored.vertices, result):
        return stored
    if refined is not None:
        return make_stored_deviations(stages.deviations(refined, result, signed_samples=SIGNED_SAMPLES))
    return None if stored is None else _transfer_deviations(stored, result)


def _transfer_deviations(stored: StoredDeviations, result: Mesh) -> StoredDeviations | None:
    """Transfer deviations to the same mesh with reordered vertices.

    Returns None if the mesh differs.
    """
    from scipy.spatial import cKDTree

    away, rows = cKDTree(stored.vertices).query(result.vertices, workers=-1)
    if len(away) == 0 or away.max() > _SAME_VERTEX_RATIO * _compute_size(result):
        return None
    return replace(stored, vertices=result.vertices, at_vertices=stored.at_vertices[rows])


def _read_bounds(path: Path, report: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the requested and the proven shape bound in metres, each or None."""
    asked = get_nested(report, "stages", "simplify", "params", "simplify", "max_shape")
    proven = get_nested(report, "stages", "simplify", "metrics", "details", "shape_bound_m")
    with convert_parse_errors(path):
        return (None if asked is None else float(asked)), (None if proven is None else float(proven))


def _add_vertex_colors(folder: Path, result: Mesh) -> Mesh:
    """Add the vertex colours of simplified.ply to a textured result."""
    simplified_file = folder / "simplified.ply"
    if result.texture is None or result.colors is not None or not simplified_file.is_file():
        return result
    plain = stages.read_mesh(simplified_file)
    return result.with_(colors=plain.colors) if _is_same(plain.vertices, result) else result


def _is_same(vertices: np.ndarray, mesh: Mesh) -> bool:
    if vertices.shape != mesh.vertices.shape or len(vertices) == 0:
        return False
    return bool(np.abs(vertices - mesh.vertices).max() <= _SAME_VERTEX_RATIO * _compute_size(mesh))


def _compute_size(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _read_report(path: Path) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Read report.json and convert it to report data of the page; empty if missing."""
    if not path.is_file():
        return {}, {}
    with convert_parse_errors(path):
        report = dict(read_json(path))  # type: ignore[call-overload]
        return report, summarize_report(report)
