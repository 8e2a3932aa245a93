"""Speed and memory of `simplify` by mesh size.

    python benches/simplify_speed.py [SIZE ...] [--mode count] [--mesh hills] [--repeats 2]

Prints Markdown. Each run is a separate process; seconds are the minimum of the repeats.

- Modes: "count" simplifies to a tenth of the triangles with default parameters, colour weight and fit
  included. "jia01" uses the default bounds of that method. "certified" uses bounds of 0.3 of the vertex
  spacing and 16 levels, proof included; tighter bounds take longer per triangle.
- Meshes: "hills" has colours and the row order of a depth image, "shuffled" is the same in random order,
  "sphere" has no colours.
- "removed/s": removed triangles per CPU second on one thread.
- "memory": growth of the process's peak memory (VmHWM) per input triangle, in bytes. It includes working
  memory and result, but not the input.
- "1 thread" and "2 threads": wall seconds. The arrays of both results are compared; a difference is an error.
- "n log n": time per removed triangle over log n, relative to the smallest size. Growth is no faster than n
  log n if it is at most 1.

Profile by perf samples, a million triangles of hills, one thread of an AMD EPYC with 1 MB of L2 cache per
core and 32 MB of L3, with other work on the other core:

| share of the time | count | jia01 |
|---|---:|---:|
| quadrics of the new one-ring | 17 % | |
| shape change between old and new one-ring | | 30 % |
| placement, legality, connectivity | 10 % | 20 % |
| queue: priorities, heap, marks of changes | 24 % | 14 % |
| between rounds: cutting regions, rebuilding queues, joining | 26 % | 26 % |
| fit and colour weight | 16 % | |
| Python: checks, centred copies, provenance | 7 % | 9 % |

Since then the last row fell to 2 % and 1 %: kernels measure edge lengths, and checks process whole arrays
first. Regions are joined in place, on all threads. The colour weight is now tested on a sample, which takes 3
% more.

The profile precedes three changes that leave results unchanged and make "count" a tenth faster: quadrics are
computed two at a time, changes are marked at vertices instead of at surrounding edges, and queue positions
are compared as integers.

Since then, independent edges collapse in passes, without queue and halfedges, and only the last fiftieth
is left to the queue. "count" takes about 70 % of the time. A pass works in the order of memory within
each quarter of its queue, because most of a collapse is waiting for memory otherwise.

"certified" spends two fifths on watched vertices during collapses, another fifth on the rest of the
collapses, a quarter on the proof, and the rest on trees, copies and checks. Memory peaks during the proof.
Bytes per triangle at the peak: points, triangles and vertex adjacency 50, tree over triangles 70, collapses
and vertex maps 38, state of each triangle 9; the rest is temporary. Free pages are returned to the system
between rounds, otherwise the peak is 50 bytes higher.

On a scan the proof dominates. 145,634 triangles of the kitchen within 5 mm and 20 levels (`scanloom simplify
KITCHEN OUT --max-shape 0.005 --max-color 20 --threads 1`) take 4.6 s, 28,000 removals per second; on two
threads 2.9 s and 44,000. Without a bound on colour it takes as long, because the colour difference is bounded
anyway. Start of the program and files are not included. By perf samples, three tenths of the time are
collapses: without any proof it would be about 93,000 removals per second. The rest is mostly the first check
of all triangles and later checks of undone collapses. Checks take longer for triangles of the result than of
the input: many have to be split several times, because the input below them has borders, or bumps beyond the
bound next to them.

Distance from the minimum possible cost for "count", by perf counters:

- Memory traffic. Reading the input once and writing the result once is 29 MB, 32 bytes per removed triangle.
  400 MB are transferred, 14 times as much: centred floating-point copies, four rounds, and the second pass of
  the fit over the input. It hardly matters: 2 million cache lines are waited for, at 100 ns each a tenth of
  the time.
- Caches. A collapse needs about 10 triangles, 10 points with quadrics of 184 bytes each, and 8 queue entries:
  2.7 kB. 3.7 kB per collapse are loaded into L2, fit included, 1.4 times as much. Regions stay in L2, as
  intended.
- Arithmetic. The core is busy: 3.0 instructions per cycle, 15,500 cycles per collapse. The minimum is 2,100
  cycles: quadrics of 7.5 new triangles (108 cycles each) and placement on 7.5 new edges (171 each), once. The
  factor is 7. Half of the cycles belong to rounds, fit and Python instead of collapses. Recomputing old
  quadrics to subtract them, instead of storing them, costs as much as the new ones.

Random row order takes 1.1 to 1.2 times as long, because four times as many lines are waited for from the L3
cache. "count" would take 1.5 times as long and therefore sorts such a mesh along a space-filling curve first.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.simplification.simplify import SimplificationResult, simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_bounding_box

SIZES = (10_000, 100_000, 1_000_000, 2_000_000, 5_000_000)
SHUFFLED_SIZE = 1_000_000
# Bounds of "certified": relative to the vertex spacing, and in 8-bit levels.
MAX_SHAPE_SPACINGS, MAX_COLOR_LEVELS = 0.3, 16.0


def make_hills(triangles: int) -> Mesh:
    """Make a noisy, coloured height field.

    Vertices and triangles have the row order of a depth image.
    """
    n = int((triangles / 2) ** 0.5) + 1
    y, x = np.mgrid[0:n, 0:n].astype(float)
    noise = np.random.default_rng(0)
    z = 3 * np.sin(x / 17) * np.cos(y / 23) + noise.normal(0, 0.05, x.shape)
    waves = np.stack([60 * np.sin(x / 31), 60 * np.cos(y / 19), 40 * np.sin((x + y) / 41)], -1)
    colors = (128 + waves + noise.normal(0, 1, waves.shape)).clip(0, 255).astype(np.uint8)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    b, c, d = a + 1, a + n + 1, a + n
    squares = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return Mesh(
        0.01 * np.stack([x, y, z], -1).reshape(-1, 3), squares.astype(np.int32), colors.reshape(-1, 3)
    )


def make_shuffled_hills(triangles: int) -> Mesh:
    """Make hills with vertices and triangles in random order."""
    mesh, random = make_hills(triangles), np.random.default_rng(1)
    order = random.permutation(len(mesh.vertices))
    number = np.argsort(order).astype(np.int32)
    assert mesh.colors is not None
    return Mesh(mesh.vertices[order], number[random.permutation(mesh.triangles)], mesh.colors[order])


def make_sphere(triangles: int) -> Mesh:
    """Make a sphere without colours, ordered in rings from pole to pole."""
    rings = int((triangles / 4) ** 0.5)
    around = 2 * rings
    polar = np.pi * np.arange(1, rings + 1)[:, None] / (rings + 1)
    turn = 2 * np.pi * np.arange(around) / around
    belt = [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar) + 0 * turn]
    vertices = np.concatenate([np.stack(belt, -1).reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i, j = np.mgrid[0 : rings - 1, 0:around]
    a, b = (i * around + j).ravel(), (i * around + (j + 1) % around).ravel()
    c, d = b + around, a + around
    j = np.arange(around)
    north, south = np.full(around, rings * around), np.full(around, rings * around + 1)
    last = (rings - 1) * around
    parts = [(a, d, c), (a, c, b), (north, j, (j + 1) % around), (south, last + (j + 1) % around, last + j)]
    return Mesh(vertices, np.concatenate([np.stack(p, 1) for p in parts]).astype(np.int32))


MESHES: dict[str, Callable[[int], Mesh]] = {
    "hills": make_hills,
    "shuffled": make_shuffled_hills,
    "sphere": make_sphere,
}


def simplify_certified(mesh: Mesh, threads: int) -> SimplificationResult[Any]:
    """Simplify by `simplify_certified` within bounds relative to the vertex spacing."""
    low, high = compute_bounding_box(mesh)
    spacing = float(np.linalg.norm(high - low)) / len(mesh.triangles) ** 0.5
    texture = None if mesh.colors is None else MAX_COLOR_LEVELS
    return simplify(
        mesh, method="certified", max_shape=MAX_SHAPE_SPACINGS * spacing, max_color=texture, threads=threads
    )


MODES: dict[str, Callable[[Mesh, int], SimplificationResult[Any]]] = {
    "count": lambda mesh, threads: simplify(mesh, ratio=0.1, threads=threads),
    "jia01": lambda mesh, threads: simplify(mesh, method="jia01", threads=threads),
    "certified": simplify_certified,
}


def main() -> None:
    """Print the measurements of each run, then the growth of the time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="*", type=int, metavar="SIZE", help="triangles")
    parser.add_argument("--mode", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--mesh", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    print("| mode | mesh | triangles | removed | removed/s | B/triangle | 1 thread | 2 threads | speedup |")
    print("|---|---|---:|---:|---:|---:|---:|---:|---:|")
    growth: dict[tuple[str, str], dict[int, float]] = {}
    for mode in options.mode:
        for mesh in options.mesh:
            for size in options.sizes or ((SHUFFLED_SIZE,) if mesh == "shuffled" else SIZES):
                one, two = measure_thread_counts(mode, mesh, size, options.repeats)
                removed, triangles = one["removed"], one["triangles"]
                growth.setdefault((mode, mesh), {})[triangles] = 1e9 * one["seconds"] / removed
                print(
                    f"| {mode} | {mesh} | {triangles:,} | {removed:,} | {removed / one['seconds']:,.0f} "
                    f"| {one['bytes'] / triangles:.0f} | {one['elapsed']:.2f} | {two['elapsed']:.2f} "
                    f"| {one['elapsed'] / two['elapsed']:.2f} |",
                    flush=True,
                )
    print("\n| mode | mesh | triangles | ns per removed triangle | n log n |\n|---|---|---:|---:|---:|")
    for (mode, mesh), times in growth.items():
        for triangles, ratio in compute_growth(times).items():
            print(f"| {mode} | {mesh} | {triangles:,} | {times[triangles]:,.0f} | {ratio:.2f} |")


def compute_growth(times: dict[int, float]) -> dict[int, float]:
    """Divide times per triangle by log n, relative to the smallest n."""
    over = {n: time / math.log(n) for n, time in times.items()}
    return {n: value / over[min(over)] for n, value in over.items()}


def measure_thread_counts(mode: str, mesh: str, size: int, repeats: int) -> Iterator[dict[str, Any]]:
    """Measure with one and with two threads, alternating.

    Yields the best measurement of each.

    Raises
    ------
    SystemExit
        If any two results differ.
    """
    runs = [[measure_in_subprocess(mode, mesh, size, threads) for threads in (1, 2)] for _ in range(repeats)]
    if len({run["digest"] for pair in runs for run in pair}) > 1:
        raise SystemExit(f"{mode}, {mesh}, {size}: results differ between runs or numbers of threads")
    for some in zip(*runs, strict=True):
        yield some[0] | {key: min(run[key] for run in some) for key in ("seconds", "elapsed")}


def measure_in_subprocess(mode: str, mesh: str, size: int, threads: int) -> dict[str, Any]:
    """Run `measure` in a new process."""
    command = [sys.executable, __file__, "--measure", mode, mesh, str(size), str(threads)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))


