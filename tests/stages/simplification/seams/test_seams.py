"""Method seams: promises of FENG12 for textured meshes, and additional bounds for the image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seamed_meshes import (
    count_duplicates,
    count_edges,
    count_outside_charts,
    find_charts,
    folded_strips,
    signed_areas,
    touching_parts,
    two_cubes,
    weld_corners,
    wrapped_ball,
)
from simplification_checks import assert_finite
from simplification_checks import assert_within_bounds as assert_near

from scanloom.stages import _kernels
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.codes import SIMPLIFY_IMAGES_KEPT
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.seams.similar_vertices import (
    group_equal_vertices,
    group_joinable_vertices,
)
from scanloom.stages.simplification.simplify import SimplifyParams, simplify
from scanloom.stages.surface.mesh import Material, Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.topology import has_repeated_vertex

DATA = Path(__file__).parents[5] / "shared" / "data" / "meshes"
TEXTURED = (
    "spot/spot_triangulated.obj",
    "ycb_banana/textured.obj",
    "bunny10k_textured",
    "fuze",
    "Duck.glb",
    "CesiumMilkTruck.glb",
    "pirate.obj",
)
TEN = (0.9, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05, 0.03)


def read_textured(name: str) -> Mesh:
    path = DATA / name
    if not path.exists():
        folder = path.parent if path.suffix else path
        found = sorted(folder.glob("*.obj")) if folder.is_dir() else []
        if not found:
            pytest.skip(f"{name} is not here")
        path = found[0]
    elif path.is_dir():
        path = sorted(path.glob("*.obj"))[0]
    return read_mesh(path)


def assert_sound(light: Mesh, source: np.ndarray, mesh: Mesh) -> None:
    """Check that the welded mesh has no new defects, and that no triangle flips in the image."""
    now, before = weld_corners(light), weld_corners(mesh)
    assert all(a <= b for a, b in zip(count_edges(now), count_edges(before), strict=True))
    assert count_duplicates(now) <= count_duplicates(before)
    assert (now[:, 0] != now[:, 1]).all()
    assert (now[:, 1] != now[:, 2]).all()
    assert (now[:, 2] != now[:, 0]).all()
    if light.texture is None or mesh.texture is None:
        return
    then, was = signed_areas(light.texture.uvs), signed_areas(mesh.texture.uvs)[source]
    assert (np.sign(then) == np.sign(was))[was != 0].all()
    np.testing.assert_array_equal(light.texture.material_ids, mesh.texture.material_ids[source])


def list_corner_attributes(mesh: Mesh) -> np.ndarray:
    assert mesh.texture is not None
    return np.concatenate([mesh.vertices[mesh.triangles], mesh.texture.uvs], axis=2)


# -- real models -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTURED)
def test_ten_triangle_counts_of_a_real_model_are_sound_and_stay_in_their_charts(name: str) -> None:
    mesh = read_textured(name)
    result = simplify(mesh, method="seams", ratio=TEN[-1], record=True)
    assert result.record is not None
    for ratio in TEN:
        # A collapse at a boundary removes one triangle, any other collapse two.
        wanted = max(int(ratio * len(mesh.triangles)), len(result.mesh.triangles))
        replayed = result.record.replay(triangles=wanted)
        assert wanted - 1 <= len(replayed.mesh.triangles) <= wanted
        assert_sound(replayed.mesh, replayed.triangle_source, mesh)
        if ratio in (0.5, 0.12, 0.03):
            assert count_outside_charts(replayed.mesh, replayed.triangle_source, mesh) == 0


def test_the_chart_check_detects_a_coordinate_outside() -> None:
    mesh = folded_strips()
    assert mesh.texture is not None
    everything = np.arange(len(mesh.triangles), dtype=np.int32)
    assert count_outside_charts(mesh, everything, mesh) == 0
    uvs = mesh.texture.uvs.copy()
    uvs[0, 0] -= 0.01
    moved = mesh.with_(texture=Texture(uvs, mesh.texture.material_ids, mesh.texture.materials))
    assert count_outside_charts(moved, everything, mesh) == 1


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_fragmented_surface_keeps_the_promise(seed: int) -> None:
    """A ball with holes is cut into random charts, with exact or approximate copies of its parts."""
    rng = np.random.default_rng(seed)
    mesh = wrapped_ball(int(rng.integers(4, 10)), int(rng.integers(5, 14)), bumps=0.1)
    assert mesh.texture is not None
    kept = np.flatnonzero(rng.random(len(mesh.triangles)) < rng.choice([0.85, 1.0]))
    mesh = mesh.with_triangles(mesh.triangles[kept], kept)
    count = len(kept)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    centres = rng.standard_normal((int(rng.integers(1, 8)), 3))
    chart = np.argmax(middle @ centres.T, axis=1)
    if rng.random() < 0.3:
        chart = rng.integers(0, 4, count)
    assert mesh.texture is not None
    uvs = mesh.texture.uvs + rng.random((8, 2))[chart][:, None]
    mirrored = rng.random(8)[chart] < 0.3
    uvs[mirrored] *= [-1, 1]
    uvs[rng.random(count) < rng.choice([0.0, 0.1])] = 0
    ids = rng.integers(-1, 2, 8)[chart].astype(np.int32)
    vertices, triangles = mesh.vertices, mesh.triangles
    if rng.random() < 0.6:
        # A separate copy of a vertex for each chart, as in files.
        pairs, corners = np.unique(
            np.column_stack([triangles.reshape(-1), np.repeat(chart, 3)]), axis=0, return_inverse=True
        )
        vertices, triangles = vertices[pairs[:, 0]], corners.reshape(-1, 3).astype(np.int32)
        if rng.random() < 0.3:
            vertices = vertices + rng.normal(0, 1e-7, vertices.shape)
    if rng.random() < 0.2:
        # A partial copy of the surface at almost the same position.
        again = np.flatnonzero(rng.random(count) < rng.choice([0.1, 0.5]))
        triangles = np.concatenate([triangles, triangles[again] + np.int32(len(vertices))])
        vertices = np.concatenate([vertices, vertices + 3e-7])
        uvs, ids = np.concatenate([uvs, uvs[again]]), np.concatenate([ids, ids[again]])
    cut = Mesh(vertices, triangles, texture=Texture(uvs, ids, (Material("a"), Material("b"))))
    result = simplify(
        cut, method="seams", ratio=float(rng.uniform(0.02, 0.9)), record=True, fit=rng.random() < 0.5
    )
    assert result.record is not None
    assert_sound(result.mesh, result.triangle_source, cut)
    assert count_outside_charts(result.mesh, result.triangle_source, cut) == 0
    for collapses in rng.integers(0, len(result.record.removed) + 1, 3):
        replayed = result.record.replay(collapses=int(collapses))
        assert_sound(replayed.mesh, replayed.triangle_source, cut)


# -- figure 3 of the paper -------------------------------------------------------------------------------


def test_figure_3_plain_quadrics_tear_a_cut_sheet_and_two_sided_collapses_do_not() -> None:
    mesh = folded_strips()
    rim = count_edges(weld_corners(mesh))[0]
    goal = len(mesh.triangles) // 2
    # The kernel of plain quadrics gets the vertex copies of the file, without welding.
    kernel = _kernels.simplify_by_quadrics(
        mesh.vertices,
        np.zeros((len(mesh.vertices), 0), np.uint8),
        mesh.triangles,
        np.zeros(len(mesh.vertices), bool),
        np.zeros(0),
        weight=0.0,
        running=_kernels.RunSettings(
            target_triangles=goal, threads=1, region_triangles=8192, record=False, partial=False
        ),
        progress=lambda _done, _total: True,
    )
    torn = Mesh(kernel.vertices, kernel.triangles)
    assert count_edges(weld_corners(torn))[0] > rim
    # Methods weld the copies first.
    asked: dict[str, dict[str, Any]] = {
        "quadric": {"triangles": goal},
        "certified": {"triangles": goal, "max_shape": 0.02},
        "jia01": {},
        "planar": {},
    }
    for method, how_far in asked.items():
        seen = simplify(mesh.with_(texture=None), SimplifyParams(method=method, **how_far))
        assert count_edges(weld_corners(seen.mesh))[0] <= rim, method
    whole = simplify(mesh, method="seams", triangles=goal)
    assert count_edges(weld_corners(whole.mesh))[0] <= rim
    assert_sound(whole.mesh, whole.triangle_source, mesh)
    # Both sides of the cut end at the same vertices, with separate coordinates.
    assert len(np.unique(find_charts(whole.mesh))) == 2


@pytest.mark.parametrize("doubled", [(4, 7), (3, 4, 7), (4, 7, 8), (3, 4, 7, 8)])
def test_figure_3_one_collapse_next_to_doubled_vertices(doubled: tuple[int, ...]) -> None:
    """The star of the edge 4–7 in a sheet of 3 × 4 vertices; vertices below the cut have copies."""
    points = np.array([[x, y, 0.02 * ((3 * x + 5 * y) % 4)] for y in range(4) for x in range(3)], float)
    triangles = [[a, b, c] for y in range(3) for x in range(2) for a, b, c in _split_quad(3 * y + x)]
    # Triangles on one side of the cut use the copies.
    copies = {v: 12 + i for i, v in enumerate(doubled)}
    left = {i for i, t in enumerate(triangles) if points[t, 0].mean() < 1}
    named = [[copies.get(v, v) if i in left else v for v in t] for i, t in enumerate(triangles)]
    vertices = np.vstack([points, points[list(doubled)]])
    flat = vertices[:, :2] / 8
    flat[12:] += [0.5, 0.5]
    uvs = flat[np.array(named)]
    texture = Texture(uvs, np.zeros(len(named), np.int32), (Material("m"),))
    mesh = Mesh(vertices, np.array(named, np.int32), texture=texture)
    for goal in range(len(named) - 1, 4, -1):
        result = simplify(mesh, method="seams", triangles=goal)
        assert_sound(result.mesh, result.triangle_source, mesh)
        assert count_outside_charts(result.mesh, result.triangle_source, mesh) == 0


def _split_quad(corner: int) -> list[list[int]]:
    a, b, c, d = corner, corner + 1, corner + 4, corner + 3
    return [[a, b, c], [a, c, d]]


# -- seams -----------------------------------------------------------------------------------------------


def test_a_straight_seam_stays_straight_in_the_image() -> None:
    mesh = wrapped_ball()
    result = simplify(mesh, ratio=0.1, seams={"max_seam_drift": 0})
    assert result.method == "seams"
    assert count_edges(weld_corners(result.mesh)) == (0, 0)
    assert result.mesh.texture is not None
    border = _find_border(result.mesh, np.ones(len(result.mesh.triangles), bool))
    # Poles are excluded, because their coordinates are cut into the image from above and below.
    u, v = border[..., 0], border[..., 1]
    between = ((v > 1 / 23.5) & (v < 1 - 1 / 23.5)).any(axis=1)
    assert np.isin(u[between], (0.0, 1.0)).all()
    # The border reaches from bottom to top on both sides of the image.
    for side in (0.0, 1.0):
        assert np.abs(np.diff(v[(u == side).all(axis=1)])).sum() == pytest.approx(1 - 2 / 24)
    assert_sound(result.mesh, result.triangle_source, mesh)
    assert count_outside_charts(result.mesh, result.triangle_source, mesh) == 0


@pytest.mark.parametrize("bound", [0.0, 0.002, 0.02])
def test_seams_stay_within_the_bound_in_the_image(bound: float) -> None:
    mesh = read_textured("Duck.glb")
    assert mesh.texture is not None
    side = max(mesh.texture.images[0].size or ())
    result = simplify(mesh, ratio=0.05, method="seams", seams={"max_seam_drift": bound * side})
    assert result.details.seam_drift_texels == pytest.approx(result.details.seam_drift * side)
    assert result.details.seam_drift is not None
    assert result.details.seam_drift <= bound
    assert result.mesh.texture is not None
    assert mesh.texture is not None
    of, now = find_charts(mesh), find_charts(mesh)[result.triangle_source]
    for chart in np.unique(now):
        seams = _find_border(result.mesh, now == chart)
        points = _find_border(mesh, of == chart).reshape(-1, 2)
        assert _measure_distances(points, seams).max() <= result.details.seam_drift + 1e-9


def _find_border(mesh: Mesh, chosen: np.ndarray) -> np.ndarray:
    """Find the edges (k, 2, 2) in the image that belong to only one of the chosen triangles."""
    assert mesh.texture is not None
    uvs = mesh.texture.uvs[chosen]
    sides = np.stack([uvs, np.roll(uvs, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    flip = (sides[:, 0, 0] > sides[:, 1, 0]) | (
        (sides[:, 0, 0] == sides[:, 1, 0]) & (sides[:, 0, 1] > sides[:, 1, 1])
    )
    key = np.where(flip[:, None, None], sides[:, ::-1], sides)
    unique, counts = np.unique(key.reshape(-1, 4), axis=0, return_counts=True)
    return unique[counts == 1].reshape(-1, 2, 2)


def _measure_distances(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    a, b = segments[:, 0], segments[:, 1]
    along = b - a
    t = ((points[:, None] - a) * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-300)
    nearest = a + np.clip(t, 0, 1)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1))


def test_without_collapses_everything_is_kept_exactly() -> None:
    for mesh in (wrapped_ball(8, 10), folded_strips()):
        result = simplify(mesh, method="seams", ratio=1.0)
        assert result.collapses == 0
        np.testing.assert_array_equal(list_corner_attributes(result.mesh), list_corner_attributes(mesh))


def test_results_are_deterministic_and_the_promise_holds_for_any_triangle_order() -> None:
    mesh = wrapped_ball()
    one, other = (simplify(mesh, ratio=0.2, keep_uv=True) for _ in range(2))
    np.testing.assert_array_equal(list_corner_attributes(one.mesh), list_corner_attributes(other.mesh))
    rng = np.random.default_rng(3)
    order = rng.permutation(len(mesh.triangles))
    shuffled = mesh.with_triangles(mesh.triangles[order], order)
    result = simplify(shuffled, ratio=0.2, keep_uv=True)
    assert_sound(result.mesh, result.triangle_source, shuffled)


# -- attributes of corners -------------------------------------------------------------------------------


def test_different_colours_of_vertex_copies_stay_separate() -> None:
    mesh = folded_strips(24, 9)
    colors = np.where(np.arange(len(mesh.vertices))[:, None] < 24 * 5, [250, 20, 20], [20, 20, 250])
    painted = mesh.with_(colors=colors.astype(np.uint8))
    result = simplify(painted, ratio=0.2)
    assert result.mesh.colors is not None
    assert set(map(tuple, result.mesh.colors.tolist())) == {(250, 20, 20), (20, 20, 250)}
    positions, counts = np.unique(result.mesh.vertices, axis=0, return_counts=True)
    assert counts.max() == 2
    assert np.abs(positions[counts == 2][:, 1] - 4).max() < 0.01


def test_corner_normals_follow_sharp_edges() -> None:
    cubes = two_cubes(1.0)
    corners = cubes.vertices[cubes.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = cubes.with_(corner_normals=np.repeat(normals[:, None], 3, axis=1))
    result = simplify(mesh, method="seams", triangles=24)
    light = result.mesh
    assert len(light.triangles) == 24
    assert light.corner_normals is not None
    corners = light.vertices[light.triangles]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(light.corner_normals, np.repeat(flat[:, None], 3, axis=1), atol=1e-6)


def test_a_palette_texture_with_zero_area_is_kept() -> None:
    mesh = wrapped_ball()
    assert mesh.texture is not None
    north = mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0
    uvs = np.where(north[:, None, None], [0.25, 0.25], [0.75, 0.25]) + np.zeros((len(north), 3, 2))
    palette = mesh.with_(texture=Texture(uvs, mesh.texture.material_ids, mesh.texture.materials))
    result = simplify(palette, ratio=0.1)
    assert result.stopped_by == "triangles"
    assert result.mesh.texture is not None
    assert {tuple(uv) for uv in result.mesh.texture.uvs.reshape(-1, 2).tolist()} == {
        (0.25, 0.25),
        (0.75, 0.25),
    }
    assert count_edges(weld_corners(result.mesh)) == (0, 0)


# -- similar vertices and parameters of the paper --------------------------------------------------------


def test_similar_sets_are_chains_of_close_vertices() -> None:
    vertices = np.array([[0, 0, 0], [5, 0, 0], [0.9, 0, 0], [1.8, 0, 0], [5, 0, 0], [9, 9, 9]], float)
    none = np.zeros((0, 3), np.int32)
    assert group_equal_vertices(vertices).tolist() == [0, 1, 2, 3, 1, 4]
    assert group_joinable_vertices(vertices, none, 0.0)[0].tolist() == [0, 1, 2, 3, 1, 4]
    sets, positions, _ = group_joinable_vertices(vertices, none, 1.0)
    assert sets.tolist() == [0, 1, 0, 0, 1, 2]
    np.testing.assert_allclose(positions[[0, 2, 3]], [[0.9, 0, 0]] * 3)
    np.testing.assert_array_equal(positions[[1, 4, 5]], vertices[[1, 4, 5]])
    # The ends of an edge are not copies of each other.
    edge = np.array([[0, 2, 5]], np.int32)
    assert group_joinable_vertices(vertices, edge, 1.0)[0].tolist() == [0, 1, 2, 2, 1, 3]


def test_a_chain_is_joined_only_if_no_vertex_moves_farther_than_the_distance() -> None:
    vertices = np.zeros((6, 3))
    vertices[:, 0] = 0.9 * np.arange(6)
    none = np.zeros((0, 3), np.int32)
    sets, positions, _ = group_joinable_vertices(vertices, none, 1.0)
    assert len(np.unique(sets)) == 6
    np.testing.assert_array_equal(positions, vertices)
    assert group_joinable_vertices(vertices, none, 3.0)[0].tolist() == [0] * 6


def count_components(light: Mesh) -> int:
    """Count the connected components of a mesh after welding equal positions."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    t = weld_corners(light)
    ends = t[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(t.max() + 1,) * 2)
    return int(connected_components(links, directed=False)[0])


