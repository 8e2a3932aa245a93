"""Files with the deviation of the result from the refined mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.pipeline.evaluation.codes import REPORT_INCOMPLETE
from scanloom.stages.comparing.deviations import Deviations
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_json
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values, write_ply
from scanloom.stages.surface.raycasting import Floats

MESH_FILE, FIGURES = "deviation.ply", "deviation.json"
# Vertex property with the deviation in metres.
VERTEX_PROPERTY = "deviation"
# Number of quantile steps of the stored distribution.
_QUANTILE_STEPS = 2000


@dataclass(frozen=True, eq=False)
class StoredDeviations:
    """Deviations as stored in the report.

    Attributes
    ----------
    metrics : metrics of `scanloom.Deviations`, without a tolerance.
    quantiles : (_STEPS + 1,) quantiles of the deviation over the surface, in metres, ascending and at equal
        probability steps.
    vertices : (n, 3) vertices of the measured mesh.
    at_vertices : (n,) deviations at the vertices, in metres.
    """

    metrics: Mapping[str, Any]
    quantiles: Floats
    vertices: Floats
    at_vertices: Floats

    def compute_ratio_within(self, low: float, high: float) -> float:
        """Return the ratio of the surface with a deviation between two values in metres."""
        below = np.interp([low, high], self.quantiles, np.linspace(0, 1, len(self.quantiles)))
        return float(below[1] - below[0])


def make_stored_deviations(deviations: Deviations) -> StoredDeviations:
    """Convert deviations to their stored form."""
    quantiles = np.quantile(deviations.sample_distances, np.linspace(0, 1, _QUANTILE_STEPS + 1))
    return StoredDeviations(
        deviations.to_dict(), quantiles, deviations.painted_mesh.vertices, deviations.vertex_distances
    )


def write_deviations(folder: Path, deviations: Deviations) -> dict[str, Any]:
    """Write the mesh coloured by deviation and the metrics, and return the metrics."""
    stored = make_stored_deviations(deviations)
    write_ply(
        folder / MESH_FILE,
        deviations.painted_mesh,
        vertex_values={VERTEX_PROPERTY: stored.at_vertices.astype(np.float32)},
    )
    document = {"metrics": stored.metrics, "quantiles_m": stored.quantiles.tolist()}
    (folder / FIGURES).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return dict(stored.metrics)


def read_deviations(folder: Path) -> StoredDeviations | None:
    """Read the files of `write_deviations`; None if the folder has none.

    Raises
    ------
    InputError
        If the files are damaged.
    """
    if not ((folder / FIGURES).is_file() and (folder / MESH_FILE).is_file()):
        return None
    document: Any = read_json(folder / FIGURES)
    mesh, values = read_ply(folder / MESH_FILE), read_vertex_values(folder / MESH_FILE, VERTEX_PROPERTY)
    quantiles = np.array(document["quantiles_m"], np.float64)
    if values is None or not np.isfinite(values).all():
        raise InputError(
            REPORT_INCOMPLETE,
            "its vertices have no property `{property}` with finite values.",
            folder / MESH_FILE,
            property=VERTEX_PROPERTY,
        )
    if quantiles.shape != (_QUANTILE_STEPS + 1,) or not (np.diff(quantiles) >= 0).all():
        raise ValueError(quantiles.shape)
    return StoredDeviations(document["metrics"], quantiles, mesh.vertices, values)
