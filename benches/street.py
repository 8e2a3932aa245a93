"""Meshing of a street from stereo, against OpenCV with Open3D.

python benches/street.py SCAN [--voxel 0.1] [--pictures FOLDER]

Prints seconds, triangles, components, and two measures of the road surface. "closed" is the ratio of downward
rays that hit the mesh below the car's path. "lane scatter" is the standard deviation of hit heights in the
lane. With --pictures, both meshes are rendered from the same two viewpoints. The scan's cameras have to look
along the road.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.rendering.render import render, write_png
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.model.scan import Camera, Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import DepthMap, depth_scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

# Strips along the path: range of metres to the right of the left camera.
STRIPS = {"lane": (-1.5, 1.5), "left side": (-6.0, -3.0), "right side": (3.0, 6.0)}
# Too few frames saw the start of the street, for either tool.
FIRST_FRAME = 8


def mesh_with_scanloom(scan: Scan, voxel_size: float) -> Mesh:
    """Match and fuse as `scanloom run` does."""
    frames = [frame for frame, measured in depth_scan(scan) if isinstance(measured, DepthMap)]
    return fuse(frames, voxel_size=voxel_size).mesh


def mesh_with_script(scan: Scan, voxel_size: float) -> Mesh:
    """Match with OpenCV and fuse with Open3D, with constants of their examples."""
    import cv2

    o3d = import_open3d()
    f32 = o3d.core.float32
    assert scan.rig is not None
    mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
    matcher = cv2.StereoSGBM_create(0, 128, 5, 200, 800, 1, 0, 10, 100, 2, mode)
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (f32,) * 3, ((1), (1), (3)), voxel_size, 16, 3000
    )
    for frame in scan.frames:
        left, right = read_color(frame), read_right(frame)
        disparity = matcher.compute(*(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in (left, right)))
        metres = frame.camera.fx * scan.rig.baseline / (np.maximum(disparity, 1) / 16)
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.where(disparity > 16, metres, 0).astype(np.float32)))
        color = o3d.t.geometry.Image(o3d.core.Tensor(left.astype(np.float32) / 255))
        matrix, extrinsic = (
            o3d.core.Tensor(m) for m in (frame.camera.matrix, np.linalg.inv(frame.world_from_camera))
        )
        blocks = grid.compute_unique_block_coordinates(depth, matrix, extrinsic, 1.0, 40.0)
        grid.integrate(blocks, depth, color, matrix, extrinsic, 1.0, 40.0)
    mesh = grid.extract_triangle_mesh()
    colors = (mesh.vertex.colors.numpy() * 255).astype(np.uint8)
    return Mesh(mesh.vertex.positions.numpy().astype(float), mesh.triangle.indices.numpy(), colors)


def measure_road(mesh: Mesh, scan: Scan, lateral_range: tuple[float, float]) -> tuple[float, float]:
    """Cast downward rays over a strip.

    Returns the ratio of rays that hit the mesh within 2.5 m, and the standard deviation of their lengths in
    metres.
    """
    poses = np.stack([frame.world_from_camera for frame in scan.frames[FIRST_FRAME:]])
    lateral_offset = np.linspace(*lateral_range, 60)[None, :, None] * poses[:, None, :3, 0]
    forward_offset = (
        np.linspace(0, 1, 12)[None, :, None, None] * np.diff(poses[:, :3, 3], axis=0)[:, None, None]
    )
    start = (poses[:-1, None, None, :3, 3] + forward_offset + lateral_offset[:-1, None]).reshape(-1, 3)
    down = np.repeat(poses[:-1, :3, 1], 12 * 60, axis=0)
    start += 0.7 * down
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles.astype(np.uint32))
    )
    rays = o3d.core.Tensor(np.concatenate([start, down], axis=1).astype(np.float32))
    distance = scene.cast_rays(rays)["t_hit"].numpy()
    hit = distance < 2.5
    return float(hit.mean()), float(np.std(distance[hit]))


def make_viewpoints(scan: Scan) -> list[Viewpoint]:
    """Make two viewpoints for pictures.

    One is the driver's at the ninth frame, the other is 6 m above the fourth frame.
    """
    driver, first = (np.array(scan.frames[k].world_from_camera) for k in (8, 3))
    above = np.array(first)
    above[:3, 3] += -6 * first[:3, 1]
    tilt = np.radians(15)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    above[:3, :3] = first[:3, :3] @ turn
    wide = Camera(1226, 600, 600.0, 600.0, 613.0, 300.0)
    return [Viewpoint("driver", scan.frames[0].camera, driver), Viewpoint("above", wide, above)]


def main() -> None:
    """Print the table and draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scan", type=Path)
    parser.add_argument("--voxel", type=float, default=0.1, help="metres")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--pictures", type=Path, help="folder for renderings of the meshes")
    options = parser.parse_args()
    scan = read_scan(options.scan)
    import_open3d()
    rivals: dict[str, Callable[[Scan, float], Mesh]] = {
        "scanloom": mesh_with_scanloom,
        "script": mesh_with_script,
    }
    seconds: dict[str, list[NDArray[np.float64]]] = {name: [] for name in rivals}
    meshes = {}
    for _ in range(options.repeats):
        for name, run in rivals.items():
            start = np.array([time.perf_counter(), time.process_time()])
            meshes[name] = run(scan, options.voxel)
            seconds[name].append(np.array([time.perf_counter(), time.process_time()]) - start)
    strips = " | ".join(f"{name} closed" for name in STRIPS)
    print(f"| tool | s | CPU s | triangles | components | largest | {strips} | lane scatter cm |")
    print("|---" * (7 + len(STRIPS)) + "|")
    for name, mesh in meshes.items():
        wall, processor = np.median(seconds[name], axis=0)
        measured = [measure_road(mesh, scan, strip) for strip in STRIPS.values()]
        closed = " | ".join(f"{share:.1%}" for share, _ in measured)
        print(
            f"| {name} | {wall:.1f} | {processor:.1f} | {len(mesh.triangles)} "
            f"| {topology(mesh).components} | {compute_largest_component_ratio(mesh):.0%} | {closed} "
            f"| {measured[0][1] * 100:.1f} |"
        )
        for viewpoint in make_viewpoints(scan) if options.pictures else []:
            options.pictures.mkdir(parents=True, exist_ok=True)
            write_png(options.pictures / f"{name}-{viewpoint.name}.png", render(mesh, viewpoint))


def compute_largest_component_ratio(mesh: Mesh) -> float:
    """Compute the ratio of triangles in the largest connected component."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, c = mesh.triangles.T
    pairs = (np.concatenate([a, b]), np.concatenate([b, c]))
    count = len(mesh.vertices)
    graph = coo_array((np.ones(2 * len(a), bool), pairs), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    return float(np.bincount(label[a]).max() / len(a))


if __name__ == "__main__":
    main()