def test_similar_distance_closes_cracks_between_parts() -> None:
    mesh = folded_strips(24, 9)
    cracked = mesh.vertices.copy()
    upper = np.arange(len(cracked)) >= 24 * 5
    cracked[upper, 1] += 0.05
    mesh = mesh.with_(vertices=cracked)
    apart = simplify(mesh, method="seams", ratio=0.3)
    assert count_components(apart.mesh) == 2
    assert apart.details.joined_vertices == 0
    joined = simplify(mesh, method="seams", ratio=0.3, seams={"similar_distance": 0.1})
    assert count_components(joined.mesh) == 1
    assert joined.details.joined_vertices == 24
    assert count_edges(weld_corners(joined.mesh))[1] == 0


def test_similar_distance_keeps_opposite_walls_separate() -> None:
    mesh = two_cubes(gap=1e-3)
    light = simplify(mesh, method="seams", ratio=0.3, seams={"similar_distance": 2e-3})
    assert count_components(light.mesh) == 2
    assert light.stopped_by == "triangles"
    assert count_edges(weld_corners(light.mesh)) == (0, 0)


@pytest.mark.slow
@given(seed=st.integers(0, 1 << 16), gap=st.floats(-8, -1.5), distance=st.floats(0, 0.2))
@settings(max_examples=60, deadline=None)
def test_no_distance_creates_edges_with_more_than_two_triangles(
    seed: int, gap: float, distance: float
) -> None:
    mesh = touching_parts(np.random.default_rng(seed), 10**gap)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    before = count_edges(weld_corners(mesh))[1]
    for ratio in (1.0, 0.3):
        try:
            light = simplify(
                mesh, method="seams", ratio=ratio, seams={"similar_distance": distance * diagonal}
            ).mesh
        except UsageError:  # the distance is larger than many edges
            return
        t = weld_corners(light)
        assert not has_repeated_vertex(t).any()
        if len(t):
            assert count_edges(t)[1] <= before
        assert_finite(light)
        if ratio == 1.0:
            assert_near(light, mesh, max_shape=distance * diagonal)


