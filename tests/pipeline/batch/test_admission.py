"""As many jobs at a time as memory is expected to hold."""

from __future__ import annotations

from scanloom.pipeline.batch.admission import Admission, Needs
from scanloom.pipeline.batch.sizing import jobs_at_once


def admitted(admission: Admission[str]) -> list[str]:
    return [who for who, _ in admission.admitted()]


def test_jobs_wait_until_there_is_memory_for_them():
    admission: Admission[str] = Admission(10, None, is_limit=False)
    for who, memory in (("a", 6), ("b", 4), ("c", 3)):
        admission.ask(who, Needs(memory, 0))
    assert admitted(admission) == ["a", "b"]
    admission.leave("b", 0)
    assert admitted(admission) == ["c"]


def test_what_is_larger_than_all_runs_alone_and_is_not_overtaken():
    admission: Admission[str] = Admission(10, None, is_limit=False)
    for who, memory in (("a", 6), ("huge", 40), ("b", 1)):
        admission.ask(who, Needs(memory, 0))
    assert admitted(admission) == ["a"]
    admission.leave("a", 0)
    assert admitted(admission) == ["huge"]
    admission.leave("huge", 0)
    assert admitted(admission) == ["b"]


def test_one_that_is_gone_is_waited_for_no_more():
    admission: Admission[str] = Admission(10, None, is_limit=False)
    for who in ("a", "gone", "b"):
        admission.ask(who, Needs(8, 0))
    assert admitted(admission) == ["a"]
    admission.leave("gone", 0)
    admission.leave("a", 0)
    assert admitted(admission) == ["b"]


def test_a_limit_is_passed_on_less_what_others_take():
    admission: Admission[str] = Admission(10, 100, is_limit=True)
    admission.ask("a", Needs(6, 30))
    admission.ask("b", Needs(4, 30))
    assert list(admission.admitted()) == [
        ("a", {"memory": 10, "disk": 100}),
        ("b", {"memory": 4, "disk": 70}),
    ]
    admission.leave("a", 80)
    admission.leave("b", 15)
    admission.ask("c", Needs(1, 30))
    assert list(admission.admitted()) == [("c", {"memory": 10, "disk": 5})]


def test_without_a_limit_none_is_passed_on():
    admission: Admission[str] = Admission(10, None, is_limit=False)
    admission.ask("a", Needs(6, 30))
    assert list(admission.admitted()) == [("a", {"memory": None, "disk": None})]


def test_jobs_at_once_by_memory_and_cores():
    assert jobs_at_once([3, 3, 3], 10, 8) == 3
    assert jobs_at_once([3, 3, 30], 10, 2) == 2
    assert jobs_at_once([30], 10, 8) == 1
    assert jobs_at_once([], 10, 8) == 8
    assert jobs_at_once([3], None, 8) == 8
