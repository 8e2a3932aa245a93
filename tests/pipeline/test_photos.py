"""Photos and cameras of the scan in the output of a run, and runs without a report."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.camera_photos import CAMERAS_FILE, write_photos
from scanloom.pipeline.evaluation.stored_deviations import FIGURES, MESH_FILE
from scanloom.pipeline.graph import list_skip_reasons
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.reader import read_scan

SCAN = Path(__file__).resolve().parents[2] / "samples" / "rgbd"
QUICK = (
    "fuse.voxel_size=0.04",
    "report.page=false",
    "report.width=64",
    "report.viewpoints=1",
    "compare.samples=1000",
)


def make_frame(number: int, **more: object) -> Frame:
    pose = np.eye(4)
    pose[0, 3] = number
    image = np.full((60, 80, 3), 10 * number, np.uint8)
    camera = Camera(80, 60, 70, 70, 39.5, 29.5)
    return Frame(f"f{number}", camera, color=image, world_from_camera=pose, **more)


def write_and_load(tmp_path, frames, count):
    made = write_photos(tmp_path, frames, count)
    return made, json.loads((tmp_path / CAMERAS_FILE).read_text())["cameras"]


def test_photos_are_spread_evenly_and_match_their_frames(tmp_path):
    made, cameras = write_and_load(tmp_path, [make_frame(k) for k in range(21)], 5)
    assert made == 5
    assert [k for k, one in enumerate(cameras) if one["photo"]] == [0, 5, 10, 15, 20]
    for k in (0, 10, 20):
        image = cv2.imread(str(tmp_path / cameras[k]["photo"]))
        assert image.shape == (360, 480, 3)
        assert abs(image.astype(int).mean() - 10 * k) < 2
        assert cameras[k]["frame"] == f"f{k}"
        assert cameras[k]["world_from_camera"][3] == k


def test_held_out_frames_are_marked_and_listed_last(tmp_path):
    made = write_photos(tmp_path, [make_frame(k) for k in range(6)], 100, [make_frame(k) for k in (7, 8)])
    cameras = json.loads((tmp_path / CAMERAS_FILE).read_text())["cameras"]
    assert made == 8
    assert [one["frame"] for one in cameras if one["held_out"]] == ["f7", "f8"]
    assert [one["frame"] for one in cameras[-2:]] == ["f7", "f8"]


@pytest.mark.parametrize("count", [0, 1, 100])
def test_the_number_of_photos_is_limited_by_the_frames(tmp_path, count):
    made, cameras = write_and_load(tmp_path, [make_frame(k) for k in range(3)], count)
    assert made == min(count, 3)
    assert len(cameras) == 3


def test_the_pose_of_the_colour_camera_is_written(tmp_path):
    color_pose = np.eye(4)
    color_pose[1, 3] = 0.1  # maps points from the depth camera to the colour camera
    lens = Camera(160, 120, 150, 151, 80, 60, (0.1, 0.0, 0.0, 0.0))
    _, (told,) = write_and_load(tmp_path, [make_frame(1, color_camera=lens, color_from_depth=color_pose)], 0)
    assert told["size"] == [160, 120]
    assert (told["fx"], told["fy"]) == (150, 151)
    np.testing.assert_allclose(np.array(told["world_from_camera"]).reshape(4, 4)[:3, 3], (1, -0.1, 0))


def test_unreadable_images_and_frames_without_poses_are_skipped(tmp_path):
    lost = Frame(
        "lost", Camera(80, 60, 70, 70, 39.5, 29.5), color=tmp_path / "none.png", world_from_camera=np.eye(4)
    )
    unplaced = Frame("unplaced", Camera(80, 60, 70, 70, 39.5, 29.5))
    made, cameras = write_and_load(tmp_path, [lost, unplaced, make_frame(2)], 10)
    assert made == 1
    assert [one["frame"] for one in cameras] == ["lost", "f2"]
    assert cameras[0]["photo"] is None


def test_the_number_of_cameras_is_limited_for_long_recordings(tmp_path):
    lens = Camera(80, 60, 70, 70, 39.5, 29.5)
    frames = [Frame(f"f{k}", lens, world_from_camera=np.eye(4)) for k in range(5000)]
    _, cameras = write_and_load(tmp_path, frames, 10)
    assert len(cameras) == 2000
    assert (cameras[0]["frame"], cameras[-1]["frame"]) == ("f0", "f4999")
    assert json.loads((tmp_path / CAMERAS_FILE).read_text())["posed"] == 5000


@pytest.mark.slow
def test_a_run_reports_as_much_as_requested(tmp_path, monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    quiet = Config().set([*QUICK, "texture.enabled=false"])
    made = run(SCAN, tmp_path, quiet.set(["report.photos=3"]))
    cameras = json.loads((tmp_path / "pictures" / CAMERAS_FILE).read_text())["cameras"]
    assert len(cameras) == len(read_scan(SCAN).frames)
    assert sum(one["photo"] is not None for one in cameras) == 3
    assert len(list((tmp_path / "pictures" / "photos").iterdir())) == 3
    assert made.report["stages"]["report"]["results"]

    bare = ["report.pictures=false", "report.photos=0", "remesh.enabled=true", "scan.hold_out=4"]
    made = run(SCAN, tmp_path, quiet.set([*bare, "remesh.levels=1"]))
    assert made.report["normal_mesh"]["levels"]
    assert made.report["held_out"]["photos"] > 0
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == [
        CAMERAS_FILE,
        FIGURES,
        MESH_FILE,
    ]

    none = run(SCAN, tmp_path, quiet.set(["report.enabled=false"]))
    assert none.report["mesh"] is None
    assert "report" not in none.report["stages"]
    assert not (tmp_path / "pictures").exists()
    assert (tmp_path / "simplified.glb").exists()


def test_the_report_can_be_disabled():
    why = list_skip_reasons(read_scan(SCAN), Config().set(["report.enabled=false"]))["report"]
    assert "report.enabled=true" in why