def test_almost_touching_parts_stay_separate_and_almost_equal_copies_are_joined() -> None:
    nearly = 1e-7
    cubes = two_cubes(gap=nearly)
    sets, positions, apart = group_joinable_vertices(cubes.vertices, cubes.triangles, 2 * nearly)
    np.testing.assert_array_equal(positions, cubes.vertices)
    assert len(np.unique(sets)) == len(np.unique(cubes.vertices, axis=0))
    facing = np.isclose(cubes.vertices[:, 0], 0.5, atol=1e-5)
    np.testing.assert_array_equal(apart, facing)
    light = simplify(cubes, method="seams", ratio=0.3)
    assert count_edges(weld_corners(light.mesh)) == (0, 0)
    assert count_duplicates(weld_corners(light.mesh)) == 0

    # The second copy of the middle row has a rounding error; the sheet is still connected.
    sheet = folded_strips()
    vertices = sheet.vertices.copy()
    copies = np.setdiff1d(np.arange(len(vertices)), np.unique(vertices, axis=0, return_index=True)[1])
    vertices[copies] += nearly
    shaken = sheet.with_(vertices=vertices)
    assert count_edges(weld_corners(shaken))[0] > count_edges(weld_corners(sheet))[0]
    assert not group_joinable_vertices(vertices, sheet.triangles, 2 * nearly)[2].any()
    light = simplify(shaken, ratio=0.3, keep_uv=True)
    assert light.details.joined_vertices == len(copies)
    assert count_edges(weld_corners(light.mesh))[0] <= count_edges(weld_corners(sheet))[0]


