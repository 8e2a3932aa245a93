"""Cleaning piece by piece: what is left is, to the byte, what cleaning the whole leaves."""

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
def test_islands_go_as_from_the_whole(large: Path, params: dict[str, Any], tmp_path: Path) -> None:
    whole = clean(read_ply(large), **params)
    write_ply(tmp_path / "whole.ply", whole.mesh)
    result = tmp_path / "clean.ply"
    with use_small_chunks():
        metrics = clean_chunked(large, result, CleanParams(**params))
    assert result.read_bytes() == (tmp_path / "whole.ply").read_bytes()
    expected = whole.to_dict()
    assert metrics == {name: pytest.approx(expected[name]) for name in metrics}
    assert whole.changes.islands > 5 or params == {"min_island_area": 0.0}
    # And it is in pieces again.
    assert len(ChunkedPly(result)) == len(ChunkedPly(large)) > 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clean.pieces.json", "clean.ply", "whole.ply"]


def test_nothing_left_is_an_error(large: Path, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="nothing is left of it"):
        clean_chunked(large, tmp_path / "clean.ply", CleanParams(min_island_area=1e6))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("params", [{"repair": True}, {"fill_holes": 0.1}, {"weld_distance": 0.001}])
def test_what_takes_the_whole_is_refused(large: Path, params: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=next(iter(params))):
        clean_chunked(large, tmp_path / "clean.ply", CleanParams(**params))
