"""Closing of holes in meshes whose true surface is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages import Frame, Mesh, Scan, clean, fuse, refine, topology
from scanloom.stages.frames.depth_filter import OrientedDepth
from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.refinement.cap_planes import Planes, divide_cap
from scanloom.stages.refinement.filling_colors import color_fillings
from scanloom.stages.refinement.free_space import FreeSpaceTest
from scanloom.stages.refinement.hole_closing import ClosedHoles, close_holes
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values, write_ply
from scanloom.stages.surface.welding import weld_vertices
from tests.made.posed_scene import BOARD, BOARD_Z, CAMERA, make_posed_scan

EDGE = 0.01  # grid spacing of the made meshes, metres
NOISE = DepthNoise(0.001, 0.0)


def _make_grid(
    count: int, shape: Callable[[np.ndarray, np.ndarray], np.ndarray], is_hole: Callable[..., np.ndarray]
) -> Mesh:
    """Make a grid of count² squares over ±1, without the triangles whose centroid is in a hole."""
    x, y = (one.reshape(-1) for one in np.meshgrid(*[np.linspace(-1, 1, count + 1)] * 2, indexing="ij"))
    vertices = shape(x, y)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).reshape(-1)
    corners = np.stack([first, first + count + 1, first + count + 2, first + 1], axis=1)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    is_left_out = is_hole(x[triangles].mean(axis=1), y[triangles].mean(axis=1))
    mesh = Mesh(vertices, triangles[~is_left_out].astype(np.int32))
    # Holes of single squares may touch at a vertex.
    return clean(mesh, min_island_area=0).mesh


def _make_wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([20 * EDGE * x, 20 * EDGE * y, np.zeros(x.shape)], axis=1)


def _make_ridge(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Make two walls that meet at a right angle along the y axis."""
    return np.stack([20 * EDGE * x, 20 * EDGE * y, -20 * EDGE * np.abs(x)], axis=1)


