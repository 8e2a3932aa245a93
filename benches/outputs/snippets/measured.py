"""Measure, render and convert a mesh without changing it: measured.py MESH."""

import json
import sys

import numpy as np

from scanloom import (
    as_mesh,
    planar_patches,
    read_mesh,
    render,
    to_open3d,
    to_open3d_legacy,
    to_trimesh,
    topology,
    viewpoints,
    write_mesh,
)

mesh = read_mesh(sys.argv[1])
patches = planar_patches(mesh)
views = viewpoints(mesh, 3, width=320)
np.savez(
    "measured.npz",
    triangle_patch=patches.triangle_patch,
    poses=np.array([view.world_from_camera for view in views]),
    pictures=np.array([render(mesh, view, shading=kind) for view in views for kind in ("color", "edges")]),
)
for convert in (to_open3d, to_open3d_legacy, to_trimesh):
    write_mesh(f"{convert.__name__}.ply", as_mesh(convert(mesh)))
print(json.dumps(topology(mesh).to_dict() | {"patches": patches.count, "views": [v.name for v in views]}))
