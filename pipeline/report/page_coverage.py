"""Gaps of a scan for the page: a coloured model and a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import COVERAGE, COVERAGE_MESH
from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.report.coarse_model import coarsen_mesh
from scanloom.pipeline.report.page.packing import PageModelSource
from scanloom.pipeline.report.page_cameras import convert_parse_errors
from scanloom.pipeline.report.page_colormaps import make_spread_colormap
from scanloom.stages.files.documents import read_json
from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS
from scanloom.stages.printing import format_position
from scanloom.stages.surface.chunked_ply import exceeds_chunk_limit
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values
from scanloom.stages.surface.formats.ply_format import read_row_count

_MAX_NEAREST_FRAMES = 2


class PageCoverage(NamedTuple):
    """Gaps as shown on the page: a model, and a table for `make_single_file_page`."""

    source: PageModelSource
    table: Mapping[str, Any]


def read_coverage(
    folder: Path, up: Up | None, rotation: NDArray[np.float64], *, is_metric: bool
) -> PageCoverage | None:
    """Read the results of the stage `coverage` from an output folder.

    Returns None if it did not run.

    Parameters
    ----------
    up : up direction of the scan.
    rotation : (3, 3) rotation to the upright frame of the page.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    if not ((folder / COVERAGE_MESH).is_file() and (folder / COVERAGE).is_file()):
        return None
    with convert_parse_errors(folder / COVERAGE):
        document: Any = read_json(folder / COVERAGE)
        rows, places = [], []
        m, m2 = ("m", "m²") if is_metric else ("units", "units²")
        for one in document["places"]:
            target, eye = (rotation @ np.array(one[name], np.float64) for name in ("point_m", "viewpoint_m"))
            nearest = [
                f"{look['frame']} ({look['why']})" for look in one["nearest_frames"][:_MAX_NEAREST_FRAMES]
            ]
            rows.append(
                [
                    str(one["why"]),
                    f"{float(one['area_m2']):.3g} {m2}",
                    format_position(one["point_m"]),
                    format_position(one["viewpoint_m"]),
                    "; ".join(nearest),
                ]
            )
            away = float(np.linalg.norm(eye - target))
            places.append({"target": target.tolist(), "away": away, "eye": eye.tolist()})
    head = [
        "gap",
        "area",
        f"location in scan coordinates, {m}",
        f"suggested viewpoint, {m}",
        "nearest frames",
        "",
    ]
    table = {"title": "Gaps to capture again", "head": head, "rows": rows, "places": places}
    if exceeds_chunk_limit(read_row_count(folder / COVERAGE_MESH, "face")):
        return PageCoverage(
            coarsen_mesh(
                folder / COVERAGE_MESH, up, _describe_colors(document["places"]), is_metric=is_metric
            ),
            table,
        )
    mesh = read_ply(folder / COVERAGE_MESH).with_(up=up)
    spread, frames = (read_vertex_values(folder / COVERAGE_MESH, name) for name in ("spread", "frames"))
    colormaps = {}
    if spread is not None and frames is not None:
        colormaps["spread"] = make_spread_colormap(
            mesh, np.where(frames > 0, spread, np.nan), is_metric=is_metric
        )
    return PageCoverage(
        PageModelSource(mesh, _describe_colors(document["places"]), colormaps=colormaps), table
    )


def _describe_colors(places: Any) -> str:
    """Describe the colours that occur."""
    names = {one["kind"] for one in places}
    told = [f"{kind.color_name} {kind.description}" for name, kind in DEFECT_KINDS.items() if name in names]
    return "; ".join(["grey is well observed", *told])
