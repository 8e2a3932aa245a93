"""How fast `simplify` is, and how much memory it takes, as the mesh grows.

    python benches/simplify_speed.py [SIZE ...] [--mode count] [--mesh hills] [--repeats 2]

It prints Markdown. Modes: "count" is to a tenth of the triangles, all else default: colours weighed, the
result fitted. "jia01" is within that method's default bounds. "certified" is within 0.3 of the spacing of
vertices and 16 levels, proof included; closer bounds take longer for each triangle. Meshes: "hills" have
colours and the row order of a depth image, "shuffled" are the same in random order, "sphere" has no colours.
Each run is a process of its own. "removed/s" are triangles removed in a second of processor time on one
thread, "memory" is how much the process's peak grows (VmHWM) over the triangles given: the work and the
result count, the input does not. "1 thread" and "2 threads" are elapsed seconds; the results are compared by
the bytes of their arrays, and a difference is an error. Seconds are the least of the repeats. "n log n" is
the time for each removed triangle over log n, against the smallest size of the same kind: at most 1 is growth
no faster than n log n.

Where the time goes, by perf's samples on a million triangles of hills, one thread of an AMD EPYC with 1 MB of
L2 a core and 32 MB behind it, other work on the other core:

| share of the time | count | jia01 |
|---|---:|---:|
| quadrics of a new star | 17 % | |
| shape change between old and new star | | 30 % |
| placement, legality, connectivity | 10 % | 20 % |
| order: priorities, heap, marks of what changed | 24 % | 14 % |
| between rounds: cutting patches, queues afresh, joining | 26 % | 26 % |
| fit and weight of colour | 16 % | |
| Python: checks, copies about the centre, sources | 7 % | 9 % |

The last row has since come down to 2 % and 1 %: the kernels measure sides, checks look at whole arrays first.
Pieces are joined in the memory of the mesh they came from, on all threads. The weight of colour is tried on a
sample now, which takes 3 % more.

These figures are from before quadrics were computed two at a time, changes noted at vertices instead of at
the edges around them, and places in the queue compared as whole numbers: with the same bits, "count" takes a
tenth less since.

"certified" spends two fifths on the watched vertices while it collapses, another fifth on the rest of that, a
quarter on the proof and the rest on trees, copies and checks. Its peak is at the proof. Bytes a triangle
there, counted by what is held: points, triangles and the triangles around each vertex 50, the tree over them
70, collapses and where they led 38, what is known of each triangle 9; the rest is short-lived. Between rounds
free pages are given back to the system: without that the peak was 50 higher.

On a scan it is the proof that counts. 145,634 triangles of the kitchen within 5 mm and 20 levels (`scanloom
simplify KITCHEN OUT --max-shape 0.005 --max-color 20 --threads 1`) take 4.6 s, 28,000 removals a second; 2.9
s and 44,000 on two threads; and as much without a bound on colours, where what they differ by is bounded on
the way. These are seconds of the method, without the program's start and files. By perf's samples three
tenths are collapses: without any proof it would be some 93,000 a second. The rest is mostly the first look
at all triangles and later looks at what was taken back, more of it for the result's triangles than for the
input's: many have to be halved several times, as the input has borders under them, or rises beyond the bound
beside them.

How far that is from the floor, for "count", by perf's counters:

- Bytes. Reading the input once and writing the result once is 29 MB, 32 bytes for each removed triangle.
  400 MB come from memory, 14 times as much: copies as floats about the centre, four rounds, the fit's second
  look at the input. It hardly matters: 2 million of those lines are waited for, at 100 ns each a tenth of the
  time.
- Caches. A collapse has to look at about 10 triangles, 10 points with their quadrics of 184 bytes each, and 8
  places in the queue: 2.7 kB. 3.7 kB a collapse come into L2 from beyond, fit included, 1.4 times as much:
  patches stay in L2, as they should.
- Arithmetic. The core is busy: 3.0 instructions a cycle, 15,500 cycles a collapse. Of these, the quadrics of
  7.5 new triangles (108 cycles each) and the placement on 7.5 new edges (171 each), once, are what the method
  cannot do without: 2,100. The factor is 7. Half of the cycles do not belong to collapses at all but to
  rounds, fit and Python; and computing old quadrics again to subtract them, rather than storing them, costs
  as much as the new ones.

Rows in random order cost 1.1 to 1.2 times the time: four times as many lines are waited for from the last
cache. "count" would take 1.5 times the time, and so it sorts such a mesh along a curve through space first.
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

from scanloom.stages.simplification.simplify import Simplified, simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import bounding_box

SIZES = (10_000, 100_000, 1_000_000, 2_000_000, 5_000_000)
SHUFFLED = 1_000_000
# Bounds of "certified": of the spacing of vertices, and in 8-bit levels.
MAX_SHAPE, MAX_TEXTURE = 0.3, 16.0


def hills(triangles: int) -> Mesh:
    """Make a noisy, coloured height field, in the row order of a depth image."""
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


def shuffled(triangles: int) -> Mesh:
    """Make hills whose vertices and triangles come in random order."""
    mesh, random = hills(triangles), np.random.default_rng(1)
    order = random.permutation(len(mesh.vertices))
    number = np.argsort(order).astype(np.int32)
    assert mesh.colors is not None
    return Mesh(mesh.vertices[order], number[random.permutation(mesh.triangles)], mesh.colors[order])


def sphere(triangles: int) -> Mesh:
    """Make a sphere without colours, ring after ring from pole to pole."""
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


MESHES: dict[str, Callable[[int], Mesh]] = {"hills": hills, "shuffled": shuffled, "sphere": sphere}


def certified(mesh: Mesh, threads: int) -> Simplified[Any]:
    """Simplify within bounds that suit the size: a share of the spacing of vertices, and some levels."""
    low, high = bounding_box(mesh)
    spacing = float(np.linalg.norm(high - low)) / len(mesh.triangles) ** 0.5
    texture = None if mesh.colors is None else MAX_TEXTURE
    return simplify(
        mesh, method="certified", max_shape=MAX_SHAPE * spacing, max_color=texture, threads=threads
    )


MODES: dict[str, Callable[[Mesh, int], Simplified[Any]]] = {
    "count": lambda mesh, threads: simplify(mesh, ratio=0.1, threads=threads),
    "jia01": lambda mesh, threads: simplify(mesh, method="jia01", threads=threads),
    "certified": certified,
}


def main() -> None:
    """Print the figures of each run, and then how the time grows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs="*", type=int, metavar="SIZE", help="triangles")
    parser.add_argument("--mode", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--mesh", nargs="+", choices=MESHES, default=list(MESHES))
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    print("| mode | mesh | triangles | removed | removed/s | memory, bytes | 1 thread | 2 threads | faster |")
    print("|---|---|---:|---:|---:|---:|---:|---:|---:|")
    growth: dict[tuple[str, str], dict[int, float]] = {}
    for mode in options.mode:
        for mesh in options.mesh:
            for size in options.sizes or ((SHUFFLED,) if mesh == "shuffled" else SIZES):
                one, two = both(mode, mesh, size, options.repeats)
                removed, triangles = one["removed"], one["triangles"]
                growth.setdefault((mode, mesh), {})[triangles] = 1e9 * one["seconds"] / removed
                print(
                    f"| {mode} | {mesh} | {triangles:,} | {removed:,} | {removed / one['seconds']:,.0f} "
                    f"| {one['bytes'] / triangles:.0f} | {one['elapsed']:.2f} | {two['elapsed']:.2f} "
                    f"| {one['elapsed'] / two['elapsed']:.2f} |",
                    flush=True,
                )
    print("\n| mode | mesh | triangles | ns for each removed | n log n |\n|---|---|---:|---:|---:|")
    for (mode, mesh), times in growth.items():
        for triangles, ratio in over_n_log_n(times).items():
            print(f"| {mode} | {mesh} | {triangles:,} | {times[triangles]:,.0f} | {ratio:.2f} |")


def over_n_log_n(times: dict[int, float]) -> dict[int, float]:
    """Return the time for each of n triangles over log n, against that of the smallest n."""
    over = {n: time / math.log(n) for n, time in times.items()}
    return {n: value / over[min(over)] for n, value in over.items()}


def both(mode: str, mesh: str, size: int, repeats: int) -> Iterator[dict[str, Any]]:
    """Return the figures with one thread and with two, in turn, the best of each.

    Raises
    ------
    SystemExit
        If any two results differ.
    """
    runs = [[in_own_process(mode, mesh, size, threads) for threads in (1, 2)] for _ in range(repeats)]
    if len({run["digest"] for pair in runs for run in pair}) > 1:
        raise SystemExit(f"{mode}, {mesh}, {size}: results differ from run to run or from one thread to two")
    for some in zip(*runs, strict=True):
        yield some[0] | {key: min(run[key] for run in some) for key in ("seconds", "elapsed")}


def in_own_process(mode: str, mesh: str, size: int, threads: int) -> dict[str, Any]:
    """Have a fresh process run `measure`."""
    command = [sys.executable, __file__, "--measure", mode, mesh, str(size), str(threads)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))


def measure(mode: str, name: str, triangles: int, threads: int) -> dict[str, Any]:
    """Simplify one mesh in this process; return counts, seconds, bytes and a digest of the result."""
    mesh = MESHES[name](triangles)
    MODES[mode](MESHES[name](1000), threads)  # loads what is loaded once
    # The peak so far belongs to making the mesh; Linux lets a process start it afresh.
    Path("/proc/self/clear_refs").write_text("5")
    memory, start, elapsed = peak_bytes(), time.process_time(), time.perf_counter()
    result = MODES[mode](mesh, threads)
    elapsed, seconds = time.perf_counter() - elapsed, time.process_time() - start
    return {
        "triangles": len(mesh.triangles),
        "removed": len(mesh.triangles) - len(result.mesh.triangles),
        "seconds": seconds,
        "elapsed": elapsed,
        "bytes": peak_bytes() - memory,
        "digest": digest(result),
    }


def peak_bytes() -> int:
    """Return the largest resident size of this process so far."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def digest(result: Simplified[Any]) -> str:
    """Return an MD5 over all arrays of a result."""
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
