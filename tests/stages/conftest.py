"""Fixtures that several rooms' tests share."""

from pathlib import Path

import pytest
from chunked_sample import fuse_chunked_sample

from scanloom.stages.surface import chunked_mesh


@pytest.fixture(scope="session")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's mesh in a file in pieces, as if it were large; tests leave it as it is."""
    return fuse_chunked_sample(tmp_path_factory.mktemp("fused") / "fused.ply")


@pytest.fixture
def few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let some pieces be worked on in several steps."""
    monkeypatch.setattr(chunked_mesh, "BATCH_TRIANGLES", 800)
