"""Check that two meshes overlap."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages import Mesh
from scanloom.stages.comparing.codes import COMPARE_MESHES_APART
from scanloom.stages.comparing.comparison_inputs import measure_unrelated_gap
from scanloom.stages.diagnostics.collector import emit


def require_overlap(file: Path, mesh: Mesh, other_file: Path, other: Mesh) -> None:
    """Report meshes that should overlap but do not; the exit code is then 1."""
    gap = measure_unrelated_gap(mesh, other)
    if gap is not None:
        emit(
            COMPARE_MESHES_APART.unmet(
                "is {gap:.3g} m from {other_file}, which is more than their size",
                file,
                remedy="give meshes of the same object, in the same coordinates and unit.",
                gap=gap,
                other_file=other_file,
            )
        )
