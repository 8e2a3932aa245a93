"""Coarse page model of a mesh that exceeds the memory, by vertex clustering."""

from __future__ import annotations

from pathlib import Path

from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.report.page.packing import PageModelSource
from scanloom.stages.surface.vertex_clustering import read_clustered_mesh

# Target vertex count of clustering: ten times more than fits in a page, for the later simplification.
_TARGET_VERTICES = 1_000_000


def coarsen_mesh(path: Path, up: Up | None, note: str, *, is_metric: bool) -> PageModelSource:
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
    found = read_clustered_mesh(path, _TARGET_VERTICES)
    words = f"{found.cell_size:.3g} {'m' if is_metric else 'units'}"
    return PageModelSource(
        found.mesh.with_(up=up),
        f"{note}; clustered in cells of {words}",
        full_triangle_count=found.triangle_count,
    )
