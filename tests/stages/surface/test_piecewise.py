"""A mesh in pieces, looked over: what each knows of its neighbours, and of all together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.surface import pieces, piecewise, runs
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Pieces
from scanloom.stages.surface.piecewise import Piecewise
from scanloom.stages.surface.raycasting import Surface, bounding_box
from scanloom.stages.surface.runs import Runs
from scanloom.stages.surface.topology import areas
from scanloom.stages.surface.vertex_normals import vertex_normals


@pytest.fixture(scope="module")
def whole(large: Path) -> Mesh:
    return read_ply(large)


@pytest.fixture(params=["file", "memory"])
def cut(
    large: Path, whole: Mesh, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Pieces | Runs:
    """The same mesh in a file in pieces, and in memory."""
    monkeypatch.setattr(runs, "_LENGTH", 700)
    return Pieces(large) if request.param == "file" else Runs(whole)


@pytest.mark.parametrize("at_once", [300, 500_000])
def test_vertices_of_pieces_face_as_in_the_whole(
    cut: Pieces | Runs, whole: Mesh, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(piecewise, "AT_ONCE", at_once)
    expected = vertex_normals(whole)
    met = count = done = 0
    for piece in Piecewise(cut).pieces(facing=True):
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


def test_areas_and_boxes_are_those_of_the_whole(cut: Pieces | Runs, whole: Mesh) -> None:
    found = Piecewise(cut)
    assert found.area_ends[-1] == np.cumsum(areas(whole.vertices, whole.triangles))[-1]
    assert (found.box == bounding_box(whole)).all()
    assert found.vertex_count == len(whole.vertices)
    some = found.some_vertices(1000)
    assert len(some) == len(whole.vertices[:: 1 + len(whole.vertices) // 1000])
    assert {tuple(place) for place in some} <= {tuple(place) for place in whole.vertices}


@pytest.mark.parametrize("wanted", [1, 37, 1000, 10**6])
def test_some_vertices_are_the_same_however_few_are_read_at_a_time(
    large: Path, whole: Mesh, wanted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pieces, "_READ_AT_ONCE", 100)
    some = Piecewise(Pieces(large)).some_vertices(wanted)
    assert (some == whole.vertices[:: 1 + len(whole.vertices) // wanted]).all()


def test_each_vertex_is_one_pieces_own_and_they_follow_each_other(cut: Pieces | Runs, whole: Mesh) -> None:
    end = done = 0
    places = np.full((len(whole.vertices), 3), np.nan)
    for part in Piecewise(cut).parts():
        own = part.numbers[: part.own]
        assert (own == np.arange(end, end + part.own)).all()
        # Others are known from pieces before, or come with one after.
        places[own] = part.mesh.vertices[: part.own]
        end += part.own
        rows = whole.triangles[done : done + len(part.mesh.triangles)]
        assert (part.mesh.vertices[part.mesh.triangles] == whole.vertices[rows]).all()
        done += len(part.mesh.triangles)
    assert end == len(whole.vertices)
    for part in Piecewise(cut).parts():
        assert (places[part.numbers] == part.mesh.vertices).all()


def test_no_point_is_farther_than_it_is_said_to_be_at_most(cut: Pieces | Runs, whole: Mesh) -> None:
    low, high = bounding_box(whole)
    points = np.random.default_rng(0).uniform(low - 1, high + 1, (500, 3))
    assert (Surface(whole).closest(points).distances <= Piecewise(cut).at_most(points) + 1e-12).all()
