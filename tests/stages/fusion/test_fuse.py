"""Fusion of analytic scenes and of a real kitchen."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.fusion.fuse import FusionResult, fuse
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh import Mesh

CAMERA = Camera(160, 120, 140.0, 140.0, 80.0, 59.0)
RADIUS = 0.5
VOXEL = 0.02


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute world_from_camera of a camera at `eye`; z of the world is up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :4] = np.stack([x, np.cross(z, x), z, eye], axis=1)
    return pose


def compute_rays(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute ray directions (h, w, 3) in the world, scaled so that depth is the ray parameter."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    d = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    return d @ pose[:3, :3].T


def render_sphere_depth(pose: NDArray[np.float64], center: NDArray[np.float64]) -> NDArray[np.float32]:
    d, o = compute_rays(pose), pose[:3, 3] - center
    a, b, c = (d * d).sum(-1), d @ o, o @ o - RADIUS**2
    root = b * b - a * c
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)


def render_sphere_frames(center: NDArray[np.float64] | None = None) -> list[Frame]:
    """Render a sphere from twelve sides, red where x > 0 in the world, blue elsewhere."""
    center = np.zeros(3) if center is None else center
    frames = []
    for k in range(12):
        turn, height = 2 * np.pi * k / 12, (-0.9, 0.8)[k % 2]
        side = np.array([np.cos(turn), np.sin(turn), height])
        eye = center + 1.6 * side / np.linalg.norm(side)
        pose = look_at(eye, center)
        depth = render_sphere_depth(pose, center)
        x = (pose[:3, 3] + depth[..., None] * compute_rays(pose))[..., 0] - center[0]
        color = np.where(x[..., None] > 0, np.uint8([200, 30, 40]), np.uint8([20, 60, 220]))
        frames.append(Frame(f"{k:02}", CAMERA, color=color, depth=depth, world_from_camera=pose))
    return frames


def render_plane_frame(height: float, tilt: float, k: int = 0) -> Frame:
    """Render the plane z = 0 from above, with a camera that is tilted by `tilt` radians below the horizon."""
    eye = np.array([0.1 * k, 0.0, height])
    pose = look_at(eye, eye + np.array([np.cos(tilt), 0.0, -np.sin(tilt)]))
    d = compute_rays(pose)
    with np.errstate(divide="ignore"):
        depth = np.where(d[..., 2] < 0, -height / d[..., 2], 0)
    return Frame(
        str(k), CAMERA, depth=np.where(depth < 6, depth, 0).astype(np.float32), world_from_camera=pose
    )


@pytest.fixture(scope="module")
def sphere() -> FusionResult:
    return fuse(render_sphere_frames(), voxel_size=VOXEL)


def is_same(a: Mesh, b: Mesh) -> bool:
    return (
        a.vertices.tobytes() == b.vertices.tobytes()
        and a.triangles.tobytes() == b.triangles.tobytes()
        and (None if a.colors is None else a.colors.tobytes())
        == (None if b.colors is None else b.colors.tobytes())
    )


def test_vertices_are_on_the_sphere(sphere: FusionResult) -> None:
    error = np.linalg.norm(sphere.mesh.vertices, axis=1) - RADIUS
    assert abs(error.mean()) < 0.1 * VOXEL
    assert np.sqrt((error**2).mean()) < 0.15 * VOXEL


def test_the_visible_sphere_is_complete(sphere: FusionResult) -> None:
    corners = sphere.mesh.vertices[sphere.mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1).sum() / 2
    assert area > 0.9 * 4 * np.pi * RADIUS**2
    # Counter-clockwise seen from outside.
    assert ((normals * corners.mean(axis=1)).sum(axis=1) > 0).mean() > 0.999


def test_no_triangle_is_degenerate(sphere: FusionResult) -> None:
    corners = sphere.mesh.vertices[sphere.mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.linalg.norm(normals, axis=1) > 0).all()
    assert len(np.unique(sphere.mesh.vertices, axis=0)) == len(sphere.mesh.vertices)


def test_colours_are_at_their_positions(sphere: FusionResult) -> None:
    assert sphere.mesh.colors is not None
    x = sphere.mesh.vertices[:, 0]
    red, blue = sphere.mesh.colors[x > 2 * VOXEL], sphere.mesh.colors[x < -2 * VOXEL]
    assert (np.abs(np.median(red, axis=0) - [200, 30, 40]) <= 1).all()
    assert (np.abs(np.median(blue, axis=0) - [20, 60, 220]) <= 1).all()


def test_the_world_origin_may_be_far_away() -> None:
    # The precision of float32 is 6 cm there.
    far = np.array([512_000.0, -4_096_000.0, 256.0])
    error = (
        np.linalg.norm(fuse(render_sphere_frames(far), voxel_size=VOXEL).mesh.vertices - far, axis=1) - RADIUS
    )
    assert np.sqrt((error**2).mean()) < 0.15 * VOXEL


def compute_closed_ratio(mesh: Mesh, x: tuple[float, float], y: tuple[float, float]) -> float:
    """Compute the share of downward rays over a rectangle of the plane z = 0 that hit the mesh."""
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles.astype(np.uint32))
    )
    at = np.stack(np.meshgrid(np.linspace(*x, 200), np.linspace(*y, 50)), axis=-1).reshape(-1, 2)
    down = np.concatenate([at, np.tile([1.0, 0, 0, -1], (len(at), 1))], axis=1).astype(np.float32)
    return float(np.isfinite(scene.cast_rays(o3d.core.Tensor(down))["t_hit"].numpy()).mean())


@pytest.mark.parametrize(
    ("tilt", "seen"), [(0.25, (1.5, 4.0)), (0.6, (1.0, 1.4)), (1.5, (0.35, 0.2))], ids=["14°", "34°", "86°"]
)
def test_a_plane_is_flat_and_closed_at_any_viewing_angle(tilt: float, seen: tuple[float, float]) -> None:
    mesh = fuse(
        [render_plane_frame(0.5, tilt, k) for k in range(4)], voxel_size=0.05, max_depth=5.0, max_jump=0.2
    ).mesh
    # Far pixels are wider than half a voxel.
    assert np.abs(mesh.vertices[:, 2]).max() < 0.3 * 0.05
    assert compute_closed_ratio(mesh, seen, (-0.15, 0.15)) == 1


def test_flying_pixels_are_rejected() -> None:
    """Sensors report depth between an object and the wall behind along its outline."""
    frames = []
    for frame in render_sphere_frames():
        depth = np.where(frame.depth == 0, 3.0, frame.depth).astype(np.float32)
        frames.append(replace(frame, depth=cv2.blur(depth, (3, 1))))
    mesh = fuse(frames, voxel_size=VOXEL, max_depth=2.5).mesh
    assert (np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS) < 2 * VOXEL).mean() > 0.995


def test_gaps_of_one_pixel_are_bridged() -> None:
    whole, gaps = render_sphere_frames(), []
    for frame in whole:
        depth = np.array(frame.depth)
        depth[::4] = 0
        depth[:, ::4] = 0
        gaps.append(replace(frame, depth=depth))
    expected, found = (fuse(frames, voxel_size=VOXEL, min_weight=1) for frames in (whole, gaps))
    assert found.pixels_valid < 0.6 * expected.pixels_valid
    assert found.pixels_used > 0.9 * expected.pixels_used
    assert len(found.mesh.triangles) > 0.97 * len(expected.mesh.triangles)


def test_results_do_not_depend_on_the_number_of_threads(
    sphere: FusionResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_same(fuse(render_sphere_frames(), voxel_size=VOXEL).mesh, sphere.mesh)
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    assert is_same(fuse(render_sphere_frames(), voxel_size=VOXEL).mesh, sphere.mesh)


def test_the_volume_grows_if_the_estimate_is_too_small(
    sphere: FusionResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scanloom.stages.fusion.fusion_plan._estimate_block_count", lambda *_: 1)
    assert is_same(fuse(render_sphere_frames(), voxel_size=VOXEL).mesh, sphere.mesh)


def test_memory_is_bounded() -> None:
    with pytest.raises(StageError, match=r"exceed its memory limit of .* MB with voxels of 0.001 m"):
        fuse(render_sphere_frames(), voxel_size=0.001, memory=20.0)


def test_derived_scale_follows_the_depth(sphere: FusionResult) -> None:
    fused = fuse(render_sphere_frames())
    # Twice the pixel spacing on the near side, about 1.3 m away.
    assert fused.voxel_size == pytest.approx(2 * 1.3 / CAMERA.fx, rel=0.15)
    assert 3 * fused.voxel_size <= fused.truncation <= 5 * fused.voxel_size
    assert fused.max_depth > 1.6
    assert sphere.voxel_size == VOXEL
    error = np.linalg.norm(fused.mesh.vertices, axis=1) - RADIUS
    assert np.sqrt((error**2).mean()) < 0.3 * fused.voxel_size


def test_the_voxel_factor_scales_derived_sizes_only() -> None:
    plans = [fuse(render_sphere_frames(), voxel_factor=factor) for factor in (1.0, 2.0, 4.0)]
    sizes = [plan.voxel_size for plan in plans]
    np.testing.assert_allclose(sizes, sizes[0] * np.array([1, 2, 4]), rtol=0.06)
    counts = [len(plan.mesh.triangles) for plan in plans]
    assert counts[1] == pytest.approx(counts[0] / 4, rel=0.3)
    assert fuse(render_sphere_frames(), voxel_size=0.05, voxel_factor=4.0).voxel_size == 0.05


def test_noise_is_measured_and_sets_the_scale() -> None:
    rng = np.random.default_rng(7)
    frames = []
    for k in range(12):
        frame = render_plane_frame(1.5, 1.5, k)
        noise = rng.normal(0, 0.02, (CAMERA.height, CAMERA.width))
        frames.append(replace(frame, depth=(frame.depth + noise * (frame.depth > 0)).astype(np.float32)))
    fused = fuse(frames, max_jump=0.2)
    assert fused.noise.compute_deviation(1.5) == pytest.approx(0.02, rel=0.25)
    assert fused.voxel_size == pytest.approx(2 * fused.noise.compute_deviation(1.5), rel=0.15)


def render_two_walls(noise: float) -> list[Frame]:
    """Render walls at 1 m and 4 m from a camera that moves sideways; noise grows with z²."""
    rng = np.random.default_rng(8)
    frames = []
    for k in range(6):
        pose = np.eye(4)
        pose[0, 3] = 0.01 * k
        depth = np.full((CAMERA.height, CAMERA.width), 1.0)
        depth[:, : CAMERA.width // 4] = 4.0
        depth += rng.normal(0, noise * depth**2)
        frames.append(Frame(str(k), CAMERA, depth=depth.astype(np.float32), world_from_camera=pose))
    return frames


def test_depth_too_noisy_for_the_voxel_size_is_reported() -> None:
    frames = render_two_walls(0.01)
    fused = fuse(frames, max_jump=0.3)
    assert fused.max_depth < 3
    (said,) = map(str, fused.diagnostics)
    assert re.fullmatch(r"2[0-9]% of the depth lies beyond 2\.\d\d m and is ignored, .*", said)
    advised = re.search(r"fuse\.voxel_size=([\d.]+) includes depth up to 4\.", said)
    assert advised is not None
    taken = fuse(frames, max_jump=0.3, voxel_size=float(advised[1]))
    assert taken.diagnostics == ()
    assert taken.mesh.vertices[:, 2].max() > 3.5
    # An explicit limit needs no report.
    assert fuse(frames, max_jump=0.3, max_depth=2).diagnostics == ()


def test_one_frame_is_enough() -> None:
    frame = render_sphere_frames()[0]
    fused = fuse([frame], voxel_size=VOXEL)
    assert fused.min_weight == 1
    assert np.abs(np.linalg.norm(fused.mesh.vertices, axis=1) - RADIUS).max() < VOXEL
    eye = np.asarray(frame.world_from_camera)[:3, 3]
    assert (fused.mesh.vertices @ eye > 0).all()


def test_colour_of_another_size_and_a_grey_one() -> None:
    frames = [
        replace(f, color=cv2.resize(np.asarray(f.color), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST))
        for f in render_sphere_frames()
    ]
    mesh = fuse(frames, voxel_size=VOXEL).mesh
    assert mesh.colors is not None
    assert (np.abs(np.median(mesh.colors[mesh.vertices[:, 0] > 0.1], axis=0) - [200, 30, 40]) <= 1).all()
    frames = [replace(f, color=np.full((120, 160), 90, np.uint8)) for f in frames]
    grey = fuse(frames, voxel_size=VOXEL).mesh.colors
    assert grey is not None
    assert (np.abs(grey.astype(int) - 90) <= 1).all()


def test_no_colour_in_no_colour_out() -> None:
    frames = [replace(f, color=None) for f in render_sphere_frames()]
    assert fuse(frames, voxel_size=VOXEL).mesh.colors is None
    assert fuse(render_sphere_frames(), voxel_size=VOXEL, color=False).mesh.colors is None


def test_lens_distortion_is_undone() -> None:
    bent = replace(CAMERA, distortion=(-0.6, 0.2, 0.0, 0.0))
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    bent_x, bent_y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    x, y = bent_x, bent_y
    for _ in range(100):
        squared = x * x + y * y
        x, y = (value / (1 - 0.6 * squared + 0.2 * squared**2) for value in (bent_x, bent_y))
    x = (x * CAMERA.fx + CAMERA.cx).astype(np.float32)
    y = (y * CAMERA.fy + CAMERA.cy).astype(np.float32)
    frames = [render_plane_frame(0.5, 0.6, k) for k in range(3)]
    seen = [replace(f, depth=cv2.remap(np.asarray(f.depth), x, y, cv2.INTER_NEAREST)) for f in frames]
    straightened = fuse([replace(f, camera=bent) for f in seen], voxel_size=0.05).mesh.vertices[:, 2]
    crooked = fuse(seen, voxel_size=0.05).mesh.vertices[:, 2]
    assert np.sqrt((straightened**2).mean()) < 0.1 * 0.05
    assert np.sqrt((crooked**2).mean()) > 3 * np.sqrt((straightened**2).mean())


def test_a_bad_frame_is_skipped_and_named(tmp_path: Path) -> None:
    frames = render_sphere_frames()
    damaged = tmp_path / "depth.png"
    damaged.write_bytes(b"no image")
    bad = replace(frames[3], depth=damaged), replace(frames[4], world_from_camera=None)
    given = {"voxel_size": VOXEL, "truncation": 3 * VOXEL, "max_depth": 3.0}
    fused, good = fuse([*frames, *bad], **given), fuse(frames, **given)
    assert [s.name for s in fused.skipped] == ["03", "04"]
    assert "depth.png" in fused.skipped[0].reason
    assert "pose" in fused.skipped[1].reason
    assert fused.frames == 12
    assert fused.mesh.vertices.shape == good.mesh.vertices.shape
    assert np.abs(fused.mesh.vertices - good.mesh.vertices).mean() < 0.01 * VOXEL


def test_too_many_unusable_frames_are_an_error() -> None:
    frames = [
        replace(f, world_from_camera=None) if k < 4 else f for k, f in enumerate(render_sphere_frames())
    ]
    with pytest.raises(InputError, match=r"3 of 12 frames cannot be used; .* allows 20%.*frame, 00.*pose"):
        fuse(frames, voxel_size=VOXEL)
    assert fuse(frames, voxel_size=VOXEL, max_skipped_ratio=0.4).frames == 8


def _remove_depth(frame: Frame) -> Frame:
    return replace(frame, depth=np.zeros((CAMERA.height, CAMERA.width), np.float32))


def _scale_pose(frame: Frame) -> Frame:
    return replace(frame, world_from_camera=np.diag([1.0, 1.0, 2.0, 1.0]))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_remove_depth, "no pixel has a depth"),
        (lambda f: replace(f, world_from_camera=None), "none of the 12 frames has a camera pose"),
        (lambda f: replace(f, depth=None), "none of the 12 frames has a depth map"),
        (lambda f: replace(f, world_from_camera=np.full((4, 4), np.nan)), "not finite"),
        (_scale_pose, "not a rotation"),
        (lambda f: replace(f, depth=np.ones((10, 10), np.float32)), "10×10"),
    ],
    ids=["zero depth", "no poses", "no depth", "nan pose", "scaled pose", "wrong size"],
)
def test_unusable_input_is_refused_in_a_sentence(spoil: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fuse([spoil(f) for f in render_sphere_frames()])  # type: ignore[operator]


def test_no_frames() -> None:
    with pytest.raises(InputError, match="no frames"):
        fuse(Scan("none", ()))


def test_depth_out_of_the_limits_is_ignored() -> None:
    with pytest.raises(InputError, match="within the limits"):
        fuse(render_sphere_frames(), min_depth=5.0)


@pytest.mark.parametrize(
    "wrong", [{"voxel_size": 0.0}, {"truncation": -1.0}, {"min_weight": 0}, {"device": "tpu"}, {"voxel": 1.0}]
)
def test_wrong_parameters(wrong: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        fuse(render_sphere_frames(), **wrong)


def test_cuda_is_not_replaced_silently() -> None:
    if import_open3d().core.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(UsageError, match="no CUDA device"):
        fuse(render_sphere_frames(), device="cuda")
    assert fuse(render_sphere_frames(), voxel_size=VOXEL, device="auto").device == "CPU:0"


def test_progress_counts_frames_and_can_stop_the_work() -> None:
    calls: list[tuple[int, int]] = []
    fuse(render_sphere_frames(), voxel_size=VOXEL, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(k, 12) for k in range(1, 13)]

    def stop(done: int, total: int) -> None:  # noqa: ARG001
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fuse(render_sphere_frames(), voxel_size=VOXEL, progress=stop)


def test_metrics_are_json_with_units(sphere: FusionResult) -> None:
    metrics = json.loads(json.dumps(sphere.to_dict()))
    assert metrics["voxel_size_m"] == VOXEL
    assert metrics["frames_used_ratio"] == 1
    assert 0 < metrics["pixels_used_ratio"] <= metrics["pixels_valid_ratio"] < 1
    assert metrics["triangles"] == len(sphere.mesh.triangles)


def test_a_real_kitchen(shared_data: Path) -> None:
    scan = read_scan(shared_data / "rgbd" / "7scenes_redkitchen")
    fused = fuse(scan.frames[:30:3], voxel_size=0.03)
    again = fuse(scan.frames[:30:3], voxel_size=0.03)
    assert is_same(fused.mesh, again.mesh)
    assert fused.pixels_used > 0.8
    # Published noise of the first Kinect at 2 m: 5 mm.
    assert 0.002 < fused.noise.compute_deviation(2.0) < 0.008
    assert len(fused.mesh.triangles) > 20_000
    assert fused.mesh.colors is not None
    assert fused.mesh.colors.std() > 20
