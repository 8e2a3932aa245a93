"""Collapse records of each kind, and their files."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from seamed_meshes import folded_strips

from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh


def ring() -> Mesh:
    # Importing trimesh takes half a second, and most importers of this module do not need it.
    import trimesh

    made = trimesh.creation.torus(1.0, 0.4, major_sections=32, minor_sections=16)
    vertices = np.array(made.vertices)
    colors = np.clip(128 + 90 * np.sin(5 * vertices), 0, 255).astype(np.uint8)
    return Mesh(vertices, np.array(made.faces, np.int32), colors=colors)


def make_cut_sheet() -> Mesh:
    mesh = folded_strips(24, 9)
    colors = np.arange(3 * len(mesh.vertices)).reshape(-1, 3) % 256
    normals = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    return mesh.with_(colors=colors.astype(np.uint8), normals=normals)


@functools.cache
def make_record(kind: str) -> CollapseRecord:
    """Simplify a mesh to get a record of one of `KINDS`."""
    mesh = ring()
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    match kind:
        case "vertices":
            result = simplify(mesh, ratio=0.1, lock=[3, 4], record=True)
        case "no colours":
            result = simplify(mesh.with_(colors=None, normals=normals), ratio=0.1, record=True)
        case "split":
            result = simplify(mesh, method="jia01", max_shape=0.05, jia01={"resolution": 0.15}, record=True)
        case _:
            result = simplify(make_cut_sheet(), method="seams", ratio=0.1, record=True)
    assert result.record is not None
    return result.record


KINDS = ["vertices", "no colours", "split", "wedges"]


def save_record(kind: str, folder: Path) -> Path:
    """Save a record of one of `KINDS` to a file."""
    make_record(kind).save(folder / "light.npz")
    return folder / "light.npz"


def load_arrays(path: Path) -> dict[str, Any]:
    """Load all arrays of an NPZ file by name."""
    with np.load(path) as content:
        return dict(content)
