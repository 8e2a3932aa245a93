"""Queues in shared folders: workers refuse content that `scanloom batch` does not write."""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from scanloom.pipeline.batch import job_queue as queues
from scanloom.pipeline.batch.claims import RELEASED, Claim, Claims
from scanloom.pipeline.batch.heartbeat import Heartbeat, HeartbeatObserver
from scanloom.pipeline.batch.job_queue import BatchQueue, BatchSettings, Job, create_queue, read_current_queue
from scanloom.pipeline.batch.job_records import DONE, FAILED, JobRecord, JobRecords
from scanloom.pipeline.batch.summary import summarize_batch
from scanloom.pipeline.batch.worker import Worker
from scanloom.stages.diagnostics.errors import InputError

JOBS = tuple(Job(k, f"../scans/{k}", f"floor/{k}") for k in range(2))


@pytest.fixture
def queue(tmp_path: Path) -> BatchQueue:
    made = create_queue(tmp_path / "out", 1, BatchSettings("", "adjust", take_over_after=0.5), JOBS)
    assert made is not None
    return made


def rewrite_queue(queue: BatchQueue, settings: dict[str, Any], *jobs: dict[str, Any]) -> None:
    """Write a job list with valid digests, as an attacker can."""
    head = {"schema": 2, "scanloom": queue.version, "jobs": 2, **asdict(queue.settings), **settings}
    lines = [head, *({**asdict(job), **changed} for job, changed in zip(JOBS, jobs, strict=False))]
    (queue.folder / "jobs.jsonl").write_text("".join(map(queues._format_line, lines)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": "../../home"}, "outside the output folder"),
        ({"name": "/etc/cron.d"}, "outside the output folder"),
        ({"name": "a/./b"}, "outside the output folder"),
        ({"name": "queue/0001"}, "would replace files of the batch"),
        ({"name": "Cache"}, "would replace files of the batch"),
        ({"name": "FLOOR/0"}, "are those of another job"),
        ({"name": 3}, "not text"),
        ({"scan": "/etc"}, "not a path relative to the output folder"),
        ({"scan": "a/../../x"}, "not a path relative to the output folder"),
        ({"scan": "a\0b"}, "not text"),
    ],
)
def test_a_changed_job_is_refused_and_reported(
    queue: BatchQueue, changed: dict[str, Any], message: str
) -> None:
    rewrite_queue(queue, {}, *(({}, changed) if changed.get("name") == "FLOOR/0" else (changed, {})))
    read = read_current_queue(queue.out)
    assert read is not None
    (number,) = read.damaged
    assert message in read.refusals[number]
    Worker(read, slots=1, threads=1, only=frozenset({number})).run()
    (record,) = [one for one in summarize_batch(read).records if one.number == number]
    assert record.state == FAILED
    assert message in record.reason
    assert [one.code for one in record.diagnostics] == ["batch.queue-refused"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"cache": "../elsewhere"}, r"elsewhere is outside the output folder and has no file CACHEDIR\.TAG"),
        ({"cache": "/tmp"}, "not a path relative"),
        ({"until": "rm"}, "there is no stage 'rm'"),
        ({"until": 3}, "wrong type"),
        ({"force": "fuse"}, "wrong type"),
        ({"force": [["fuse"]]}, "wrong type"),
        ({"config": "[fuse]\nhook = 'sh'\n"}, "its configuration is invalid"),
        ({"config": ["a"]}, "wrong type"),
        ({"overwrite": 1}, "wrong type"),
        ({"timeout": -1}, "not a number of seconds"),
        ({"take_over_after": "1"}, "not a number of seconds"),
        ({"jobs": 10**12}, "the queue is damaged"),
        ({"jobs": True}, "the queue is damaged"),
    ],
)
def test_changed_settings_are_refused(queue: BatchQueue, changed: dict[str, Any], message: str) -> None:
    rewrite_queue(queue, changed, {}, {})
    with pytest.raises(InputError, match=message):
        read_current_queue(queue.out)


def test_a_marked_cache_elsewhere_is_accepted(queue: BatchQueue, tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "CACHEDIR.TAG").write_text("made")
    rewrite_queue(queue, {"cache": "../shared"}, {}, {})
    read = read_current_queue(queue.out)
    assert read is not None
    assert read.cache == tmp_path / "shared"


@pytest.mark.parametrize("name", ["queue", "queue/0001", "queue/0001/done", "queue/0001/jobs.jsonl"])
def test_links_in_the_queue_are_refused(queue: BatchQueue, tmp_path: Path, name: str) -> None:
    path = queue.out / name
    path.rename(tmp_path / "moved")
    path.symlink_to(tmp_path / "moved")
    with pytest.raises(InputError, match="the queue contains a link; if you trust"):
        read_current_queue(queue.out)


