"""Near-planar patches: time by mesh size, and reductions of Chen and Qin.

    python benches/planar.py DATA

DATA holds `meshes/`. Times are the best of several runs: CPU time over all threads, and wall time. The meshes
are a room and a horse, subdivided repeatedly into four triangles each, and a noisy wall.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import meshes
import numpy as np
from markdown_tables import print_head, print_row
from surfaces_of_revolution import REDUCTIONS

from scanloom import compare, planar_patches, simplify
from scanloom.stages.surface.mesh import Mesh

RUNS = 3
# Degrees. The angle for the cone is less than the 9° between its sectors: a patch cannot then grow into the
# next sector, which is within the bound near the apex.
ANGLES = {"cone": 6, "cup": 40, "bottle": 40}
SIZES = (50_000, 200_000, 500_000, 1_000_000, 2_500_000)


def subdivide_mesh(mesh: Mesh) -> Mesh:
    """Subdivide each triangle into four at the midpoints of its sides."""
    sides = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = sides[:, 0].astype(np.int64) * len(mesh.vertices) + sides[:, 1]
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    ends = sides[first]
    middles = mesh.vertices[ends].mean(axis=1)
    a, b, c = mesh.triangles.T
    ab, bc, ca = (number.reshape(-1, 3) + len(mesh.vertices)).T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    triangles = np.stack([np.stack(part, 1) for part in parts], 1).reshape(-1, 3)
    return Mesh(np.concatenate([mesh.vertices, middles]), triangles.astype(np.int32))


def make_wall(triangles: int) -> Mesh:
    """Make a noisy wall of about `triangles` triangles.

    The wall is 4 m × 3 m and has noise of 1 mm.
    """
    n = int(np.sqrt(triangles / 2))
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    z = np.random.default_rng(0).normal(0, 0.001, x.shape).clip(-0.003, 0.003) * min(1, 150 / n)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    rows = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    return Mesh(np.stack([4 * x, 3 * y, z], -1).reshape(-1, 3), rows.astype(np.int32))


def time_mesh(mesh: Mesh) -> list[str]:
    """Time simplification and patches; return a row of the table of times."""
    best = np.full(3, np.inf)
    for _ in range(RUNS):
        process, wall_clock = time.process_time(), time.perf_counter()
        result = simplify(mesh, method="planar")
        spent = np.array([time.process_time() - process, time.perf_counter() - wall_clock, 0.0])
        process = time.process_time()
        planar_patches(mesh)
        spent[2] = time.process_time() - process
        best = np.minimum(best, spent)
    count = len(mesh.triangles)
    cpu, clock, patches = best / count * 1e9
    reduction = 100 * (1 - len(result.mesh.triangles) / count)
    return [
        f"{count:,}",
        f"{reduction:.1f} %",
        f"{cpu:.0f}",
        f"{clock:.0f}",
        f"{patches:.0f}",
        f"{1e3 / clock:.2f}",
    ]


def print_times(data: Path) -> None:
    """Print the table of times."""
    times_ns = ["CPU ns / triangle", "wall ns / triangle", "patches: CPU ns / triangle"]
    print_head(["mesh", "triangles", "reduction", *times_ns, "M triangles/s"])
    for name, mesh in (("room", meshes.read_kitchen(data)), ("horse", meshes.read_horse(data))):
        mesh = Mesh(mesh.vertices, mesh.triangles)
        while len(mesh.triangles) <= SIZES[-1]:
            print_row([name, *time_mesh(mesh)])
            mesh = subdivide_mesh(mesh)
    for size in SIZES:
        print_row(["wall", *time_mesh(make_wall(size))])


def print_reductions() -> None:
    """Print the paper's reductions and the errors at which we reach them."""
    print_head(["mesh", "points", "paper", "ours", "bound / diagonal", "max / diagonal", "RMS / diagonal"])
    for name, (make, _, *wanted) in REDUCTIONS.items():
        mesh = make()
        diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        for percent in wanted:
            for shape in np.geomspace(1e-5, 0.02, 34):
                angle = ANGLES[name]
                own = {"patch_angle": angle}
                result = simplify(mesh, method="planar", max_shape=shape * diagonal, planar=own)
                left = 100 * (1 - len(result.mesh.vertices) / len(mesh.vertices))
                if left >= percent:
                    break
            found = compare(mesh, result.mesh).symmetric
            print_row(
                [
                    name,
                    f"{len(mesh.vertices):,}",
                    f"{percent:g} %",
                    f"{left:.1f} %",
                    f"{100 * shape:.3f} %",
                    f"{100 * found.maximum / diagonal:.3f} %",
                    f"{100 * found.rms / diagonal:.3f} %",
                ]
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path)
    arguments = parser.parse_args()
    print_reductions()
    print()
    print_times(arguments.data)