def test_auto_selects_seams_if_only_seams_keeps_the_attributes() -> None:
    mesh = two_cubes(gap=0.5)
    assert simplify(mesh, ratio=0.3).method == "seams"
    plain = Mesh(mesh.vertices, mesh.triangles)
    assert simplify(plain, ratio=0.3).method == "quadric"
    one_part = plain.with_(part_ids=np.zeros(len(plain.triangles), np.int32), part_names=("box",))
    assert simplify(one_part, ratio=0.3).method == "quadric"
    colored = Texture(
        np.zeros((len(mesh.triangles), 3, 2)),
        np.repeat([0, 1], len(mesh.triangles) // 2).astype(np.int32),
        (Material("red", base_color=(1, 0, 0, 1)), Material("blue", base_color=(0, 0, 1, 1))),
    )
    light = simplify(plain.with_(texture=colored), ratio=0.3)
    assert light.method == "seams"
    assert light.mesh.texture is not None
    left = light.mesh.vertices[light.mesh.triangles].mean(axis=1)[:, 0] < 0.75
    np.testing.assert_array_equal(light.mesh.texture.material_ids, np.where(left, 0, 1))
    corners = np.broadcast_to([0.0, 0.0, 1.0], (len(mesh.triangles), 3, 3)).copy()
    assert simplify(plain.with_(corner_normals=corners), ratio=0.3).method == "seams"


def test_a_part_border_penalty_keeps_vertices_on_the_border() -> None:
    mesh = wrapped_ball(rings=40, sectors=40, bumps=0.1)
    parts = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0).astype(np.int32)
    halves = mesh.with_(part_ids=parts, part_names=("back", "front"))

    def count_on_border(**changes: Any) -> int:
        result = simplify(halves, method="seams", ratio=0.1, **changes)
        t = result.mesh.triangles
        by_part = [set(t[result.mesh.part_ids == part].reshape(-1).tolist()) for part in (0, 1)]
        return len(by_part[0] & by_part[1])

    assert count_on_border(seams={"part_border_penalty": 1000}) > count_on_border(
        seams={"part_border_penalty": 0}
    )


