"""Repairs: planted defects are repaired or reported, other data is bit-identical, and the bound holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanloom import Mesh, MeshError, RepairResult, UsageError, check, clean, repair
from scanloom.stages.cleaning.check import CLASSES
from scanloom.stages.cleaning.repairs.editable_mesh import GONE, EditableMesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.texture import Image, Material, Texture
from tests.made.coloured_meshes import MESHES, ball, sheet

PLANTS = ("cap", "needle", "fold", "flat", "repeating", "duplicate")
# Defect class of each planted defect. The triangle of a fold overlaps its neighbour, so it may also count as
# that class.
CLASS_OF = {
    "cap": "caps",
    "needle": "needles",
    "fold": "sharp_edges",
    "flat": "degenerate_triangles",
    "repeating": "degenerate_triangles",
    "duplicate": "duplicate_triangles",
}


def make_plain_sheet() -> Mesh:
    return sheet(12, noise=0, height=0)


def split_triangle(mesh: Mesh, row: int, weights: tuple[float, float, float]) -> Mesh:
    """Split a triangle at a new vertex with barycentric weights, which may be outside the triangle."""
    a, b, c = mesh.triangles[row]
    new = len(mesh.vertices)
    share = np.array(weights)
    triangles = mesh.triangles.copy()
    triangles[row] = (a, b, new)
    more = np.array([[b, c, new], [c, a, new]], np.int32)
    source = np.concatenate((np.arange(len(mesh.triangles)), [row, row]))
    uvs = None
    if mesh.texture is not None:
        corner_a, corner_b, corner_c = given = mesh.texture.uvs[row]
        middle = share @ given
        uvs = mesh.texture.uvs[source]
        uvs[row] = (corner_a, corner_b, middle)
        uvs[-2:] = ((corner_b, corner_c, middle), (corner_c, corner_a, middle))
    place = share @ mesh.vertices[mesh.triangles[row]]
    colors = None if mesh.colors is None else np.concatenate((mesh.colors, [[9, 99, 199]])).astype(np.uint8)
    grown = mesh.with_(
        vertices=np.concatenate((mesh.vertices, [place])),
        colors=colors,
        normals=None if mesh.normals is None else np.concatenate((mesh.normals, [[0, 0, 1.0]])),
    )
    return grown.with_triangles(np.concatenate((triangles, more)), source, uvs=uvs)


def plant_defect(mesh: Mesh, plant: str, row: int) -> Mesh:
    a, b, c = mesh.triangles[row].tolist()
    match plant:
        case "cap":
            return split_triangle(mesh, row, (0.498, 0.498, 0.004))
        case "needle":
            return split_triangle(mesh, row, (0.99, 0.005, 0.005))
        case "fold":
            return split_triangle(mesh, row, (0.53, 0.53, -0.06))
        case "flat":
            return split_triangle(mesh, row, (0.5, 0.5, 0.0))
        case "repeating":
            more = [[a, b, b]]
        case _:
            more = [[b, c, a]]
    source = np.concatenate((np.arange(len(mesh.triangles)), [row]))
    return mesh.with_triangles(np.concatenate((mesh.triangles, np.array(more, np.int32))), source)


def add_texture(mesh: Mesh) -> Mesh:
    """Add a texture whose coordinates are x and y."""
    image = Image("map.png", given=np.zeros((4, 4, 3), np.uint8))
    uvs = np.ascontiguousarray(mesh.vertices[mesh.triangles][..., :2] + 2)
    ids = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(texture=Texture(uvs, ids, (Material("map", image), Material("bare"))))


def find_inner_triangle(mesh: Mesh) -> int:
    """Find a triangle far from any border."""
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    return int(np.linalg.norm(middle - mesh.vertices.mean(axis=0), axis=1).argmin())


def count_defects(mesh: Mesh, **params: float) -> dict[str, int]:
    found = check(mesh, **params)
    return {name: len(places) for name, places in found.defects.items() if len(places)}


def count_remaining(done: RepairResult) -> dict[str, int]:
    """Count remaining defects by class, except borders, which are never repaired."""
    return {
        name: len(places)
        for name, places in done.remaining_defects.items()
        if len(places) and name != "border_edges"
    }


def assert_rest_is_unchanged(mesh: Mesh, done: RepairResult, around: NDArray[np.integer]) -> None:
    """Check that triangles without vertices in `around`, and all unmoved vertices, are unchanged."""
    assert (np.diff(done.vertex_source) > 0).all()
    assert (np.diff(done.triangle_source) > 0).all()
    spiked = done.repaired_defects["spikes"]
    still = ~np.isin(done.vertex_source, spiked)
    for name in ("vertices", "colors", "normals"):
        now, before = getattr(done.mesh, name), getattr(mesh, name)
        if before is not None:
            kept = still if name != "colors" else np.ones(len(still), bool)
            assert now[kept].tobytes() == before[done.vertex_source][kept].tobytes()
    before = mesh.triangles[done.triangle_source]
    away = ~np.isin(before, around).any(axis=1)
    gone = np.setdiff1d(np.arange(len(mesh.triangles)), done.triangle_source)
    assert np.isin(mesh.triangles[gone], around).any(axis=1).all()
    np.testing.assert_array_equal(done.vertex_source[done.mesh.triangles][away], before[away])
    if mesh.texture is not None:
        now, was = done.mesh.texture, mesh.texture.select_triangles(done.triangle_source)
        assert now.uvs[away].tobytes() == was.uvs[away].tobytes()
        np.testing.assert_array_equal(now.material_ids, was.material_ids)


def assert_no_new_defects(mesh: Mesh, done: RepairResult, **params: float) -> None:
    """Check that no class has a new defect and that borders are unchanged."""
    before, now = check(mesh, **params), check(done.mesh, **params)
    # The first of several coincident vertices represents all of them; it may be removed with a degenerate
    # triangle.
    _, first, of_place = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    named = first[of_place.reshape(-1)]
    for name, (kind, _, _) in CLASSES.items():
        if name == "thin_triangles":
            continue
        places, was = now.defects[name], before.defects[name]
        if kind == "triangle":
            places = done.triangle_source[places]
        else:
            places, was = named[done.vertex_source[places]], named[was]
            if kind == "edge":
                places, was = np.sort(places, axis=1), np.sort(was, axis=1)
        keys = [
            set(map(tuple, some.tolist())) if some.ndim == 2 else set(some.tolist()) for some in (places, was)
        ]
        assert keys[0] <= keys[1], name
        if name == "border_edges":
            assert keys[0] == keys[1]
        if name in done.remaining_defects:
            left = done.remaining_defects[name] if kind == "triangle" else named[done.remaining_defects[name]]
            left = (np.sort(left, axis=1) if kind == "edge" else left).tolist()
            assert keys[0] == (set(map(tuple, left)) if kind == "edge" else set(left)), name


def to_set(places: NDArray[np.integer]) -> set[tuple[int, ...]]:
    return set(map(tuple, places.reshape(len(places), -1).tolist()))


def sample_points(mesh: Mesh, rows: NDArray[np.integer], each: int) -> NDArray[np.float64]:
    """Sample points on triangles, including corners and edges."""
    random = np.random.default_rng(1)
    weights = random.dirichlet((0.7, 0.7, 0.7), each)
    weights = np.concatenate((weights, np.eye(3), (1 - np.eye(3)) / 2))
    return np.einsum("pk,tkx->tpx", weights, mesh.vertices[mesh.triangles[rows]]).reshape(-1, 3)


def find_closest_on_segments(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the closest point on each segment to a point."""
    along = end - start
    length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    share = np.clip(np.einsum("ij,ij->i", points - start, along) / length, 0, 1)
    return np.asarray(start + share[:, None] * along)


