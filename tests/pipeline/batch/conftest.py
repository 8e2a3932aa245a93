from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from small_scans import write_small_scan

from scanloom.pipeline.batch.job_queue import BatchQueue, BatchSettings, create_queue, make_jobs


@pytest.fixture(scope="session")
def small_scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write four small scans, and a fifth that cannot be read."""
    folder = tmp_path_factory.mktemp("many") / "scans"
    for number in range(4):
        write_small_scan(folder / f"scan-{number}", number)
    broken = write_small_scan(folder / "broken", 5)
    (broken / "scan.json").write_text('{"frames": 3')
    return folder


@pytest.fixture
def queue_of(tmp_path: Path) -> Callable[..., BatchQueue]:
    """Return a function that creates a queue for the scans in a folder.

    The stages end with `adjust` by default, which imports little.
    """

    def create_test_queue(
        folder: Path, *, until: str = "adjust", take_over_after: float = 60.0
    ) -> BatchQueue:
        settings = BatchSettings("", until, take_over_after=take_over_after)
        out = tmp_path / "out"
        jobs = make_jobs([(place, place.name) for place in sorted(folder.iterdir())], out)
        queue = create_queue(out, 1, settings, jobs)
        assert queue is not None
        return queue

    return create_test_queue
