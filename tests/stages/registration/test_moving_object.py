"""Registration of an object that turns in front of a static camera, without its background."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import turntable_object
from scipy.spatial.transform import Rotation

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.inspecting.inspect import inspect
from scanloom.stages.registration.codes import REGISTER_OBJECT_UNMATCHED
from scanloom.stages.registration.moving_object import _warn_unmatched, has_moving_object
from scanloom.stages.registration.plate_motion import Plate, drop_static_marks, estimate_plate_motion
from scanloom.stages.registration.register import register
from scanloom.stages.registration.registration_result import Registration
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose, Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"
TURNTABLE = "rgbd/turntable_d435_data1"
INTRINSICS = "616.8676,617.0631,319.5701,233.0649"


def compute_true_pose(angle: float) -> Pose:
    """Compute object-from-camera for an angle of the turntable."""
    return invert_pose(turntable_object.make_object_pose(angle)) @ turntable_object.camera_pose()


def compute_errors(found: Registration, angles: list[float]) -> tuple[list[float], list[float]]:
    """Compute rotation errors in degrees, and errors at the centre of the plate in metres."""
    first = invert_pose(compute_true_pose(angles[found.frame_indices[0]]))
    turns, shifts = [], []
    for place, frame in zip(found.frame_indices, found.frames, strict=True):
        off = invert_pose(first @ compute_true_pose(angles[place])) @ frame.world_from_camera
        turns.append(float(np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude())))
        middle = np.array((0, 0, 0.6, 1))
        shifts.append(float(np.linalg.norm((off @ middle - middle)[:3])))
    return turns, shifts


def assert_only_object(found: Registration, angles: list[float]) -> None:
    """Check that the fused mesh is on the plate and that the masks contain nothing else."""
    for place, frame in zip(found.frame_indices, found.frames, strict=True):
        _, _, shows = turntable_object.render_view(angles[place])
        assert np.mean((frame.mask > 0) & (shows == 0)) < 0.002
    mesh = fuse(list(found.frames), voxel_size=0.004).mesh
    world = compute_true_pose(angles[found.frame_indices[0]])
    points = mesh.vertices @ world[:3, :3].T + world[:3, 3]
    assert np.hypot(points[:, 0], points[:, 1]).max() < turntable_object.PLATE + 0.01
    assert points[:, 2].min() > -0.01
    # The box and the ball are reconstructed.
    assert np.count_nonzero(points[:, 2] > 0.09) > 100
    near_ball = np.linalg.norm(points - turntable_object.BALL[0], axis=1) < turntable_object.BALL[1] + 0.005
    assert np.count_nonzero(near_ball) > 100


def test_a_turning_object_is_registered_without_its_background() -> None:
    angles = [20.0 * k for k in range(10)]
    frames = turntable_object.frames(angles, texture=20)
    before = frames[0].depth.copy()
    found = register(frames)
    assert found.subject == "object"
    assert found.to_dict()["subject"] == "object"
    assert REGISTER_OBJECT_UNMATCHED.name not in {one.code for one in found.diagnostics}
    assert [len(piece) for piece in found.pieces] == [len(angles)]
    turns, shifts = compute_errors(found, angles)
    assert max(turns) < 1.2
    assert max(shifts) < 0.004
    assert_only_object(found, angles)
    np.testing.assert_array_equal(frames[0].depth, before)


def test_marks_on_the_plate_register_an_untextured_object_with_large_steps() -> None:
    angles = [47.0 * k for k in range(6)]
    found = register(turntable_object.frames(angles, texture=4, dots=True), loops=False)
    assert [len(piece) for piece in found.pieces] == [len(angles)]
    turns, shifts = compute_errors(found, angles)
    assert max(turns) < 2.0
    assert max(shifts) < 0.004
    assert_only_object(found, angles)


def test_a_static_scene_with_a_static_camera_has_no_moving_object() -> None:
    frames = turntable_object.frames([0.0] * 4)
    assert not has_moving_object(frames)
    found = register(frames)
    assert found.subject == "scene"
    assert any("the camera does not move" in str(one) for one in found.diagnostics)
    with pytest.raises(StageError, match="nothing moves in front of the camera"):
        register(frames, subject="object")


def test_a_moving_camera_has_no_moving_object() -> None:
    frames = [replace(frame, world_from_camera=None) for frame in read_scan(SAMPLE).frames[::4]]
    assert not has_moving_object(frames)
    auto, scene = register(frames), register(frames, subject="scene")
    for one, other in zip(auto.frames, scene.frames, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
        assert one.mask is None
    with pytest.raises(StageError, match=r"the camera moves\. register\.subject=object needs"):
        register(frames, subject="object")


@pytest.mark.parametrize(
    "name", ["rgbd/7scenes_redkitchen", "real/rgbd_dataset_freiburg1_rpy", "real/phone_desk_no_calibration"]
)
def test_public_scans_of_scenes_have_no_moving_object(shared_data: Path, name: str) -> None:
    assert not has_moving_object(read_scan(shared_data / name, complete=False).frames)


def test_independently_moving_objects_are_an_error() -> None:
    """Without feature matches, a mesh of independently moving objects would be meaningless."""
    frames = turntable_object.frames([0.0, 160.0, 40.0, 250.0], texture=3)
    draw = np.random.default_rng(0)
    torn = []
    for frame in frames:
        depth = np.array(frame.depth)
        for _ in range(12):
            row, column = draw.integers(90, 150), draw.integers(110, 200)
            depth[row : row + 12, column : column + 12] = draw.uniform(0.3, 0.6)
        torn.append(replace(frame, depth=depth))
    with pytest.raises(
        StageError, match="an object moves in front of a static camera, but its poses cannot be estimated"
    ):
        register(torn)


def test_inspect_reports_the_subject_of_registration() -> None:
    scan = Scan("made", turntable_object.frames([0.0, 25.0, 50.0, 75.0]))
    found = inspect(scan)
    assert found.to_dict()["subject"] == "object"
    assert any("register.subject=scene" in line for line in found.format_lines())


# -- the real one ----------------------------------------------------------------------------------------


def test_a_plush_dog_on_a_marked_sheet_is_fused_without_its_background(
    shared_data: Path, tmp_path: Path
) -> None:
    """Six frames about 60° apart: the sheet is turned by hand, the keyboard behind is static."""
    config = Config().set([f"scan.intrinsics={INTRINSICS}", "fuse.voxel_size=0.003"])
    out = tmp_path / "out"
    ran = run(shared_data / TURNTABLE, out, config, until="fuse")
    metrics = ran.report["stages"]["register"]["metrics"]
    assert (metrics["subject"], metrics["pieces"]) == ("object", [6])
    assert ran.unmet_requirements == ()
    masks = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((out / "masks").iterdir())]
    assert len(masks) == 6
    assert all(0.1 < np.mean(mask > 0) < 0.45 for mask in masks)
    scan = read_scan(shared_data / TURNTABLE, ScanParams(intrinsics=INTRINSICS), complete=False)
    kept = np.concatenate(
        [read_masked_depth(frame, mask) for frame, mask in zip(scan.frames, masks, strict=True)]
    )
    # The keyboard and the screen begin at 0.5 m.
    assert np.percentile(kept, 99.5) < 0.5


def read_masked_depth(frame: Frame, mask: np.ndarray) -> np.ndarray:
    depth = read_depth(replace(frame, mask=mask))
    return depth[depth > 0]


def test_subject_scene_registers_the_whole_scene(shared_data: Path) -> None:
    scan = read_scan(shared_data / TURNTABLE, ScanParams(intrinsics=INTRINSICS), complete=False)
    found = register(scan, subject="scene")
    assert found.subject == "scene"
    assert all(frame.mask is None for frame in found.frames)


# -- marks -----------------------------------------------------------------------------------------------


PLATE = Plate(np.array((0.0, 0.0, 0.5)), np.diag((-1.0, 1.0, -1.0)), 0.4)


def draw_marks(seed: int, count: int = 14) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.15, 0.15, (count, 2))


def test_the_rotation_of_marks_is_found_among_outliers() -> None:
    here = draw_marks(1)
    angle, shift = np.radians(131.0), np.array((0.02, -0.03))
    cosine, sine = np.cos(angle), np.sin(angle)
    there = here[2:11] @ np.array(((cosine, -sine), (sine, cosine))).T + shift
    found = estimate_plate_motion(here, np.concatenate([there, draw_marks(2, 6)]), PLATE)
    assert found is not None
    assert found.mark_count >= 9
    np.testing.assert_allclose(found.target_from_source, PLATE.compute_motion(angle, shift), atol=1e-6)


def test_different_marks_give_no_motion() -> None:
    assert estimate_plate_motion(draw_marks(1), draw_marks(7), PLATE) is None
    assert estimate_plate_motion(draw_marks(1, 3), draw_marks(7, 0), PLATE) is None


def test_static_marks_are_not_on_the_plate() -> None:
    table, turning = draw_marks(3, 5), [draw_marks(10 + k, 6) for k in range(4)]
    found = drop_static_marks({k: np.concatenate([table, own]) for k, own in enumerate(turning)}, PLATE)
    for k, own in enumerate(turning):
        np.testing.assert_array_equal(found[k], own)
    assert drop_static_marks({0: np.zeros((0, 2)), 1: table}, PLATE)[0].shape == (0, 2)


def test_a_component_of_one_frame_needs_no_mask() -> None:
    with pytest.raises(InputError, match="1 of 1 frames can be used"):
        register(turntable_object.frames([0.0]))


def test_a_plain_object_is_reported_before_its_registration_fails() -> None:
    """The warning comes before the first progress, because registration takes minutes."""
    events: list[str] = []
    with collecting() as diagnostics, pytest.raises(StageError, match="poses cannot be estimated"):
        register(
            turntable_object.frames([5.0 * k for k in range(12)], texture=0),
            progress=lambda *_: events.append(",".join(one.code for one in diagnostics)),
        )
    assert events[0] == REGISTER_OBJECT_UNMATCHED.name
    assert "12 of 12 frames match no other frame on the moving object (000 to 011)" in str(diagnostics[0])
    assert "scan.first=6 with scan.last=6 uses a single frame" in str(diagnostics[0])


def test_frames_that_do_not_match_are_named_with_the_longest_sequence_that_does() -> None:
    frames = [Frame(f"{n:04}", turntable_object.CAMERA) for n in range(20)]
    matched = {n: np.eye(4) for n in (2, 3, 9, 10, 11, 15)}
    with collecting() as diagnostics:
        _warn_unmatched(frames, range(20), matched)
    (warning,) = map(str, diagnostics)
    assert "14 of 20 frames match no other frame" in warning
    assert "(0000 to 0001, 0004 to 0008, 0012 to 0014 …)" in warning
    assert "scan.first=9 with scan.last=11 uses the longest sequence that matches" in warning
    with collecting() as diagnostics:
        _warn_unmatched(frames, range(20), dict.fromkeys(range(10), np.eye(4)))
    assert not diagnostics
