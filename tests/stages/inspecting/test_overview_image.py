"""The picture of an inspection: camera positions from above, and depth drawn over colour."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.inspecting.overview_image import draw_inspection
from scanloom.stages.scans.model.scan import Camera, Frame, Scan

CAMERA = Camera(64, 48, 50, 50, 31.5, 23.5)


def make_scan(*centres: tuple[float, float, float]) -> Scan:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[:, 32:] = 0
    frames = []
    for i, centre in enumerate(centres):
        pose = np.eye(4)
        pose[:3, 3] = centre
        color = np.full((48, 64, 3), (255, 0, 0), np.uint8)
        frames.append(Frame(str(i), CAMERA, color, depth=depth, world_from_camera=pose))
    return Scan("made", frames)


def test_depth_is_drawn_over_colour() -> None:
    picture = draw_inspection(make_scan((0, 0, 0), (1, 0, 0)))
    assert picture.dtype == np.uint8
    assert picture.shape == (480, 480 + 8 + 480 + 8 + 640, 3)
    shown = picture[:, 976:]
    np.testing.assert_array_equal(shown[240, 480], (255, 0, 0))
    assert not np.array_equal(shown[240, 160], (255, 0, 0))


def test_the_path_changes_from_blue_to_red() -> None:
    above = draw_inspection(make_scan((0, 0, 0), (1, 0, 0), (2, 0, 0)))[:, :480]
    blue = (above[..., 2].astype(int) - above[..., 0] > 100).nonzero()
    red = (above[..., 0].astype(int) - above[..., 2] > 100).nonzero()
    assert min(len(blue[0]), len(red[0])) > 0
    # The ends of the path are on opposite sides.
    assert abs(np.median(blue[1]) - np.median(red[1])) + abs(np.median(blue[0]) - np.median(red[0])) > 200


def test_without_poses_the_picture_has_a_note() -> None:
    scan = make_scan((0, 0, 0))
    without = replace(scan, frames=[replace(frame, world_from_camera=None) for frame in scan.frames])
    picture = draw_inspection(without)
    assert picture.shape == (480, 480 + 8 + 640, 3)


def test_a_pair_is_shown_side_by_side() -> None:
    left = np.full((48, 64, 3), 40, np.uint8)
    right = np.full((48, 64, 3), 200, np.uint8)
    frame = Frame("pair", CAMERA, left, right=right, world_from_camera=np.eye(4))
    picture = draw_inspection(Scan("made", [frame]))
    assert picture[300, 976 + 100, 0] == 40
    assert picture[300, 976 + 640 + 100, 0] == 200


def test_the_command_writes_the_picture(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from scanloom.cli.app import app

    sample = Path(__file__).parents[3] / "samples" / "rgbd"
    ran = CliRunner().invoke(app(), ["inspect", str(sample), "--picture", str(tmp_path / "sample.png")])
    assert ran.exit_code == 0
    assert (tmp_path / "sample.png").read_bytes().startswith(b"\x89PNG")