def measure_max_distance(points: NDArray[np.float64], mesh: Mesh) -> float:
    """Compute the largest distance of points to a mesh by brute force over all candidate triangles."""
    from trimesh.triangles import closest_point

    corners = mesh.vertices[mesh.triangles]
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    apart = np.linalg.norm(points[:, None] - centres, axis=2)
    may_be = apart - reach <= (apart + reach).min(axis=1, keepdims=True) + 1e-9
    which, triangle = np.nonzero(may_be)
    points, corners = points[which], corners[triangle]
    # A triangle without area consists only of its edges.
    flat = (
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) < 1e-12
    )
    off = np.full(len(points), np.inf)
    off[~flat] = np.linalg.norm(points[~flat] - closest_point(corners[~flat], points[~flat]), axis=1)
    for k in range(3):
        near = find_closest_on_segments(points[flat], corners[flat, k - 1], corners[flat, k])
        off[flat] = np.minimum(off[flat], np.linalg.norm(points[flat] - near, axis=1))
    best = np.full(len(may_be), np.inf)
    np.minimum.at(best, which, off)
    return float(best.max(initial=0.0))


def assert_bound_holds(mesh: Mesh, done: RepairResult, each: int = 60) -> None:
    before = mesh.triangles[done.triangle_source]
    same = (done.vertex_source[done.mesh.triangles] == before).all(axis=1)
    moved = np.isin(before, done.repaired_defects["spikes"]).any(axis=1)
    written = np.flatnonzero(~same | moved)
    old = np.setdiff1d(np.arange(len(mesh.triangles)), done.triangle_source[same & ~moved])
    off = max(
        measure_max_distance(sample_points(done.mesh, written, each), mesh),
        measure_max_distance(sample_points(mesh, old, each), done.mesh),
    )
    assert off <= done.bound_m <= done.max_shape_m


