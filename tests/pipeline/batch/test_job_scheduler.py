"""Which job comes next: what nobody has, then what the dead had, and what is given up."""

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


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def queue(tmp_path: Path) -> BatchQueue:
    return made(tmp_path, 4)


def made(out: Path, count: int) -> BatchQueue:
    queue = create_queue(
        out, 1, BatchSettings("", take_over_after=0.0), [Job(k, str(k), str(k)) for k in range(count)]
    )
    assert queue is not None
    return queue


def claims_of(queue: BatchQueue, worker: str) -> Claims:
    return Claims(queue.folder / "claims", worker)


def supply_of(
    queue: BatchQueue, worker: str = "me", clock: Clock | None = None, patience: float = 60.0
) -> JobScheduler:
    watch = HeartbeatObserver(queue.folder / "workers", clock or Clock())
    supply = JobScheduler(queue, claims_of(queue, worker), JobRecords(queue.folder / "done"), watch, patience)
    supply._pause = 0.0
    return supply


def taken(supply: JobScheduler) -> list[Claim]:
    return list(iter(supply.take_next, None))


def firsts(numbers: Iterable[int]) -> list[Claim]:
    return [Claim(number, 0) for number in numbers]


def end(queue: BatchQueue, claim: Claim) -> None:
    JobRecords(queue.folder / "done").write(JobRecord(claim.number, "x", DONE, attempt=claim.attempt))


def test_two_workers_share_all_jobs_and_both_see_the_end(queue: BatchQueue):
    one, other = supply_of(queue, "one"), supply_of(queue, "other")
    alternating = [supply.take_next() for _ in range(2) for supply in (one, other)]
    assert alternating == firsts(range(4))
    assert not one.is_finished()
    for claim, supply in zip(alternating, [one, other] * 2, strict=True):
        assert claim is not None
        end(queue, claim)
        supply.record_end(claim.number)
    assert one.take_next() is None
    assert one.is_finished()
    assert one.count_ended() == (4, 4)


def test_what_can_be_taken_is_told_from_what_others_have(queue: BatchQueue):
    one, other = supply_of(queue, "one"), supply_of(queue, "other")
    assert one.has_more()
    assert taken(other) == firsts(range(4))
    assert one.take_next() is None
    assert not one.has_more()
    assert not one.is_finished()


def test_the_dead_lose_their_jobs_to_one_worker(queue: BatchQueue):
    clock = Clock()
    dead = claims_of(queue, "dead")
    assert all(dead.take(claim) for claim in firsts(range(3)))
    end(queue, Claim(0, 0))
    (queue.folder / "workers" / "dead.alive").write_text("000000000001 beats, one each 00002.000 s\n")
    one, other = supply_of(queue, "one", clock), supply_of(queue, "other", clock)
    assert taken(one) == firsts([3])
    assert taken(other) == []
    clock.now += 61
    for worker in ("one", "other"):
        (queue.folder / "workers" / f"{worker}.alive").write_text(
            "000000000009 beats, one each 00002.000 s\n"
        )
    first = one.take_next()
    assert first == Claim(1, 1)
    assert taken(other) == [Claim(2, 1)]
    assert taken(one) == []


def test_the_living_keep_theirs(queue: BatchQueue):
    clock = Clock()
    assert all(claims_of(queue, "slow").take(claim) for claim in firsts(range(4)))
    supply = supply_of(queue, "me", clock)
    for count in range(10):
        (queue.folder / "workers" / "slow.alive").write_text(f"{count:012d} beats, one each 00002.000 s\n")
        assert supply.take_next() is None
        clock.now += 50


def test_what_is_given_back_is_taken_at_once(queue: BatchQueue):
    claims = claims_of(queue, "gone")
    assert all(claims.take(claim) for claim in firsts(range(4)))
    claims.record_end(Claim(2, 0), RELEASED)
    assert supply_of(queue).take_next() == Claim(2, 1)


def test_a_worker_that_said_it_ended_is_not_waited_for(queue: BatchQueue):
    assert claims_of(queue, "gone").take(Claim(0, 0))
    (queue.folder / "workers" / "gone.alive").write_text("ended\n")
    assert taken(supply_of(queue)) == [*firsts([1, 2, 3]), Claim(0, 1)]


def test_a_claim_without_a_name_is_watched_itself(queue: BatchQueue):
    clock = Clock()
    (queue.folder / "claims" / "000000.0").write_text("")
    supply = supply_of(queue, "me", clock)
    assert taken(supply) == firsts([1, 2, 3])
    clock.now += 30
    assert supply.take_next() is None
    clock.now += 31
    assert supply.take_next() == Claim(0, 1)


def test_a_claim_that_is_lost_is_made_again(queue: BatchQueue):
    supply = supply_of(queue)
    other = supply_of(queue, "other")
    assert taken(other) == firsts(range(4))
    (queue.folder / "claims" / "000002.0").unlink()
    assert supply.take_next() == Claim(2, 0)


@pytest.mark.parametrize(("how", "most"), [(KILLED, 6), (CRASHED, 2)])
def test_a_job_that_takes_its_process_along_is_given_up(tmp_path: Path, how: str, most: int):
    queue = made(tmp_path, 1)
    claims, supply = claims_of(queue, "me"), supply_of(queue)
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


def test_a_job_that_gets_on_between_kills_is_not_given_up(tmp_path: Path):
    queue = made(tmp_path, 1)
    claims, supply = claims_of(queue, "me"), supply_of(queue)
    for count in range(20):
        claim = supply.take_next()
        assert claim is not None
        claims.record_stage(claim, f"stage {count // 4}")
        claims.record_end(claim, KILLED)
        supply.schedule_retry(claim)


def test_a_claim_costs_less_than_a_millisecond_however_many_there_are(tmp_path: Path):
    queue = made(tmp_path, 3000)
    started = time.process_time()
    supply = supply_of(queue)
    assert sum(1 for _ in zip(range(3000), iter(supply.take_next, None), strict=False)) == 3000
    assert (time.process_time() - started) / 3000 < 1e-3
