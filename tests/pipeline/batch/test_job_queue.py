"""Job queue: written atomically, validated when read, and created by one batch only."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest

from scanloom.pipeline.batch import job_queue as queues
from scanloom.pipeline.batch.job_queue import (
    BatchQueue,
    BatchSettings,
    Job,
    create_queue,
    find_latest_number,
    make_jobs,
    read_current_queue,
)
from scanloom.stages.diagnostics.errors import InputError, StageError

SETTINGS = BatchSettings(config="[fuse]\n", until="clean", force=("fuse",), cache="cache")
JOBS = tuple(Job(k, f"../scans/{k}", f"floor/{k}") for k in range(5))


@pytest.fixture
def written(tmp_path: Path) -> BatchQueue:
    queue = create_queue(tmp_path / "out", 1, SETTINGS, JOBS)
    assert queue is not None
    return queue


def test_a_queue_is_read_as_written(written: BatchQueue):
    read = read_current_queue(written.out)
    assert read == written
    assert read.matches(SETTINGS, JOBS)
    assert not read.matches(SETTINGS, JOBS[:4])
    assert read.get_scan_path(JOBS[2]) == written.out.parent / "scans" / "2"
    assert read.get_output_folder(JOBS[2]) == written.out / "floor" / "2"
    assert read.cache == written.out / "cache"


def test_a_missing_queue_is_none(tmp_path: Path):
    assert read_current_queue(tmp_path) is None


def test_the_next_queue_replaces_the_previous_one(written: BatchQueue):
    following = create_queue(written.out, 2, SETTINGS, JOBS[:2])
    assert read_current_queue(written.out) == following
    assert not written.folder.exists()


def test_damaged_lines_are_listed(written: BatchQueue):
    path = written.folder / "jobs.jsonl"
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace("scans/1", "scans/7")
    lines[4] = lines[4][:20]
    path.write_text("\n".join(lines) + "\n")
    read = read_current_queue(written.out)
    assert read is not None
    assert read.damaged == (1, 3)
    assert [job.number for job in read.jobs] == [0, 2, 4]
    assert read.numbers == [0, 1, 2, 3, 4]
    assert not read.matches(SETTINGS, JOBS)


def test_a_truncated_queue_counts_its_missing_jobs(written: BatchQueue):
    path = written.folder / "jobs.jsonl"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    read = read_current_queue(written.out)
    assert read is not None
    assert len(read.jobs) + len(read.damaged) == 5
    assert read.damaged


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"check": 1}\n', b"[" * 100_000])
def test_a_damaged_header_is_one_error(written: BatchQueue, content: bytes):
    (written.folder / "jobs.jsonl").write_bytes(content)
    with pytest.raises(InputError, match=r"jobs\.jsonl: the queue is damaged.*run `scanloom batch` again"):
        read_current_queue(written.out)


def test_a_job_name_outside_the_output_folder_is_damaged(written: BatchQueue):
    path = written.folder / "jobs.jsonl"
    head = path.read_text().splitlines()[0]
    values = {"number": 0, "scan": "x", "name": "../../etc"}
    path.write_text(f"{head}\n{queues._format_line(values)}")
    read = read_current_queue(written.out)
    assert read is not None
    assert read.damaged == (0, 1, 2, 3, 4)


def test_only_one_of_several_batches_creates_the_queue(tmp_path: Path):
    made: list[BatchQueue | None] = []
    together = threading.Barrier(8)

    latest = find_latest_number(tmp_path)

    def begin() -> None:
        together.wait()
        made.append(create_queue(tmp_path, latest + 1, SETTINGS, JOBS))

    threads = [threading.Thread(target=begin) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (first,) = [one for one in made if one is not None]
    assert read_current_queue(tmp_path) == first


def test_an_unfinished_queue_is_skipped(written: BatchQueue, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(queues, "_WRITE_TIMEOUT", 0.05)
    (written.folder.parent / "0002").mkdir()
    assert read_current_queue(written.out) == written
    assert find_latest_number(written.out) == 2
    assert create_queue(written.out, 2, SETTINGS, JOBS) is None
    assert create_queue(written.out, 3, SETTINGS, JOBS) is not None


def test_a_write_error_is_reported(tmp_path: Path):
    (tmp_path / "queue").write_text("mine")
    with pytest.raises(StageError, match=r"the queue in .*queue cannot be written: "):
        create_queue(tmp_path, 1, SETTINGS, JOBS)


def test_reserved_and_repeated_names_get_a_suffix(tmp_path: Path):
    names = ["cache", "Queue/a", "index.html", "a/b", "A/B", "a/b_", "plain"]
    jobs = make_jobs([(tmp_path / name, name) for name in names], tmp_path / "out")
    assert [job.name for job in jobs] == [
        "cache_",
        "Queue_/a",
        "index.html_",
        "a/b",
        "A/B_",
        "a/b__",
        "plain",
    ]
    assert jobs[3].scan == "../a/b"
    json.dumps([job.name for job in jobs])
