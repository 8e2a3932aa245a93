"""Ctrl-C during a long simplification, with and without `keep_on_interrupt`."""

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

# A height field of up to half a million triangles. The child process reports the start of collapsing or of
# the proof, and finally its progress and its end.
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
has_reported = False
def progress(done, total):
    # During a proof, the triangle count does not change.
    global has_reported
    if not has_reported and (not at_proof or (done > 0 and seen[-1:] == [(done, total)])):
        # Ctrl-C is sent as soon as this is printed.
        has_reported = True
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


def run_interrupted(**arguments: Any) -> dict[str, Any]:
    command = [sys.executable, "-c", CHILD, json.dumps(arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as child:
        too_long = threading.Timer(120, child.kill)
        too_long.start()
        assert child.stdout is not None
        assert child.stdout.readline() == "working\n"
        # Both processes use the same clock.
        sent_at = time.monotonic()
        child.send_signal(signal.SIGINT)
        # The rest of the output is in this buffer, which `communicate` does not read.
        output = child.stdout.read()
        too_long.cancel()
    assert child.returncode == 0, output
    report: dict[str, Any] = json.loads(output)
    if "stopped_at" in report:
        report["seconds"] = report["stopped_at"] - sent_at
    return report


# Maximum time from Ctrl-C to the end, seconds. It was at most 0.13 s in 20 tries on an idle machine, but
# other tests may run at the same time.
SOON = 1.0

METHODS = pytest.mark.parametrize(
    "arguments",
    [{"ratio": 0.05}, {"method": "jia01", "max_shape": 0.01}, {"max_shape": 0.01}],
    ids=["quadric", "jia01", "certified"],
)


@METHODS
def test_ctrl_c_stops_the_collapses(arguments: dict[str, float]) -> None:
    report = run_interrupted(**arguments)
    assert report["interrupted"]
    # Work was left, or the total was not yet known.
    assert all(done < total or total == 0 for done, total in report["seen"])
    assert report["seconds"] < SOON


def test_ctrl_c_stops_a_proof() -> None:
    report = run_interrupted(n=300, max_shape=0.0005, max_color=3, at_proof=True)
    assert report["interrupted"]
    assert report["seconds"] < SOON


def test_ctrl_c_during_a_proof_returns_the_mesh() -> None:
    report = run_interrupted(n=300, max_shape=0.0005, max_color=3, at_proof=True, keep_on_interrupt=True)
    assert not report["interrupted"]
    # If this proof succeeds, the simplification is complete.
    assert report["stopped_by"] in ("request", "bounds")
    assert report["triangles"] < 0.9 * 180_000
    assert report["sound"]


@METHODS
def test_ctrl_c_returns_the_mesh_simplified_so_far(arguments: dict[str, float]) -> None:
    # With bounds, the mesh is smaller, because the proof for the current mesh takes longer than the
    # collapses.
    n = 500 if {"ratio", "method"} & arguments.keys() else 200
    report = run_interrupted(keep_on_interrupt=True, n=n, **arguments)
    assert not report["interrupted"]
    assert report["stopped_by"] == "request"
    assert 0.05 * 2 * n**2 < report["triangles"] < 2 * n**2
    assert report["sound"]
    assert report["euler"] == 1


def make_hills(n: int) -> Mesh:
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    z = 0.1 * np.sin(7 * x) * np.cos(5 * y) + np.random.default_rng(0).normal(0, 0.1 / n, x.shape)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    triangles = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), triangles.astype(np.int32))


@METHODS
def test_progress_that_returns_false_returns_the_mesh_simplified_so_far(arguments: dict[str, float]) -> None:
    mesh = make_hills(500)
    result = simplify(mesh, record="ratio" in arguments, progress=lambda *_: False, **arguments)
    assert result.stopped_by == "request"
    assert not getattr(result.details, "fitted", False)
    now = topology(result.mesh)
    assert 0.05 * 500_000 < now.triangles < 500_000
    assert now.is_manifold
    assert now.euler == 1
    if result.record is not None:
        np.testing.assert_array_equal(result.record.replay().mesh.vertices, result.mesh.vertices)


def test_ctrl_c_during_the_progress_callback_is_handled() -> None:
    mesh = make_hills(500)

    def raise_sigint(*_: int) -> None:
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        simplify(mesh, ratio=0.05, progress=raise_sigint)
    assert simplify(mesh, ratio=0.05, progress=raise_sigint, keep_on_interrupt=True).stopped_by == "request"


def test_other_return_values_of_progress_are_ignored() -> None:
    result = simplify(make_hills(300), ratio=0.05, progress=lambda *_: 0)
    assert result.stopped_by == "triangles"


def test_an_interrupted_fit_returns_the_mesh_without_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = make_hills(40)
    plain = simplify(mesh, ratio=0.1, fit=False)

    def raise_sigint(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    def call_progress(_light: Any, _given: Any, _lock: Any, _threads: int, progress: Progress) -> NoReturn:
        progress(0, 0)
        raise AssertionError("progress requested a stop")

    calls: list[tuple[int, int]] = []

    def stop(done: int, total: int) -> bool:
        calls.append((done, total))
        return False

    monkeypatch.setattr("scanloom.stages.simplification.quadric.run.fit_to_input", raise_sigint)
    with pytest.raises(KeyboardInterrupt):
        simplify(mesh, ratio=0.1)
    results = [simplify(mesh, ratio=0.1, keep_on_interrupt=True)]
    monkeypatch.setattr("scanloom.stages.simplification.quadric.run.fit_to_input", call_progress)
    results.append(simplify(mesh, ratio=0.1, progress=stop))
    assert calls[-1] == (2880, 2880)
    for result in results:
        assert (result.stopped_by, result.details.fitted) == ("request", False)
        np.testing.assert_array_equal(result.mesh.vertices, plain.mesh.vertices)
