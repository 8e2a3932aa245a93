"""Processor time of the measures of a marked region, and of its check and repair (Wang, Lu and Pan 2012).

    python benches/marked_region.py DATA [--vertices 1192 10000]

DATA holds `meshes/`. The region is a sphere about a vertex of the horse. Its triangles are checked and
repaired alone, as they are, and with noise of 0.02 % and 0.1 % of the diagonal. The paper needs 4 ms for the
evaluation of 1,192 vertices, and 8 ms for their adjustment. Times are the smallest of ten runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row

from scanloom.stages import Mesh, Sphere, check, lod, read_mesh, repair

COLUMNS = ["vertices", "triangles", "evaluate ms", "evaluate + adjust ms", "noise", "check ms", "repair ms"]
NOISE_RATIOS = (0.0, 2e-4, 1e-3)
# Vertex of the horse at the centre of the region.
CENTER = 1234


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--vertices", type=int, nargs="+", default=[1192, 10_000])
    given = parser.parse_args()
    mesh = read_mesh(given.data / "meshes" / "horse.ply")
    hierarchy = lod.build(mesh, threads=1)
    middle, radius = hierarchy.spheres[0][0], hierarchy.spheres[1][0]
    view = lod.View(tuple(middle + np.array((0.0, 0.0, 3.0 * radius))), tuple(middle))
    distance = np.linalg.norm(mesh.vertices - mesh.vertices[CENTER], axis=1)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    print_head(COLUMNS)
    for count in given.vertices:
        region = Sphere(
            center=tuple(mesh.vertices[CENTER]), radius=float(np.sort(distance)[count - 1]), lock=True
        )
        evaluate_ms = measure_min_ms(lambda: lod.evaluate(hierarchy, view, region))  # noqa: B023
        adjust_ms = measure_min_ms(
            lambda: lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, view, region), 10**9)  # noqa: B023
        )
        for ratio in NOISE_RATIOS:
            part = extract_part(mesh, region, ratio * diagonal)
            row = [
                f"{count:,}",
                f"{len(part.triangles):,}",
                f"{evaluate_ms:.1f}",
                f"{adjust_ms:.1f}",
                f"{ratio:g}",
                f"{measure_min_ms(lambda: check(part, threads=1)):.0f}",  # noqa: B023
                f"{measure_min_ms(lambda: repair(part, threads=1)):.0f}",  # noqa: B023
            ]
            print_row(row)


def extract_part(mesh: Mesh, region: Sphere, noise: float) -> Mesh:
    """Extract the triangles at the vertices of a region, with noise in metres."""
    rows = mesh.triangles[region.contains(mesh.vertices)[mesh.triangles].any(axis=1)]
    used, index = np.unique(rows, return_inverse=True)
    random = np.random.default_rng(0)
    vertices = mesh.vertices[used] + random.normal(scale=noise, size=(len(used), 3))
    return Mesh(vertices, index.reshape(-1, 3).astype(np.int32))


def measure_min_ms(call: Callable[[], object]) -> float:
    """Measure the smallest processor time of ten calls, ms."""
    times = []
    for _ in range(10):
        before = time.process_time()
        call()
        times.append(time.process_time() - before)
    return 1e3 * min(times)


if __name__ == "__main__":
    main()