def test_a_material_border_penalty_keeps_vertices_on_the_border() -> None:
    mesh = wrapped_ball(rings=40, sectors=40, bumps=0.1)
    ids = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0).astype(np.int32)
    assert mesh.texture is not None
    (material,) = mesh.texture.materials
    texture = Texture(mesh.texture.uvs, ids, (material, Material("other", material.image)))
    halves = mesh.with_(texture=texture)

    def count_on_border(penalty: float) -> int:
        result = simplify(halves, method="seams", ratio=0.1, seams={"material_border_penalty": penalty}).mesh
        assert result.texture is not None
        here, there = (np.unique(result.triangles[result.texture.material_ids == k]) for k in (0, 1))
        return len(np.intersect1d(here, there))

    counts = [count_on_border(penalty) for penalty in (0, 10, 1000)]
    assert counts[0] < counts[1] < counts[2]


def test_a_duplicate_penalty_keeps_duplicated_vertices() -> None:
    mesh = wrapped_ball(rings=40, sectors=40, bumps=0.1)

    def count_duplicated(penalty: float) -> int:
        light = simplify(mesh, method="seams", ratio=0.1, seams={"duplicate_penalty": penalty}).mesh
        assert light.texture is not None
        corners = light.triangles.reshape(-1)
        rows = np.column_stack([corners, np.round(light.texture.uvs.reshape(-1, 2), 9)])
        _, copies = np.unique(np.unique(rows, axis=0)[:, 0], return_counts=True)
        return int((copies > 1).sum())

    counts = [count_duplicated(penalty) for penalty in (0, 10, 1000)]
    assert counts[0] < counts[1] < counts[2]


