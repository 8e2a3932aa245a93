import json

import numpy as np
import pytest

from stages.errors import InputError
from stages.scans.read import read_scan


def write(folder, tiny, form="beside", **changed):
    entries = []
    for number, pose in enumerate((tiny.identity, tiny.second)):
        info = {
            "kcam": {"matrix": [[100, 0, 16], [0, 100, 12], [0, 0, 1]], "undist_coeff": []},
            "depth_scale": 0.0005,
            "rt_cam": {"matrix": pose.tolist()},
            **changed,
        }
        images = {f"{kind}_image": f"frame_{number:05}_{kind}.png" for kind in ("rgb", "depth")}
        entries.append(info if form == "flat" else {"info": info} | (images if form == "named" else {}))
    (folder / "frames.json").write_text(json.dumps({"root": entries}))


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for number in range(2):
        tiny.color(tmp_path / f"frame_{number:05}_rgb.png")
        tiny.depth(tmp_path / f"frame_{number:05}_depth.png", 2000)
    write(tmp_path, tiny)
    return tmp_path


@pytest.mark.parametrize("form", ["beside", "named", "flat"])
def test_known_points_come_out_in_the_world(scan_folder, tiny, form):
    write(scan_folder, tiny, form)
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.frames[0].color.name) == ("frame-list", "frame_00000_rgb.png")
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"depth_image": "../a.png"}, "frame 0: depth_image is not a path inside the folder"),
        ({"depth_scale": 0}, "depth_scale is 0; it must be a positive number"),
        ({"kcam": 7}, "a camera matrix must be 3x3"),
        ({"rt_cam": None}, "frame 0: rt_cam"),
    ],
)
def test_what_is_damaged_is_told(scan_folder, tiny, changed, message):
    write(scan_folder, tiny, **changed)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_a_frame_without_depth_is_told(scan_folder):
    (scan_folder / "frame_00001_depth.png").unlink()
    with pytest.raises(InputError, match="frame 1 names no depth map, and there is none of its number"):
        read_scan(scan_folder)