# -- each planted defect ---------------------------------------------------------------------------------


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("kind", ["sheet", "ball"])
@pytest.mark.parametrize("is_textured", [False, True])
def test_planted_defects_are_repaired_and_the_rest_is_unchanged(
    plant: str, kind: str, is_textured: bool
) -> None:
    sound = make_plain_sheet() if kind == "sheet" else ball()
    if is_textured:
        sound = add_texture(sound)
    row = find_inner_triangle(sound) if kind == "sheet" else 700
    mesh = plant_defect(sound, plant, row)
    assert CLASS_OF[plant] in count_defects(mesh)
    done = repair(mesh)
    name = CLASS_OF[plant]
    assert len(done.found_defects[name]) == len(done.repaired_defects[name]) > 0
    assert count_remaining(done) == {}
    assert done.diagnostics == ()
    assert count_defects(done.mesh) == count_defects(sound)
    assert 0 <= done.bound_m <= done.max_shape_m
    around = np.unique(np.append(mesh.triangles[row], len(sound.vertices)))
    assert_rest_is_unchanged(mesh, done, around)
    assert_no_new_defects(mesh, done)
    assert_bound_holds(mesh, done)
    if is_textured:
        corners = done.mesh.vertices[done.mesh.triangles][..., :2] + 2
        np.testing.assert_allclose(done.mesh.texture.uvs, corners, atol=1e-12)


def test_a_spike_is_smoothed_within_the_bound() -> None:
    mesh = ball()
    pulled = mesh.vertices.copy()
    pulled[300] *= 1.5
    mesh = mesh.with_(vertices=pulled, normals=pulled / np.linalg.norm(pulled, axis=1, keepdims=True))
    done = repair(mesh, max_shape=0.6)
    assert done.repaired_defects["spikes"].tolist() == [300]
    assert count_defects(done.mesh) == {}
    assert 0.4 < done.bound_m <= 0.6
    assert np.linalg.norm(done.mesh.vertices[300]) == pytest.approx(1, abs=0.02)
    assert done.mesh.normals[300] @ pulled[300] == pytest.approx(1.5, abs=0.05)
    assert_rest_is_unchanged(mesh, done, mesh.triangles[(mesh.triangles == 300).any(axis=1)])
    assert_bound_holds(mesh, done, 20)


