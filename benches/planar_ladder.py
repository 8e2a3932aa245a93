"""Near-planar patches at ten bounds.

    python benches/planar_ladder.py DATA

DATA holds `meshes/`. Bounds are relative to the diagonal of the bounding box. A looser bound should not leave
more triangles than a tighter one. Each cell has the triangle count, and CPU seconds over all threads in
parentheses.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import meshes
import numpy as np
import trimesh
from markdown_tables import print_head, print_row
from surfaces_of_revolution import bottle, cone, cup

from scanloom import simplify
from scanloom.stages.surface.mesh import Mesh

BOUNDS = np.geomspace(1e-6, 1e-1, 10)


def chamfered_box() -> Mesh:
    """Make a chamfered cube.

    Its side is 2 m, its chamfers are 0.1 m wide. It has 26 flat faces in 11,264 triangles.
    """
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).T.reshape(-1, 3)
    corners = np.concatenate([signs * (1 - 0.1 * (np.arange(3) != axis)) for axis in range(3)])
    made = trimesh.convex.convex_hull(corners)
    for _ in range(4):
        made = made.subdivide()
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32))


def print_mesh_row(name: str, mesh: Mesh) -> None:
    """Print the row of one mesh."""
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    cells = []
    for bound in BOUNDS:
        begin = time.process_time()
        result = simplify(mesh, method="planar", max_shape=bound * diagonal)
        cells.append(f"{len(result.mesh.triangles):,} ({time.process_time() - begin:.2f})")
    print_row([name, f"{len(mesh.triangles):,}", *cells])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    print_head(["mesh", "triangles", *(f"{bound:.1e}" for bound in BOUNDS)])
    for make in (cone, cup, bottle, chamfered_box):
        print_mesh_row(make.__name__.replace("_", " "), make())
    room = meshes.read_kitchen(data)
    print_mesh_row("room", room)
    print_mesh_row("room without colours", room.with_(colors=None))


if __name__ == "__main__":
    main()
