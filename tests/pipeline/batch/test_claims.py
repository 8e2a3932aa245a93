"""A job is one worker's, whoever asks at the same moment."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims


def _take(folder: Path, worker: str, count: int, taken: multiprocessing.Queue) -> None:  # type: ignore[type-arg]
    claims = Claims(folder, worker)
    taken.put([k for k in range(count) if claims.take(Claim(k, 0))])


def test_each_claim_is_made_once_by_several_processes(tmp_path: Path):
    context = multiprocessing.get_context("spawn")
    taken = context.Queue()
    words = [(tmp_path, f"w{k}", 300, taken) for k in range(2)]
    workers = [context.Process(target=_take, args=each) for each in words]
    for worker in workers:
        worker.start()
    numbers = [number for _ in workers for number in taken.get(timeout=60)]
    for worker in workers:
        worker.join()
    assert sorted(numbers) == list(range(300))


def test_a_claim_says_whose_it_is_and_how_it_ended(tmp_path: Path):
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
    # What was given back was no try.
    assert [one.end for one in claims.read_attempts(Claim(7, 2))] == [KILLED, CRASHED]


def test_the_latest_is_found_among_what_is_no_claim(tmp_path: Path):
    claims = Claims(tmp_path, "me")
    for claim in (Claim(1, 0), Claim(1, 1), Claim(2, 0), Claim(1, 10)):
        assert claims.take(claim)
    for name in (".DS_Store", "000003", "000004.x", ".000001.0.part"):
        (tmp_path / name).write_text("")
    assert claims.list_latest() == {1: Claim(1, 10), 2: Claim(2, 0)}


def test_a_claim_that_cannot_be_signed_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    claims = Claims(tmp_path, "me")
    with monkeypatch.context() as patched:
        patched.setattr("os.write", full)
        with pytest.raises(OSError, match="No space"):
            claims.take(Claim(1, 0))
    assert claims.list_latest() == {}


@pytest.mark.parametrize("content", [b"", b"\xff\xff", b"\n\n"])
def test_what_cannot_be_read_is_nobodys(tmp_path: Path, content: bytes):
    (tmp_path / "000001.0").write_bytes(content)
    assert Claims(tmp_path, "me").read_claim(Claim(1, 0)).worker == ""