def test_a_cap_becomes_a_needle_which_is_collapsed() -> None:
    # The apex is near one end of the longest edge, and the vertex across that edge is far away.
    even = 2 * (find_inner_triangle(make_plain_sheet()) // 2)
    mesh = split_triangle(make_plain_sheet(), even, (0.025, 0.9749, 0.0001))
    assert set(count_defects(mesh)) == {"caps", "border_edges"}
    done = repair(mesh)
    assert count_remaining(done) == {}
    assert count_defects(done.mesh) == count_defects(make_plain_sheet())
    assert len(done.mesh.vertices) == len(mesh.vertices) - 1


def test_many_defects_are_repaired_on_every_surface() -> None:
    for make in MESHES.values():
        sound = mesh = make()
        for number, row in enumerate(range(60, len(sound.triangles) - 60, 97)):
            mesh = plant_defect(mesh, PLANTS[number % len(PLANTS)], row)
        done = repair(mesh)
        repaired, found = (
            sum(len(some[name]) for name in CLASS_OF.values())
            for some in (done.repaired_defects, done.found_defects)
        )
        # On the curved ring a folded triangle does not overlap its neighbour.
        assert repaired > 0.7 * found > 0
        assert_no_new_defects(mesh, done)
        assert done.bound_m <= done.max_shape_m


def test_a_sound_mesh_is_unchanged() -> None:
    for make in MESHES.values():
        mesh = make()
        done = repair(mesh)
        assert done.mesh.vertices.tobytes() == mesh.vertices.tobytes()
        assert done.mesh.triangles.tobytes() == mesh.triangles.tobytes()
        assert done.diagnostics == ()
        assert done.bound_m == 0


# -- defects that remain and are reported ----------------------------------------------------------------


def test_defects_without_a_repair_are_reported_and_kept() -> None:
    mesh = ball()
    a, b, _ = mesh.triangles[0]
    fin = mesh.with_(
        vertices=np.concatenate((mesh.vertices, [[3, 3, 3]])),
        colors=np.concatenate((mesh.colors, [[1, 2, 3]])).astype(np.uint8),
        triangles=np.concatenate((mesh.triangles, [[a, b, len(mesh.vertices)]])).astype(np.int32),
    )
    done = repair(fin)
    assert done.mesh.triangles.tobytes() == fin.triangles.tobytes()
    assert len(done.found_defects["nonmanifold_edges"]) == 1
    assert "1 nonmanifold edges" in str(done.diagnostics[-1])
    metrics = done.to_dict()["classes"]["nonmanifold_edges"]
    assert (metrics["treatment"], metrics["found"], metrics["left"]) == ("warning", 1, 1)
    assert metrics["first"][0]["edge"] == sorted((int(a), int(b)))


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("border", "at a border"),
        ("uvs", "the texture, the material, the part or the colour changes"),
        ("material", "the texture, the material, the part or the colour changes"),
        ("part", "the texture, the material, the part or the colour changes"),
        ("normals", "the texture, the material, the part or the colour changes"),
        ("colour", "the texture, the material, the part or the colour changes"),
        ("fin", "not a manifold"),
    ],
)
def test_a_cap_is_kept_if_its_flip_would_cross_a_constraint(what: str, reason: str) -> None:
    sound = add_texture(make_plain_sheet())
    row = 0 if what == "border" else find_inner_triangle(sound)
    mesh = plant_defect(sound, "cap", row)
    a, b, _ = mesh.triangles[row]
    texture = mesh.texture
    beyond = np.flatnonzero(np.isin(mesh.triangles, (a, b)).sum(axis=1) == 2)
    beyond = int(beyond[beyond != row][0]) if what != "border" else -1
    if what == "uvs":
        uvs = texture.uvs.copy()
        uvs[beyond] += 1
        mesh = mesh.with_(texture=replace(texture, uvs=uvs))
    elif what == "material":
        ids = texture.material_ids.copy()
        ids[beyond] = 1
        mesh = mesh.with_(texture=replace(texture, material_ids=ids))
    elif what == "part":
        ids = np.zeros(len(mesh.triangles), np.int32)
        ids[beyond] = 1
        mesh = mesh.with_(part_ids=ids, part_names=("one", "other"))
    elif what == "normals":
        normals = np.tile([0, 0, 1.0], (len(mesh.triangles), 3, 1))
        normals[beyond] = (0, 1.0, 0)
        mesh = mesh.with_(corner_normals=normals)
    elif what == "colour":
        # Two coincident vertices with different colours.
        count, triangles = len(mesh.vertices), mesh.triangles.copy()
        triangles[beyond] = np.where(triangles[beyond] == a, count, triangles[beyond])
        colors = np.concatenate((mesh.colors, [[255, 0, 255]])).astype(np.uint8)
        vertices = np.concatenate((mesh.vertices, mesh.vertices[[a]]))
        mesh = mesh.with_(vertices=vertices, colors=colors, triangles=triangles)
    elif what == "fin":
        mesh = mesh.with_(
            vertices=np.concatenate((mesh.vertices, [[0.5, 0.5, 5]])),
            colors=np.concatenate((mesh.colors, [[1, 2, 3]])).astype(np.uint8),
        )
        fin = np.concatenate((mesh.triangles, [[a, b, len(mesh.vertices) - 1]])).astype(np.int32)
        mesh = mesh.with_triangles(fin, np.append(np.arange(len(mesh.triangles)), row))
    done = repair(mesh)
    assert done.remaining_defects["caps"].tolist() == [row]
    assert reason in done.remaining_reasons["caps"][0]
    assert "1 of 1 caps not repaired" in str(done.diagnostics[0])
    assert done.mesh.triangles.tobytes() == mesh.triangles.tobytes()
    assert done.mesh.vertices.tobytes() == mesh.vertices.tobytes()


