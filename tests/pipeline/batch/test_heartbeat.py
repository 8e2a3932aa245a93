"""Who lives is told by signs that change, never by what time it is."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import pytest

from scanloom.pipeline.batch.heartbeat import Heartbeat, HeartbeatObserver


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


def beat(folder: Path, worker: str, count: int, every: float = 1.0) -> None:
    (folder / f"{worker}.alive").write_text(f"{count:012d} beats, one each {every:09.3f} s\n")


def test_silence_is_counted_from_the_last_change_that_was_seen(tmp_path: Path):
    clock = Clock()
    watch = HeartbeatObserver(tmp_path, clock)
    beat(tmp_path, "a", 1)
    watch.refresh()
    clock.now += 50
    assert watch.get_silence("a") == 50
    assert not watch.is_dead("a", 60)
    beat(tmp_path, "a", 2)
    assert watch.get_silence("a") == 0
    clock.now += 61
    assert watch.is_dead("a", 60)


@pytest.mark.parametrize("shift", [3600, -3600, 0])
def test_clocks_an_hour_apart_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shift: int):
    clock = Clock()
    watch = HeartbeatObserver(tmp_path, clock)
    # As the other machine, and the server that keeps the files, say what time it is.
    monkeypatch.setattr(time, "time", lambda: 1.7e9 + shift)
    for count in range(5):
        beat(tmp_path, "a", count)
        beat(tmp_path, "dead", 0)
        for worker in ("a", "dead"):
            os.utime(tmp_path / f"{worker}.alive", (1.7e9 + shift, 1.7e9 + shift))
        watch.refresh()
        clock.now += 20
    assert not watch.is_dead("a", 60)
    assert watch.is_dead("dead", 60)


def test_a_worker_that_beats_slowly_is_not_taken_for_dead(tmp_path: Path):
    clock = Clock()
    watch = HeartbeatObserver(tmp_path, clock)
    beat(tmp_path, "a", 1, every=2.0)
    watch.refresh()
    clock.now += 7
    assert not watch.is_dead("a", 1.0)
    clock.now += 2
    assert watch.is_dead("a", 1.0)


def test_one_without_a_file_is_silent_from_when_it_is_asked_for(tmp_path: Path):
    clock = Clock()
    watch = HeartbeatObserver(tmp_path, clock)
    assert watch.get_silence("never") == 0
    clock.now += 61
    assert watch.is_dead("never", 60)


def test_a_heart_beats_and_says_when_it_ends(tmp_path: Path):
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


def test_a_disk_that_is_full_for_a_while_does_not_stop_the_heart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
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


def test_others_take_a_worker_for_dead_only_after_many_beats(tmp_path: Path):
    assert Heartbeat(tmp_path, "a", take_over_after=60).interval == 2.0
    assert Heartbeat(tmp_path, "a", take_over_after=4).interval == 0.5
