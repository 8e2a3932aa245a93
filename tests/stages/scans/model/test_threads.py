"""The number of threads is set in one place for our code, the kernels and the libraries."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from itertools import islice

import pytest

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.scans.codes import SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered, run_concurrently
from scanloom.stages.scans.model.threads import THREADS_VARIABLE, build_thread_environment, get_thread_count

# Prints the maximum number of threads during simplification, and the result.
SCRIPT = """
import hashlib, threading, time
from pathlib import Path
import numpy as np
import scanloom.stages
from scanloom.stages.surface.mesh import Mesh
u, v = np.meshgrid(np.arange(260), np.arange(260))
height = 0.3 * np.sin(u / 9) * np.cos(v / 7)
vertices = np.stack([u, v, height], -1).reshape(-1, 3).astype(float)
at = (u[:-1, :-1] + 260 * v[:-1, :-1]).ravel()
faces = np.stack([np.stack([at, at + 1, at + 261], -1), np.stack([at, at + 261, at + 260], -1)], 1)
most, going = 0, True
def count():
    global most
    while going:
        lines = Path("/proc/self/status").read_text().splitlines()
        most = max(most, int(next(line for line in lines if line.startswith("Threads")).split()[1]))
        time.sleep(0.002)
counter = threading.Thread(target=count)
before = len(list(Path("/proc/self/task").iterdir()))
counter.start()
light = scanloom.stages.simplify(Mesh(vertices, faces.reshape(-1, 3).astype(np.int32)), ratio=0.2).mesh
going = False
counter.join()
print(most - before, hashlib.sha256(light.vertices.tobytes()).hexdigest())
"""


@pytest.mark.parametrize(
    ("said", "meant"),
    [("1", 1), ("7", 7), ("0", None), ("-1", None), ("many", None), ("", None), ("²", None)],
)
def test_the_thread_variable_is_used_if_it_is_a_number(
    monkeypatch: pytest.MonkeyPatch, said: str, meant: int | None
):
    monkeypatch.setenv(THREADS_VARIABLE, said)
    assert get_thread_count() == (meant or os.cpu_count())
    assert get_worker_count() <= get_thread_count()


def test_libraries_get_their_own_thread_variables():
    told = build_thread_environment(3)
    assert set(told.values()) == {"3"}
    assert {THREADS_VARIABLE, "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"} <= told.keys()


@pytest.mark.parametrize(("said", "others"), [("1", False), ("2", True)])
def test_with_one_thread_nothing_runs_concurrently(monkeypatch: pytest.MonkeyPatch, said: str, others: bool):
    monkeypatch.setenv(THREADS_VARIABLE, said)
    beside, here = run_concurrently(threading.get_ident, threading.get_ident)
    assert (beside != here) is others


@pytest.mark.parametrize("threads", ["1", "2"])
def test_diagnostics_of_both_have_the_same_order_for_any_thread_count(
    monkeypatch: pytest.MonkeyPatch, threads: str
) -> None:
    def warn(name: str) -> None:
        emit(SCAN_FRAMES_SKIPPED.warning("a sampled frame cannot be used: {reason}", reason=name))

    monkeypatch.setenv(THREADS_VARIABLE, threads)
    with collecting() as diagnostics:
        run_concurrently(lambda: warn("background"), lambda: warn("foreground"))
    assert [one.values["reason"] for one in diagnostics] == ["background", "foreground"]


@pytest.mark.parametrize(("threads", "others"), [(1, False), (2, True)])
def test_one_thread_that_works_ahead_is_the_callers(threads: int, others: bool):
    def worked(item: int) -> tuple[int, int]:
        return item, threading.get_ident()

    found = list(map_ordered(worked, range(9), threads=threads, max_pending=4))
    assert [item for item, _ in found] == list(range(9))
    assert (threading.get_ident() not in {where for _, where in found}) is others


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_is_raised_in_the_order_of_items(threads: int):
    results = map_ordered(lambda item: 6 // (3 - item), range(9), threads=threads, max_pending=5)
    assert list(islice(results, 3)) == [2, 3, 6]
    with pytest.raises(ZeroDivisionError):
        next(results)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_the_kernels_use_as_many_and_come_to_the_same():
    found = {}
    for count in ("1", "6"):
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env=os.environ | build_thread_environment(int(count)),
            capture_output=True,
            text=True,
            check=True,
        )
        found[count] = done.stdout.split()
    # A sampling thread and a waiting main thread are included; of six workers, one is the calling thread.
    assert int(found["1"][0]) <= 3
    assert int(found["6"][0]) >= 6
    assert found["1"][1] == found["6"][1]