def test_a_needle_is_not_collapsed_along_a_seam_that_would_tear() -> None:
    sound = add_texture(make_plain_sheet())
    row = find_inner_triangle(sound)
    mesh = plant_defect(sound, "needle", row)
    # Every triangle at the new vertex has separate texture coordinates there, and all but one at the old
    # vertex.
    for vertex in (len(sound.vertices), int(mesh.triangles[row, 0])):
        uvs = mesh.texture.uvs.copy()
        uvs[mesh.triangles == vertex] += np.arange(np.count_nonzero(mesh.triangles == vertex))[:, None]
        mesh = mesh.with_(texture=replace(mesh.texture, uvs=uvs))
    done = repair(mesh)
    assert len(done.remaining_defects["needles"]) == 2
    assert all("texture" in why for why in done.remaining_reasons["needles"])
    assert done.mesh.texture.uvs.tobytes() == mesh.texture.uvs.tobytes()


# -- the bound, and edits that are rolled back -----------------------------------------------------------


def test_only_edits_beyond_the_bound_are_rolled_back() -> None:
    sound = make_plain_sheet()
    far, near = find_inner_triangle(sound), 40
    mesh = plant_defect(plant_defect(sound, "needle", near), "needle", far)
    bent = mesh.vertices.copy()
    # Only the height changes: the triangle is as thin as before, but its collapse moves the surface.
    bent[-1, 2] += 0.0005
    mesh = mesh.with_(vertices=bent)
    every = repair(mesh, max_shape=0.01)
    assert count_remaining(every) == {}
    done = repair(mesh, max_shape=0.0004)
    new = len(sound.vertices)
    gone = np.setdiff1d(np.arange(len(mesh.vertices)), done.vertex_source)
    assert len(gone) == 1
    assert gone[0] in (new, sound.triangles[near, 0])
    assert done.rollback_counts["needles"] >= 1
    assert len(done.remaining_defects["needles"]) == len(done.repaired_defects["needles"]) == 2
    assert all("not proven to be within max_shape" in why for why in done.remaining_reasons["needles"])
    assert done.bound_m <= 0.0004 < 0.0005 <= every.bound_m
    beside = (mesh.triangles == sound.triangles[near, 0]).any(axis=1)
    assert_rest_is_unchanged(mesh, done, np.append(mesh.triangles[beside], new))
    assert_bound_holds(mesh, done)