def _make_dome(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Project points to a sphere of radius 0.3 m around the origin."""
    points = np.stack([x, y, np.full(x.shape, 1.5)], axis=1)
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True)


def _is_round_hole(x: np.ndarray, y: np.ndarray, radius: float = 0.2) -> np.ndarray:
    return np.hypot(x, y) < radius


def _close_holes(
    mesh: Mesh, plane_ids: np.ndarray | None = None, max_length: float | None = 1.0, *views: PosedDepth
) -> ClosedHoles:
    def show(test: FreeSpaceTest) -> None:
        for view in views:
            test.observe(view)

    ids = np.full(len(mesh.vertices), -1, np.int32) if plane_ids is None else plane_ids.astype(np.int32)
    return close_holes(mesh, ids, np.full(len(ids), 0.0005), NOISE, show, max_length)


def _make_frame_facing_down(depth: float, size: int = 64) -> PosedDepth:
    """Make a frame 1 m above the origin that faces down.

    It has the same depth at size² pixels in the centre of the image, and none around them.
    """
    camera = Camera(64, 64, 100.0, 100.0, 31.5, 31.5)
    pose = np.diag((1.0, -1.0, -1.0, 1.0))
    pose[2, 3] = 1.0
    image = np.zeros((64, 64), np.float32)
    image[32 - size // 2 :, 32 - size // 2 :][:size, :size] = depth
    return PosedDepth(OrientedDepth(image, (image,) * 3, image), camera, pose, image.size)


def _require_closed(mesh: Mesh, loops: int = 1) -> None:
    found = topology(mesh)
    assert found.is_manifold
    assert found.is_oriented
    assert found.degenerate == found.duplicate == found.unreferenced == 0
    assert found.boundary_loops == loops


def test_a_hole_in_a_wall_is_filled_flat() -> None:
    wall = _make_grid(40, _make_wall, _is_round_hole)
    colors = np.tile(np.array([[200, 100, 50]], np.uint8), (len(wall.vertices), 1))
    found = _close_holes(wall.with_(colors=colors), np.zeros(len(wall.vertices)))
    _require_closed(found.mesh)
    assert len(found.fillings) == 1
    assert found.area == pytest.approx(np.pi * (4 * EDGE) ** 2, rel=0.15)
    assert np.abs(found.mesh.vertices[:, 2]).max() < 1e-12
    assert found.is_filled.sum() > 20
    assert not found.is_filled[: len(wall.vertices)].any()
    assert (found.plane_ids == 0).all()
    assert (found.deviations[found.is_filled] > 0.0005).all()
    (filling,) = found.fillings
    assert filling.area == found.area
    assert filling.border_length == pytest.approx(2 * np.pi * 4 * EDGE, rel=0.3)
    assert np.linalg.norm(filling.center) < 0.2 * EDGE
    filled_colors = color_fillings(found.mesh, found.is_filled, [])
    assert filled_colors is not None
    assert (filled_colors == colors[0]).all()


def test_the_mask_of_fillings_is_written_and_read_without_warning(tmp_path: Path) -> None:
    found = _close_holes(_make_grid(40, _make_wall, _is_round_hole))
    write_ply(
        tmp_path / "refined.ply", found.mesh, vertex_values={"filled": found.is_filled.astype(np.float64)}
    )
    values = read_vertex_values(tmp_path / "refined.ply", "filled")
    assert values is not None
    assert np.array_equal(values > 0, found.is_filled)
    assert read_ply(tmp_path / "refined.ply").diagnostics == ()


def test_a_cap_has_the_edge_length_of_the_mesh() -> None:
    found = _close_holes(_make_grid(40, _make_wall, _is_round_hole))
    corners = found.mesh.vertices[found.mesh.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert lengths.max() < 1.5 * lengths[: -len(found.is_filled)].mean() * np.sqrt(2)
    assert lengths.min() > EDGE / 4


def test_a_hole_in_a_curved_surface_is_filled_smoothly() -> None:
    found = _close_holes(_make_grid(40, _make_dome, _is_round_hole))
    _require_closed(found.mesh)
    heights = np.linalg.norm(found.mesh.vertices[found.is_filled], axis=1) - 0.3
    # A flat cap would be 2 mm too low.
    assert np.abs(heights).max() < 0.0003


def test_a_crease_continues_straight_over_a_hole() -> None:
    ridge = _make_grid(40, _make_ridge, _is_round_hole)
    ids = np.where(ridge.vertices[:, 0] < 0, 0, 1)
    found = _close_holes(ridge, ids)
    _require_closed(found.mesh)
    x, _, z = found.mesh.vertices[found.is_filled].T
    assert np.abs(z + np.abs(x)).max() < 1e-9
    assert (np.abs(x) < 1e-9).sum() >= 5
    # No triangle spans the crease.
    sides = np.sign(np.round(found.mesh.vertices[:, 0], 9))[found.mesh.triangles]
    assert (sides.max(axis=1) - sides.min(axis=1)).max() < 2
    assert set(found.plane_ids[found.is_filled].tolist()) == {0, 1}


def _make_corner(is_hole: Callable[..., np.ndarray], sign: float) -> tuple[Mesh, np.ndarray]:
    """Make three walls at right angles that meet in the origin; return the wall of each vertex as well.

    The walls face the axis (1, 1, 1), or for sign −1 away from it.
    """
    wall = _make_grid(20, lambda x, y: np.stack([x + 1, y + 1, 0 * x], axis=1) * 10 * EDGE, _mask_no_hole)
    walls = [np.roll(wall.vertices, turn, axis=1) for turn in range(3)]
    count = len(wall.vertices)
    triangles = np.concatenate([wall.triangles + turn * count for turn in range(3)]).astype(np.int32)
    joined = weld_vertices(
        Mesh(np.concatenate(walls).round(12), triangles if sign > 0 else triangles[:, ::-1].copy())
    )
    centres = joined.vertices[joined.triangles].mean(axis=1)
    mesh = clean(joined.with_(triangles=joined.triangles[~is_hole(centres)]), min_island_area=0).mesh
    return mesh, np.abs(mesh.vertices).argmin(axis=1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_three_planes_continue_to_their_corner(sign: float) -> None:
    mesh, ids = _make_corner(lambda centres: np.linalg.norm(centres, axis=1) < 4.3 * EDGE, sign)
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 3 * EDGE
    found = _close_holes(mesh, ids)
    _require_closed(found.mesh)
    assert len(found.fillings) == 1
    filled = found.mesh.vertices[found.is_filled]
    assert np.linalg.norm(filled, axis=1).min() < 1e-9
    # Each vertex is on a wall, those on a crease are on two.
    heights = np.abs(filled)
    assert heights.min(axis=1).max() < 1e-9
    assert (heights < 1e-9).sum(axis=0).min() >= 6
    assert found.area == pytest.approx(3 * np.pi * (4.3 * EDGE) ** 2 / 4, rel=0.1)
    # No triangle spans a crease.
    corners = found.mesh.vertices[found.mesh.triangles]
    assert (np.abs(corners) < 1e-9).all(axis=1).any(axis=1).all()
    assert set(found.plane_ids[found.is_filled].tolist()) == {0, 1, 2}


@pytest.mark.parametrize(("slope", "is_corner"), [(0.6, True), (3.0, False)])
def test_only_corners_near_the_hole_are_used(slope: float, is_corner: bool) -> None:
    """Three planes meet in a tip at the centre of a round hole."""
    directions = np.radians((90, 210, 330))
    tips = np.stack([np.cos(directions), np.sin(directions), np.full(3, 1 / slope)], axis=1)
    planes = Planes(tips / np.linalg.norm(tips, axis=1, keepdims=True), np.zeros(3))
    angles = np.radians(np.arange(0, 360, 10))
    cosines = np.cos(angles[:, None] - directions)
    rim = np.stack([np.cos(angles), np.sin(angles), -slope * cosines.max(axis=1)], axis=1)
    divided = divide_cap(rim, cosines.argmax(axis=1), np.full(36, 1e-6), planes, 0.17)
    if not is_corner:
        assert divided is None
        return
    assert divided is not None
    assert {section.plane for section in divided.sections} == {0, 1, 2}
    assert np.abs(divided.points).min(axis=0).max() < 1e-9
    assert (
        len(divided.points) == len(divided.point_planes) == 1 + sum(len(one) - 2 for one in divided.creases)
    )
    points = np.concatenate([rim, divided.points])
    for section in divided.sections:
        assert np.abs(planes.measure_heights(points[section.outline], np.full(1, section.plane))).max() < 1e-6


def test_free_space_is_not_filled() -> None:
    wall = _make_grid(40, _make_wall, _is_round_hole)
    behind = _close_holes(wall, None, 1.0, _make_frame_facing_down(1.0), _make_frame_facing_down(1.5))
    assert len(behind.fillings) == 0
    assert behind.mesh is wall
    assert not behind.is_filled.any()
    # A surface at the cap, a surface in front of it, and missing depth do not contradict the cap.
    for depth in (1.0, 0.5, 0.0):
        assert len(_close_holes(wall, None, 1.0, _make_frame_facing_down(depth)).fillings) == 1


def test_a_single_wrong_measurement_does_not_keep_a_hole_open() -> None:
    wall = _make_grid(40, _make_wall, _is_round_hole)
    for count, size, hole_count in ((1, 1, 1), (1, 2, 1), (1, 3, 0), (2, 1, 0), (2, 2, 0)):
        views = [_make_frame_facing_down(1.5, size)] * count
        assert len(_close_holes(wall, None, 1.0, *views, _make_frame_facing_down(1.0)).fillings) == hole_count


def test_only_holes_within_the_limit_are_filled() -> None:
    wall = _make_grid(
        40, _make_wall, lambda x, y: _is_round_hole(x + 0.5, y, 0.1) | _is_round_hole(x - 0.4, y, 0.3)
    )
    assert [len(_close_holes(wall, None, limit).fillings) for limit in (0.0, 0.1, 0.2, 0.6)] == [0, 0, 1, 2]
    # 20 mean edge lengths.
    assert len(_close_holes(wall, None, None).fillings) == 1


def test_a_mesh_without_holes_is_unchanged() -> None:
    wall = _make_grid(10, _make_wall, _mask_no_hole)
    assert _close_holes(wall, None, 100.0).mesh is wall
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
    assert _close_holes(empty).mesh is empty


def test_a_cap_does_not_touch_other_surface() -> None:
    wall = _make_grid(40, _make_wall, _is_round_hole)
    post = _make_grid(
        4, lambda x, y: np.stack([0.2 * EDGE * x, np.zeros(x.shape), 0.1 * y], axis=1), _mask_no_hole
    )
    both = Mesh(
        np.concatenate([wall.vertices, post.vertices]),
        np.concatenate([wall.triangles, post.triangles + np.int32(len(wall.vertices))]),
    )
    assert len(_close_holes(both).fillings) == 0


def _mask_no_hole(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.zeros(np.broadcast(x, y).shape, bool)


@pytest.mark.parametrize("seed", range(6))
def test_random_holes_leave_an_oriented_manifold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (_make_wall, _make_ridge, _make_dome)[seed % 3]
    centres = rng.uniform(-0.8, 0.8, (14, 2))
    radii = rng.uniform(0.02, 0.3, 14)

    def is_hole(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        distances = np.hypot(x[:, None] - centres[:, 0], y[:, None] - centres[:, 1])
        return (distances < radii).any(axis=1) | (rng.uniform(size=len(x)) < 0.01)

    mesh = _make_grid(40, shape, is_hole)
    mesh = mesh.with_(vertices=mesh.vertices + rng.normal(0, 0.15 * EDGE, mesh.vertices.shape))
    ids = np.where(mesh.vertices[:, 0] < 0, 0, 1) if seed % 3 < 2 else None
    found = _close_holes(mesh, ids, 2.0)
    before = topology(mesh)
    _require_closed(found.mesh, before.boundary_loops - len(found.fillings))
    assert len(found.fillings) > 3
    again = _close_holes(mesh, ids, 2.0)
    assert np.array_equal(found.mesh.vertices, again.mesh.vertices)
    assert np.array_equal(found.mesh.triangles, again.mesh.triangles)


def test_refine_fills_surface_without_depth() -> None:
    """In all frames, depth is missing in a disc of the board, like on a black spot."""
    views, depths = make_posed_scan()
    rng = np.random.default_rng(2)
    centre = np.array((-0.3, 0.3, BOARD_Z))
    frames = []
    for view, depth in zip(views.frames, depths, strict=True):
        pose = view.world_from_camera
        assert pose is not None
        rows, columns = np.indices(depth.shape)
        rays = np.stack(
            [(columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy, np.ones(depth.shape)], axis=-1
        )
        points = (rays * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]
        is_spot = np.linalg.norm(points - centre, axis=-1) < 0.025
        noisy = depth + 0.001 * rng.standard_normal(depth.shape)
        measured = np.where((depth > 0) & ~is_spot, noisy, 0).astype(np.float32)
        frames.append(Frame.from_arrays(np.asarray(view.color), measured, CAMERA, pose))
    scan = Scan.from_frames(frames)
    fused = clean(fuse(scan, voxel_size=0.008).mesh).mesh
    filled = refine(fused, scan, fill_holes=0.4)
    points = filled.mesh.vertices[filled.is_filled]
    is_spot = np.linalg.norm(points - centre, axis=1) < 0.05
    assert is_spot.sum() >= 5
    assert np.abs(points[is_spot, 2] - BOARD_Z).max() < 0.001
    assert (np.abs(points[:, :2]) < BOARD).all()
    metrics = filled.to_dict()
    assert metrics["filled_holes"] >= 1
    assert metrics["filled_area_m2"] > 0.001
    largest = metrics["largest_fillings"]
    assert sum(one["area_m2"] for one in largest) <= metrics["filled_area_m2"] + 1e-12
    assert min(np.linalg.norm(np.array(one["point_m"]) - centre) for one in largest) < 0.02
    assert filled.mesh.colors is not None
    # Black does not occur on the board.
    assert filled.mesh.colors[filled.is_filled].min() > 0
    assert len(filled.is_filled) == len(filled.deviations) == len(filled.plane_ids) == metrics["vertices"]
    kept = refine(fused, scan, fill_holes=0)
    assert not kept.is_filled.any()
    assert kept.to_dict()["filled_holes"] == 0
