"""A frame alone: its mesh shows what has depth, up to the rims, and nothing else."""

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

# Missing, a wall, the same with noise, and something before it.
DEPTHS = (0.0, 2.0, 2.01, 1.99, 1.2)
CAMERA = Camera(200, 150, 220.0, 220.0, 99.5, 74.5)


def shown(mesh: Mesh, frame: Frame) -> np.ndarray:
    """Return the depth (h, w) at which a frame's rays hit the mesh, by Open3D's ray caster."""
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


def floor_and_box(noise: float = 0.002) -> np.ndarray:
    """Return depth of a floor that recedes, with a board before it and holes where nothing was measured."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    depth = 1 / (0.25 + 0.5 * v / CAMERA.height)
    depth *= 1 + np.random.default_rng(4).normal(0, noise, depth.shape)
    depth[30:90, 60:120] = 1.3
    for row, column in ((20, 20), (110, 150), (60, 90), (120, 40), (40, 170)):
        depth[np.hypot(v - row, u - column) < 6] = 0
    return depth.astype(np.float32)


def pose() -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    result[:3, 3] = (100.0, -30.0, 2.0)
    return result


def test_a_lone_frame_shows_what_has_depth_and_nothing_else() -> None:
    depth = floor_and_box()
    color = np.full((*depth.shape, 3), 90, np.uint8)
    frame = Frame("0", CAMERA, color=color, depth=depth, world_from_camera=pose())

    fused = fuse([frame])
    z = shown(fused.mesh, frame)

    has = depth > 0
    # Rays end at the outermost pixels' middles, which lie on the rim.
    assert np.mean(np.isfinite(z)[has]) > 0.95
    assert not np.isfinite(z[~has]).any()
    # Of all pixels, as of many frames; the gaps are too wide to be closed.
    assert fused.pixels_used == fused.pixels_valid == np.mean(has)
    np.testing.assert_array_equal(fused.mesh.colors, 90)
    assert clean(fused.mesh).mesh.triangles.shape == fused.mesh.triangles.shape


def test_colours_are_seen_through_the_lens() -> None:
    """A frame alone has the same colours at the same places as the first of two."""
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


def test_triangles_face_the_camera_and_meet_at_their_edges() -> None:
    frame = Frame("0", CAMERA, depth=floor_and_box(0), world_from_camera=pose())
    mesh = fuse([frame]).mesh
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - pose()[:3, 3]) < 0).all()
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() == 2


def test_nothing_is_joined_across_a_jump() -> None:
    """On the board or on the floor, and on no triangle between."""
    depth = floor_and_box(0)
    mesh = fuse([Frame("0", CAMERA, depth=depth, world_from_camera=np.eye(4))], max_jump=0.05).mesh
    z = mesh.vertices[mesh.triangles][..., 2]
    assert (z.max(axis=1) / z.min(axis=1)).max() < 1.06


def test_noise_is_evened_out_within_surfaces() -> None:
    exact, noisy = floor_and_box(0), floor_and_box(0.004)
    even = denoise_depth(noisy, 0.05)
    has = exact > 0
    before, after = (np.abs(depth[has] / exact[has] - 1) for depth in (noisy, even))
    assert after[before > 0].mean() < before[before > 0].mean() / 3
    # The board has none; it keeps its rim, where some of the floor's noise counts.
    board = exact == np.float32(1.3)
    np.testing.assert_allclose(even[board], 1.3, rtol=0.008)
    inside = np.zeros_like(board)
    inside[38:82, 68:112] = True
    np.testing.assert_allclose(even[board & inside], 1.3, rtol=1e-4)
    assert ((even > 0) == (noisy > 0)).all()


def test_what_is_exact_stays_so() -> None:
    """But for the tenth of a percent by which slopes are wrong beside another surface."""
    depth = floor_and_box(0)
    np.testing.assert_allclose(denoise_depth(depth, 0.05), depth, rtol=1e-3)


@given(
    hnp.arrays(
        np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from(DEPTHS)
    ),
    st.floats(0.001, 0.5),
)
def test_any_depth_map_stays_within_its_own(depth: np.ndarray, max_jump: float) -> None:
    even = denoise_depth(depth, max_jump)
    assert ((even > 0) == (depth > 0)).all()
    has = depth > 0
    np.testing.assert_array_less(np.abs(depth[has] / even[has] - 1), max_jump * 1.01 + 1e-5)


def test_a_larger_voxel_leaves_pixels_out() -> None:
    frame = Frame("0", CAMERA, depth=floor_and_box(0), world_from_camera=np.eye(4))
    whole, half = fuse([frame]), fuse([frame], voxel_factor=2.0)
    assert 0.15 < len(half.mesh.triangles) / len(whole.mesh.triangles) < 0.3
    assert whole.truncation == 0


def test_a_crop_and_an_angle_leave_triangles_out() -> None:
    frame = Frame("0", CAMERA, depth=floor_and_box(0), world_from_camera=np.eye(4))
    whole = fuse([frame]).mesh
    near = fuse([frame], box=(-9, -9, 0, 9, 9, 2)).mesh
    assert 0 < len(near.triangles) < len(whole.triangles)
    assert near.vertices[:, 2].max() <= 2
    steep = fuse([frame], max_angle=60).mesh
    assert 0 < len(steep.triangles) < len(whole.triangles)


def test_part_of_a_mesh_keeps_the_order() -> None:
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
    z = shown(clean(fused.mesh).mesh, frame)
    has = frame.depth > 0
    assert np.mean(np.isfinite(z)[has]) > 0.95
    hit = has & np.isfinite(z)
    assert np.mean(np.abs(z - frame.depth)[hit] < 0.01 * frame.depth[hit]) > 0.98


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
def test_a_street_pair_is_no_heap_of_islands(shared_data, first: int) -> None:
    scan = read_scan(shared_data / "real" / "kitti_stereo_2015", ScanParams(first=first, last=first))
    frame, _ = next(iter(depth_scan(scan)))
    frame = replace(frame, world_from_camera=np.eye(4))
    mesh = clean(fuse([frame]).mesh).mesh
    has = frame.depth > 0
    assert np.mean(np.isfinite(shown(mesh, frame))[has]) > 0.88
    assert topology(mesh).components < 300
