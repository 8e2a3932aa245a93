"""Crops: containment, cropped depth maps and meshes, and fusion of the cropped region."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from object_on_table import BALL, BOX_HALF_SIZE, CAMERA, OBJECT_POSITION, frames, pose, render_depth
from scipy.spatial import cKDTree

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from scanloom.stages.fusion.crop import Crop, crop_depth, crop_mesh, mask_pixels_inside
from scanloom.stages.fusion.fuse import FusionResult, fuse
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
VOXEL = 0.015
SAME: dict[str, Any] = {"voxel_size": VOXEL, "truncation": 3 * VOXEL, "max_depth": 3.0, "min_weight": 2}
LIMITS = DepthLimits(min_depth=0, max_depth=9, max_jump=0.05, max_angle=87)

numbers = st.floats(-1.5, 1.5)
points = st.tuples(numbers, numbers, numbers)


@st.composite
def draw_boxes(draw: st.DrawFn) -> tuple[float, ...]:
    low, size = draw(points), draw(st.tuples(*3 * [st.floats(0.01, 2)]))
    return (*low, *np.add(low, size).tolist())


@st.composite
def draw_crops(draw: st.DrawFn) -> Crop:
    has_ball, has_plane = draw(st.booleans()), draw(st.booleans())
    normal = np.array(draw(points.filter(lambda p: np.linalg.norm(p) > 0.1)))
    normal /= np.linalg.norm(normal)
    return Crop(
        box=draw(st.none() | draw_boxes()),
        center=draw(points) if has_ball else None,
        radius=draw(st.floats(0.01, 2)) if has_ball else None,
        normal=tuple(normal.tolist()) if has_plane else None,
        height=draw(numbers) if has_plane else 0.0,
    )


def is_inside(crop: Crop, place: Floats) -> bool:
    """Check containment by separate conditions for box, sphere and plane."""
    in_box = crop.box is None or all(crop.box[k] <= place[k] <= crop.box[3 + k] for k in range(3))
    in_ball = crop.radius is None or sum((place - crop.center) ** 2) <= crop.radius**2
    return in_box and in_ball and (crop.normal is None or np.dot(crop.normal, place) >= crop.height)


@given(draw_crops(), st.lists(points, min_size=1, max_size=5))
@settings(max_examples=50)
def test_the_distance_to_a_crop_is_zero_inside(crop: Crop, places: list[Any]) -> None:
    outside = crop.compute_distance(np.array(places))
    for place, far in zip(np.array(places), outside, strict=True):
        assert abs(far) < 1e-9 or (far < 0) == is_inside(crop, place)


@given(draw_crops(), points, points)
@settings(max_examples=50)
def test_the_distance_to_a_crop_is_1_lipschitz(crop: Crop, a: Any, b: Any) -> None:
    one, other = crop.compute_distance(np.array([a, b]))
    assert not crop or abs(one - other) <= np.linalg.norm(np.subtract(a, b)) + 1e-9


@pytest.fixture(scope="module")
def view() -> PosedDepth:
    return read_posed_depth(frames("ball")[3], LIMITS)


@given(draw_crops(), st.floats(0, 0.5))
@settings(max_examples=30)
def test_cropped_depth_is_exactly_the_depth_inside(view: PosedDepth, crop: Crop, by: float) -> None:
    was = view.surface.depth
    inside = mask_pixels_inside(view, crop, by)
    left = crop_depth(view, crop).surface.depth
    assert (left == np.where(mask_pixels_inside(view, crop), was, 0)).all()
    # Unproject differently: with the camera matrix, columns as x and rows as y.
    rows, columns = np.nonzero(was)
    rays = np.linalg.solve(CAMERA.matrix, np.stack([columns, rows, np.ones(len(rows))])).T
    places = (rays * was[rows, columns, None]) @ view.pose[:3, :3].T + view.pose[:3, 3]
    outside = crop.compute_distance(places)
    clear = np.abs(outside - by) > 1e-5
    assert (inside[rows, columns] == (outside <= by))[clear].all()
    assert np.count_nonzero(inside) == np.count_nonzero(inside[rows, columns]), "and none without depth"


def test_an_empty_crop_keeps_the_depth(view: PosedDepth) -> None:
    assert not Crop()
    assert (crop_depth(view, Crop()).surface.depth == view.surface.depth).all()
    assert (Crop().compute_distance(np.zeros((2, 3))) < 0).all()


def test_a_cropped_mesh_keeps_colours_and_order() -> None:
    vertices = np.array([[x, y, 0.0] for y in (0, 1) for x in range(5)])
    triangles = np.array([[x, x + 1, x + 5] for x in range(4)], np.int32)
    colors = np.arange(30, dtype=np.uint8).reshape(10, 3)
    left = crop_mesh(Mesh(vertices, triangles, colors), Crop(box=(0.5, -1, -1, 9, 9, 9)))
    assert left.vertices[left.triangles].tolist() == vertices[triangles[1:]].tolist()
    assert left.colors is not None
    assert left.colors[left.triangles].tolist() == colors[triangles[1:]].tolist()
    assert len(left.vertices) == len(np.unique(triangles[1:]))


@pytest.fixture(scope="module")
def whole() -> FusionResult:
    return fuse(frames("ball"), **SAME)


@pytest.mark.parametrize(
    "crop",
    [
        Crop(box=(-0.1, -0.3, -0.05, 0.4, 0.05, 0.2)),
        Crop(center=(*OBJECT_POSITION.tolist(), 0.1), radius=0.2),
        Crop(box=(-0.3, -0.3, 0.04, 0.3, 0.3, 0.5), center=(0.0, 0.0, 0.1), radius=0.16),
    ],
    ids=str,
)
def test_fusing_a_crop_equals_cropping_the_fused_mesh_within_a_voxel(whole: FusionResult, crop: Crop) -> None:
    part = fuse(frames("ball"), **SAME, box=crop.box, center=crop.center, radius=crop.radius)
    assert part.crop == crop
    assert (crop.compute_distance(part.mesh.vertices) <= 0).all()
    # All of the part belongs to the whole mesh, and all of the whole mesh inside the crop is in the part.
    off, _ = cKDTree(whole.mesh.vertices).query(part.mesh.vertices)
    assert np.percentile(off, 99) < 1e-6
    assert off.max() < VOXEL
    within = whole.mesh.vertices[crop.compute_distance(whole.mesh.vertices) < -VOXEL]
    off, _ = cKDTree(part.mesh.vertices).query(within)
    assert np.percentile(off, 99) < 1e-6
    assert off.max() < VOXEL
    assert part.volume_bytes < 0.6 * whole.volume_bytes


def test_the_same_crop_gives_the_same_bytes() -> None:
    one, other = (fuse(frames("box"), remove_plane=True, radius=0.4).mesh for _ in range(2))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.triangles.tobytes() == other.triangles.tobytes()


def test_the_voxel_size_follows_the_cropped_depth() -> None:
    # The floor is farther away.
    floor = fuse(frames("ball"), box=(-1, -1, -0.7, 1, 1, -0.5))
    thing = fuse(frames("ball"), radius=0.25)
    assert thing.voxel_size < 0.7 * floor.voxel_size
    assert thing.to_dict()["crop"]["radius_m"] == 0.25
    assert thing.crop.center is not None
    assert np.abs(thing.crop.center - np.array([*OBJECT_POSITION, 0.08])).max() < 0.01, (
        "where the cameras look"
    )


@pytest.mark.parametrize("roll", [0.0, 90.0, -90.0], ids=["level", "upright", "the other way"])
@pytest.mark.parametrize("table", [0.45, 0.3])
def test_plane_removal_keeps_only_the_ball(roll: float, table: float) -> None:
    fused = fuse(frames("ball", roll=roll, table=table), remove_plane=True)
    assert fused.diagnostics == ()
    assert fused.support is not None
    assert fused.support.normal[2] > np.cos(np.radians(0.1))
    assert abs(fused.support.offset_m) < 0.0005
    assert 0.0003 < fused.support.spread_m < 0.0012
    told = fused.to_dict()["crop"]["plane"]
    assert fused.mesh.vertices[:, 2].min() >= told["margin_m"] - 1e-3 > fused.voxel_size
    error = np.linalg.norm(fused.mesh.vertices - [*OBJECT_POSITION, BALL], axis=1) - BALL
    assert np.abs(error).max() < fused.voxel_size
    assert fused.mesh.colors is not None
    red = fused.mesh.colors[fused.mesh.vertices[:, 2] > 1.2 * BALL, 0]
    assert np.percentile(red, 10) > 140


def test_the_lid_of_a_box_is_not_removed_as_table() -> None:
    # The lid is as large as the visible part of this table.
    fused = fuse(frames("box", table=0.3), remove_plane=True)
    assert fused.support is not None
    assert abs(fused.support.offset_m) < 0.001
    assert abs(fused.mesh.vertices[:, 2].max() - 2 * BOX_HALF_SIZE[2]) < 0.005
    reach = np.abs(fused.mesh.vertices[:, :2] - OBJECT_POSITION).max(axis=0)
    assert reach == pytest.approx(BOX_HALF_SIZE[:2], abs=2 * fused.voxel_size)


def test_a_table_is_kept_if_the_center_marks_it_as_object() -> None:
    fused = fuse(frames("nothing", table=0.2), remove_plane=True, center=(0, 0, -0.3), radius=0.7)
    assert fused.support is not None
    assert abs(fused.support.offset_m + 0.6) < 0.001
    assert fused.mesh.vertices[:, 2].min() > -0.6 + fused.voxel_size
    assert np.linalg.norm(fused.mesh.vertices[:, :2], axis=1).max() < 0.2 + fused.voxel_size


def test_a_plane_without_objects_is_kept_and_reported() -> None:
    given = {"radius": 0.3, "voxel_size": VOXEL}
    bare, fused = (fuse(frames("nothing"), **given, remove_plane=remove) for remove in (False, True))
    assert fused.support is None
    (said,) = map(str, fused.diagnostics)
    assert said.startswith(
        "remove_plane: no plane is removed, because none was found under the object: the largest plane"
    )
    assert "has no points above it" in said
    assert fused.mesh.vertices.tobytes() == bare.mesh.vertices.tobytes()


def test_a_wall_is_not_removed_as_table() -> None:
    # The same scene with world and cameras rotated by 90°: the up direction is in the plane of the table.
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    level = [pose(angle, lift=0.05) for angle in (-15, -5, 5, 15)]
    wall = []
    for number, there in enumerate(level):
        looking = np.eye(4)
        looking[:3, :3], looking[:3, 3] = turn.T @ there[:3, :3], turn.T @ there[:3, 3]
        depth = render_depth(looking, "ball").astype(np.float32)
        wall.append(Frame(f"{number}", CAMERA, depth=depth, world_from_camera=there))
    fused = fuse(wall, remove_plane=True)
    assert fused.support is None
    assert "because none was found under the object" in str(fused.diagnostics[0])


def test_removing_nearly_everything_is_reported() -> None:
    fused = fuse(frames("ball"), remove_plane=True, plane_margin=0.23, voxel_size=0.01)
    (said,) = map(str, fused.diagnostics)
    assert said.startswith("remove_plane: only 0.")
    assert "% of the points are more than 0.23 m above the plane; if it is not the plane under" in said


@pytest.mark.parametrize(
    ("changes", "of"),
    [
        ({"box": (5, 5, 5, 6, 6, 6)}, "the box (5, 5, 5) to (6, 6, 6) m; most points are within ("),
        ({"radius": 0.01}, "0.01 m around (0.0"),
        ({"remove_plane": True, "plane_margin": 0.5}, "the half-space above the plane ("),
    ],
)
def test_an_empty_crop_is_an_error_with_its_extent(changes: dict[str, Any], of: str) -> None:
    with pytest.raises(UsageError) as caught:
        fuse(frames("ball"), **changes)
    assert str(caught.value).startswith("the crop is empty: none of ")
    assert " is inside " in str(caught.value)
    assert of in str(caught.value)


def test_a_crop_without_surface_is_an_error_with_the_point_count() -> None:
    with pytest.raises(
        InputError, match=r"inside 0\.04 m around \(.*\) \([\d,]+ depth points there\)\. Check"
    ):
        fuse(
            frames("ball"), radius=0.04, center=(*OBJECT_POSITION.tolist(), 2 * BALL + 0.03), voxel_size=0.05
        )


def test_parameters_without_effect_are_reported() -> None:
    fused = fuse(frames("ball"), center=(0, 0, 0), plane_margin=0.1, voxel_size=0.03)
    assert list(map(str, fused.diagnostics)) == [
        "center has no effect without radius or remove_plane",
        "plane_margin has no effect without remove_plane",
    ]
    assert not fused.crop


def test_frames_outside_the_crop_are_not_skipped_frames() -> None:
    away = [replace(frame, name=f"away-{k}") for k, frame in enumerate(frames("ball"))]
    for frame in away:
        assert frame.world_from_camera is not None
        frame.world_from_camera[:3, 3] += [30, 0, 0]
    near = frames("ball")
    # Two of 34 frames show the region, and neither is in the sample for estimates.
    scan = [*away, near[2], near[3], *(replace(frame, name=f"more-{frame.name}") for frame in away)]
    fused = fuse(scan, box=(-0.3, -0.3, -0.1, 0.3, 0.3, 0.4))
    assert (fused.frames, fused.outside, fused.skipped) == (2, 32, ())
    assert fused.to_dict()["crop"]["frames_outside"] == 32
    assert fused.to_dict()["frames_used_ratio"] == 1
    assert len(fused.mesh.triangles) > 500


@pytest.mark.parametrize("box", [(0, 0, 0, 1, 1, 0), (1, 0, 0, 0, 1, 1), (0, 0, 0, 0, 0, 0)])
def test_a_box_must_have_its_lowest_corner_first(box: Any) -> None:
    with pytest.raises(UsageError, match=r"^box is .* m; the first three numbers must be the lowest corner"):
        FuseParams(box=box)


def test_boxes_are_accepted_as_any_six_numbers() -> None:
    given = [FuseParams(box=box) for box in ([0, 0, 0, 1, 1, 1], np.array([0, 0, 0, 1, 1, 1.0]))]  # type: ignore[arg-type]
    assert given[0] == given[1] == FuseParams(box=(0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
    with pytest.raises(UsageError, match=r"box is .*; it must be 6 finite numbers"):
        FuseParams(box=(0, 0, 0))  # type: ignore[arg-type]


def test_plane_removal_on_a_real_tabletop(shared_data: Path) -> None:
    scan = read_scan(shared_data / "rgbd" / "tabletop_box_realsense")
    fused = fuse(scan, remove_plane=True, radius=0.3, voxel_size=0.004)
    assert fused.diagnostics == ()
    assert fused.support is not None
    assert fused.support.spread_m < 0.002
    normal = np.array(fused.support.normal)
    assert normal @ [-0.03, -0.947, -0.32] > np.cos(np.radians(1))
    # No horizontal surface remains near the table; the remaining surface is steep.
    corners = fused.mesh.vertices[fused.mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    height = corners.mean(axis=1) @ normal - fused.support.offset_m
    level = (across @ normal > 1.8 * area) & (height < 0.012)
    assert area[level].sum() < 0.01 * area.sum()
    assert height.max() > 0.15
