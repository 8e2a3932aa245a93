"""Simplify with locked vertices and importance: controlled.py MESH METHOD NAME=NUMBER ...."""

import sys

import numpy as np

from scanloom import Box, Sphere, UsageError, read_mesh, simplify, write_mesh

path, method, *options = sys.argv[1:]
mesh = read_mesh(path)
low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
share = (mesh.vertices - low) / (high - low)
controls = {
    "lock": {"lock": share[:, 0] < 0.2},
    "lock_by_index": {"lock": np.flatnonzero(share[:, 1] > 0.9)},
    "importance": {"importance": 1 + 50 * share[:, 1] ** 2},
    "regions": {
        "regions": [
            Sphere(low + 0.3 * (high - low), 0.2 * np.linalg.norm(high - low), importance=8),
            Box(low + 0.5 * (high - low), high, lock=True),
        ]
    },
}
numbers = {name: float(number) for name, number in (option.split("=") for option in options)}
for name, control in controls.items():
    try:
        light = simplify(mesh, method=method, **numbers, **control)
    except UsageError as error:
        print(f"{name}: {error}")
        continue
    print(f"{name}: {len(light.mesh.triangles)} triangles, stopped by {light.stopped_by}")
    print(*light.diagnostics, sep="\n")
    write_mesh(f"{name}.ply", light.mesh)
    np.savez(f"{name}.npz", vertex_source=light.vertex_source, triangle_source=light.triangle_source)
