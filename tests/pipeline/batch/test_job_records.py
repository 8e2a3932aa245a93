"""What became of a job is kept for each try, and the last that came to an end counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.job_records import DONE, FAILED, JobRecord, JobRecords
from scanloom.stages.diagnostics.codes import MACHINE_BUG

ODD = MACHINE_BUG.warning("odd: {count}", "a.png", remedy="look", count=3).replace_location_fields(
    stage="fuse"
)


def test_a_record_is_read_as_it_was_written(tmp_path: Path):
    records = JobRecords(tmp_path)
    record = JobRecord(3, "späße", DONE, "", 1.5, "w", 1, (ODD,), {"frames": 3, "voxel_size_m": None})
    records.write(record)
    assert records.list_ended() == {3: Claim(3, 1)}
    assert records.read_records(records.list_ended().values()) == [record]


def test_of_two_tries_that_which_took_over_counts_and_both_are_known(tmp_path: Path):
    records = JobRecords(tmp_path)
    # The first came to its end when it had lost the job already.
    for attempt, state in ((1, DONE), (0, FAILED)):
        records.write(JobRecord(3, "a", state, attempt=attempt))
    assert [(one.attempt, one.state) for one in records.read_records(records.list_ended().values())] == [
        (1, DONE)
    ]
    assert len(records.list_finished()) == 2


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"\xff", b'{"number": 1}', b"[" * 100_000])
def test_a_damaged_record_says_so(tmp_path: Path, content: bytes):
    (tmp_path / "000003.0.json").write_bytes(content)
    for name in (".000004.0.json.ab.part", "x.json", "000005.json"):
        (tmp_path / name).write_bytes(b"")
    records = JobRecords(tmp_path)
    (record,) = records.read_records(records.list_ended().values())
    assert (record.number, record.state) == (3, FAILED)
    assert record.reason.endswith("000003.0.json is damaged; run the batch again.")
