"""Speed of method `seams` on one thread, by mesh size.

    python benches/seams_speed.py [SIZES ...]

A noisy height field is cut into strips of 50 rows, each a chart with separate vertices, and simplified to a
tenth of its triangles: with texture coordinates only, and with colours. Prints a Markdown table of collapses
per CPU second, the best of three calls without the fit.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from markdown_tables import print_head, print_row
from simplify_speed import make_hills

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Material, Mesh, Texture

SIZES = (10_000, 100_000, 1_000_000)
_STRIP_ROWS = 50


def make_strips(triangles: int) -> Mesh:
    """Make a height field whose strips are separate charts.

    The charts are rotated by 90° in the image.
    """
    mesh = make_hills(triangles)
    place = mesh.vertices[:, :2] / np.ptp(mesh.vertices[:, :2])
    n = round(len(mesh.vertices) ** 0.5)
    strip = mesh.triangles.min(axis=1) // n // _STRIP_ROWS
    keys, corners = np.unique(
        np.repeat(strip, 3).astype(np.int64) << 32 | mesh.triangles.reshape(-1), return_inverse=True
    )
    source = keys & 0xFFFFFFFF
    flat = place[mesh.triangles]
    uvs = np.stack([flat[..., 1] + 0.01 * strip[:, None], flat[..., 0]], axis=2)
    assert mesh.colors is not None
    return Mesh(
        mesh.vertices[source],
        corners.reshape(-1, 3).astype(np.int32),
        mesh.colors[source],
        texture=Texture(uvs, np.zeros(len(uvs), np.int32), (Material("strips"),)),
    )


def main() -> None:
    """Print the table."""
    print_head(["triangles", "attributes", "collapses/s"], words=2)
    for size in [int(word) for word in sys.argv[1:]] or SIZES:
        mesh = make_strips(size)
        for name, one in (
            ("texture coordinates", mesh.with_(colors=None)),
            ("texture coordinates, colours", mesh),
        ):
            best, collapses = np.inf, 0
            for _ in range(3):
                began = time.process_time()
                result = simplify(one, ratio=0.1, fit=False, threads=1)
                best, collapses = min(best, time.process_time() - began), result.collapses
            print_row([f"{len(mesh.triangles):,}", name, f"{collapses / best:,.0f}"])


if __name__ == "__main__":
    main()
