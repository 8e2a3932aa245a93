"""RealSense recordings: depth, colour, their cameras, and the unit of depth."""

import dataclasses

import numpy as np
import pytest
from recordings import INFRARED, Image
from tiny_recordings import (
    DEPTH_TURN,
    INTERVAL,
    START,
    color_stream,
    depth_map,
    depth_stream,
    list_warnings,
    recording,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_color, read_depth, read_right
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
def test_known_points_and_colours_come_out(tmp_path, tiny, trajectory, compression):
    file = recording(compression=compression).write(tmp_path / "take.bag")
    scan = read_scan(file, trajectory)
    assert scan.layout == "ros-bag"
    assert not list_warnings(scan)
    assert not scan.skipped_frames
    assert [one.name for one in scan.frames] == ["000000", "000001"]
    assert [one.timestamp for one in scan.frames] == [START, START + INTERVAL]
    for one, point in zip(scan.frames, tiny.points, strict=True):
        # Times in the trajectory are decimal seconds, which doubles represent to 0.2 microseconds only.
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-4)
        assert read_depth(one)[0, 0] == 0
        assert tiny.green_is_at_the_pixel(one)


def test_the_folder_of_a_recording_is_the_scan_too(tmp_path, tiny):
    recording().write(tmp_path / "take.bag")
    scan = read_scan(tmp_path, complete=False)
    assert [one.code for one in scan.missing] == ["pose.missing"]
    assert not scan.has_poses
    assert tiny.green_is_at_the_pixel(scan.frames[0])
    assert read_scan(tmp_path / "take.bag", ScanParams(layout="ros-bag"), complete=False).frames
    with pytest.raises(InputError, match="no poses"):
        read_scan(tmp_path)
    recording().write(tmp_path / "other.bag")
    with pytest.raises(InputError, match=r"2 recordings"):
        read_scan(tmp_path)


def test_a_recording_named_as_another_layout_is_one_sentence(tmp_path):
    file = recording().write(tmp_path / "take.bag")
    with pytest.raises(InputError, match="a file, not a scan folder"):
        read_scan(file, ScanParams(layout="tum"))


@pytest.mark.parametrize(
    ("units", "behind", "metres", "words"),
    [
        ((0.001,), 0.0001, 20.0, None),
        ((0.00025,), None, 5.0, None),
        ((), 0.0001, 2.0, None),
        ((), 0.0, 20.0, "millimetres are assumed; set scan.depth_scale"),
        ((), None, 20.0, "millimetres are assumed; set scan.depth_scale"),
        ((0.001, 0.0001), 0.0001, 2.0, "changes within the recording"),
    ],
)
def test_the_unit_of_depth_is_read(tmp_path, units, behind, metres, words):
    images = [Image(START, depth_map(), "mono16", unit=behind)]
    made = recording(streams=[depth_stream(images=images), color_stream(1)], units=units)
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == pytest.approx(metres)
    assert [words in text for text in list_warnings(scan)] == [True] * (words is not None)


@pytest.mark.parametrize("units", [float("nan"), -0.001, 1e12])
def test_a_unit_that_cannot_be_right(tmp_path, units):
    file = recording(units=(units,)).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"depth unit is .* scan\.depth_scale"):
        read_scan(file, complete=False)
    assert read_depth(read_scan(file, ScanParams(depth_scale=1e4), complete=False).frames[0])[17, 26] == 2


def test_the_camera_that_is_stated_wins(tmp_path):
    made = recording(streams=[depth_stream(intrinsics=None), color_stream()])
    file = made.write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"Depth_0.*scan\.intrinsics"):
        read_scan(file, complete=False)
    camera = read_scan(file, ScanParams(intrinsics="50,60,15,11"), complete=False).frames[0].camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (
        32,
        24,
        50,
        60,
        15,
        11,
    )


@pytest.mark.parametrize("model", ["Brown Conrady", "Inverse Brown Conrady"])
def test_lenses(tmp_path, model):
    bent = (-0.05, 0.06, 0.001, -0.002, -0.02)
    made = recording(streams=[depth_stream(), color_stream(model=model, distortion=bent)])
    frame = read_scan(made.write(tmp_path / "take.bag"), complete=False).frames[0]
    assert frame.color_camera.distortion == bent
    assert frame.camera.distortion == ()


def test_a_lens_that_is_not_known(tmp_path):
    made = recording(streams=[depth_stream(), color_stream(model="Ftheta", distortion=(0.9, 0, 0, 0, 0))])
    with pytest.raises(InputError, match=r"unknown lens model 'Ftheta' of .*Color_0"):
        read_scan(made.write(tmp_path / "take.bag"), complete=False)


def test_cameras_of_unknown_places(tmp_path):
    made = recording(streams=[depth_stream(), color_stream(from_reference=None)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert scan.frames[0].color_from_depth is None
    assert any("does not contain the extrinsics" in text for text in list_warnings(scan))


def test_depth_alone_and_with_infrared(tmp_path):
    scan = read_scan(recording(streams=[depth_stream()]).write(tmp_path / "take.bag"), complete=False)
    assert [one.color for one in scan.frames] == [None, None]
    assert read_depth(scan.frames[1])[17, 26] == 2
    infrared = Image(START, np.full((24, 32), 77, np.uint8), "8UC1")
    left, right = (
        dataclasses.replace(depth_stream(), name=INFRARED.format(n), images=[infrared]) for n in (1, 2)
    )
    made = recording(streams=[depth_stream(1), right, left])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert (read_color_aligned_to_depth(scan.frames[0], read_depth(scan.frames[0])) == 77).all()
    assert any("no colour stream" in text for text in list_warnings(scan))
    with pytest.raises(InputError, match=r"no depth stream, only .*Color_0"):
        read_scan(recording(streams=[color_stream()]).write(tmp_path / "take.bag"), complete=False)


@pytest.mark.parametrize("written", ["write", "write_db3"])
def test_the_infrared_pair_where_there_is_no_depth(tmp_path, written):
    images = [[Image(START, np.full((24, 32), grey, np.uint8), "8UC1")] for grey in (77, 99)]
    # The right camera is 5 cm to the right, so points move to the left.
    left, right = (
        depth_stream(name=INFRARED.format(n + 1), images=images[n], from_reference=((x, 0, 1), DEPTH_TURN))
        for n, x in enumerate((0, -0.05))
    )
    made = recording(streams=[right, color_stream(), left])
    scan = read_scan(getattr(made, written)(tmp_path / f"take{written[5:].replace('_', '.') or '.bag'}"))
    assert scan.is_stereo
    assert scan.rig.is_rectified
    np.testing.assert_allclose(scan.rig.right_from_left[:3, 3], (-0.05, 0, 0), atol=1e-5)
    assert (read_color(scan.frames[0]) == 77).all()
    assert (read_right(scan.frames[0]) == 99).all()
    lone = recording(streams=[left, dataclasses.replace(right, from_reference=None)])
    file = getattr(lone, written)(tmp_path / f"lone{written[5:].replace('_', '.') or '.bag'}")
    with pytest.raises(InputError, match=r"the extrinsics between .*; set scan\.baseline"):
        read_scan(file)
    assert read_scan(file, ScanParams(baseline=0.06)).rig.baseline == pytest.approx(0.06)
