"""Simplification in chunks: no cracks, the same topology, the requested count, and proven bounds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chunked_sample import use_small_chunks

from scanloom.stages.cleaning.chunked_clean import clean_chunked
from scanloom.stages.cleaning.clean import CleanParams
from scanloom.stages.comparing.certify import certify
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification import chunked_simplify as simplify_in_pieces_module
from scanloom.stages.simplification.chunked_simplify import simplify_chunked
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.mesh_subsets import make_full_subset, split_subset
from scanloom.stages.simplification.params import SimplifyParams
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology


@pytest.fixture(scope="module")
def path(large: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clean")
    with use_small_chunks():
        clean_chunked(large, folder / "clean.ply", CleanParams())
    return folder / "clean.ply"


def assert_same_manifold(light: Mesh, given: Mesh) -> None:
    """Check that there is no new boundary, component or handle."""
    found, expected = topology(light), topology(given)
    assert found.is_manifold
    assert found.is_oriented
    assert (found.euler, found.components, found.boundary_loops) == (
        expected.euler,
        expected.components,
        expected.boundary_loops,
    )


@pytest.mark.slow
def test_the_triangle_count_is_reached(path: Path) -> None:
    given = read_ply(path)
    done: list[tuple[int, int]] = []
    found = simplify_chunked(path, SimplifyParams(ratio=0.1), progress=lambda *call: done.append(call))
    assert 0.098 < len(found.mesh.triangles) / len(given.triangles) <= 0.1
    assert_same_manifold(found.mesh, given)
    metrics = found.to_dict()
    assert metrics["triangles_before"] == len(given.triangles)
    assert metrics["triangles"] == len(found.mesh.triangles)
    assert metrics["parts"] > 5
    assert done == sorted(done)
    assert done[-1][0] == done[-1][1]
    wanted = len(given.triangles) // 5
    assert len(simplify_chunked(path, SimplifyParams(triangles=wanted)).mesh.triangles) in (
        wanted - 1,
        wanted,
    )


@pytest.mark.slow
def test_bounds_are_proven_for_the_whole_mesh(path: Path) -> None:
    given = read_ply(path)
    params = SimplifyParams(method="certified", max_shape=0.009)
    found = simplify_chunked(path, params)
    assert_same_manifold(found.mesh, given)
    details = found.to_dict()["details"]
    assert details["proven"]
    assert details["shape_bound_m"] <= 0.009
    # A separate proof compares the result with the input.
    assert certify(found.mesh, given, max_shape=0.009).within_limits
    in_one = len(simplify(given, params).mesh.triangles)
    assert in_one < len(found.mesh.triangles) < 2.5 * in_one


@pytest.mark.parametrize("params", [SimplifyParams(ratio=0.2), SimplifyParams(max_shape=0.02)])
def test_regions_that_remain_large_are_halved(
    path: Path, params: SimplifyParams, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simplify_in_pieces_module, "MAX_TRIANGLES_AT_ONCE", 1_500)
    given = read_ply(path)
    found = simplify_chunked(path, params)
    assert len(found.joined) > 2
    assert max(one["triangles_before"] for one in (*found.parts, *found.joined)) <= 1_500
    assert_same_manifold(found.mesh, given)
    if params.ratio is None:
        assert found.to_dict()["details"]["proven"]
        assert certify(found.mesh, given, max_shape=0.02).within_limits
    else:
        assert 0.198 < len(found.mesh.triangles) / len(given.triangles) <= 0.2


def test_a_resolution_is_refused(path: Path) -> None:
    with pytest.raises(UsageError, match=r"jia01\.resolution is not supported for a mesh that is too large"):
        simplify_chunked(path, SimplifyParams(jia01=Jia01Params(resolution=0.1)))


@pytest.mark.slow
def test_without_options_the_result_fits_in_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = simplify_chunked(path, SimplifyParams())
    assert free.diagnostics == ()
    monkeypatch.setattr(simplify_in_pieces_module, "MAX_IN_MEMORY_TRIANGLES", 1_200)
    assert len(free.mesh.triangles) > 1_200
    assert_same_manifold(free.mesh, read_ply(path))
    found = simplify_chunked(path, SimplifyParams())
    assert len(found.mesh.triangles) <= 1_200
    assert any("default bounds" in str(one) and "1,200 are kept" in str(one) for one in found.diagnostics)
    # An explicit target is kept.
    asked = simplify_chunked(path, SimplifyParams(ratio=0.2))
    assert len(asked.mesh.triangles) > 1_200
    assert asked.diagnostics == ()


def test_a_floor_is_not_divided_along_its_plane() -> None:
    # Most triangles of a hall are on its floor, where the noise exceeds the triangle size.
    x, y = np.meshgrid(np.linspace(0, 4, 120), np.linspace(0, 3, 90))
    height = np.random.default_rng(0).normal(0, 0.05, x.shape)
    # The wall makes the hall higher than it is wide.
    height[:, 60] += 40
    at = (np.arange(119) + 120 * np.arange(89)[:, None]).ravel()
    sides = [np.stack([at, at + 1, at + 121], -1), np.stack([at, at + 121, at + 120], -1)]
    mesh = Mesh(np.stack([x, y, height], -1).reshape(-1, 3), np.concatenate(sides).astype(np.int32))
    parts = list(split_subset(make_full_subset(mesh), 6_000))
    assert max(len(part.mesh.triangles) for part in parts) <= 6_000
    assert sum(len(part.mesh.triangles) for part in parts) == len(mesh.triangles)
    assert np.mean(np.concatenate([part.is_shared for part in parts])) < 0.12


def test_coincident_triangles_are_divided_by_count() -> None:
    mesh = Mesh(np.zeros((300, 3)), np.arange(300, dtype=np.int32).reshape(-1, 3))
    assert sorted(len(part.mesh.triangles) for part in split_subset(make_full_subset(mesh), 30)) == [25] * 4


def test_colours_are_kept(path: Path) -> None:
    given = read_ply(path)
    found = simplify_chunked(path, SimplifyParams(ratio=0.3)).mesh
    assert found.colors is not None
    assert given.colors is not None
    assert np.abs(found.colors.mean(axis=0) - given.colors.mean(axis=0)).max() < 3


@pytest.mark.slow
def test_equal_input_gives_equal_bytes(path: Path) -> None:
    one, other = (simplify_chunked(path, SimplifyParams(ratio=0.2, threads=n)).mesh for n in (1, 2))
    assert (one.vertices == other.vertices).all()
    assert (one.triangles == other.triangles).all()


@pytest.mark.slow
def test_small_components_are_kept_with_a_diagnostic(path: Path) -> None:
    found = simplify_chunked(path, SimplifyParams(ratio=0.1, drop_below=0.5))
    assert any(str(one).startswith("drop_below has no effect") for one in found.diagnostics)
    np.testing.assert_array_equal(
        found.mesh.vertices, simplify_chunked(path, SimplifyParams(ratio=0.1)).mesh.vertices
    )