def test_a_spike_is_rolled_back_by_default() -> None:
    mesh = ball()
    pulled = mesh.vertices.copy()
    pulled[300] *= 1.5
    mesh = mesh.with_(vertices=pulled)
    done = repair(mesh)
    assert done.rollback_counts["spikes"] == 1
    assert done.remaining_defects["spikes"].tolist() == [300]
    assert done.mesh.vertices.tobytes() == mesh.vertices.tobytes()
    assert "1 where the distance is not proven to be within max_shape" in str(done.diagnostics[0])


def test_a_bound_of_zero_keeps_all_defects() -> None:
    mesh = plant_defect(make_plain_sheet(), "needle", find_inner_triangle(make_plain_sheet()))
    done = repair(mesh, max_shape=0)
    assert done.mesh.triangles.tobytes() == mesh.triangles.tobytes()
    assert done.bound_m == 0


def test_undoing_an_edit_undoes_only_dependent_edits() -> None:
    edited = EditableMesh.start(make_plain_sheet())
    before = edited.input_corners.copy(), edited.triangles.copy(), edited.positions.copy()
    none = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3))

    def edit(seen: list[int], written: int, corner: int) -> int:
        corners = np.full((1, 3), corner) if corner == GONE else np.arange(corner, corner + 3)[None]
        seen_by = np.zeros(len(seen), np.int64), np.array(seen)
        return int(
            edited.apply_edits(seen_by, (np.zeros(1, np.int64), np.array([written]), corners), none, 1)[0]
        )

    first = edit([4, 5], 5, 30)
    after_first = edited.input_corners.copy()
    rests = edit([5, 9], 9, GONE)
    apart = edit([50, 51], 51, 60)
    rests_on_that = edit([9, 12], 12, 90)
    undone, rows = edited.undo(np.array([rests]))
    assert undone.tolist() == [rests, rests_on_that]
    assert rows.tolist() == [9, 12]
    assert edited.input_corners[51].tolist() == [60, 61, 62]
    edited.undo(np.array([apart]))
    np.testing.assert_array_equal(edited.input_corners, after_first)
    edited.undo(np.array([first]))
    for now, was in zip((edited.input_corners, edited.triangles, edited.positions), before, strict=True):
        np.testing.assert_array_equal(now, was)


