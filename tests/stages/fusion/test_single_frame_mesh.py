"""Mesh of a single frame: it covers exactly the pixels with depth, up to the rims."""

from __future__ import annotations

from dataclasses import replace

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from scanloom import clean, fuse, read_scan
from scanloom.stages._open3d import import_open3d
from scanloom.stages.fusion.crop import select_triangles
from scanloom.stages.fusion.single_frame_mesh import denoise_depth
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.stereo.depth import depth_scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

# Missing, a wall, the wall with noise, and an object in front.
DEPTHS = (0.0, 2.0, 2.01, 1.99, 1.2)
CAMERA = Camera(200, 150, 220.0, 220.0, 99.5, 74.5)


def render_depth(mesh: Mesh, frame: Frame) -> np.ndarray:
    """Compute the depth (h, w) of a frame's rays on the mesh with Open3D's ray caster."""
    core, t = import_open3d().core, import_open3d().t
    whole = t.geometry.TriangleMesh(
        core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.triangles.astype(np.int32))
    )
    scene = t.geometry.RaycastingScene()
    scene.add_triangles(whole)
    camera, pose = frame.camera, frame.world_from_camera
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    way = rays @ pose[:3, :3].T
    both = np.concatenate([np.broadcast_to(pose[:3, 3], way.shape), way], axis=-1).astype(np.float32)
    return scene.cast_rays(core.Tensor(both))["t_hit"].numpy()


