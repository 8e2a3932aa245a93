import json
from dataclasses import fields

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.model.world import WorldUp
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERA = {"width": 32, "height": 24, "fx": 100, "fy": 100, "cx": 16, "cy": 12}


@pytest.fixture
def scan_folder(tmp_path, tiny):
    frames = []
    for name, pose in (("a", tiny.identity), ("b", tiny.second)):
        tiny.color(tmp_path / "color" / f"{name}.png")
        tiny.depth(tmp_path / "depth" / f"{name}.png", 2000)
        frames.append(
            {
                "name": name,
                "color": f"color/{name}.png",
                "depth": f"depth/{name}.png",
                "world_from_camera": pose.tolist(),
            }
        )
    document = {
        "version": 1,
        "camera": CAMERA,
        "depth_scale": 2000,
        "depth_missing": [65535],
        "frames": frames,
    }
    (tmp_path / "scan.json").write_text(json.dumps(document))
    return tmp_path


def change(folder, **values):
    path = folder / "scan.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def change_frame(folder, position, **values):
    document = json.loads((folder / "scan.json").read_text())
    document["frames"][position] |= values
    (folder / "scan.json").write_text(json.dumps(document))


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "plain-rgbd"
    assert [frame.name for frame in scan.frames] == ["a", "b"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)
    assert read_depth(scan.frames[0])[0, 1] == 0


def test_a_written_scan_is_read_back(tmp_path, tiny):
    usual = Camera(32, 24, 101.5, 99.25, 15.5, 11.5, (0.1, -0.2, 0.003, 0.004))
    own = Camera(32, 24, 50, 50, 16, 12)
    large = Camera(64, 48, 200, 200, 32, 24)
    frames = [
        Frame("one", usual, tmp_path / "color" / "1.png", None, tmp_path / "depth" / "1.npy", 1.0, (7,),
              tiny.second, 123456789012345678),
        Frame("two", own, None, None, tmp_path / "depth" / "2.npy", 1.0, (7,), tiny.identity, None,
              large, tiny.second, tmp_path / "trust" / "2.png", 3, tmp_path / "mask.png", (0.25, 4.0),
              np.array((0.6, -0.8, 0.0)), np.array((0.01, -0.02, 0.003))),
    ]  # fmt: skip
    (tmp_path / "color").mkdir()
    (tmp_path / "depth").mkdir()
    (tmp_path / "trust").mkdir()
    for file in (frames[0].color, frames[0].depth, frames[1].depth, frames[1].confidence, frames[1].mask):
        file.touch()
    up = WorldUp((0.0, 0.6, -0.8), "a level")
    assert write_scan_json(tmp_path, frames, up=up, is_metric=False) == tmp_path / "scan.json"
    scan = read_scan(tmp_path)
    assert (scan.up, scan.is_metric) == (up, False)
    for written, read in zip(frames, scan.frames, strict=True):
        for field in fields(Frame):
            one, other = getattr(read, field.name), getattr(written, field.name)
            assert np.array_equal(one, other) if isinstance(other, np.ndarray) else one == other, field.name


def test_the_up_direction_can_be_given_in_the_file(scan_folder):
    change(scan_folder, up=[0, 0, 2])
    scan = read_scan(scan_folder)
    assert (scan.up, scan.is_metric) == (WorldUp((0.0, 0.0, 1.0), "scan.json"), True)
    assert scan.diagnostics == ()


def test_a_frame_without_pose_is_kept_as_lost(tmp_path, tiny):
    frames = [
        Frame(
            str(i),
            Camera(32, 24, 100, 100, 16, 12),
            None,
            None,
            tmp_path / f"{i}.png",
            world_from_camera=pose,
        )
        for i, pose in enumerate((tiny.identity, None, tiny.second))
    ]
    for frame in frames:
        frame.depth.touch()
    write_scan_json(tmp_path, frames)
    scan = read_scan(tmp_path)
    assert [frame.name for frame in scan.frames] == ["0", "2"]
    assert [one.name for one in scan.skipped_frames] == ["1"]


def test_float_depth_is_read_in_its_unit(scan_folder):
    depth = np.full((24, 32), 1.25, np.float32)
    depth[0, 0] = np.nan
    depth[0, 1] = -3
    np.save(scan_folder / "depth" / "a.npy", depth)
    change_frame(scan_folder, 0, depth="depth/a.npy")
    change(scan_folder, depth_scale=1)
    values = read_depth(read_scan(scan_folder).frames[0])
    assert values[5, 5] == 1.25
    assert values[0, 0] == values[0, 1] == 0


