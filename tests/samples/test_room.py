"""The made room is a scan of its true surface with the errors of a sensor."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.raycasting import RaycastingSurface

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
FRAMES = 3


@pytest.fixture(scope="module")
def room():
    """Import the script's module; it imports other modules by plain names."""
    sys.path.insert(0, str(SAMPLES))
    try:
        yield importlib.import_module("room")
    finally:
        sys.path.remove(str(SAMPLES))


@pytest.fixture(scope="module")
def scans(room, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("room")
    for name, warp in (("plain", False), ("warped", True)):
        room.make_room(folder / name, warp=warp, frames=FRAMES)
    return folder


def unproject(depth: np.ndarray, camera, pose: np.ndarray) -> np.ndarray:
    v, u = np.nonzero(depth > 0)
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    return points @ pose[:3, :3].T + pose[:3, 3]


def test_depth_is_the_true_surface_with_sensor_errors(room, scans: Path):
    scan, truth = read_scan(scans / "plain"), RaycastingSurface(read_ply(scans / "plain" / "truth.ply"))
    assert len(scan.frames) == FRAMES
    for frame, pose in zip(scan.frames, room.make_poses(FRAMES), strict=True):
        depth = read_depth(frame)
        assert frame.camera == room.CAMERA
        assert 0.85 < (depth > 0).mean() < 0.99
        distances = truth.find_closest_points(unproject(depth, frame.camera, pose)).distances
        assert 0.001 < np.median(distances) < 0.004
        assert np.quantile(distances, 0.99) < 0.03
        assert read_color(frame).std() > 20


def test_poses_have_the_noise_of_a_tracker(room, scans: Path):
    for frame, pose in zip(read_scan(scans / "plain").frames, room.make_poses(FRAMES), strict=True):
        error = np.linalg.inv(pose) @ frame.world_from_camera
        angle = np.degrees(np.arccos((np.trace(error[:3, :3]) - 1) / 2))
        assert 0 < angle < 1
        assert 0 < np.linalg.norm(frame.world_from_camera[:3, 3] - pose[:3, 3]) < 0.015


def test_warped_depth_is_scaled_and_bent(room, scans: Path):
    plain, warped = (read_depth(read_scan(scans / name).frames[0]) for name in ("plain", "warped"))
    both = (plain > 0) & (warped > 0)
    ratio = np.where(both, warped / np.where(both, plain, 1), np.nan)
    factor = room.compute_warp(room.CAMERA)
    assert (factor.min(), factor.max()) == pytest.approx((1.005, 1.025))
    assert np.nanmedian(ratio) == pytest.approx(np.median(factor), abs=0.002)
    # Quantisation of disparity averages out over a part of the image.
    for rows, columns in ((slice(0, 120), slice(0, 160)), (slice(360, 480), slice(480, 640))):
        assert np.nanmean(ratio[rows, columns]) == pytest.approx(factor[rows, columns].mean(), abs=0.002)


def test_thin_parts_belong_to_the_truth(room, scans: Path):
    truth, thin = (read_ply(scans / "plain" / f"{name}.ply") for name in ("truth", "thin_parts"))
    assert RaycastingSurface(truth).find_closest_points(thin.vertices).distances.max() < 1e-6
    # The wall of the mug at half its height.
    distance = np.hypot(*(thin.vertices - room.MUG)[:, :2].T)
    near = (distance < 0.042) & (np.abs(thin.vertices[:, 2] - room.MUG[2] - 0.03) < 0.005)
    assert set(np.round(distance[near], 4)) == {0.037, 0.041}


def test_surfaces_face_the_inside_of_the_room(room):
    scene = room.Room()
    corners = scene.mesh.vertices[scene.mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    surface = RaycastingSurface(scene.mesh)
    for pose in room.make_poses(5):
        directions = np.random.default_rng(0).normal((0, 0, 1), 0.3, (5000, 3)) @ pose[:3, :3].T
        hits = surface.cast_rays(pose[:3, 3], directions)
        assert len(hits.rays) == len(directions)
        assert (np.einsum("kx,kx->k", normals[hits.triangles], directions[hits.rays]) < 0).mean() > 0.9999
