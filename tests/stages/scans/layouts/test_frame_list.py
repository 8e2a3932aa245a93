import json

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


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
        ({"depth_bias": "a"}, "depth_bias is a; it must be an offset in metres"),
        ({"depth_bias": 12}, "depth_bias is 12; it must be an offset in metres"),
        ({"depth_max": -1}, "depth_max is -1; it must be a positive number"),
        ({"kcam": 7}, "a camera matrix must be 3x3"),
        ({"rt_cam": None}, "frame 0: rt_cam"),
    ],
)
def test_damaged_files_are_reported(scan_folder, tiny, changed, message):
    write(scan_folder, tiny, **changed)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_a_frame_without_depth_is_reported(scan_folder):
    (scan_folder / "frame_00001_depth.png").unlink()
    with pytest.raises(
        InputError, match="frame 1 names no depth map, and the folder has none with this number"
    ):
        read_scan(scan_folder)


def test_a_bias_in_metres_is_added_to_valid_depth(scan_folder, tiny):
    for number in range(2):
        tiny.depth(scan_folder / f"frame_{number:05}_depth.png", 2000, metres=1.9)
    write(scan_folder, tiny, depth_bias=0.1)
    scan = read_scan(scan_folder)
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-5)
    assert read_depth(scan.frames[0])[0, 0] == 0
    # The bias is added in the unit that the user gives.
    for number in range(2):
        tiny.depth(scan_folder / f"frame_{number:05}_depth.png", 1000, metres=1.9)
    scan = read_scan(scan_folder, ScanParams(depth_scale=1000))
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-5)


def test_depth_beyond_the_sensor_range_is_missing_and_reported(scan_folder, tiny):
    # Depth maps of the fixture contain 4000 (2 m) and one pixel of 65535.
    write(scan_folder, tiny, depth_max=4500.0)
    scan = read_scan(scan_folder)
    depth = read_depth(scan.frames[0])
    assert (depth[0, 1], depth[5, 5]) == (0, 2)
    assert [str(one) for one in scan.diagnostics] == [
        "0.1% of the sampled depth exceeds depth_max in frames.json (2.25 m) and is ignored"
    ]


def test_a_limit_that_takes_most_of_the_depth_is_asked_about(scan_folder, tiny):
    write(scan_folder, tiny, depth_max=4.5)
    scan = read_scan(scan_folder)
    assert read_depth(scan.frames[0])[5, 5] == 2
    (said,) = map(str, scan.diagnostics)
    assert "100% of the sampled depth" in said
    assert "depth_max is not applied; set fuse.max_depth=METRES" in said


@pytest.mark.parametrize("damage", [lambda text: text[:-20], lambda text: text.replace("0.0005", "0,0005")])
def test_a_list_that_does_not_parse_is_reported(scan_folder, damage):
    path = scan_folder / "frames.json"
    path.write_text(damage(path.read_text()))
    with pytest.raises(InputError, match=r"frames\.json: the file is not valid JSON"):
        read_scan(scan_folder)