# -- any mesh --------------------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 10**6),
    disorder=st.sampled_from([0.2, 0.5, 0.9]),
    height=st.sampled_from([0.0, 0.02, 0.3]),
    max_shape=st.sampled_from([None, 1e-3, 0.05, 1.0]),
    corner_angle=st.sampled_from([1.0, 5.0, 15.0]),
)
@settings(deadline=None, max_examples=40)
def test_repairing_a_crumpled_sheet_adds_no_defects(
    seed: int, disorder: float, height: float, max_shape: float | None, corner_angle: float
) -> None:
    random = np.random.default_rng(seed)
    mesh = sheet(9, noise=0, height=height)
    inner = (np.abs(mesh.vertices[:, :2] - 0.5) < 0.45).all(axis=1)
    shift = random.uniform(-disorder, disorder, (int(inner.sum()), 2)) / 9
    # Half of the shifts are small, so that some vertices are close to each other.
    shift[random.random(len(shift)) < 0.5] *= 0.1
    vertices = mesh.vertices.copy()
    vertices[inner, :2] += shift
    mesh = add_texture(mesh.with_(vertices=vertices))
    done = repair(mesh, max_shape=max_shape, corner_angle=corner_angle)
    again = repair(mesh, max_shape=max_shape, corner_angle=corner_angle, threads=1)
    assert done.mesh.vertices.tobytes() == again.mesh.vertices.tobytes()
    assert done.mesh.triangles.tobytes() == again.mesh.triangles.tobytes()
    assert_no_new_defects(mesh, done, corner_angle=corner_angle)
    assert_bound_holds(mesh, done, 12)
    # Texture coordinates stay with their corners.
    was = mesh.texture.uvs.reshape(-1, 2)
    place = {
        tuple(xyz): uv
        for xyz, uv in zip(mesh.vertices[mesh.triangles].reshape(-1, 3).tolist(), was, strict=True)
    }
    moved = np.isin(done.vertex_source, done.repaired_defects["spikes"])
    for xyz, uv, is_moved in zip(
        done.mesh.vertices[done.mesh.triangles].reshape(-1, 3).tolist(),
        done.mesh.texture.uvs.reshape(-1, 2),
        moved[done.mesh.triangles].reshape(-1),
        strict=True,
    ):
        assert is_moved or (place[tuple(xyz)] == uv).all()


@pytest.mark.slow
@given(st.integers(0, 10**6), st.integers(1, 60), st.sampled_from([4, 9, 30]))
@settings(deadline=None, max_examples=60)
def test_repairing_a_triangle_soup_adds_no_defects(seed: int, count: int, places: int) -> None:
    random = np.random.default_rng(seed)
    vertices = random.integers(0, 4, (places, 3)) + random.choice([0, 1e-3], (places, 3))
    mesh = Mesh(vertices.astype(float), random.integers(0, places, (count, 3)).astype(np.int32))
    done = repair(mesh, max_shape=0.5)
    assert_no_new_defects(mesh, done)
    assert_bound_holds(mesh, done, 12)


# -- as a part of clean, and invalid input ---------------------------------------------------------------


def test_clean_repairs_on_request_and_keeps_provenance() -> None:
    sound = ball()
    mesh = plant_defect(plant_defect(sound, "needle", 700), "cap", 100)
    untouched = clean(mesh)
    assert untouched.repair_result is None
    assert "repair" not in untouched.to_dict()
    done = clean(mesh, repair=True)
    assert count_defects(done.mesh) == {}
    assert done.to_dict()["repair"]["classes"]["caps"]["repaired"] == 1
    np.testing.assert_array_equal(mesh.vertices[done.vertex_source], done.mesh.vertices)
    np.testing.assert_array_equal(mesh.colors[done.vertex_source], done.mesh.colors)
    assert len(done.triangle_source) == len(done.mesh.triangles)


def test_max_shape_without_repair_is_refused() -> None:
    with pytest.raises(UsageError, match="max_shape applies only to repairs"):
        clean(ball(), max_shape=0.1)


def test_invalid_input_is_one_sentence() -> None:
    with pytest.raises(MeshError, match="vertex 0 is at"):
        repair((np.full((3, 3), 1e70), np.array([[0, 1, 2]])))
    with pytest.raises(UsageError, match="max_shape is -1"):
        repair(ball(), max_shape=-1)


def test_a_mesh_without_triangles_is_repaired() -> None:
    done = repair((np.zeros((2, 3)), np.empty((0, 3), np.int32)))
    assert len(done.mesh.vertices) == 2
    assert done.bound_m == 0


@pytest.mark.parametrize("name", ["camelhead.off", "Duck.glb", "redkitchen_fused_vertexcolor.ply"])
def test_repairing_real_meshes_adds_no_defects(shared_data: Path, name: str) -> None:
    mesh = read_mesh(shared_data / "meshes" / name)
    done = repair(mesh)
    assert_no_new_defects(mesh, done)
    assert sum(map(len, done.repaired_defects.values())) > 0
    assert done.bound_m <= done.max_shape_m
