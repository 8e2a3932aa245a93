"""Coverage of synthetic scans with known missing parts, positions and nearby frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flat_plates import CAMERA, join_meshes, look_at, plate, remove_triangles, render_depth, render_frames

from scanloom import Mesh, clean, coverage
from scanloom.stages.diagnostics.errors import InputError, MeshError, UsageError
from scanloom.stages.inspecting.coverage.coverage_result import Coverage
from scanloom.stages.inspecting.coverage.defect import CoverageDefect
from scanloom.stages.inspecting.coverage.defect_kinds import MISSING_KINDS, WEAK_KINDS
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.raycasting import RaycastingSurface

WALL = plate((-0.8, 0, 0), (1.6, 0, 0), (0, 0, 1.2))
# Five cameras in a row in front of the wall.
ROW = [((x, -1.2, 0.6), (x, 0, 0.6)) for x in np.linspace(-0.3, 0.3, 5)]


def select_kinds(found: Coverage, *kinds: str) -> list[CoverageDefect]:
    return [place for place in found.defects if place.kind in kinds]


def compute_visible_ratio(world: Mesh, place: CoverageDefect, points: np.ndarray) -> float:
    """Compute the share of points of the world that are visible from the suggested viewpoint."""
    eye = np.array(place.viewpoint.position)
    lines = points - eye
    lengths = np.linalg.norm(lines, axis=1)
    hits = RaycastingSurface(world).cast_rays(eye, lines / lengths[:, None])
    seen = np.ones(len(points), bool)
    seen[hits.rays] = hits.distances > lengths[hits.rays] - 0.01
    return float(seen.mean())


def mask_pane(points: np.ndarray) -> np.ndarray:
    """Mask the part of the wall without depth: black glass."""
    return (np.abs(points[:, 0] - 0.1) < 0.15) & (np.abs(points[:, 2] - 0.5) < 0.1)


@pytest.fixture(scope="module")
def glass() -> Coverage:
    """Scan a wall with a pane of 30 × 20 cm that gives no depth and has a surface, not a hole, behind."""
    frames = render_frames(WALL, ROW)
    poses = [frame.world_from_camera for frame in frames]
    broken = []
    for frame, pose in zip(frames, poses, strict=True):
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
        z = frame.depth
        points = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], axis=-1)
        at = points.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
        broken.append(replace(frame, depth=np.where(mask_pane(at).reshape(z.shape), np.float32(0), z)))
    return coverage(remove_triangles(WALL, mask_pane), broken)


def test_a_hole_is_reported_with_area_and_position(glass: Coverage) -> None:
    (hole,) = select_kinds(glass, *MISSING_KINDS)

    assert hole.kind == "hole"
    assert hole.area == pytest.approx(0.3 * 0.2, rel=0.1)
    np.testing.assert_allclose(hole.point, (0.1, 0, 0.5), atol=0.06)
    np.testing.assert_allclose(hole.normal, (0, -1, 0), atol=1e-6)
    assert hole.frames_in_view == 5
    assert glass.defects[0] is hole
    assert glass.missing_areas["hole"] == pytest.approx(hole.area)


def test_the_outline_of_a_scan_is_not_a_hole(glass: Coverage) -> None:
    frames = render_frames(WALL, ROW)
    whole = coverage(select_measured(WALL, frames), frames)

    assert not whole.defects
    assert whole.scan_end_area > 0
    assert sum(whole.weak_areas.values()) < 0.01 * whole.surface_area
    assert len(select_kinds(glass, *MISSING_KINDS)) == 1


def test_a_hole_without_depth_lists_its_frames_and_a_frontal_viewpoint(glass: Coverage) -> None:
    (hole,) = select_kinds(glass, "hole")

    assert len(hole.nearest_frames) == 5
    assert {look.reason for look in hole.nearest_frames} == {"no depth there"}
    assert all(look.in_view_ratio == 1 for look in hole.nearest_frames)
    assert hole.viewpoint.position[1] < -0.5
    assert hole.viewpoint.visible_ratio == 1
    assert hole.viewpoint.is_free
    assert np.dot(hole.viewpoint.direction, (0, 1, 0)) > 0.7


def test_the_painted_mesh_adds_triangles_for_a_hole(glass: Coverage) -> None:
    mesh = remove_triangles(WALL, mask_pane)
    count = len(mesh.vertices)

    np.testing.assert_array_equal(glass.painted_mesh.vertices[:count], mesh.vertices)
    np.testing.assert_array_equal(glass.painted_mesh.triangles[: len(mesh.triangles)], mesh.triangles)
    cap = glass.painted_mesh.vertices[count:]
    assert len(cap)
    assert (np.abs(cap - (0.1, 0, 0.5)) <= (0.16, 1e-6, 0.11)).all()
    red, green, blue = glass.painted_mesh.colors[count:].astype(int).T
    assert (red > 2 * np.maximum(green, blue)).all()


def test_an_opening_with_visible_background_is_not_a_hole() -> None:
    window = remove_triangles(WALL, mask_pane)
    behind = plate((-2, 0.8, -0.6), (4, 0, 0), (0, 0, 2.4))
    frames = render_frames(join_meshes([window, behind]), ROW)

    assert not select_kinds(coverage(window, frames), "hole")


BOX = [
    plate((-0.15, -0.1, 0), (0.3, 0, 0), (0, 0, 0.3)),
    plate((0.15, -0.1, 0), (0, 0.2, 0), (0, 0, 0.3)),
    plate((0.15, 0.1, 0), (-0.3, 0, 0), (0, 0, 0.3)),
    plate((-0.15, 0.1, 0), (0, -0.2, 0), (0, 0, 0.3)),
    plate((-0.15, -0.1, 0.3), (0.3, 0, 0), (0, 0.2, 0)),
]
FLOOR = remove_triangles(
    plate((-0.8, -0.8, 0), (1.6, 0, 0), (0, 1.6, 0)),
    lambda p: (np.abs(p[:, 0]) < 0.15) & (np.abs(p[:, 1]) < 0.1),
)
# Cameras around the front and the sides of the box, but not behind.
FRONT = [((1.1 * np.sin(a), -1.1 * np.cos(a), 0.8), (0, 0, 0.1)) for a in np.radians(np.linspace(-50, 50, 9))]


def select_measured(world: Mesh, frames: list[Frame]) -> Mesh:
    """Return the mesh that fusion would produce: triangles whose centres some frame measured."""
    middles = world.vertices[world.triangles].mean(axis=1)
    is_seen = np.zeros(len(middles), bool)
    for frame in frames:
        pose = np.linalg.inv(frame.world_from_camera)
        p = middles @ pose[:3, :3].T + pose[:3, 3]
        ahead = p[:, 2] > 0.01
        u = np.rint(CAMERA.fx * p[:, 0] / np.where(ahead, p[:, 2], 1) + CAMERA.cx).astype(int)
        v = np.rint(CAMERA.fy * p[:, 1] / np.where(ahead, p[:, 2], 1) + CAMERA.cy).astype(int)
        inside = ahead & (u >= 0) & (v >= 0) & (u < CAMERA.width) & (v < CAMERA.height)
        is_seen[inside] |= np.abs(frame.depth[v[inside], u[inside]] - p[inside, 2]) < 0.03
    return clean(remove_triangles(world, lambda middle: ~is_seen), min_island_area=0.0).mesh  # noqa: ARG005


@pytest.fixture(scope="module")
def world() -> Mesh:
    return join_meshes([*BOX, FLOOR])


def test_an_unseen_side_of_an_object_is_reported_with_a_viewpoint(world: Mesh) -> None:
    frames = render_frames(world, FRONT)
    found = coverage(select_measured(world, frames), frames, spacing=0.02)

    first = found.defects[0]
    assert first.kind in ("hidden", "hole")
    # Behind the box, and below its top.
    assert first.point[1] > 0.05
    assert abs(first.point[0]) < 0.2
    assert 0 <= first.point[2] < 0.35
    assert first.viewpoint.position[1] > 0.2
    assert first.viewpoint.visible_ratio > 0.7
    back = BOX[2].vertices[BOX[2].triangles].mean(axis=1)
    assert compute_visible_ratio(world, first, back) > 0.9
    assert any("occluded" in look.reason or "behind" in look.reason for look in first.nearest_frames)


@pytest.mark.slow
def test_a_side_seen_by_additional_frames_is_not_reported(world: Mesh) -> None:
    frames = render_frames(world, FRONT)
    before = coverage(select_measured(world, frames), frames, spacing=0.02)
    place = before.defects[0]
    eye = place.viewpoint.position
    more = render_frames(world, [*FRONT, (eye, np.add(eye, place.viewpoint.direction))])
    after = coverage(select_measured(world, more), more, spacing=0.02)

    assert before.missing_areas["hidden"] > 0.04
    assert after.missing_areas["hidden"] == 0
    # The floor below the box is never visible.
    assert after.missing_areas["hole"] == pytest.approx(2 * 0.3 * 0.2, rel=0.05)


def test_a_gap_between_scanned_parts_is_located_on_the_missing_surface() -> None:
    floor = plate((-1.5, -0.4, 0), (3, 0, 0), (0, 0.8, 0))
    left = [((x, 0, 0.9), (x, 0, 0)) for x in (-1.1, -1.0, -0.9)]
    right = [((x, 0, 0.9), (x, 0, 0)) for x in (0.9, 1.0, 1.1)]
    frames = render_frames(floor, [*left, *right])
    found = coverage(select_measured(floor, frames), frames)

    gap = select_kinds(found, "gap")[0]
    area = sum(one.area for one in select_kinds(found, "gap"))
    # Images cover 1.08 m of the floor.
    width = 2 * (0.9 - 0.54)
    np.testing.assert_allclose(gap.point, (0, 0, 0), atol=0.2)
    assert gap.normal[2] == pytest.approx(1)
    assert area == pytest.approx(0.8 * width, rel=0.1)
    assert {look.frame for look in gap.nearest_frames[:2]} == {"2", "3"}
    assert 0.5 < gap.viewpoint.position[2] < 1.4
    assert gap.viewpoint.visible_ratio == 1
    assert "outside the image" in gap.nearest_frames[0].reason
    assert gap.frames_in_view == 0
    # The ends of the floor are not gaps.
    assert not [place for place in select_kinds(found, *MISSING_KINDS) if abs(place.point[0]) > 0.6]


@pytest.mark.slow
def test_an_unseen_wall_of_a_room_is_reported() -> None:
    room = [
        plate((-1, 1, 0), (2, 0, 0), (0, 0, 1.6), 0.04),
        plate((-1, -1, 0), (0, 2, 0), (0, 0, 1.6), 0.04),
        plate((1, 1, 0), (0, -2, 0), (0, 0, 1.6), 0.04),
        plate((-1, -1, 0), (2, 0, 0), (0, 2, 0), 0.04),
        plate((-1, 1, 1.6), (2, 0, 0), (0, -2, 0), 0.04),
        plate((1, -1, 0), (-2, 0, 0), (0, 0, 1.6), 0.04),
    ]
    walls = join_meshes(room)
    looks = [
        ((0.3 * np.sin(a), 0.3 * np.cos(a), 0.8), (np.sin(a), np.cos(a), 0.8 + rise))
        for a in np.radians(np.linspace(-100, 100, 15))
        for rise in (-0.6, 0, 0.6)
    ]
    frames = render_frames(walls, looks)
    found = coverage(select_measured(walls, frames), frames, spacing=0.06, max_defects=1000)

    # Below and above the cameras, where floor and ceiling would continue.
    gaps = select_kinds(found, "gap")
    assert {round(place.point[2], 1) for place in gaps} == {0.0, 1.6}
    assert all(np.hypot(*place.point[:2]) < 0.9 for place in gaps)
    # And towards the wall at y = −1.
    unseen = select_kinds(found, "unseen")
    towards = [place.area for place in unseen if place.point[1] < 0]
    assert sum(towards) > 1
    assert sum(towards) > 0.7 * sum(place.area for place in unseen)
    assert not select_kinds(found, "hidden", "hole", "blank")


def test_few_oblique_and_distant_frames_are_distinguished() -> None:
    near = [((0.4, -0.8, 0.6), (0.4, 0, 0.6))] * 3
    # The left half has one frame, and all of it has oblique frames from the right.
    few = coverage(WALL, render_frames(WALL, [*near, ((-0.4, -0.8, 0.6), (-0.4, 0, 0.6))]), few_frames=2)
    few_there = few.vertex_kinds == WEAK_KINDS.index("few")
    assert few_there[
        (np.abs(WALL.vertices[:, 0] + 0.5) < 0.15) & (np.abs(WALL.vertices[:, 2] - 0.6) < 0.3)
    ].all()
    assert not few_there[
        (np.abs(WALL.vertices[:, 0] - 0.4) < 0.3) & (np.abs(WALL.vertices[:, 2] - 0.6) < 0.2)
    ].any()
    assert select_kinds(few, "few")[0].point[0] < 0.1

    aslant = [((0.8 + 1.2, -0.3, 0.6), (0.5, 0, 0.6))] * 3
    oblique = coverage(WALL, render_frames(WALL, aslant), max_angle=70, min_area=0.01)
    cosine = 0.3 / np.hypot(1.2 + 0.8 - WALL.vertices[:, 0], 0.3)
    seen = oblique.vertex_evidence.frame_counts > 0
    np.testing.assert_allclose(
        oblique.vertex_evidence.max_cosine[seen & (WALL.vertices[:, 2] == 0.6)],
        cosine[seen & (WALL.vertices[:, 2] == 0.6)],
        atol=0.02,
    )
    assert select_kinds(oblique, "oblique")

    far = coverage(WALL, render_frames(WALL, ROW), max_distance=1.0)
    assert select_kinds(far, "far")
    assert far.vertex_evidence.min_distance[far.vertex_evidence.frame_counts > 0] == pytest.approx(
        1.2, abs=1e-3
    )
    assert not select_kinds(coverage(WALL, render_frames(WALL, ROW), max_distance=1.3), "far")


def test_masked_objects_do_not_occlude() -> None:
    box = join_meshes(BOX)
    all_around = [
        ((1.1 * np.sin(a), -1.1 * np.cos(a), 0.6), (0, 0, 0.15)) for a in np.radians(np.arange(0, 360, 30))
    ]
    frames = render_frames(box, all_around)
    masked = [replace(one, mask=np.where(one.depth > 0, 255, 0).astype(np.uint8)) for one in frames]
    found = coverage(box, masked)

    # Only the ground below the box.
    assert all(place.point[2] < 0.05 for place in select_kinds(found, *MISSING_KINDS))
    assert not select_kinds(found, "unseen", "end", "blank")


def test_results_far_from_the_origin_are_the_same(glass: Coverage) -> None:
    shift = np.array((500_000.0, 5_200_000.0, 300.0))
    mesh = remove_triangles(WALL, mask_pane)
    frames = []
    for frame in render_frames(remove_triangles(WALL, mask_pane), ROW):
        pose = frame.world_from_camera.copy()
        pose[:3, 3] += shift
        frames.append(replace(frame, world_from_camera=pose))
    found = coverage(mesh.with_(vertices=mesh.vertices + shift), frames)

    (hole,) = select_kinds(found, "hole")
    assert hole.area == pytest.approx(select_kinds(glass, "hole")[0].area, rel=1e-3)
    np.testing.assert_allclose(np.array(hole.point) - shift, (0.1, 0, 0.5), atol=0.06)


def test_equal_input_gives_an_equal_result() -> None:
    frames = render_frames(WALL, ROW)
    one, other = (coverage(remove_triangles(WALL, mask_pane), frames) for _ in range(2))

    assert one.to_dict() == other.to_dict()
    np.testing.assert_array_equal(one.painted_mesh.colors, other.painted_mesh.colors)


def test_defects_are_ranked_limited_and_counted(world: Mesh) -> None:
    frames = render_frames(world, FRONT)
    mesh = select_measured(world, frames)
    every = coverage(mesh, frames, max_defects=1000)
    few = coverage(mesh, frames, max_defects=2)
    metrics = every.to_dict()["places"]

    scores = [one["weight"] * one["area_m2"] for one in metrics]
    assert scores == sorted(scores, reverse=True)
    assert [one.point for one in few.defects] == [one.point for one in every.defects[:2]]
    assert few.omitted_count == len(every.defects) - 2
    assert min(one["area_m2"] for one in metrics) > 0


@pytest.mark.slow
def test_a_large_defect_is_split_by_viewpoint(world: Mesh) -> None:
    frames = render_frames(world, FRONT)
    mesh = select_measured(world, frames)
    whole = coverage(mesh, frames, max_patch_size=2.0, max_defects=1000)
    cut = coverage(mesh, frames, max_patch_size=0.15, min_area=1e-4, max_defects=1000)

    assert max(place.extent for place in select_kinds(cut, *MISSING_KINDS)) < 0.25
    assert len(select_kinds(cut, "hidden", "hole")) > len(select_kinds(whole, "hidden", "hole"))


def test_damaged_frames_are_reported_and_the_others_used() -> None:
    frames = render_frames(WALL, ROW)
    empty = replace(frames[0], name="empty", depth=np.zeros_like(frames[0].depth))
    lost = replace(frames[1], name="lost", world_from_camera=None)
    found = coverage(WALL, [empty, lost, *frames[2:]])

    assert found.frame_count == 3
    assert [(one.name, one.reason) for one in found.skipped] == [
        ("empty", "no pixel has a depth."),
        ("lost", "there is no camera pose."),
    ]


@pytest.mark.parametrize(
    ("frames", "why"),
    [
        ([], "none of the 0 frames has a camera pose and depth"),
        ([Frame("a", CAMERA)], "none of the 1 frames .* frame a: there is no camera pose"),
        (
            [Frame("a", CAMERA, world_from_camera=np.eye(4))],
            "none of the 1 frames .* frame a: there is no depth map",
        ),
    ],
)
def test_frames_without_depth_or_poses_are_refused(frames: list[Frame], why: str) -> None:
    with pytest.raises(InputError, match=why):
        coverage(WALL, frames)


def test_frames_of_another_scene_are_refused() -> None:
    frames = [
        replace(one, world_from_camera=look_at((50, 0, 0), (51, 0, 0))) for one in render_frames(WALL, ROW)
    ]
    with pytest.raises(InputError, match="poses and mesh are in the same coordinate system"):
        coverage(WALL, frames)


def test_meshes_without_surface_are_refused() -> None:
    frames = render_frames(WALL, ROW)
    with pytest.raises(MeshError, match="no triangles"):
        coverage(Mesh(WALL.vertices, np.zeros((0, 3), np.int32)), frames)
    fin = np.concatenate([WALL.triangles, WALL.triangles[:1, ::-1] * (1, 1, 0) + (0, 0, 500)])
    with pytest.raises(MeshError):
        coverage(Mesh(WALL.vertices, fin.astype(np.int32)), frames)


@pytest.mark.parametrize(
    "wrong",
    [{"max_angle": 91}, {"few_frames": 0}, {"max_distance": 0.0}, {"spread": 0.0}, {"max_defects": 0}],
)
def test_parameters_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        coverage(WALL, [], **wrong)


def test_depth_of_a_plate_is_exact() -> None:
    depth = render_depth(RaycastingSurface(WALL), look_at((0, -1.2, 0.6), (0, 0, 0.6)))
    assert depth[30:40, 40:50] == pytest.approx(1.2, abs=1e-5)
