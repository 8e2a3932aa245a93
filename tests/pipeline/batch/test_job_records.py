"""Job records: one for each attempt; the latest finished attempt counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.job_records import DONE, FAILED, JobRecord, JobRecords
from scanloom.stages.diagnostics.codes import MACHINE_BUG

ODD = MACHINE_BUG.warning("odd: {count}", "a.png", remedy="look", count=3).replace_location_fields(
    stage="fuse"
)


def test_a_record_is_read_as_written(tmp_path: Path):
    records = JobRecords(tmp_path)
    record = JobRecord(3, "späße", DONE, "", 1.5, "w", 1, (ODD,), {"frames": 3, "voxel_size_m": None})
    records.write(record)
    assert records.list_ended() == {3: Claim(3, 1)}
    assert records.read_records(records.list_ended().values()) == [record]


def test_the_record_of_the_latest_attempt_counts(tmp_path: Path):
    records = JobRecords(tmp_path)
    # The first attempt ended after the job was taken over.
    for attempt, state in ((1, DONE), (0, FAILED)):
        records.write(JobRecord(3, "a", state, attempt=attempt))
    assert [(one.attempt, one.state) for one in records.read_records(records.list_ended().values())] == [
        (1, DONE)
    ]
    assert len(records.list_finished()) == 2


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"\xff", b'{"number": 1}', b"[" * 100_000])
def test_a_damaged_record_is_a_failed_job(tmp_path: Path, content: bytes):
    (tmp_path / "000003.0.json").write_bytes(content)
    for name in (".000004.0.json.ab.part", "x.json", "000005.json"):
        (tmp_path / name).write_bytes(b"")
    records = JobRecords(tmp_path)
    (record,) = records.read_records(records.list_ended().values())
    assert (record.number, record.state) == (3, FAILED)
    assert record.reason.endswith("000003.0.json is damaged; run the batch again.")
