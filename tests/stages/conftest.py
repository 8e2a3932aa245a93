"""Fixtures that several folders of tests share."""

from pathlib import Path

import pytest
from chunked_sample import fuse_chunked_sample

from scanloom.stages.surface import chunked_mesh


@pytest.fixture(scope="session")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fuse the sample into a chunked PLY file, like a large mesh; tests must not change the file."""
    return fuse_chunked_sample(tmp_path_factory.mktemp("fused") / "fused.ply")


@pytest.fixture
def few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Process chunks in several batches."""
    monkeypatch.setattr(chunked_mesh, "BATCH_TRIANGLES", 800)
