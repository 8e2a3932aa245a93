"""What is missing in a scan whose mesh is in pieces: the same as of the whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cut_in_pieces import cut_in_pieces
from plates import frames_of, plate, without

from scanloom import coverage, read_scan
from scanloom.stages.inspecting.coverage import probes
from scanloom.stages.inspecting.coverage.borders import border_of
from scanloom.stages.inspecting.coverage.covered import Coverage
from scanloom.stages.inspecting.coverage.sight import Sight
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface import piecewise
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.pieces import Pieces
from scanloom.stages.surface.piecewise import OnePiece, Piecewise
from scanloom.stages.surface.raycasting import Surface

_SAMPLE = Path(__file__).resolve().parents[4] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """All from one side, so that there is something of several kinds."""
    return list(read_scan(_SAMPLE).frames[:8])


@pytest.fixture(scope="module")
def whole(large: Path, frames: list[Frame]) -> Coverage:
    return coverage(read_ply(large), frames, few_frames=2, spacing=0.03)


@pytest.fixture(scope="module")
def pieced(large: Path, frames: list[Frame]) -> Coverage:
    with pytest.MonkeyPatch.context() as patch:
        # Of some pieces not all triangles are worked on at a time.
        patch.setattr(piecewise, "AT_ONCE", 300)
        surface = Piecewise(Pieces(large))
        assert len(surface) > 5
        assert len(list(surface.pieces())) > len(surface)
        found = coverage(surface, frames, few_frames=2, spacing=0.03)
        # What it tells of vertices is read when it is asked for.
        found.painted  # noqa: B018
    return found


def test_figures_and_places_are_those_of_the_whole(whole: Coverage, pieced: Coverage) -> None:
    expected, told = whole.figures(), pieced.figures()
    assert len(expected["places"]) > 10
    assert {place.kind for place in whole.places} == {"hidden", "few", "oblique", "unmeasured", "apart"}
    assert [one.pop("nearest_frames") for one in told["places"]] == [
        one.pop("nearest_frames") for one in expected["places"]
    ]
    for one, other in zip(expected.pop("places"), told.pop("places"), strict=True):
        for name, value in one.items():
            assert other[name] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-6))
    for name, value in expected.items():
        assert told[name] == (value if isinstance(value, list) else pytest.approx(value, rel=1e-6))


def test_colours_and_what_is_known_of_vertices_are_those_of_the_whole(
    whole: Coverage, pieced: Coverage
) -> None:
    np.testing.assert_array_equal(pieced.painted.vertices, whole.painted.vertices)
    np.testing.assert_array_equal(pieced.painted.triangles, whole.painted.triangles)
    off = np.abs(pieced.painted.colors.astype(int) - whole.painted.colors.astype(int))
    # Where pieces meet, normals are sums in single precision.
    assert off.max() <= 1
    np.testing.assert_array_equal(pieced.kinds, whole.kinds)
    for name in ("frames", "cosine", "distance", "pixel", "mean_cosine", "spread"):
        values = getattr(pieced.evidence, name)
        np.testing.assert_allclose(values, getattr(whole.evidence, name), rtol=1e-4, atol=1e-7)
    assert len(whole.painted.vertices) > len(whole.kinds) == len(pieced.kinds)


def test_the_border_is_that_of_the_whole_though_loops_run_through_many_pieces(large: Path) -> None:
    one, many = border_of(OnePiece(read_ply(large))), border_of(Piecewise(Pieces(large)))
    assert len(one.tails) > 100
    for name in ("tails", "heads", "starts", "ends"):
        np.testing.assert_array_equal(getattr(many, name), getattr(one, name))
    for name in ("facing", "beside"):
        np.testing.assert_allclose(getattr(many, name), getattr(one, name), atol=1e-6)


def test_a_hole_whose_rim_runs_through_four_pieces_is_told_as_of_the_whole(tmp_path: Path) -> None:
    wall = plate((-0.8, 0, 0), (1.6, 0, 0), (0, 0, 1.2), 0.02)
    open_wall = without(wall, lambda p: (np.abs(p[:, 0] - 0.1) < 0.15) & (np.abs(p[:, 2] - 0.5) < 0.1))
    # Nothing is measured there, though there is glass.
    frames = frames_of(open_wall, [((x, -1.2, 0.6), (x, 0, 0.6)) for x in (-0.2, 0.0, 0.2)])
    middles = open_wall.vertices[open_wall.triangles].mean(axis=1)
    large = cut_in_pieces(tmp_path / "wall.ply", open_wall, (middles[:, 0] > 0.1) + 2 * (middles[:, 2] > 0.5))
    assert len(large) == 4

    (expected,) = [one for one in coverage(open_wall, frames).places if one.kind == "hole"]
    (hole,) = [one for one in coverage(large, frames).places if one.kind == "hole"]
    assert hole.area == pytest.approx(expected.area, rel=1e-9)
    assert hole.area == pytest.approx(0.3 * 0.2, rel=0.15)
    np.testing.assert_allclose(hole.point, (0.1, 0, 0.5), atol=0.06)


def test_what_stands_for_others_is_never_far_from_them_however_large_the_mesh_is(
    large: Path, frames: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "_POINTS", 10)
    for mesh in (read_ply(large), Piecewise(Pieces(large))):
        found = coverage(mesh, frames).covered
        vertices = read_ply(large).vertices - found.surface.box.mean(axis=0)
        stands = np.concatenate([part.probes for part in found.painted()])[: len(vertices)]
        away = np.linalg.norm(found.probes.points[stands] - vertices, axis=1)
        # Marching cubes of 15 mm: their edges are shorter. Beside rims another cube's stands for a vertex.
        assert np.quantile(away, 0.95) < 6 * 0.015
        assert 200 < len(found.probes.points) < len(vertices) / 4


def test_rays_meet_pieces_as_they_meet_the_whole(large: Path) -> None:
    mesh, pieced = read_ply(large), Piecewise(Pieces(large))
    rng = np.random.default_rng(3)
    low, high = pieced.box
    origins = rng.uniform(low - 0.2, high + 0.2, (3000, 3))
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # Some along the axes of boxes.
    directions[:300] = np.eye(3)[rng.integers(0, 3, 300)]
    reaches = rng.uniform(0.05, 1.0, 3000)
    hits = Surface(mesh, pieced.box).cast(origins, directions)
    expected = np.zeros(3000, bool)
    expected[hits.rays] = hits.distances <= reaches[hits.rays]
    assert 100 < expected.sum() < 2900
    for surface in (OnePiece(mesh), pieced):
        np.testing.assert_array_equal(Sight(surface).is_met(origins, directions, reaches), expected)
