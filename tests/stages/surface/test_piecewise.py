"""A mesh in pieces, looked over: what each knows of its neighbours, and of all together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stages.surface import piecewise
from stages.surface.formats.ply import read_ply
from stages.surface.mesh import Mesh
from stages.surface.piecewise import Piecewise
from stages.surface.raycasting import Surface, bounding_box
from stages.surface.topology import areas
from stages.surface.vertex_normals import vertex_normals


@pytest.fixture(scope="module")
def whole(large: Path) -> Mesh:
    return read_ply(large)


@pytest.mark.parametrize("at_once", [300, 500_000])
def test_vertices_of_pieces_face_as_in_the_whole(
    large: Path, whole: Mesh, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(piecewise, "AT_ONCE", at_once)
    expected = vertex_normals(whole)
    met = count = done = 0
    for piece in Piecewise(large).pieces(facing=True):
        count += 1
        own = piece.mesh.triangles
        rows = whole.triangles[done : done + len(own)]
        numbers = np.full(len(piece.mesh.vertices), -1)
        numbers[own] = rows
        assert (numbers[own] == rows).all()
        assert (piece.mesh.vertices == whole.vertices[numbers]).all()
        np.testing.assert_allclose(piece.normals, expected[numbers], atol=1e-5)
        assert (piece.box == bounding_box(piece.mesh)).all()
        assert whole.colors is not None
        assert (piece.mesh.colors == whole.colors[numbers]).all()
        alone = vertex_normals(piece.mesh)
        met += np.count_nonzero(np.abs(alone - expected[numbers]).max(axis=1) > 0.1)
        done += len(own)
    assert met > 100, "alone they would not"
    assert done == len(whole.triangles)
    assert count > (60 if at_once == 300 else 30)


def test_areas_and_boxes_are_those_of_the_whole(large: Path, whole: Mesh) -> None:
    found = Piecewise(large)
    assert found.area_ends[-1] == np.cumsum(areas(whole.vertices, whole.triangles))[-1]
    assert (found.box == bounding_box(whole)).all()
    assert (found.some_vertices(1000) == whole.vertices[:: 1 + len(whole.vertices) // 1000]).all()


def test_no_point_is_farther_than_it_is_said_to_be_at_most(large: Path, whole: Mesh) -> None:
    low, high = bounding_box(whole)
    points = np.random.default_rng(0).uniform(low - 1, high + 1, (500, 3))
    assert (Surface(whole).closest(points).distances <= Piecewise(large).at_most(points) + 1e-12).all()
