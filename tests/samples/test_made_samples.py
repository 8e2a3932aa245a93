"""The sample scans in the repository equal the output of their script and show its scene."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.scans.model.images import read_color, read_depth, read_right
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.raycasting import RaycastingSurface

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).resolve().parents[2] / "samples"


@pytest.fixture(scope="module")
def made():
    """Import the script's modules; they import each other by plain names from their folder."""
    sys.path.insert(0, str(SAMPLES))
    try:
        yield {name: importlib.import_module(name) for name in ("scene", "sensors", "make_samples")}
    finally:
        sys.path.remove(str(SAMPLES))


@pytest.fixture(scope="module")
def scene(made):
    return made["scene"].Scene()


def test_the_scans_are_small():
    assert sum(file.stat().st_size for file in SAMPLES.rglob("*") if file.is_file()) < 8e6


def test_reading_the_stereo_scan_returns_the_made_frames(made):
    scan, rig = read_scan(SAMPLES / "stereo"), made["make_samples"].make_rig()
    assert len(scan.frames) == made["make_samples"].PAIRS
    assert (scan.rig.left, scan.rig.right, scan.rig.is_rectified) == (rig.left, rig.right, False)
    np.testing.assert_allclose(scan.rig.right_from_left, rig.right_from_left, atol=1e-8)
    assert scan.rig.baseline == pytest.approx(0.12, abs=1e-4)
    for frame, pose in zip(scan.frames, made["make_samples"].make_arc_poses(14, 104, 0.4), strict=True):
        np.testing.assert_allclose(frame.world_from_camera, pose, atol=1e-8)


def test_reading_the_rgbd_scan_returns_the_made_frames(made):
    scan = read_scan(SAMPLES / "rgbd")
    assert len(scan.frames) == made["make_samples"].DEPTH_FRAMES
    assert all(frame.camera == made["make_samples"].DEPTH_CAMERA for frame in scan.frames)


def test_the_first_pair_is_reproduced_from_its_seed(made, scene):
    frame, rig = read_scan(SAMPLES / "stereo").frames[0], made["make_samples"].make_rig()
    rng = np.random.default_rng((made["make_samples"].SEED, 0, 0))
    pose = frame.world_from_camera
    for read, camera, at in (
        (read_color, rig.left, pose),
        (read_right, rig.right, pose @ np.linalg.inv(rig.right_from_left)),
    ):
        again = made["sensors"].photograph(scene, camera, at, rng).astype(int)
        # The remaining difference is JPEG's loss on sensor noise.
        assert np.abs(again - read(frame)).mean() < 4


@pytest.mark.parametrize("number", [0, 11, 23])
def test_depth_is_the_true_surface_with_a_sensors_errors(number):
    frame, truth = read_scan(SAMPLES / "rgbd").frames[number], read_ply(SAMPLES / "truth.ply")
    depth, camera = read_depth(frame), frame.camera
    seen = depth > 0
    assert 0.8 < seen.mean() < 0.99
    v, u = np.nonzero(seen)
    z = depth[seen].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    points = points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
    distances = RaycastingSurface(truth).find_closest_points(points).distances
    assert 0.0003 < np.median(distances) < 0.002
    assert np.quantile(distances, 0.99) < 0.01


def test_the_truth_consists_of_the_shapes_of_the_scene(made, scene):
    truth, names = read_ply(SAMPLES / "truth.ply"), made["scene"]
    np.testing.assert_allclose(truth.vertices, scene.mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(truth.triangles, scene.mesh.triangles)
    # Rounding on another processor may move the edge of a shadow across a vertex.
    assert np.abs(truth.colors.astype(int) - scene.mesh.colors).mean() < 0.05

    def measure_distance_to_globe(v):
        return np.abs(np.linalg.norm(v - names.GLOBE, axis=1) - names.GLOBE_RADIUS)

    def measure_distance_to_ring(v):
        wide, thin = names.RING_RADII
        across = np.hypot(*(v - names.RING)[:, :2].T) - wide
        return np.abs(np.hypot(across, v[:, 2] - names.RING[2]) - thin)

    for distance, area in (
        (measure_distance_to_globe, 4 * np.pi * names.GLOBE_RADIUS**2),
        (measure_distance_to_ring, 4 * np.pi**2 * names.RING_RADII[0] * names.RING_RADII[1]),
    ):
        on = distance(truth.vertices) < 1e-6
        own = truth.vertices[truth.triangles[on[truth.triangles].all(axis=1)]]
        cross = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
        assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(area, rel=0.005)


def test_surfaces_of_the_truth_face_the_cameras():
    truth = read_ply(SAMPLES / "truth.ply")
    surface = RaycastingSurface(truth)
    corners = truth.vertices[truth.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    frame = read_scan(SAMPLES / "rgbd").frames[12]
    directions = np.random.default_rng(0).normal((0, 0, 1), 0.25, (5000, 3))
    directions = directions @ frame.world_from_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = surface.cast_rays(frame.world_from_camera[:3, 3], directions)
    assert len(hits.rays) > 0.8 * len(directions)
    assert (np.einsum("kx,kx->k", normals[hits.triangles], directions[hits.rays]) < 0).all()
