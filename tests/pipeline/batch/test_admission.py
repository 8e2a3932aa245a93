"""As many jobs at a time as memory is expected to hold."""

from __future__ import annotations

from scanloom.pipeline.batch.admission import AdmissionControl, JobNeeds
from scanloom.pipeline.batch.job_concurrency import compute_concurrency


def admitted(admission: AdmissionControl[str]) -> list[str]:
    return [who for who, _ in admission.pop_admissible()]


def test_jobs_wait_until_there_is_memory_for_them():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who, memory in (("a", 6), ("b", 4), ("c", 3)):
        admission.enqueue(who, JobNeeds(memory, 0))
    assert admitted(admission) == ["a", "b"]
    admission.remove_job("b", 0)
    assert admitted(admission) == ["c"]


def test_what_is_larger_than_all_runs_alone_and_is_not_overtaken():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who, memory in (("a", 6), ("huge", 40), ("b", 1)):
        admission.enqueue(who, JobNeeds(memory, 0))
    assert admitted(admission) == ["a"]
    admission.remove_job("a", 0)
    assert admitted(admission) == ["huge"]
    admission.remove_job("huge", 0)
    assert admitted(admission) == ["b"]


def test_one_that_is_gone_is_waited_for_no_more():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    for who in ("a", "gone", "b"):
        admission.enqueue(who, JobNeeds(8, 0))
    assert admitted(admission) == ["a"]
    admission.remove_job("gone", 0)
    admission.remove_job("a", 0)
    assert admitted(admission) == ["b"]


def test_a_limit_is_passed_on_less_what_others_take():
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


def test_without_a_limit_none_is_passed_on():
    admission: AdmissionControl[str] = AdmissionControl(10, None, is_limit=False)
    admission.enqueue("a", JobNeeds(6, 30))
    assert list(admission.pop_admissible()) == [("a", {"memory": None, "disk": None})]


def test_jobs_at_once_by_memory_and_cores():
    assert compute_concurrency([3, 3, 3], 10, 8) == 3
    assert compute_concurrency([3, 3, 30], 10, 2) == 2
    assert compute_concurrency([30], 10, 8) == 1
    assert compute_concurrency([], 10, 8) == 8
    assert compute_concurrency([3], None, 8) == 8
