"""Claims: exactly one worker gets a job, also when several ask at the same time."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims


def _take_claims(folder: Path, worker: str, count: int, taken: multiprocessing.Queue) -> None:  # type: ignore[type-arg]
    claims = Claims(folder, worker)
    taken.put([k for k in range(count) if claims.take(Claim(k, 0))])


def test_each_claim_is_made_by_exactly_one_process(tmp_path: Path):
    context = multiprocessing.get_context("spawn")
    taken = context.Queue()
    words = [(tmp_path, f"w{k}", 300, taken) for k in range(2)]
    workers = [context.Process(target=_take_claims, args=each) for each in words]
    for worker in workers:
        worker.start()
    numbers = [number for _ in workers for number in taken.get(timeout=60)]
    for worker in workers:
        worker.join()
    assert sorted(numbers) == list(range(300))


def test_a_claim_stores_worker_stage_and_end(tmp_path: Path):
    claims = Claims(tmp_path, "me")
    first = Claim(7, 0)
    assert claims.take(first)
    assert not claims.take(first)
    claims.record_stage(first, "fuse")
    claims.record_stage(first, "clean")
    assert (
        claims.read_claim(first).worker,
        claims.read_claim(first).stage,
        claims.read_claim(first).end,
    ) == (
        "me",
        "clean",
        None,
    )
    claims.record_end(first, KILLED)
    assert claims.read_claim(first).end == KILLED
    assert claims.take(first.successor)
    claims.record_end(first.successor, RELEASED)
    assert claims.take(first.successor.successor)
    claims.record_end(first.successor.successor, CRASHED)
    # A released claim does not count as an attempt.
    assert [one.end for one in claims.read_attempts(Claim(7, 2))] == [KILLED, CRASHED]


def test_the_latest_claim_is_found_among_other_files(tmp_path: Path):
    claims = Claims(tmp_path, "me")
    for claim in (Claim(1, 0), Claim(1, 1), Claim(2, 0), Claim(1, 10)):
        assert claims.take(claim)
    for name in (".DS_Store", "000003", "000004.x", ".000001.0.part"):
        (tmp_path / name).write_text("")
    assert claims.list_latest() == {1: Claim(1, 10), 2: Claim(2, 0)}


def test_a_claim_that_cannot_be_written_does_not_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def raise_disk_full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    claims = Claims(tmp_path, "me")
    with monkeypatch.context() as patched:
        patched.setattr("os.write", raise_disk_full)
        with pytest.raises(OSError, match="No space"):
            claims.take(Claim(1, 0))
    assert claims.list_latest() == {}


@pytest.mark.parametrize("content", [b"", b"\xff\xff", b"\n\n"])
def test_an_unreadable_claim_has_no_worker(tmp_path: Path, content: bytes):
    (tmp_path / "000001.0").write_bytes(content)
    assert Claims(tmp_path, "me").read_claim(Claim(1, 0)).worker == ""