def test_the_shape_weight_keeps_the_shape_next_to_seams() -> None:
    mesh = wrapped_ball(rings=40, sectors=40, bumps=0.1)
    is_seam = (np.abs(mesh.vertices[:, 1]) < 1e-9) & (mesh.vertices[:, 0] > 0)
    assert 30 < is_seam.sum() < 50

    def measure_distances(weight: float) -> np.ndarray:
        light = simplify(mesh, method="seams", ratio=0.05, seams={"shape_weight": weight}).mesh
        surface = RaycastingSurface(light, np.array([[-2.0] * 3, [2.0] * 3]))
        return surface.find_closest_points(mesh.vertices).distances

    light, heavy = measure_distances(0), measure_distances(1000)
    assert np.sqrt((heavy[is_seam] ** 2).mean()) < 0.5 * np.sqrt((light[is_seam] ** 2).mean())
    # At an equal triangle count, the rest of the surface has a larger error.
    assert np.sqrt((heavy[~is_seam] ** 2).mean()) > np.sqrt((light[~is_seam] ** 2).mean())


def test_importance_keeps_triangles_at_important_vertices() -> None:
    mesh = wrapped_ball(rings=40, sectors=40, bumps=0.1)
    upper = mesh.vertices[:, 2] > 0

    def share_above(**changes: Any) -> float:
        light = simplify(mesh, method="seams", ratio=0.1, **changes)
        assert_sound(light.mesh, light.triangle_source, mesh)
        return float((light.mesh.vertices[light.mesh.triangles].mean(axis=1)[:, 2] > 0).mean())

    assert share_above(importance=np.where(upper, 50.0, 1.0)) > 1.25 * share_above()
    np.testing.assert_array_equal(
        simplify(mesh, ratio=0.1, importance=np.full(len(upper), 1.0)).mesh.vertices,
        simplify(mesh, ratio=0.1).mesh.vertices,
    )


