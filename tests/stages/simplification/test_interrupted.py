"""A real Ctrl-C in the middle of a long simplification, with and without wanting what there is by then."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from typing import Any, NoReturn

import numpy as np
import pytest

from scanloom.stages.progress import Progress
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow

# Hills of half a million triangles or fewer; the child says when collapsing, or proving, has begun, and
# afterwards how far it came and when it stopped.
CHILD = """
import json, sys, time
import numpy as np
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.topology import topology

arguments = json.loads(sys.argv[1])
at_proof = arguments.pop("at_proof", False)
n = arguments.pop("n", 500)
y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
z = 0.1 * np.sin(7 * x) * np.cos(5 * y) + np.random.default_rng(0).normal(0, 0.0001, x.shape)
a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
b, c, d = a + 1, a + n + 2, a + n + 1
triangles = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
colors = np.stack([255 * x, 255 * y, 0 * x], -1).reshape(-1, 3).astype(np.uint8)
mesh = Mesh(np.stack([x, y, z], -1).reshape(-1, 3), triangles.astype(np.int32), colors=colors)

seen = []
said = False
def progress(done, total):
    # While a proof is made, no more triangles go.
    global said
    if not said and (not at_proof or (done > 0 and seen[-1:] == [(done, total)])):
        # Ctrl-C comes as soon as this is printed.
        said = True
        print("working", flush=True)
    seen.append((done, total))

try:
    result = simplify(mesh, progress=progress, **arguments)
except KeyboardInterrupt:
    print(json.dumps({"interrupted": True, "seen": seen, "stopped_at": time.monotonic()}))
else:
    now = topology(result.mesh)
    print(json.dumps({
        "interrupted": False, "stopped_by": result.stopped_by, "triangles": now.triangles, "euler": now.euler,
        "sound": now.is_manifold and now.is_oriented, "seen": seen,
    }))
"""


def interrupted(**arguments: Any) -> dict[str, Any]:
    command = [sys.executable, "-c", CHILD, json.dumps(arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as child:
        too_long = threading.Timer(120, child.kill)
        too_long.start()
        assert child.stdout is not None
        assert child.stdout.readline() == "working\n"
        # The clock is the same for both processes.
        sent_at = time.monotonic()
        child.send_signal(signal.SIGINT)
        # What came together with the first line waits here, where `communicate` would not look.
        output = child.stdout.read()
        too_long.cancel()
    assert child.returncode == 0, output
    report: dict[str, Any] = json.loads(output)
    if "stopped_at" in report:
        report["seconds"] = report["stopped_at"] - sent_at
    return report


# Seconds from Ctrl-C to the end of the work: with nothing else to do 0.13 at most in 20 tries, but other
# tests are at work beside this one.
SOON = 1.0

METHODS = pytest.mark.parametrize(
    "arguments",
    [{"ratio": 0.05}, {"method": "jia01", "max_shape": 0.01}, {"max_shape": 0.01}],
    ids=["quadric", "jia01", "certified"],
)


@METHODS
def test_ctrl_c_stops_the_work(arguments: dict[str, float]) -> None:
    report = interrupted(**arguments)
    assert report["interrupted"]
    # It had a long way to go still, or did not even know how long.
    assert all(done < total or total == 0 for done, total in report["seen"])
    assert report["seconds"] < SOON


def test_ctrl_c_stops_a_proof() -> None:
    report = interrupted(n=300, max_shape=0.0005, max_color=3, at_proof=True)
    assert report["interrupted"]
    assert report["seconds"] < SOON


def test_ctrl_c_during_a_proof_ends_it_and_gives_out_what_it_was_about() -> None:
    report = interrupted(n=300, max_shape=0.0005, max_color=3, at_proof=True, keep_on_interrupt=True)
    assert not report["interrupted"]
    # Where that proof succeeds there was nothing left to do.
    assert report["stopped_by"] in ("request", "bounds")
    assert report["triangles"] < 0.9 * 180_000
    assert report["sound"]


@METHODS
def test_ctrl_c_gives_out_what_there_is(arguments: dict[str, float]) -> None:
    # Bounds are proven of what there is, which takes longer than getting there.
    n = 500 if {"ratio", "method"} & arguments.keys() else 200
    report = interrupted(keep_on_interrupt=True, n=n, **arguments)
    assert not report["interrupted"]
    assert report["stopped_by"] == "request"
    assert 0.05 * 2 * n**2 < report["triangles"] < 2 * n**2
    assert report["sound"]
    assert report["euler"] == 1


def hills(n: int) -> Mesh:
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    z = 0.1 * np.sin(7 * x) * np.cos(5 * y) + np.random.default_rng(0).normal(0, 0.1 / n, x.shape)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    triangles = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), triangles.astype(np.int32))


@METHODS
def test_progress_that_returns_false_gives_out_what_there_is(arguments: dict[str, float]) -> None:
    mesh = hills(500)
    result = simplify(mesh, record="ratio" in arguments, progress=lambda *_: False, **arguments)
    assert result.stopped_by == "request"
    assert not getattr(result.details, "fitted", False)
    now = topology(result.mesh)
    assert 0.05 * 500_000 < now.triangles < 500_000
    assert now.is_manifold
    assert now.euler == 1
    if result.record is not None:
        np.testing.assert_array_equal(result.record.replay().mesh.vertices, result.mesh.vertices)


def test_ctrl_c_while_progress_is_told() -> None:
    mesh = hills(500)

    def ctrl_c(*_: int) -> None:
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        simplify(mesh, ratio=0.05, progress=ctrl_c)
    assert simplify(mesh, ratio=0.05, progress=ctrl_c, keep_on_interrupt=True).stopped_by == "request"


def test_other_answers_of_progress_mean_nothing() -> None:
    result = simplify(hills(300), ratio=0.05, progress=lambda *_: 0)
    assert result.stopped_by == "triangles"


def test_what_is_there_while_fitting_is_the_mesh_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = hills(40)
    plain = simplify(mesh, ratio=0.1, fit=False)

    def ctrl_c(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    def asks(_light: Any, _given: Any, _lock: Any, _threads: int, progress: Progress) -> NoReturn:
        progress(0, 0)
        raise AssertionError("progress was told to stop")

    told: list[tuple[int, int]] = []

    def stop(done: int, total: int) -> bool:
        told.append((done, total))
        return False

    monkeypatch.setattr("scanloom.stages.simplification.quadric.run.fit_to_input", ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        simplify(mesh, ratio=0.1)
    results = [simplify(mesh, ratio=0.1, keep_on_interrupt=True)]
    monkeypatch.setattr("scanloom.stages.simplification.quadric.run.fit_to_input", asks)
    results.append(simplify(mesh, ratio=0.1, progress=stop))
    assert told[-1] == (2880, 2880)
    for result in results:
        assert (result.stopped_by, result.details.fitted) == ("request", False)
        np.testing.assert_array_equal(result.mesh.vertices, plain.mesh.vertices)
