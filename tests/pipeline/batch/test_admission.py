"""Admission control: jobs run concurrently as far as their expected memory fits."""

from __future__ import annotations

from scanloom.pipeline.batch.admission import AdmissionControl, JobNeeds
from scanloom.pipeline.batch.job_concurrency import compute_concurrency


def pop_names(admission: AdmissionControl[str]) -> list[str]:
    return [who for who, _ in admission.pop_admissible()]


def test_jobs_wait_until_memory_is_available():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who, memory in (("a", 6), ("b", 4), ("c", 3)):
        admission.enqueue(who, JobNeeds(memory, 0))
    assert pop_names(admission) == ["a", "b"]
    admission.remove_job("b", 0)
    assert pop_names(admission) == ["c"]


def test_a_job_above_the_limit_runs_alone_and_is_not_overtaken():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who, memory in (("a", 6), ("huge", 40), ("b", 1)):
        admission.enqueue(who, JobNeeds(memory, 0))
    assert pop_names(admission) == ["a"]
    admission.remove_job("a", 0)
    assert pop_names(admission) == ["huge"]
    admission.remove_job("huge", 0)
    assert pop_names(admission) == ["b"]


def test_a_removed_job_does_not_block_later_ones():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who in ("a", "gone", "b"):
        admission.enqueue(who, JobNeeds(8, 0))
    assert pop_names(admission) == ["a"]
    admission.remove_job("gone", 0)
    admission.remove_job("a", 0)
    assert pop_names(admission) == ["b"]


def test_a_job_gets_the_limits_minus_the_needs_of_other_jobs():
    admission: AdmissionControl[str] = AdmissionControl(10, 100, is_limit=True)
    admission.enqueue("a", JobNeeds(6, 30))
    admission.enqueue("b", JobNeeds(4, 30))
    assert list(admission.pop_admissible()) == [
        ("a", {"memory": 10, "disk": 100}),
        ("b", {"memory": 4, "disk": 70}),
    ]
    admission.remove_job("a", 80)
    admission.remove_job("b", 15)
    admission.enqueue("c", JobNeeds(1, 30))
    assert list(admission.pop_admissible()) == [("c", {"memory": 10, "disk": 5})]


def test_without_a_limit_jobs_get_none():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    admission.enqueue("a", JobNeeds(6, 30))
    assert list(admission.pop_admissible()) == [("a", {"memory": None, "disk": None})]


def test_concurrency_follows_from_memory_and_cores():
    assert compute_concurrency([3, 3, 3], 10, 8) == 3
    assert compute_concurrency([3, 3, 30], 10, 2) == 2
    assert compute_concurrency([30], 10, 8) == 1
    assert compute_concurrency([], 10, 8) == 8
    assert compute_concurrency([3], None, 8) == 8
