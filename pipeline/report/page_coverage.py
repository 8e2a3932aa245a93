"""Gaps of a scan for the page: a coloured model and a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import COVERAGE, COVERAGE_MESH
from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.report.page.packing import Shown
from scanloom.pipeline.report.page_cameras import as_runs_write
from scanloom.pipeline.report.page_coarse import coarsely
from scanloom.pipeline.report.page_paints import spread_paint
from scanloom.stages.files.documents import read_json
from scanloom.stages.inspecting.coverage.kinds import KINDS
from scanloom.stages.printing import place_in_words
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values
from scanloom.stages.surface.formats.ply_format import promised
from scanloom.stages.surface.pieces import is_many

_NEAREST = 2


class Missing(NamedTuple):
    """Gaps as shown on the page: a model, and a table for `one_file`."""

    shown: Shown
    table: Mapping[str, Any]


def missing_of(folder: Path, up: Up | None, turn: NDArray[np.float64], *, is_metric: bool) -> Missing | None:
    """Read the results of the stage `coverage` from an output folder.

    Returns None if it did not run.

    Parameters
    ----------
    up : up direction of the scan.
    turn : (3, 3) rotation to the upright frame of the page.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    if not ((folder / COVERAGE_MESH).is_file() and (folder / COVERAGE).is_file()):
        return None
    with as_runs_write(folder / COVERAGE):
        told: Any = read_json(folder / COVERAGE)
        rows, places = [], []
        m, m2 = ("m", "m²") if is_metric else ("units", "units²")
        for one in told["places"]:
            target, eye = (turn @ np.array(one[name], np.float64) for name in ("point_m", "look_from_m"))
            nearest = [f"{look['frame']} ({look['why']})" for look in one["nearest_frames"][:_NEAREST]]
            rows.append(
                [
                    str(one["why"]),
                    f"{float(one['area_m2']):.3g} {m2}",
                    place_in_words(one["point_m"]),
                    place_in_words(one["look_from_m"]),
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
    if is_many(promised(folder / COVERAGE_MESH, "face")):
        return Missing(
            coarsely(folder / COVERAGE_MESH, up, _in_words(told["places"]), is_metric=is_metric), table
        )
    mesh = read_ply(folder / COVERAGE_MESH).with_(up=up)
    spread, frames = (read_vertex_values(folder / COVERAGE_MESH, name) for name in ("spread", "frames"))
    paints = {}
    if spread is not None and frames is not None:
        paints["spread"] = spread_paint(mesh, np.where(frames > 0, spread, np.nan), is_metric=is_metric)
    return Missing(Shown(mesh, _in_words(told["places"]), paints=paints), table)


def _in_words(places: Any) -> str:
    """Describe the colours that occur."""
    names = {one["kind"] for one in places}
    told = [f"{kind.word} {kind.text}" for name, kind in KINDS.items() if name in names]
    return "; ".join(["grey is well observed", *told])
