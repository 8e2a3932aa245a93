"""A mesh too large for memory, as a page shows it: what lies in a cell of a grid as one."""

from __future__ import annotations

from pathlib import Path

from scanloom.pipeline.artifacts.up_direction import Up
from scanloom.pipeline.report.page.packing import Shown
from scanloom.stages.surface.vertex_clustering import clustered

# A page has room for a tenth of that, which are chosen with care.
_VERTICES = 1_000_000


def coarsely(path: Path, up: Up | None, note: str, *, is_metric: bool) -> Shown:
    """Return what a page shows of a mesh in pieces.

    Parameters
    ----------
    note : a few words of what it is, before those of how it is shown.
    is_metric : lengths are metres, else units of the scan.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    found = clustered(path, _VERTICES)
    words = f"{found.cell:.3g} {'m' if is_metric else 'units'}"
    return Shown(
        found.mesh.with_(up=up), f"{note}; each cell of {words} as one", complete=found.triangle_count
    )
