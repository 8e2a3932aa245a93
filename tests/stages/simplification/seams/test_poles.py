"""Seams that end inside a chart, such as at a pole, and boxes that share an edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from seamed_meshes import count_edges, count_outside_charts, weld_corners

from scanloom.stages.comparing.compare import compare
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture


def make_globe(rings: int, segments: int, bumps: float) -> Mesh:
    """Make a globe as a grid of vertices; all vertices of the first and last row are at a pole.

    The fans at the poles have degenerate triangles, and each triangle has its own texture coordinate of the
    pole.
    """
    polar = np.linspace(0, np.pi, rings + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, segments + 1)[None]
    radius = 1 + bumps * np.sin(5 * polar) * np.cos(4 * around) * np.sin(polar)
    flat = radius * np.sin(polar)
    points = np.stack([flat * np.cos(around), flat * np.sin(around), radius * np.cos(polar) + 0 * around], -1)
    points[:, -1] = points[:, 0]
    points[0], points[-1] = points[0, 0], points[-1, 0]
    uv = np.stack(np.broadcast_arrays(around / (2 * np.pi), 1 - polar / np.pi), -1).reshape(-1, 2)
    grid = np.arange((rings + 1) * (segments + 1)).reshape(rings + 1, -1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    triangles = np.concatenate([np.stack(half, -1).reshape(-1, 3) for half in ((a, b, c), (a, c, d))])
    texture = Texture(uv[triangles], np.zeros(len(triangles), np.int32), (Material("globe"),))
    return Mesh(points.reshape(-1, 3), triangles.astype(np.int32), texture=texture)


@pytest.mark.parametrize("bumps", [0.0, 0.1])
@pytest.mark.parametrize("ratio", [0.3, 0.1, 0.03])
def test_poles_of_a_globe_cause_little_error(bumps: float, ratio: float) -> None:
    mesh = make_globe(32, 64, bumps)
    light = simplify(mesh, ratio=ratio)
    assert light.method == "seams"
    assert light.stopped_by == "triangles"
    assert light.details.seam_drift <= 0.1
    assert light.diagnostics == ()
    assert count_edges(weld_corners(light.mesh))[0] == 0
    assert count_outside_charts(light.mesh, light.triangle_source, mesh) == 0
    plain = simplify(mesh.with_(texture=None), ratio=ratio, method="quadric")
    rms = [
        compare(one.mesh, mesh, samples=30_000).to_dict()["distance"]["symmetric"]["rms_m"]
        for one in (light, plain)
    ]
    # Without the texture, the error is about half; earlier, the textured error was forty times as large.
    assert rms[0] < 2.5 * rms[1]


def test_seams_stay_within_their_drift_and_a_large_drift_is_reported() -> None:
    mesh = make_globe(32, 64, 0.1)
    assert mesh.texture is not None
    image = Image(given=np.full((512, 512, 3), 128, np.uint8))
    mesh = mesh.with_(texture=replace(mesh.texture, materials=(Material("globe", image),)))
    for bound in (10.0, 25.0):
        light = simplify(mesh, ratio=0.03, method="seams", seams={"max_seam_drift": bound})
        assert light.details.seam_drift_texels <= bound
    far = simplify(mesh, ratio=0.02, method="seams", seams={"max_seam_drift": 512})
    assert far.details.seam_drift_texels > 50
    assert any("texture seams moved by up to" in str(one) for one in far.diagnostics)


def test_boxes_that_share_an_edge_are_two_surfaces() -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = np.array([half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))])
    vertices = np.vstack([corners, corners - [1, 1, 0]])
    both = np.vstack([box, box + 8])
    # The upper edge of one box and the lower edge of the other have the same two vertices.
    both[both == 8 + 6], both[both == 8 + 7] = 0, 1
    mesh = Mesh(vertices, both.astype(np.int32))
    for method in ("seams", "quadric"):
        light = simplify(mesh, method=method, triangles=12)
        assert len(light.mesh.triangles) == 12
        kept = {tuple(p) for p in light.mesh.vertices.tolist()}
        assert {(0, 0, 0), (0, 0, 1)} <= kept
