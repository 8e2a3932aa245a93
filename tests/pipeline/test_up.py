"""The up direction passes through the stages of a run to all upright results."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scanloom.pipeline.artifacts.depth_maps import write_depth_maps
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.artifacts.up_direction import UpDirection
from scanloom.pipeline.cache.digest import compute_label_digests, compute_scan_digest
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import STAGES, plan_stages
from scanloom.pipeline.run.run import run
from scanloom.pipeline.steps import upright
from scanloom.pipeline.steps.upright import UprightSection
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.model.world import Y_UP, Z_DOWN, Z_UP, WorldUp
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import depth_scan
from scanloom.stages.surface.mesh import Mesh

CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)
UP = np.array((0.0, -1.0, 0.0))
POLYCAM = WorldUp(Y_UP, "layout polycam: y up")
FLOOR = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]], np.int32))


def make_posed_frame(turn: Rotation, **more) -> Frame:
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    return Frame("a", CAMERA, world_from_camera=pose, **more)


# A camera that faces along x in a world with z up.
LEVEL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


@pytest.mark.parametrize(
    ("scan", "up", "source", "doubts"),
    [
        (
            Scan("s", [make_posed_frame(LEVEL)], up=WorldUp(Z_UP, "layout euroc: z up")),
            Z_UP,
            "layout euroc: z up",
            0,
        ),
        (Scan("s", [make_posed_frame(LEVEL, up=UP)]), Z_UP, "gravity of the IMU", 0),
        (Scan("s", [make_posed_frame(LEVEL)]), Z_UP, "surface", 0),
        (
            Scan("s", [make_posed_frame(LEVEL)], up=WorldUp(Z_DOWN, "layout x: z down")),
            Z_DOWN,
            "layout x: z down",
            1,
        ),
        (Scan("s", [replace(make_posed_frame(LEVEL, up=UP), world_from_camera=None)]), None, "nothing", 0),
    ],
)
def test_the_source_of_the_up_direction_is_reported(tmp_path: Path, scan, up, source, doubts) -> None:
    with collecting() as diagnostics:
        metrics = upright.estimate_up(tmp_path, FLOOR, scan, None, UprightSection())
    assert (metrics["up"], metrics["up_source"]) == (up, source)
    assert UpDirection(tmp_path).load() == up
    assert ["set upright.up=AXIS if it is wrong" in str(one) for one in diagnostics] == [True] * doubts


def test_a_given_up_direction_overrides_others(tmp_path: Path) -> None:
    scan = Scan("s", [make_posed_frame(LEVEL)], up=POLYCAM)
    metrics = upright.estimate_up(tmp_path, FLOOR, scan, None, UprightSection(up="-x"))
    assert (metrics["up"], metrics["up_source"]) == ((-1.0, 0.0, 0.0), "given")


def test_registration_drops_the_world_up_and_keeps_measured_up(tmp_path: Path) -> None:
    scan = Scan("polycam", [replace(make_posed_frame(LEVEL, up=UP), name=name) for name in "ab"], up=POLYCAM)
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("x", 30, degrees=True).as_matrix()
    poses = {"0": turned.tolist(), "1": turned.tolist()}
    (tmp_path / "registration.json").write_text(json.dumps({"poses": poses, "apart": {"2": poses}}))
    for found in (Poses(tmp_path).apply_to(scan), Poses(tmp_path).load_separate_components(scan)[2]):
        assert found.up is None
        up = upright.estimate_up(tmp_path, FLOOR, found, None, UprightSection())
        np.testing.assert_allclose(up["up"], turned[:3, :3] @ UP, atol=1e-6)
        assert up["up_source"] == "gravity of the IMU"


def test_up_is_written_with_depth_in_the_rectified_axes(tmp_path: Path) -> None:
    # The right camera is lower, so rectification rolls both cameras.
    right_from_left = np.eye(4)
    right_from_left[:3, 3] = (-0.1, -0.02, 0)
    rig = StereoRig(CAMERA, CAMERA, right_from_left, is_rectified=False)
    wall = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 255, (72, 200, 3), np.uint8), (3, 3), 0)
    frame = replace(make_posed_frame(LEVEL, up=UP), color=np.ascontiguousarray(wall[:, 20:116]))
    frame = replace(frame, right=np.ascontiguousarray(wall[:, 28:124]))
    scan = Scan("pairs", [frame], rig, up=POLYCAM, is_metric=False)
    write_depth_maps(tmp_path, depth_scan(scan, min_confidence=0, left_right_tolerance=99), scan)
    again = read_scan(tmp_path)
    assert (again.up, again.is_metric) == (POLYCAM, False)
    (read,) = again.frames
    assert not np.allclose(read.up, UP, atol=1e-3)
    world = read.world_from_camera[:3, :3] @ read.up
    np.testing.assert_allclose(world, LEVEL.apply(UP), atol=1e-9)


def test_up_is_in_the_key_of_the_stages_that_use_it() -> None:
    frame = replace(make_posed_frame(LEVEL), depth=np.ones((72, 96), np.float32))
    scan = Scan("s", [frame])
    others = [
        replace(scan, up=POLYCAM),
        replace(scan, up=replace(POLYCAM, source="a level")),
        replace(scan, is_metric=False),
        replace(scan, frames=[replace(frame, up=UP)]),
        replace(scan, frames=[replace(frame, up=-UP)]),
    ]
    assert len({compute_label_digests(one)["world"] for one in (scan, *others)}) == 1 + len(others)
    assert {compute_scan_digest(one).digest for one in others} == {compute_scan_digest(scan).digest}
    assert {stage.name for stage in STAGES if "world" in stage.input_names} == {"depth", "upright"}
    pairs = replace(scan, rig=StereoRig(CAMERA, CAMERA, np.eye(4), is_rectified=True))
    for one, name in ((scan, "upright"), (pairs, "depth")):
        assert [stage.name for stage in plan_stages(one, Config()) if "world" in stage.input_names] == [name]


@pytest.mark.slow
def test_changing_up_only_reruns_upright_stages(tmp_path: Path) -> None:
    scan, out = tmp_path / "scan", tmp_path / "out"
    scan.mkdir()
    depth = np.full((72, 96), 1000, np.uint16)
    depth[20:50, 30:60] = 900
    cv2.imwrite(str(scan / "0.png"), depth)
    camera = {"width": 96, "height": 72, "fx": 80, "fy": 80, "cx": 47.5, "cy": 35.5}
    document = {"version": 1, "camera": camera, "frames": []}
    for number in range(3):
        pose = np.eye(4)
        pose[0, 3] = 0.01 * number
        document["frames"].append({"depth": "0.png", "world_from_camera": pose.tolist()})
    (scan / "scan.json").write_text(json.dumps(document))
    config = Config().set(["fuse.voxel_size=0.02"])
    run(scan, out, config, until="upright")
    (scan / "scan.json").write_text(json.dumps(document | {"up": [0, 0, -3], "up_source": "a level"}))
    result = run(scan, out, config, until="upright")
    assert [one.stage for one in result.stages if not one.cached] == ["upright"]
    assert result.report["stages"]["upright"]["metrics"]["up_source"] == "a level"
    assert result.report["stages"]["upright"]["metrics"]["up"] == [0, 0, -1]