def test_stated_camera_and_scale_win(scan_folder):
    frame = read_scan(scan_folder, ScanParams(intrinsics="50,50,15,11", depth_scale=4000)).frames[0]
    assert frame.camera.fx == 50
    assert read_depth(frame)[5, 5] == 1.0


def test_images_in_memory_cannot_be_written(tmp_path):
    frame = Frame("x", Camera(2, 2, 1, 1, 1, 1), depth=np.ones((2, 2), np.float32))
    with pytest.raises(ValueError, match="frame x: depth is not a file"):
        write_scan_json(tmp_path, [frame])
    assert not (tmp_path / "scan.json").exists()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"up": [0, 0, 0]}, "up must be three numbers"),
        ({"up": [0, 1]}, "up must be three numbers"),
        ({"up": [0, float("nan"), 1]}, "up must be three numbers"),
        ({"up": [1e300, 0, 0]}, "up must be three numbers"),
        ({"up": "z"}, "up must be three numbers"),
        ({"up": [0, 0, 1], "up_source": 3}, "up_source must be a string"),
        ({"metric": 1}, "metric is '1'; it must be true or false"),
        ({"version": 2}, "unsupported version 2"),
        ({"frames": {}}, "no list of frames"),
        ({"frames": [3]}, "frame 0 is not an object"),
        ({"frames": []}, "none of its 0 frames"),
        ({"camera": None}, "no camera"),
        ({"camera": {**CAMERA, "width": -1}}, "width and height"),
        ({"camera": {**CAMERA, "width": 10**9, "height": 10**9}}, "width and height"),
        ({"camera": {**CAMERA, "fx": 0}}, "focal lengths"),
        ({"camera": {**CAMERA, "fx": "wide"}}, "fx is 'wide'"),
        ({"camera": {**CAMERA, "distortion": [1, 2]}}, "2 coefficients"),
        ({"depth_scale": 0}, "depth_scale"),
        ({"depth_missing": ["x"]}, "depth_missing"),
    ],
)
def test_damaged_documents_are_reported(scan_folder, values, message):
    change(scan_folder, **values)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"up": [0, True, 1]}, "frame .*: up must be three numbers"),
        ({"depth": "../secret.png"}, "not a path inside the folder"),
        ({"color": "/etc/passwd"}, "not a path inside the folder"),
        ({"timestamp": "now"}, "timestamp"),
        ({"mask": "../secret.png"}, "frame b: mask is not a path inside the folder"),
        ({"color_camera": {**CAMERA, "fx": 0}}, "focal lengths"),
        ({"color_from_depth": [[1, 2], [3, 4]]}, "frame b: color_from_depth is not a 4x4 matrix"),
        ({"min_confidence": "x"}, "frame b: min_confidence"),
        ({"min_confidence": 300}, "frame b: min_confidence"),
        ({"depth_range": [2, 1]}, "frame b: depth_range"),
        ({"depth_range": [1, float("nan")]}, "frame b: depth_range"),
        ({"depth_range": 7}, "frame b: depth_range"),
        ({"world_from_camera": [[1, 2], [3, 4]]}, "frame b is not a 4x4 matrix"),
        ({"world_from_camera": (2 * np.eye(4)).tolist()}, "frame b.*last row"),
        ({"world_from_camera": np.diag((1.0, 1, 1.1, 1)).tolist()}, "frame b.*not rigid"),
    ],
)
def test_damaged_frames_are_reported(scan_folder, values, message):
    change_frame(scan_folder, 1, **values)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\x00", '{"version": 1e999999}', "null"])
def test_invalid_json_is_reported(scan_folder, text):
    (scan_folder / "scan.json").write_text(text)
    with pytest.raises(InputError, match=r"scan\.json"):
        read_scan(scan_folder)


def test_a_fisheye_camera_is_read_back(tmp_path, tiny):
    camera = Camera(32, 24, 50, 50, 16, 12, (0.0, 0.0, 0.0, 0.0), fisheye=True)
    tiny.depth(tmp_path / "depth.png", 1000)
    write_scan_json(tmp_path, [Frame("0", camera, depth=tmp_path / "depth.png", world_from_camera=np.eye(4))])
    assert read_scan(tmp_path).frames[0].camera == camera
