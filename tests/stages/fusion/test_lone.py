"""A frame that is fused alone: its mesh shows what has depth, up to the rims, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stages import clean, fuse, read_scan
from stages._open3d import open3d
from stages.fusion.crop import part_of
from stages.fusion.depth_filter import surface
from stages.fusion.lone import as_one, continued
from stages.fusion.posed_depth import PosedDepth
from stages.fusion.voxels import layers
from stages.scans.scan import Camera, Frame
from stages.stereo.depth import depth_scan
from stages.surface.mesh import Mesh

CAMERA = Camera(200, 150, 220.0, 220.0, 99.5, 74.5)


def shown(mesh: Mesh, frame: Frame) -> np.ndarray:
    """Return the depth (h, w) at which a frame's rays hit the mesh, by Open3D's ray caster."""
    core, t = open3d().core, open3d().t
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
    z = shown(clean(fused.mesh).mesh, frame)

    has = depth > 0
    assert np.mean(np.abs(z - depth)[has] < 2 * fused.voxel_size) > 0.95
    # Half of the holes' rims at most, of one voxel, which is two pixels wide.
    assert np.mean(np.isfinite(z[~has])) < 0.3
    assert fused.pixels_used <= 1
    np.testing.assert_array_equal(fused.mesh.colors, 90)


def test_two_frames_are_fused_as_before() -> None:
    """Where others fill what one tears, nothing is continued: the strip at the rim is left out."""
    frame = Frame("0", CAMERA, depth=floor_and_box(0), world_from_camera=np.eye(4))
    one, two = fuse([frame], voxel_size=0.02), fuse([frame, frame], voxel_size=0.02, min_weight=1)
    assert two.truncation < one.truncation
    assert np.isfinite(shown(two.mesh, frame)).sum() < np.isfinite(shown(one.mesh, frame)).sum()


def test_planes_are_continued_as_planes() -> None:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    plane = (1 / (0.4 + 0.3 * x - 0.4 * y)).astype(np.float32)
    has = (u > 50) & (u < 150) & (v > 40) & (v < 110)
    seen = surface(np.where(has, plane, 0).astype(np.float32), CAMERA, max_jump=0.05, max_angle=87)
    view = PosedDepth(seen, CAMERA, np.eye(4), int(has.sum()))

    found = continued(view, seen.depth > 0, None, 0.03)

    margin = (found.view.camera.width - CAMERA.width) // 2
    depth = found.view.surface.depth[margin:-margin, margin:-margin]
    added = (depth > 0) & ~has
    assert 500 < np.count_nonzero(added) < 5000
    np.testing.assert_allclose(depth[added], plane[added], rtol=0.002)
    np.testing.assert_array_equal(depth[has], plane[has])
    np.testing.assert_array_equal(found.here, found.view.surface.depth > 0)
    assert found.color is None
    parts = layers(found.view, found.here, voxel_size=0.03, truncation=0.1, max_depth=10)
    assert all(len(part.points) == sum(len(one.points) for one in parts) for part in as_one(parts))
    assert as_one([]) == []


def test_part_of_a_mesh_keeps_the_order() -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], np.float64)
    mesh = Mesh(vertices, np.array([(0, 1, 2), (2, 1, 3)], np.int32))
    part = part_of(mesh, np.array([False, True]))
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
    assert np.mean(np.abs(z - frame.depth)[has] < 2 * fused.voxel_size) > 0.95