def test_no_folder_behind_a_link_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "home" / "2024").mkdir(parents=True)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "queue").symlink_to(tmp_path / "home")
    with pytest.raises(InputError, match="the queue contains a link"):
        create_queue(tmp_path / "out", 3000, BatchSettings(""), JOBS)
    assert (tmp_path / "home" / "2024").is_dir()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
def test_files_of_other_users_are_refused(queue: BatchQueue) -> None:
    os.chown(queue.folder / "jobs.jsonl", 12345, -1)
    with pytest.raises(InputError, match="this file belongs to another user"):
        read_current_queue(queue.out)
    os.chown(queue.out, 12345, -1)
    assert read_current_queue(queue.out) is not None


def test_results_behind_a_link_out_of_the_folder_are_refused(queue: BatchQueue, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (queue.out / "floor").symlink_to(tmp_path / "home")
    Worker(queue, slots=1, threads=1, only=frozenset({0})).run()
    (record, _) = summarize_batch(queue).records
    assert record.state == FAILED
    assert "a link leads from" in record.reason
    assert not list((tmp_path / "home").iterdir())


def test_malformed_claims_are_not_used_as_paths(queue: BatchQueue, tmp_path: Path) -> None:
    folder = queue.folder / "claims"
    for name in ("000000.999999999", "0" * 200 + ".0", "000000.²", "999999999999.0", "000000.-1"):
        (folder / name).write_text("w\n")
    (folder / "000001.3").write_text("../../../home\0\nat \x1b]0;x\x07\nat ../x\nreleased\n")
    claims = Claims(folder, "me")
    assert claims.list_latest() == {1: Claim(1, 3)}
    content = claims.read_claim(Claim(1, 3))
    assert (content.worker, content.stage, content.end) == ("", "", None)

    (tmp_path / "rc").write_text("mine\n")
    (folder / "000000.0").symlink_to(tmp_path / "rc")
    with pytest.raises(OSError, match="symbolic link"):
        claims.record_end(Claim(0, 0), RELEASED)
    os.mkfifo(folder / "000002.0")
    with pytest.raises(OSError, match="No such device"):
        claims.record_end(Claim(2, 0), RELEASED)
    assert (tmp_path / "rc").read_text() == "mine\n"
    assert claims.read_claim(Claim(2, 0)).worker == ""


def test_a_heartbeat_does_not_follow_a_link(tmp_path: Path) -> None:
    (tmp_path / "rc").write_text("mine\n")
    (tmp_path / "w.alive").symlink_to(tmp_path / "rc")
    with pytest.raises(OSError, match="symbolic link"), Heartbeat(tmp_path, "w", 1.0):
        pass
    assert (tmp_path / "rc").read_text() == "mine\n"
    (tmp_path / "v.alive").write_text("one each 1.2.3 s")
    (tmp_path / "u.alive").write_text("one each " + "9" * 400 + " s")
    observer = HeartbeatObserver(tmp_path)
    time.sleep(0.02)
    assert observer.is_dead("v", 0.0) in (True, False)
    assert observer.is_dead("u", 0.0) in (True, False)


@pytest.mark.parametrize(
    "changed",
    [
        {"number": 1},
        {"state": "<script>"},
        {"reason": ["a"]},
        {"seconds": "1"},
        {"metrics": [1]},
        {"diagnostics": [{"code": "a", "severity": "error", "message": 3}]},
    ],
)
def test_a_record_with_values_of_other_types_is_damaged(queue: BatchQueue, changed: dict[str, Any]) -> None:
    records = JobRecords(queue.folder / "done")
    records.write(JobRecord(0, "floor/0", DONE))
    path = queue.folder / "done" / "000000.0.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changed}))
    (record,) = records.read_records([Claim(0, 0)])
    assert (record.state, record.number) == (FAILED, 0)
    assert "is damaged" in record.reason


def test_paths_and_names_in_records_stay_inside_the_output_folder(queue: BatchQueue) -> None:
    metrics = {
        "result": "../../x.glb",
        "page": "javascript:/../alert(1)",
        "picture": 3,
        "triangles": "<b>",
        "layout": "tum",
    }
    JobRecords(queue.folder / "done").write(JobRecord(0, "../..", DONE, metrics=metrics))
    (row, _) = summarize_batch(queue).make_rows()
    assert (row["scan"], row["out"]) == ("floor/0", "floor/0")
    assert (row["result"], row["page"], row["picture"], row["triangles"]) == (None,) * 4
    assert row["layout"] == "tum"
