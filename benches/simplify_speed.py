"""How fast `simplify` is, and how much memory it takes, as the mesh grows.

Run `python benches/simplify_speed.py`; it prints a Markdown table. Each row is a process of its own: the time
is its processor time in `simplify`, the memory the growth of its peak (VmHWM) during the call: the work and
the result count, the input does not. Sizes can be given: `python benches/simplify_speed.py 10000`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from stages.mesh import Mesh
from stages.simplify import simplify

SIZES = (10_000, 100_000, 1_000_000, 2_000_000)


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


MESHES = {"hills": hills, "sphere": sphere}


def peak_bytes() -> int:
    """Return the largest resident size of this process so far."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def measure(name: str, triangles: int) -> dict[str, float]:
    """Simplify one mesh to a tenth in this process."""
    mesh = MESHES[name](triangles)
    simplify(MESHES[name](1000), ratio=0.5)  # loads what is loaded once
    # The peak so far belongs to making the mesh; Linux lets a process start it afresh.
    Path("/proc/self/clear_refs").write_text("5")
    before, start = peak_bytes(), time.process_time()
    result = simplify(mesh, ratio=0.1)
    seconds = time.process_time() - start
    return {
        "triangles": len(mesh.triangles),
        "collapses": result.collapses,
        "seconds": seconds,
        "bytes": (peak_bytes() - before) / len(mesh.triangles),
    }


def main(sizes: tuple[int, ...]) -> None:
    """Print the table, a row a process."""
    print("| mesh | triangles | collapses | CPU s | collapses/s | ns/collapse | peak bytes/triangle |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in MESHES:
        for size in sizes:
            command = [sys.executable, __file__, "--measure", name, str(size)]
            row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            rate = row["collapses"] / row["seconds"]
            print(
                f"| {name} | {row['triangles']:,} | {row['collapses']:,} | {row['seconds']:.2f} "
                f"| {rate:,.0f} | {1e9 / rate:,.0f} | {row['bytes']:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        print(json.dumps(measure(sys.argv[2], int(sys.argv[3]))))
    else:
        main(tuple(map(int, sys.argv[1:])) or SIZES)