def test_a_valence_penalty_reduces_high_valences() -> None:
    mesh = folded_strips(40, 41)

    def sum_valences_above_eight(**changes: Any) -> int:
        light = simplify(mesh, method="seams", ratio=0.2, **changes).mesh
        return int(np.maximum(np.bincount(weld_corners(light).reshape(-1)) - 8, 0).sum())

    assert sum_valences_above_eight(seams={"valence_penalty": 10}) < sum_valences_above_eight(
        seams={"valence_penalty": 0}
    )


def test_material_borders_are_kept() -> None:
    mesh = wrapped_ball()
    assert mesh.texture is not None
    ids = (mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0).astype(np.int32)
    two = Texture(mesh.texture.uvs, ids, (*mesh.texture.materials, Material("other")))
    result = simplify(mesh.with_(texture=two), ratio=0.1, keep_uv=True)
    assert_sound(result.mesh, result.triangle_source, mesh.with_(texture=two))
    assert result.mesh.texture is not None
    border = set.intersection(
        *(
            set(result.mesh.triangles[result.mesh.texture.material_ids == i].reshape(-1).tolist())
            for i in (0, 1)
        )
    )
    assert len(border) >= 3
    # Materials meet at the equator, also in the simplified mesh.
    assert np.abs(result.mesh.vertices[list(border), 2]).max() < 0.15


def test_locked_vertices_are_kept() -> None:
    mesh = wrapped_ball()
    locked = np.flatnonzero(mesh.vertices[:, 2] > 0.8)
    result = simplify(mesh, ratio=0.2, lock=locked)
    kept = {tuple(v) for v in result.mesh.vertices.tolist()}
    assert {tuple(v) for v in mesh.vertices[locked].tolist()} <= kept


# -- selection and refusal --------------------------------------------------------------------------------


def test_double_faces_are_kept_with_a_warning_and_a_remedy() -> None:
    mesh = folded_strips(20, 11)
    assert mesh.texture is not None
    back = mesh.triangles[:, ::-1]
    both = Mesh(
        mesh.vertices,
        np.concatenate([mesh.triangles, back]),
        texture=mesh.texture.select_triangles(np.tile(np.arange(len(back)), 2)),
    )
    result = simplify(both, ratio=0.2)
    # Without collapses, all corners are unchanged.
    np.testing.assert_array_equal(result.mesh.vertices[result.mesh.triangles], both.vertices[both.triangles])
    assert len(result.mesh.vertices) <= len(both.vertices)
    kept, warning, unmet = result.diagnostics
    assert kept.code == SIMPLIFY_IMAGES_KEPT.name
    assert "double faces" in str(warning)
    assert unmet.severity == Severity.UNMET
    light = simplify(clean(both).mesh, ratio=0.2)
    assert light.stopped_by == "triangles"
    assert light.diagnostics == (kept,)


def test_a_distant_vertex_does_not_join_all_other_vertices() -> None:
    ball = wrapped_ball(8, 10)
    far = len(ball.vertices)
    vertices = np.concatenate([ball.vertices, [[4e9, 0, 0]]])
    triangles = np.concatenate([ball.triangles, np.array([[0, 1, far]], np.int32)])
    mesh = ball.with_triangles(triangles, np.append(np.arange(len(ball.triangles)), 0)).with_(
        vertices=vertices
    )
    light = simplify(mesh, method="seams", ratio=0.5)
    assert light.details.similar_distance_m < 0.01
    assert 0.4 * len(triangles) < len(light.mesh.triangles) <= 0.5 * len(triangles)


