"""OBJ reading and writing speed, compared with trimesh.

    python benches/obj_files.py [VERTICES ...] [--repeats N]

The mesh is a noisy sheet: positions only, and with colours, texture coordinates and normals. Each cell is the
minimum of the repeats in seconds, and trimesh's time for the same file over ours. The mesh that is read back
has to equal the written one exactly. trimesh writes eight digits, which is its default.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from markdown_tables import print_head, print_row

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.texture import Texture

SIZES = (250_000, 1_000_000)


def make_sheet(count: int) -> Mesh:
    """Make a square height field of about `count` vertices."""
    side = round(count**0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0, 1, side)] * 2))
    z = 0.1 * np.sin(9 * x) + np.random.default_rng(0).normal(0, 1e-3, side * side)
    rows = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(np.column_stack([x, y, z]), triangles.astype(np.int32))


def add_attributes(mesh: Mesh) -> Mesh:
    """Add colours, normals and texture coordinates to a mesh."""
    colors = np.random.default_rng(1).integers(0, 256, (len(mesh.vertices), 3))
    normals = mesh.vertices / np.linalg.norm(mesh.vertices + 1, axis=1, keepdims=True)
    uvs = mesh.vertices[mesh.triangles][:, :, :2].copy()
    texture = Texture(uvs, np.full(len(mesh.triangles), -1, np.int32), ())
    return mesh.with_(colors=colors.astype(np.uint8), normals=normals, texture=texture)


def compare_with_trimesh(mesh: Mesh, folder: Path, repeats: int) -> tuple[list[str], bool]:
    """Time writing and reading a mesh.

    Returns the cells, and True if the mesh was read back unchanged.
    """
    path, other = folder / "ours.obj", folder / "theirs.obj"
    write, _ = measure_min_time(lambda: write_mesh(path, mesh), repeats)
    read, back = measure_min_time(lambda: read_mesh(path), repeats)
    their_read, loaded = measure_min_time(lambda: trimesh.load(path, process=False), repeats)
    their_write, _ = measure_min_time(lambda: loaded.export(other), repeats)
    equal = np.array_equal(back.vertices, mesh.vertices) and np.array_equal(back.triangles, mesh.triangles)
    pairs = ((write, their_write), (read, their_read))
    cells = [f"{path.stat().st_size / 1e6:.0f}", *(c for a, b in pairs for c in (f"{a:.2f}", f"{b / a:.2f}"))]
    return cells, equal


def measure_min_time(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Measure the minimum time of a call.

    Returns seconds and the result of the call.
    """
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = call()
        found.append(time.perf_counter() - start)
    return min(found), result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vertices", nargs="*", type=int, default=SIZES)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    columns = ("vertices", "data", "MB", "write s", "× trimesh", "read s", "× trimesh", "equal when read")
    print_head(columns, words=2)
    with tempfile.TemporaryDirectory() as folder:
        for count in arguments.vertices:
            bare = make_sheet(count)
            for name, mesh in (("positions", bare), ("colours, normals, UVs", add_attributes(bare))):
                cells, equal = compare_with_trimesh(mesh, Path(folder), arguments.repeats)
                print_row([f"{len(mesh.vertices):,}", name, *cells, "yes" if equal else "no"])


if __name__ == "__main__":
    main()