def measure(mode: str, name: str, triangles: int, threads: int) -> dict[str, Any]:
    """Simplify one mesh in this process.

    Returns counts, seconds, bytes and a digest of the result.
    """
    mesh = MESHES[name](triangles)
    MODES[mode](MESHES[name](1000), threads)  # Warm up: load libraries.
    # Linux resets the peak memory of a process on this write; the peak so far is from making the mesh.
    Path("/proc/self/clear_refs").write_text("5")
    memory, start, elapsed = read_peak_bytes(), time.process_time(), time.perf_counter()
    result = MODES[mode](mesh, threads)
    elapsed, seconds = time.perf_counter() - elapsed, time.process_time() - start
    return {
        "triangles": len(mesh.triangles),
        "removed": len(mesh.triangles) - len(result.mesh.triangles),
        "seconds": seconds,
        "elapsed": elapsed,
        "bytes": read_peak_bytes() - memory,
        "digest": compute_digest(result),
    }


def read_peak_bytes() -> int:
    """Return the peak resident memory of this process since its last reset."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def compute_digest(result: SimplificationResult[Any]) -> str:
    """Compute an MD5 digest over all arrays of a result."""
    mesh = result.mesh
    arrays = (mesh.vertices, mesh.triangles, mesh.colors, result.vertex_source, result.triangle_source)
    md5 = hashlib.md5(usedforsecurity=False)
    for array in arrays:
        if array is not None:
            md5.update(np.ascontiguousarray(array).data)
    return md5.hexdigest()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        print(json.dumps(measure(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))))
    else:
        main()
