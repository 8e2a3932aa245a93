"""Check that two meshes overlap."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages import Mesh
from scanloom.stages.comparing.codes import COMPARE_MESHES_APART
from scanloom.stages.comparing.measurable import gap_of_unrelated
from scanloom.stages.diagnostics.collector import emit


def require_overlap(file: Path, mesh: Mesh, other_file: Path, other: Mesh) -> None:
    """Report meshes that should overlap but do not; the exit code is then 1."""
    gap = gap_of_unrelated(mesh, other)
    if gap is not None:
        emit(
            COMPARE_MESHES_APART.unmet(
                "lies {gap:.3g} m from {other_file}, which is more than their size",
                file,
                remedy="give meshes of one thing, in the same world and unit.",
                gap=gap,
                other_file=other_file,
            )
        )
