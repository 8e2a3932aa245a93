"""Meshes of objects that are one piece with the table on which they stand, as fusion makes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from scanloom.stages.surface.mesh import Mesh

TABLE_SIZE = (1.0, 0.8)
BOX_SIZE, BOX_CENTER = (0.2, 0.14, 0.16), (-0.2, 0.0)
CAN_RADIUS, CAN_HEIGHT, CAN_CENTER, CAN_SIDES = 0.05, 0.12, (0.2, 0.1), 16


def make_box(size: Sequence[float], center: Sequence[float], bottom: float = 0.0) -> Any:
    """Make a box whose lower side is at the height `bottom`."""
    manifold3d = pytest.importorskip("manifold3d")
    box = manifold3d.Manifold.cube([*size], True)
    return box.translate((*center, bottom + size[2] / 2))


def make_can() -> Any:
    """Make a prism with many sides on the table."""
    manifold3d = pytest.importorskip("manifold3d")
    can = manifold3d.Manifold.cylinder(CAN_HEIGHT + 0.01, CAN_RADIUS, CAN_RADIUS, CAN_SIDES)
    return can.translate((*CAN_CENTER, -0.01))


def scan_table(objects: Sequence[Any], edge_length: float = 0.05) -> Mesh:
    """Make the visible surface of a table top at height 0 with objects, z-up."""
    solid = make_box((*TABLE_SIZE, 0.02), (0.0, 0.0), -0.02)
    for one in objects:
        solid += one
    mesh = solid.refine_to_length(edge_length).to_mesh64()
    vertices = np.asarray(mesh.vert_properties)[:, :3]
    triangles = np.asarray(mesh.tri_verts).astype(np.int32)
    corners = vertices[triangles]
    visible = corners[:, :, 2].min(axis=1) > -1e-9
    used, index = np.unique(triangles[visible], return_inverse=True)
    return Mesh(vertices[used], index.reshape(-1, 3).astype(np.int32), up=(0.0, 0.0, 1.0))


def make_default_table() -> Mesh:
    """Make a table with a box, a can and a crumb of 5 mm."""
    crumb = make_box((0.005, 0.005, 0.015), (0.1, -0.2), -0.01)
    return scan_table([make_box((*BOX_SIZE[:2], BOX_SIZE[2] + 0.01), BOX_CENTER, -0.01), make_can(), crumb])
