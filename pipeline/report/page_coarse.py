"""Coarse page model of a mesh that exceeds the memory, by vertex clustering."""

from __future__ import annotations

from pathlib import Path

from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.report.page.packing import Shown
from scanloom.stages.surface.vertex_clustering import clustered

# Target vertex count of clustering: ten times more than fits in a page, for the later simplification.
_VERTICES = 1_000_000


def coarsely(path: Path, up: Up | None, note: str, *, is_metric: bool) -> Shown:
    """Coarsen a chunked mesh for a page.

    Parameters
    ----------
    path : chunked PLY file.
    up : up direction of the scan.
    note : short description of the mesh, shown before the cell size.
    is_metric : True if lengths are in metres; False if in units of the scan.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    found = clustered(path, _VERTICES)
    words = f"{found.cell:.3g} {'m' if is_metric else 'units'}"
    return Shown(
        found.mesh.with_(up=up),
        f"{note}; clustered in cells of {words}",
        complete=found.triangle_count,
    )
