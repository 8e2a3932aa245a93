"""Cleaning a chunked mesh gives the same bytes as cleaning the mesh in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from chunked_sample import use_small_chunks

from scanloom.stages.cleaning.chunked_clean import clean_chunked
from scanloom.stages.cleaning.clean import CleanParams, clean
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.surface.chunked_ply import ChunkedPly
from scanloom.stages.surface.formats.ply import read_ply, write_ply


@pytest.mark.parametrize(
    "params", [{}, {"keep_largest": True}, {"min_island_area": 0.0}, {"min_island_area": 0.01}]
)
def test_islands_are_removed_like_in_memory(large: Path, params: dict[str, Any], tmp_path: Path) -> None:
    whole = clean(read_ply(large), **params)
    write_ply(tmp_path / "whole.ply", whole.mesh)
    result = tmp_path / "clean.ply"
    with use_small_chunks():
        metrics = clean_chunked(large, result, CleanParams(**params))
    assert result.read_bytes() == (tmp_path / "whole.ply").read_bytes()
    expected = whole.to_dict()
    assert metrics == {name: pytest.approx(expected[name]) for name in metrics}
    assert whole.changes.islands > 5 or params == {"min_island_area": 0.0}
    # The result is chunked, too.
    assert len(ChunkedPly(result)) == len(ChunkedPly(large)) > 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clean.pieces.json", "clean.ply", "whole.ply"]


def test_an_empty_result_is_an_error(large: Path, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="nothing is left of it"):
        clean_chunked(large, tmp_path / "clean.ply", CleanParams(min_island_area=1e6))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("params", [{"repair": True}, {"fill_holes": 0.1}, {"weld_distance": 0.001}])
def test_operations_on_the_whole_mesh_are_refused(
    large: Path, params: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=next(iter(params))):
        clean_chunked(large, tmp_path / "clean.ply", CleanParams(**params))
