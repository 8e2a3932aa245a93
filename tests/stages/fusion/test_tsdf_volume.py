"""The TSDF kernel: comparison with Open3D, subdivision into bricks, and invalid input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from thin_sheet import thin_sheet

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import StageError, UsageError
from scanloom.stages.frames.posed_depth import read_posed_depth
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.fusion.fusion_plan import make_depth_limits
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.tsdf_volume import (
    DepthNoiseModel,
    SparseVolume,
    compute_block_bytes,
    find_touched_blocks,
)
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh import Mesh

VOXEL = 0.02
CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)


def make_plate(x: float, far: float = 3.0) -> Frame:
    """Render a plate of 0.5 m at 1 m distance in front of a wall, from a camera at `x`."""
    rows, columns = np.mgrid[:120, :160]
    across, down = (columns - CAMERA.cx) / CAMERA.fx + x, (rows - CAMERA.cy) / CAMERA.fy
    depth = np.where((abs(across) < 0.25) & (abs(down) < 0.25), 1, far).astype(np.float32)
    color = np.where(depth[..., None] < 2, np.uint8([200, 40, 30]), np.uint8([20, 60, 220]))
    pose = np.eye(4)
    pose[0, 3] = x
    return Frame(f"{x}", CAMERA, color=color, depth=depth, world_from_camera=pose)


def measure_distances(one: Mesh, other: Mesh) -> NDArray[np.float64]:
    """Compute distances from vertices to the nearest vertex of the other mesh."""
    return np.asarray(cKDTree(other.vertices).query(one.vertices)[0])


def test_a_real_kitchen_agrees_with_open3d(shared_data: Path) -> None:
    frames = read_scan(shared_data / "rgbd" / "7scenes_redkitchen").frames[:40:5]
    own, other = (fuse(frames, voxel_size=0.02, min_weight=2, backend=name) for name in ("own", "open3d"))
    for one, two in ((own, other), (other, own)):
        assert np.median(measure_distances(one.mesh, two.mesh)) < 0.15 * 0.02
        assert np.quantile(measure_distances(one.mesh, two.mesh), 0.8) < 0.5 * 0.02
    assert own.volume_bytes < 0.7 * other.volume_bytes
    nearest = cKDTree(other.mesh.vertices).query(own.mesh.vertices)[1]
    assert own.mesh.colors is not None
    assert other.mesh.colors is not None
    off = np.abs(own.mesh.colors.astype(int) - other.mesh.colors[nearest].astype(int))
    assert np.median(off) <= 5


def test_unmeasured_surface_is_left_open() -> None:
    """Behind the rim of a plate there could be the sides of a thick plate, but no frame measured them."""
    mesh = fuse([make_plate(0.02 * k) for k in range(4)], voxel_size=VOXEL, min_weight=1).mesh
    near = mesh.vertices[mesh.vertices[:, 2] < 2]
    assert np.abs(near[:, 2] - 1).max() < 0.05 * VOXEL
    assert near[:, :2].min() < -0.2
    assert near[:, :2].max() > 0.2


@pytest.mark.parametrize("behind", [3, 12])
def test_both_sides_of_a_thin_sheet_are_kept(behind: int) -> None:
    """Frames of one side do not displace or tear the other side, and do not mix its colours."""
    frames = [thin_sheet(-1, 0.02 * k, 2 * VOXEL, (200, 40, 30)) for k in range(3)]
    frames += [thin_sheet(1, 0.02 * k, 2 * VOXEL, (20, 60, 220)) for k in range(behind)]
    mesh = fuse(frames, voxel_size=VOXEL, truncation=5 * VOXEL, min_weight=1).mesh
    assert mesh.colors is not None
    inner = np.abs(mesh.vertices[:, :2]).max(axis=1) < 0.18
    for side, channel in ((-1, 0), (1, 2)):
        here = inner & (side * mesh.vertices[:, 2] > 0) & (np.abs(mesh.vertices[:, 2]) < 0.5)
        off = np.abs(mesh.vertices[here, 2] - side * VOXEL)
        assert np.quantile(off, 0.95) < 0.35 * VOXEL
        assert np.median(mesh.colors[here].argmax(axis=1)) == channel
        # Complete: a vertex for each column of voxels.
        assert here.sum() >= 17**2


def test_observations_are_counted_per_vertex() -> None:
    frames = [make_plate(0.1 * k) for k in range(4)]
    whole = fuse(frames, voxel_size=VOXEL, min_weight=1)
    assert whole.observation_counts is not None
    assert whole.observation_counts.shape == (len(whole.mesh.vertices),)
    near = whole.mesh.vertices[:, 2] < 2
    # All frames see the plate, only the first frame sees the left end of the wall.
    assert np.median(whole.observation_counts[near]) == 4
    assert np.median(whole.observation_counts[~near & (whole.mesh.vertices[:, 0] < -1.65)]) == 1
    part = fuse(frames, voxel_size=VOXEL, min_weight=1, box=(-1, -1, 0.5, 1, 1, 1.5))
    assert part.observation_counts is not None
    assert len(part.observation_counts) == len(part.mesh.vertices) < near.sum() + 1
    assert fuse(frames, voxel_size=VOXEL, backend="open3d").observation_counts is None


def test_near_depth_has_more_weight_than_far_depth() -> None:
    """Two frames disagree by 1 cm, and one of them is at twice the distance."""
    camera = Camera(40, 40, 100.0, 100.0, 19.5, 19.5)
    volume = SparseVolume(
        VOXEL, 3 * VOXEL, DepthNoiseModel(1e-3, 1.0, 1.0), color=False, max_bytes=1e8, threads=1
    )
    limits = make_depth_limits(FuseParams())
    for z, off in ((1.0, 0.0), (2.0, 0.01)):
        pose = np.eye(4)
        pose[2, 3] = -z
        wall = np.full((40, 40), z + off, np.float32)
        view = read_posed_depth(Frame("0", camera, depth=wall, world_from_camera=pose), limits)
        here = np.ones_like(wall, bool)
        volume.integrate(view, volume.prepare_frame(view, here, pose), pose, None)
    # Weights of 1 and 1/16.
    vertices = volume.extract_mesh(2)[0].vertices
    np.testing.assert_allclose(vertices[:, 2], 0.01 / 17, atol=1e-4)


def test_the_memory_of_a_voxel_is_as_documented() -> None:
    for color in (False, True):
        fused = fuse([make_plate(0.02 * k) for k in range(4)], voxel_size=VOXEL, color=color)
        assert fused.volume_bytes % (64 * compute_block_bytes(color=color)) == 0
    assert compute_block_bytes(color=True) == 12 * 8**3


def test_blocks_of_bricks_equal_blocks_of_the_whole_volume() -> None:
    view = read_posed_depth(make_plate(0.1), make_depth_limits(FuseParams()))
    wanted = view.surface.depth > 0
    whole = find_touched_blocks(view, wanted, view.pose, voxel_size=VOXEL, truncation=0.06)
    camera = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 160, 120), view.pose
    surface = view.surface
    parts = [
        _kernels.find_touched_blocks(
            camera,
            surface.depth,
            surface.normal,
            surface.obliqueness,
            wanted,
            voxel_size=VOXEL,
            truncation=0.06,
            within=bounds,
        )
        for bounds in (((-1000, -1000, -1000), (0, 1000, 1000)), ((0, -1000, -1000), (1000, 1000, 1000)))
    ]
    assert all(len(part) for part in parts)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), whole)


def test_a_pose_far_from_the_others_is_an_error() -> None:
    far = np.eye(4)
    far[0, 3] = 1e6
    view = read_posed_depth(make_plate(0.0), make_depth_limits(FuseParams()))
    with pytest.raises(StageError, match=r"more than 168 km from the other cameras.*Check the poses"):
        find_touched_blocks(view, view.surface.depth > 0, far, voxel_size=VOXEL, truncation=0.06)


def test_the_own_backend_refuses_cuda() -> None:
    with pytest.raises(UsageError, match="backend 'own' runs on the CPU only"):
        fuse([make_plate(0.0)], backend="own", device="cuda")
    assert fuse([make_plate(0.1 * k) for k in range(3)], backend="own", device="auto").device == "CPU:0"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"depth": np.ones((7, 7), np.float32)}, "size differs"),
        ({"depth": np.ones((240, 160), np.float32)[::2]}, "not contiguous"),
        ({"color": np.zeros((120, 160, 4), np.uint8)}, "h × w × 3"),
        ({"color": None}, "the frame has no colour image"),
        ({"pose": np.full((4, 4), np.nan)}, "finite"),
        ({"pose": np.eye(3)}, "4 × 4"),
        ({"pixels": (0.0, 140.0, 80.0, 60.0, 160, 120)}, "focal"),
        ({"pixels": (140.0, 140.0, 80.0, 60.0, 1 << 20, 1 << 20)}, "2³⁰"),
    ],
)
def test_inconsistent_arguments_are_refused(wrong: dict[str, object], message: str) -> None:
    volume = _kernels.Volume(VOXEL, 0.06, color=True, max_blocks=100)
    given = {
        "pixels": (140.0, 140.0, 80.0, 60.0, 160, 120),
        "pose": np.eye(4),
        "depth": np.ones((120, 160), np.float32),
        "color": np.zeros((120, 160, 3), np.uint8),
        **wrong,
    }
    with pytest.raises(ValueError, match=message):
        volume.integrate(
            np.zeros(1, np.uint64),
            (given["pixels"], given["pose"]),  # type: ignore[arg-type]
            given["depth"],  # type: ignore[arg-type]
            np.ones((120, 160), np.float32),
            given["color"],  # type: ignore[arg-type]
            weighing=(1.0, 1.0, 0.0),
            wanted_threads=1,
        )
    assert volume.block_count == 0


def test_invalid_depth_is_ignored() -> None:
    """NaN, infinite, negative and tiny depth count as missing."""
    frames = [make_plate(0.02 * k) for k in range(4)]
    good, bad = [], []
    for frame in frames:
        depth = np.array(frame.depth)
        depth[40:50, 60:70] = 0
        good.append(replace(frame, depth=depth.copy()))
        depth[40:50, 60:70] = np.resize([np.nan, np.inf, -1, 1e-42], (10, 10))
        bad.append(replace(frame, depth=depth))
    given = {"voxel_size": VOXEL, "truncation": 0.06, "max_depth": 2.0, "min_weight": 1}
    one, other = (fuse(frames, **given).mesh for frames in (good, bad))  # type: ignore[arg-type]
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.triangles, other.triangles)


def make_kernel_volume(**changes: Any) -> _kernels.Volume:
    """Integrate two plates directly into a kernel volume."""
    given = {"instructions": None, "weighing": (1.0, 1.0, 0.0)} | changes
    volume = _kernels.Volume(
        VOXEL, 3 * VOXEL, color=True, max_blocks=1 << 16, instructions=given["instructions"]
    )
    for x in (0.0, 0.1):
        frame = make_plate(x)
        view = read_posed_depth(frame, make_depth_limits(FuseParams()))
        here = view.surface.depth > 0
        keys = find_touched_blocks(view, here, view.pose, voxel_size=VOXEL, truncation=3 * VOXEL)
        camera = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 160, 120), view.pose
        color = np.ascontiguousarray(np.asarray(frame.color, np.uint8))
        surface = view.surface
        volume.integrate(
            keys,
            camera,
            surface.depth,
            surface.obliqueness,
            color,
            weighing=given["weighing"],
            wanted_threads=2,
        )
    return volume


def test_every_instruction_set_gives_the_same_volume() -> None:
    sets = _kernels.Volume.supported_instructions()
    assert sets[-1] == "plain"
    usual = make_kernel_volume().copy_voxels()
    for name in sets:
        for one, other in zip(make_kernel_volume(instructions=name).copy_voxels(), usual, strict=True):
            assert one is not None
            assert other is not None
            assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"instructions": "MMX"}, "this processor does not support MMX"),
        ({"weighing": (1.0, float("nan"), 0.0)}, "weighing must have finite values"),
        ({"weighing": (1.0, 1.0, -1.0)}, "weighing must have finite values"),
    ],
)
def test_invalid_volume_parameters_are_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make_kernel_volume(**changes)


def test_an_image_too_wide_for_single_precision_is_refused() -> None:
    with pytest.raises(ValueError, match="sides below 2²⁴"):
        _kernels.filter_depth(
            np.zeros((1, 8), np.float32),
            (1.0, 1.0, 0.0, 0.0, 1 << 24, 1),
            limits=(0.0, 1.0, 0.05, 0.1),
            wanted_threads=1,
        )
