"""Dropped islands: bounds hold for the kept mesh, and results are marked as one-sided."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scanloom.stages import InputError, Mesh, UsageError, lod, topology
from scanloom.stages.lod import Hierarchy
from scanloom.stages.surface.small_components import find_small_components
from tests.made.coloured_meshes import ball
from tests.stages.lod.test_build import (
    get_base_mesh,
    list_leaves,
    measure_max_distance,
    sample_surface,
    sort_triangle_corners,
)

SIZES = (0.02, 0.05, 0.08, 0.3)
ASKED = {"cell_triangles": 500, "root_triangles": 50}


def make_scattered_balls() -> tuple[Mesh, list[int]]:
    """Make a ball with ten small balls of each diameter in SIZES around it, and their triangle counts."""
    main = ball()
    random = np.random.default_rng(3)
    part = trimesh.creation.icosphere(subdivisions=1)
    vertices, triangles, colors = [main.vertices], [main.triangles], [main.colors]
    for size in SIZES:
        for _ in range(10):
            towards = random.normal(size=3)
            at = 3 * towards / np.linalg.norm(towards)
            triangles.append(np.asarray(part.faces) + sum(map(len, vertices)))
            vertices.append(part.vertices * size / 2 + at)
            colors.append(random.integers(256, size=(len(part.vertices), 3)).astype(np.uint8))
    mesh = Mesh(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int32),
        colors=np.concatenate(colors),
    )
    return mesh, [len(main.triangles), *(len(part.faces) for _ in SIZES)]


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return make_scattered_balls()[0]


@pytest.fixture(scope="module")
def dropped(mesh: Mesh) -> Hierarchy:
    """Build levels without the two smallest sizes, whose boxes have diagonals of 0.035 and 0.087."""
    return lod.build(mesh, drop_islands=0.1, **ASKED)


def test_small_components_are_dropped_and_counted(mesh: Mesh, dropped: Hierarchy) -> None:
    assert (dropped.dropped_islands, dropped.dropped_triangles) == (20, 20 * 80)
    assert dropped.input_triangles == len(mesh.triangles)
    kept = mesh.triangles[np.r_[: len(ball().triangles), len(mesh.triangles) - 20 * 80 : len(mesh.triangles)]]
    leaves = list_leaves(dropped, 0)
    np.testing.assert_array_equal(
        sort_triangle_corners(dropped.mesh(leaves, dropped.splits[leaves])),
        sort_triangle_corners(Mesh(mesh.vertices, kept)),
    )
    assert topology(dropped.cut(triangles=1).mesh).components == 21
    metrics = dropped.to_dict()
    result = [metrics[name] for name in ("one_sided", "dropped_islands", "dropped_triangles")]
    assert result == [True, 20, 1600]
    assert any(
        "20 connected components smaller than 0.1 m, with 1,600 triangles" in str(one)
        for one in dropped.diagnostics
    )


def test_bounds_hold_both_ways_for_the_kept_mesh_and_one_way_for_the_input(
    mesh: Mesh, dropped: Hierarchy
) -> None:
    for node in range(dropped.nodes):
        coarse, base = dropped.mesh([node], [0]), get_base_mesh(dropped, node)
        there, back = (
            measure_max_distance(sample_surface(coarse, 1500, node), base),
            measure_max_distance(sample_surface(base, 1500, node), coarse),
        )
        assert max(there, back) <= dropped.shape_bound[node] * (1 + 1e-9)
        assert measure_max_distance(sample_surface(coarse, 1500, node), mesh) <= dropped.shape_bound[node] * (
            1 + 1e-9
        )
    # The mark is required because dropped islands are far from every level.
    finest = dropped.cut(max_shape=0.0)
    assert finest.is_one_sided
    assert measure_max_distance(mesh.vertices, finest.mesh) > 100 * finest.shape_bound_m + 0.1


def test_dropping_islands_reduces_the_coarsest_level(mesh: Mesh, dropped: Hierarchy) -> None:
    whole = lod.build(mesh, **ASKED)
    assert not whole.is_one_sided
    assert not whole.cut(triangles=1).to_dict()["one_sided"]
    assert dropped.coarse[0] < whole.coarse[0] - 20 * 4 + 1


def test_without_small_components_nothing_changes() -> None:
    plain, asked = lod.build(ball(), **ASKED), lod.build(ball(), drop_islands=0.5, **ASKED)
    assert not asked.is_one_sided
    assert asked.diagnostics == plain.diagnostics
    np.testing.assert_array_equal(asked.triangles, plain.triangles)
    np.testing.assert_array_equal(asked.shape_bound, plain.shape_bound)


def test_the_size_is_the_box_diagonal_and_coincident_vertices_connect_triangles() -> None:
    corners = np.array([(0, 0, 0), (3, 0, 0), (0, 4, 0), (3, 4, 0)], float)
    # Two triangles that share an edge in space with separate vertices: a square of diagonal 5.
    mesh = Mesh(corners[[0, 1, 2, 2, 1, 3]], np.arange(6, dtype=np.int32).reshape(2, 3))
    assert [find_small_components(mesh, size)[1] for size in (5.0, 5.001)] == [0, 1]
    apart = Mesh(np.concatenate([mesh.vertices[:3], mesh.vertices[3:] + 10]), mesh.triangles)
    np.testing.assert_array_equal(find_small_components(apart, 5.001)[0], (True, True))
    assert find_small_components(apart, 5.001)[1] == 2


def test_dropping_everything_and_invalid_sizes_are_one_error() -> None:
    with pytest.raises(InputError, match="all connected components of the mesh are smaller than 100 m"):
        lod.build(ball(), drop_islands=100.0)
    with pytest.raises(UsageError, match="drop_islands"):
        lod.build(ball(), drop_islands=-1.0)


def test_the_file_and_the_tiles_store_that_bounds_are_one_sided(dropped: Hierarchy, tmp_path: Path) -> None:
    lod.write_slod(tmp_path / "m.slod", dropped)
    read = lod.read_slod(tmp_path / "m.slod")
    assert (read.dropped_islands, read.dropped_triangles, read.is_one_sided) == (20, 1600, True)
    assert read.to_dict() == dropped.to_dict()
    written = lod.write_tiles(read, tmp_path / "tiles")
    assert written.to_dict()["one_sided"]
    tree = json.loads((tmp_path / "tiles" / "tileset.json").read_text())
    about = tree["asset"]["extras"]
    assert (about["one_sided"], about["dropped_islands"], about["dropped_triangles"]) == (True, 20, 1600)
    todo = [tree["root"]]
    while todo:
        tile = todo.pop()
        assert tile["content"]["extras"]["one_sided"] is True
        todo += tile.get("children", [])


def test_two_sided_tiles_have_no_such_mark(tmp_path: Path) -> None:
    written = lod.write_tiles(lod.build(ball(), **ASKED), tmp_path / "tiles")
    assert not written.to_dict()["one_sided"]
    assert "one_sided" not in (tmp_path / "tiles" / "tileset.json").read_text()


def test_other_file_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.slod"
    lod.write_slod(path, lod.build(ball(), **ASKED))
    data = bytearray(path.read_bytes())
    for version in (1, 3):
        struct.pack_into("<I", data, 4, version)
        path.write_bytes(data)
        with pytest.raises(InputError, match=f"version {version}; this scanloom reads version 2"):
            lod.read_slod(path)