def test_auto_selects_seams_for_kept_texture_coordinates_and_parameters_of_seams() -> None:
    mesh = wrapped_ball(8, 10)
    assert simplify(mesh, ratio=0.5, keep_uv=True).method == "seams"
    assert simplify(mesh, ratio=0.5, seams={"max_seam_drift": 0.05}).method == "seams"
    assert simplify(mesh, ratio=0.5, record=True).method == "seams"
    assert simplify(mesh, ratio=0.5, bake=True).method == "quadric"
    assert simplify(mesh.with_(texture=None), ratio=0.5).method == "quadric"
    assert simplify(mesh.with_(texture=None), ratio=0.5, seams={"similar_distance": 0.0}).method == "seams"
    assert simplify(mesh, max_shape=0.05).method == "certified"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"method": "seams"}, "needs a triangle count"),
        ({"method": "seams", "ratio": 0.5, "max_shape": 0.1}, "max_shape is not supported by method seams"),
        (
            {"method": "quadric", "ratio": 0.5, "seams": {"part_border_penalty": 1.0}},
            "part_border_penalty is not supported",
        ),
        ({"ratio": 0.5, "seams": {"texture_weight": -1.0}}, "texture_weight"),
        ({"ratio": 0.5, "seams": {"similar_distance": 5.0}}, "similar_distance is 5 m, far more"),
    ],
)
def test_unsupported_parameters_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        simplify(wrapped_ball(), **changes)


def test_several_sheets_at_an_edge_stay_connected() -> None:
    """Three sheets share an edge, each with separate copies of its vertices."""
    n = 9
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    at = np.arange(n * n).reshape(n, n)
    squares = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=2).reshape(-1, 4)
    one = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    turned = [(x.ravel() * np.cos(angle), x.ravel() * np.sin(angle), y.ravel()) for angle in (0, 2, 4)]
    vertices = np.concatenate([np.column_stack(sheet) for sheet in turned])
    triangles = np.concatenate([one + i * n * n for i in range(3)]).astype(np.int32)
    mesh = Mesh(vertices, triangles)
    result = simplify(mesh, method="seams", ratio=0.2)
    assert_sound(result.mesh, result.triangle_source, mesh)
    on_axis = np.unique(result.mesh.vertices[np.abs(result.mesh.vertices[:, :2]).max(axis=1) == 0], axis=0)
    assert len(on_axis) == n


@pytest.mark.parametrize("name", ["bunny_nonmanifold.ply", "cow_nonmanifold.off", "moebius.obj", "fan3.obj"])
def test_broken_files_give_a_result_that_is_no_worse(name: str) -> None:
    path = DATA.parent / "broken" / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    mesh = read_mesh(path)
    result = simplify(mesh, method="seams", ratio=0.3)
    assert_sound(result.mesh, result.triangle_source, mesh)


def test_a_mesh_without_triangles_is_accepted() -> None:
    result = simplify(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), method="seams", ratio=0.5)
    assert len(result.mesh.triangles) == 0


# -- the progressive record ------------------------------------------------------------------------------


def simplify_with_record() -> tuple[Mesh, SimplificationResult, CollapseRecord]:
    mesh = folded_strips(24, 9)
    colors = np.arange(3 * len(mesh.vertices)).reshape(-1, 3) % 256
    mesh = mesh.with_(colors=colors.astype(np.uint8), part_ids=None)
    result = simplify(mesh, ratio=0.1, record=True, fit=False)
    assert result.record is not None
    return mesh, result, result.record


def assert_equal(one: Mesh, other: Mesh) -> None:
    np.testing.assert_array_equal(list_corner_attributes(one), list_corner_attributes(other))
    np.testing.assert_array_equal(one.triangles, other.triangles)
    np.testing.assert_array_equal(one.colors, other.colors)


def test_the_record_replays_to_the_result_and_to_every_intermediate_mesh() -> None:
    mesh, result, record = simplify_with_record()
    assert_equal(record.replay().mesh, result.mesh)
    assert_equal(record.replay(collapses=0).mesh, simplify(mesh, method="seams", ratio=1.0).mesh)
    for collapses in range(0, len(record.removed) + 1, 7):
        replayed = record.replay(collapses=collapses)
        assert len(replayed.mesh.triangles) == record.count_triangles_after(collapses)
        assert_sound(replayed.mesh, replayed.triangle_source, mesh)
    # The default weight of colours depends on the ratio.
    weight = result.details.attribute_scale_m_per_level
    stopped = simplify(mesh, method="seams", ratio=0.4, fit=False, attribute_scale=weight)
    assert_equal(record.replay(ratio=0.4).mesh, stopped.mesh)
    with pytest.raises(UsageError, match="the record ends at"):
        record.replay(triangles=1)