def make_floor_and_board(noise: float = 0.002) -> np.ndarray:
    """Make depth of a receding floor with a board in front and holes without measurements."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    depth = 1 / (0.25 + 0.5 * v / CAMERA.height)
    depth *= 1 + np.random.default_rng(4).normal(0, noise, depth.shape)
    depth[30:90, 60:120] = 1.3
    for row, column in ((20, 20), (110, 150), (60, 90), (120, 40), (40, 170)):
        depth[np.hypot(v - row, u - column) < 6] = 0
    return depth.astype(np.float32)


def make_pose() -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    result[:3, 3] = (100.0, -30.0, 2.0)
    return result


def test_a_single_frame_covers_exactly_the_pixels_with_depth() -> None:
    depth = make_floor_and_board()
    color = np.full((*depth.shape, 3), 90, np.uint8)
    frame = Frame("0", CAMERA, color=color, depth=depth, world_from_camera=make_pose())

    fused = fuse([frame])
    z = render_depth(fused.mesh, frame)

    has = depth > 0
    # Rays pass through pixel centres, and the outermost centres are on the rim.
    assert np.mean(np.isfinite(z)[has]) > 0.95
    assert not np.isfinite(z[~has]).any()
    # The statistics cover all pixels, like for many frames; the gaps are too wide to be closed.
    assert fused.pixels_used == fused.pixels_valid == np.mean(has)
    np.testing.assert_array_equal(fused.mesh.colors, 90)
    assert clean(fused.mesh).mesh.triangles.shape == fused.mesh.triangles.shape


def test_colours_are_projected_with_lens_distortion() -> None:
    """A single frame gives the same colours at the same points as two equal frames."""
    bent = replace(CAMERA, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    color = np.stack([u, v, u + v], axis=-1).astype(np.uint8)
    frame = Frame("0", bent, color=color, depth=np.full(u.shape, 2, np.float32), world_from_camera=np.eye(4))
    one, two = (fuse(frames, voxel_size=0.02, min_weight=1).mesh for frames in ([frame], [frame, frame]))
    nearest, place = cKDTree(one.vertices).query(two.vertices)
    near = nearest < 0.02
    assert near.mean() > 0.9
    difference = np.abs(one.colors[place].astype(int) - two.colors)[near]
    assert np.median(difference) <= 1
    assert np.percentile(difference, 90) <= 4


def test_triangles_face_the_camera_and_share_edges() -> None:
    frame = Frame("0", CAMERA, depth=make_floor_and_board(0), world_from_camera=make_pose())
    mesh = fuse([frame]).mesh
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - make_pose()[:3, 3]) < 0).all()
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() == 2


def test_no_triangle_spans_a_depth_discontinuity() -> None:
    """Each triangle is on the board or on the floor."""
    depth = make_floor_and_board(0)
    mesh = fuse([Frame("0", CAMERA, depth=depth, world_from_camera=np.eye(4))], max_jump=0.05).mesh
    z = mesh.vertices[mesh.triangles][..., 2]
    assert (z.max(axis=1) / z.min(axis=1)).max() < 1.06


def test_noise_is_smoothed_within_surfaces() -> None:
    exact, noisy = make_floor_and_board(0), make_floor_and_board(0.004)
    even = denoise_depth(noisy, 0.05)
    has = exact > 0
    before, after = (np.abs(depth[has] / exact[has] - 1) for depth in (noisy, even))
    assert after[before > 0].mean() < before[before > 0].mean() / 3
    # The board is constant up to noise; its rim is influenced by the noise of the floor.
    board = exact == np.float32(1.3)
    np.testing.assert_allclose(even[board], 1.3, rtol=0.008)
    inside = np.zeros_like(board)
    inside[38:82, 68:112] = True
    np.testing.assert_allclose(even[board & inside], 1.3, rtol=1e-4)
    assert ((even > 0) == (noisy > 0)).all()


def test_exact_depth_is_kept() -> None:
    """Slopes next to another surface have errors of 0.1 %."""
    depth = make_floor_and_board(0)
    np.testing.assert_allclose(denoise_depth(depth, 0.05), depth, rtol=1e-3)


@given(
    hnp.arrays(
        np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from(DEPTHS)
    ),
    st.floats(0.001, 0.5),
)
def test_smoothing_keeps_the_depth_range(depth: np.ndarray, max_jump: float) -> None:
    even = denoise_depth(depth, max_jump)
    assert ((even > 0) == (depth > 0)).all()
    has = depth > 0
    np.testing.assert_array_less(np.abs(depth[has] / even[has] - 1), max_jump * 1.01 + 1e-5)


def test_a_larger_voxel_size_skips_pixels() -> None:
    frame = Frame("0", CAMERA, depth=make_floor_and_board(0), world_from_camera=np.eye(4))
    whole, half = fuse([frame]), fuse([frame], voxel_factor=2.0)
    assert 0.15 < len(half.mesh.triangles) / len(whole.mesh.triangles) < 0.3
    assert whole.truncation == 0


def test_a_crop_and_an_angle_limit_remove_triangles() -> None:
    frame = Frame("0", CAMERA, depth=make_floor_and_board(0), world_from_camera=np.eye(4))
    whole = fuse([frame]).mesh
    near = fuse([frame], box=(-9, -9, 0, 9, 9, 2)).mesh
    assert 0 < len(near.triangles) < len(whole.triangles)
    assert near.vertices[:, 2].max() <= 2
    steep = fuse([frame], max_angle=60).mesh
    assert 0 < len(steep.triangles) < len(whole.triangles)


def test_a_part_of_a_mesh_keeps_the_order() -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], np.float64)
    mesh = Mesh(vertices, np.array([(0, 1, 2), (2, 1, 3)], np.int32))
    part = select_triangles(mesh, np.array([False, True]))
    np.testing.assert_array_equal(part.vertices, vertices[1:])
    np.testing.assert_array_equal(part.triangles, [(1, 0, 2)])


@pytest.mark.slow
def test_the_mesh_of_motorcycle(shared_data) -> None:
    scan = read_scan(shared_data / "stereo" / "middlebury2014_motorcycle")
    frame, _ = next(iter(depth_scan(scan)))
    frame = replace(frame, world_from_camera=np.eye(4))
    fused = fuse([frame])
    z = render_depth(clean(fused.mesh).mesh, frame)
    has = frame.depth > 0
    assert np.mean(np.isfinite(z)[has]) > 0.95
    hit = has & np.isfinite(z)
    assert np.mean(np.abs(z - frame.depth)[hit] < 0.01 * frame.depth[hit]) > 0.98


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_a_street_pair_has_few_islands(shared_data, first: int) -> None:
    scan = read_scan(shared_data / "real" / "kitti_stereo_2015", ScanParams(first=first, last=first))
    frame, _ = next(iter(depth_scan(scan)))
    frame = replace(frame, world_from_camera=np.eye(4))
    mesh = clean(fuse([frame]).mesh).mesh
    has = frame.depth > 0
    assert np.mean(np.isfinite(render_depth(mesh, frame))[has]) > 0.88
    assert topology(mesh).components < 300
