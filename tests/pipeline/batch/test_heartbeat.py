"""Heartbeats: a worker is alive if its heartbeat file changes; clock times are not compared."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import pytest

from scanloom.pipeline.batch.heartbeat import Heartbeat, HeartbeatObserver


class FakeClock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


def write_heartbeat(folder: Path, worker: str, count: int, every: float = 1.0) -> None:
    (folder / f"{worker}.alive").write_text(f"{count:012d} beats, one each {every:09.3f} s\n")


def test_silence_is_counted_from_the_last_observed_change(tmp_path: Path):
    clock = FakeClock()
    watch = HeartbeatObserver(tmp_path, clock)
    write_heartbeat(tmp_path, "a", 1)
    watch.refresh()
    clock.now += 50
    assert watch.get_silence("a") == 50
    assert not watch.is_dead("a", 60)
    write_heartbeat(tmp_path, "a", 2)
    assert watch.get_silence("a") == 0
    clock.now += 61
    assert watch.is_dead("a", 60)


@pytest.mark.parametrize("shift", [3600, -3600, 0])
def test_clock_differences_have_no_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shift: int):
    clock = FakeClock()
    watch = HeartbeatObserver(tmp_path, clock)
    # The other machine and the file server have shifted clocks.
    monkeypatch.setattr(time, "time", lambda: 1.7e9 + shift)
    for count in range(5):
        write_heartbeat(tmp_path, "a", count)
        write_heartbeat(tmp_path, "dead", 0)
        for worker in ("a", "dead"):
            os.utime(tmp_path / f"{worker}.alive", (1.7e9 + shift, 1.7e9 + shift))
        watch.refresh()
        clock.now += 20
    assert not watch.is_dead("a", 60)
    assert watch.is_dead("dead", 60)


def test_a_slow_heartbeat_does_not_count_as_dead(tmp_path: Path):
    clock = FakeClock()
    watch = HeartbeatObserver(tmp_path, clock)
    write_heartbeat(tmp_path, "a", 1, every=2.0)
    watch.refresh()
    clock.now += 7
    assert not watch.is_dead("a", 1.0)
    clock.now += 2
    assert watch.is_dead("a", 1.0)


def test_a_missing_heartbeat_is_silent_from_the_first_query(tmp_path: Path):
    clock = FakeClock()
    watch = HeartbeatObserver(tmp_path, clock)
    assert watch.get_silence("never") == 0
    clock.now += 61
    assert watch.is_dead("never", 60)


def test_a_heartbeat_changes_and_marks_its_end(tmp_path: Path):
    watch = HeartbeatObserver(tmp_path)
    with Heartbeat(tmp_path, "a", take_over_after=0.08) as heart:
        assert heart.interval == pytest.approx(0.01)
        first = watch.read_heartbeat("a")
        end = time.monotonic() + 10
        while watch.read_heartbeat("a") == first and time.monotonic() < end:
            time.sleep(0.005)
        assert watch.read_heartbeat("a") != first
        assert watch.list_living() == ["a"]
    assert watch.get_silence("a") == math.inf
    assert watch.list_living() == []


def test_a_heartbeat_survives_a_temporarily_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    watch = HeartbeatObserver(tmp_path)
    with Heartbeat(tmp_path, "a", take_over_after=0.08):
        written = os.write
        monkeypatch.setattr("os.write", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
        time.sleep(0.05)
        monkeypatch.setattr("os.write", written)
        first, end = watch.read_heartbeat("a"), time.monotonic() + 10
        while watch.read_heartbeat("a") == first and time.monotonic() < end:
            time.sleep(0.005)
        assert watch.read_heartbeat("a") != first


def test_the_heartbeat_interval_is_a_fraction_of_the_takeover_time(tmp_path: Path):
    assert Heartbeat(tmp_path, "a", take_over_after=60).interval == 2.0
    assert Heartbeat(tmp_path, "a", take_over_after=4).interval == 0.5
