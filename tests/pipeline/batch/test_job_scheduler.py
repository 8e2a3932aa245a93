"""Order of jobs: unclaimed jobs, then jobs of dead workers; and jobs that fail for good."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims
from scanloom.pipeline.batch.heartbeat import HeartbeatObserver
from scanloom.pipeline.batch.job_queue import BatchQueue, BatchSettings, Job, create_queue
from scanloom.pipeline.batch.job_records import DONE, FAILED, JobRecord, JobRecords
from scanloom.pipeline.batch.job_scheduler import JobScheduler


class FakeClock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def queue(tmp_path: Path) -> BatchQueue:
    return create_numbered_queue(tmp_path, 4)


def create_numbered_queue(out: Path, count: int) -> BatchQueue:
    queue = create_queue(
        out, 1, BatchSettings("", take_over_after=0.0), [Job(k, str(k), str(k)) for k in range(count)]
    )
    assert queue is not None
    return queue


def make_claims(queue: BatchQueue, worker: str) -> Claims:
    return Claims(queue.folder / "claims", worker)


def make_scheduler(
    queue: BatchQueue, worker: str = "me", clock: FakeClock | None = None, patience: float = 60.0
) -> JobScheduler:
    watch = HeartbeatObserver(queue.folder / "workers", clock or FakeClock())
    supply = JobScheduler(
        queue, make_claims(queue, worker), JobRecords(queue.folder / "done"), watch, patience
    )
    supply._pause = 0.0
    return supply


def take_all(supply: JobScheduler) -> list[Claim]:
    return list(iter(supply.take_next, None))


def list_first_claims(numbers: Iterable[int]) -> list[Claim]:
    return [Claim(number, 0) for number in numbers]


def record_job_end(queue: BatchQueue, claim: Claim) -> None:
    JobRecords(queue.folder / "done").write(JobRecord(claim.number, "x", DONE, attempt=claim.attempt))


def test_two_workers_share_all_jobs_and_both_see_the_end(queue: BatchQueue):
    one, other = make_scheduler(queue, "one"), make_scheduler(queue, "other")
    alternating = [supply.take_next() for _ in range(2) for supply in (one, other)]
    assert alternating == list_first_claims(range(4))
    assert not one.is_finished()
    for claim, supply in zip(alternating, [one, other] * 2, strict=True):
        assert claim is not None
        record_job_end(queue, claim)
        supply.record_end(claim.number)
    assert one.take_next() is None
    assert one.is_finished()
    assert one.count_ended() == (4, 4)


def test_jobs_of_other_workers_cannot_be_taken(queue: BatchQueue):
    one, other = make_scheduler(queue, "one"), make_scheduler(queue, "other")
    assert one.has_more()
    assert take_all(other) == list_first_claims(range(4))
    assert one.take_next() is None
    assert not one.has_more()
    assert not one.is_finished()


def test_jobs_of_a_dead_worker_are_taken_over_once(queue: BatchQueue):
    clock = FakeClock()
    dead = make_claims(queue, "dead")
    assert all(dead.take(claim) for claim in list_first_claims(range(3)))
    record_job_end(queue, Claim(0, 0))
    (queue.folder / "workers" / "dead.alive").write_text("000000000001 beats, one each 00002.000 s\n")
    one, other = make_scheduler(queue, "one", clock), make_scheduler(queue, "other", clock)
    assert take_all(one) == list_first_claims([3])
    assert take_all(other) == []
    clock.now += 61
    for worker in ("one", "other"):
        (queue.folder / "workers" / f"{worker}.alive").write_text(
            "000000000009 beats, one each 00002.000 s\n"
        )
    first = one.take_next()
    assert first == Claim(1, 1)
    assert take_all(other) == [Claim(2, 1)]
    assert take_all(one) == []


def test_a_living_worker_keeps_its_jobs(queue: BatchQueue):
    clock = FakeClock()
    assert all(make_claims(queue, "slow").take(claim) for claim in list_first_claims(range(4)))
    supply = make_scheduler(queue, "me", clock)
    for count in range(10):
        (queue.folder / "workers" / "slow.alive").write_text(f"{count:012d} beats, one each 00002.000 s\n")
        assert supply.take_next() is None
        clock.now += 50


def test_a_released_job_is_taken_at_once(queue: BatchQueue):
    claims = make_claims(queue, "gone")
    assert all(claims.take(claim) for claim in list_first_claims(range(4)))
    claims.record_end(Claim(2, 0), RELEASED)
    assert make_scheduler(queue).take_next() == Claim(2, 1)


def test_jobs_of_an_ended_worker_are_taken_at_once(queue: BatchQueue):
    assert make_claims(queue, "gone").take(Claim(0, 0))
    (queue.folder / "workers" / "gone.alive").write_text("ended\n")
    assert take_all(make_scheduler(queue)) == [*list_first_claims([1, 2, 3]), Claim(0, 1)]


def test_a_claim_without_worker_expires(queue: BatchQueue):
    clock = FakeClock()
    (queue.folder / "claims" / "000000.0").write_text("")
    supply = make_scheduler(queue, "me", clock)
    assert take_all(supply) == list_first_claims([1, 2, 3])
    clock.now += 30
    assert supply.take_next() is None
    clock.now += 31
    assert supply.take_next() == Claim(0, 1)


def test_a_lost_claim_is_made_again(queue: BatchQueue):
    supply = make_scheduler(queue)
    other = make_scheduler(queue, "other")
    assert take_all(other) == list_first_claims(range(4))
    (queue.folder / "claims" / "000002.0").unlink()
    assert supply.take_next() == Claim(2, 0)


@pytest.mark.parametrize(("how", "most"), [(KILLED, 6), (CRASHED, 2)])
def test_a_job_that_kills_its_process_is_given_up(tmp_path: Path, how: str, most: int):
    queue = create_numbered_queue(tmp_path, 1)
    claims, supply = make_claims(queue, "me"), make_scheduler(queue)
    tries = 0
    while (claim := supply.take_next()) is not None:
        tries += 1
        claims.record_stage(claim, "fuse")
        claims.record_end(claim, how)
        supply.schedule_retry(claim)
    assert tries == most
    (record,) = supply.pop_given_up()
    assert record.state == FAILED
    assert "in fuse" in record.reason
    assert supply.is_finished()


def test_a_job_that_progresses_between_kills_is_not_given_up(tmp_path: Path):
    queue = create_numbered_queue(tmp_path, 1)
    claims, supply = make_claims(queue, "me"), make_scheduler(queue)
    for count in range(20):
        claim = supply.take_next()
        assert claim is not None
        claims.record_stage(claim, f"stage {count // 4}")
        claims.record_end(claim, KILLED)
        supply.schedule_retry(claim)


def test_taking_a_claim_from_thousands_takes_under_a_millisecond(tmp_path: Path):
    queue = create_numbered_queue(tmp_path, 3000)
    started = time.process_time()
    supply = make_scheduler(queue)
    assert sum(1 for _ in zip(range(3000), iter(supply.take_next, None), strict=False)) == 3000
    assert (time.process_time() - started) / 3000 < 1e-3
