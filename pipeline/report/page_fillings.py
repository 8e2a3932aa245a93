"""Filled holes for the page: a colormap of the refined mesh and a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import FILLED_PROPERTY
from scanloom.pipeline.evaluation.filled_surface import FILLED_COLORS
from scanloom.pipeline.report.page.packing import VertexColormap
from scanloom.pipeline.report.page.single_file_page import PageScale
from scanloom.pipeline.report.report_summary import get_nested
from scanloom.stages.printing import format_position
from scanloom.stages.surface.formats.ply import read_vertex_values
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas

# Smaller lengths and areas are given in millimetres and square millimetres.
_MIN_METRES, _MIN_SQUARE_METRES = 0.1, 0.001


def read_filled_colormap(path: Path, mesh: Mesh) -> VertexColormap | None:
    """Make the colormap that marks filled holes; None without filled holes.

    Parameters
    ----------
    path : file of the refined mesh, with the vertex property `filled`.
    mesh : the mesh in this file.
    """
    filled = read_vertex_values(path, FILLED_PROPERTY)
    if filled is None or len(filled) != len(mesh.vertices) or not (filled > 0).any():
        return None
    areas = compute_areas(mesh.vertices, mesh.triangles)
    is_marked = (filled > 0)[mesh.triangles].any(axis=1)
    ratio = float(areas[is_marked].sum() / max(areas.sum(), np.finfo(np.float64).tiny))
    scale = PageScale(
        unit="1: filled",
        low=-0.5,
        high=1.5,
        within=None,
        colors=[f"rgb({r}, {g}, {b})" for r, g, b in FILLED_COLORS],
        shares=[round(1 - ratio, 5), round(ratio, 5)],
        marks=[0.0, 1.0],
    )
    return VertexColormap(np.minimum(filled, 1.0), scale, "holes that refine filled, in the refined mesh")


def make_fillings_table(
    report: Mapping[str, Any], rotation: NDArray[np.float64], away: float, *, is_metric: bool
) -> dict[str, Any] | None:
    """Make the table of the largest filled holes; None without filled holes.

    Parameters
    ----------
    report : content of report.json.
    rotation : (3, 3) rotation to the upright frame of the page.
    away : camera distance after flying to a filling, metres.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    metrics = get_nested(report, "stages", "refine", "metrics", default={})
    fillings = metrics.get("largest_fillings", [])
    if not fillings:
        return None
    m = "m" if is_metric else "units"
    area = _format_area(float(metrics["filled_area_m2"]), is_metric=is_metric)
    return {
        "title": f"Filled holes: {int(metrics['filled_holes']):,}, {area} in total; the largest ones",
        "head": ["area", "border", f"location in scan coordinates, {m}", ""],
        "rows": [
            [
                _format_area(float(one["area_m2"]), is_metric=is_metric),
                _format_length(float(one["border_m"]), is_metric=is_metric),
                format_position(one["point_m"]),
            ]
            for one in fillings
        ],
        "places": [
            {"target": (rotation @ np.array(one["point_m"], np.float64)).tolist(), "away": away}
            for one in fillings
        ],
        "folded": True,
    }


def _format_area(area: float, *, is_metric: bool) -> str:
    if not is_metric:
        return f"{area:.3g} units²"
    return f"{area:.3g} m²" if area >= _MIN_SQUARE_METRES else f"{1e6 * area:,.3g} mm²"


def _format_length(length: float, *, is_metric: bool) -> str:
    if not is_metric:
        return f"{length:.3g} units"
    return f"{length:.3g} m" if length >= _MIN_METRES else f"{1e3 * length:.3g} mm"
