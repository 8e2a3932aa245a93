"""Ordinary ROS 1 and ROS 2 recordings: choice of depth and colour topics, and camera extrinsics."""

import dataclasses
import struct

import cv2
import numpy as np
import pytest
from recordings import Image, Recording
from tiny_recordings import (
    INTERVAL,
    LINKS,
    START,
    color_image,
    depth_map,
    list_warnings,
    recording,
    ros_bag,
    ros_color,
    ros_depth,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import zstd_blocks
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def test_a_bag_without_images_is_reported_with_its_content(tmp_path):
    others = {"/weather": ("std_msgs/Float32", {"data": 21.0})}
    file = recording(streams=[], units=(), others=others).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"take\.bag: the recording has neither depth images .*/weather"):
        read_scan(file)


# Forms of a recording: ROS 1 bag, and each ROS 2 storage with its kinds of compression.
FORMS = ["bag", "sqlite3 none", "sqlite3 message", "mcap none", "mcap message", "mcap storage"]


def written(recording, folder, form):
    """Write a recording in one of the forms."""
    return (
        recording.write(folder / "take.bag")
        if form == "bag"
        else recording.write_ros2(folder / "take", *form.split())
    )


@pytest.mark.parametrize("form", FORMS)
def test_known_points_and_colours(tmp_path, tiny, form):
    scan = read_scan(written(ros_bag(links=LINKS), tmp_path, form), complete=False)
    assert not list_warnings(scan)
    (frame,) = scan.frames
    assert frame.timestamp == START
    np.testing.assert_allclose(
        tiny.seen(dataclasses.replace(frame, world_from_camera=tiny.second)), tiny.points[1], atol=1e-6
    )
    assert tiny.green_is_at_the_pixel(frame)
    assert read_depth(frame)[0, 0] == 0


@pytest.mark.parametrize(
    "links", [[], LINKS[:2], [*LINKS, ("color_optical", "base", (0, 0, 0), (0, 0, 0, 1))]]
)
def test_frames_without_transform(tmp_path, links):
    scan = read_scan(ros_bag(links=links).write(tmp_path / "take.bag"), complete=False)
    assert scan.frames[0].color_from_depth is None
    assert ["does not contain the extrinsics" in text for text in list_warnings(scan)] == [True]


@pytest.mark.parametrize("form", ["bag", "mcap none"])
def test_aligned_depth_and_float_depth(tmp_path, form):
    pixels = np.full((24, 32), 2, np.float32)
    pixels[0, 0] = np.nan
    images = [Image(START, pixels, "32FC1", unit=None, frame="color_optical")]
    depth = ros_depth(name="/cam/aligned_depth_to_color", images=images)
    # The recording also contains another depth topic and the colour of another camera.
    made_bag = ros_bag(depth)
    made_bag.streams = [ros_color(name="/bar/color"), ros_depth(name="/cam/a_depth"), *made_bag.streams]
    scan = read_scan(written(made_bag, tmp_path, form), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == 2
    assert read_depth(scan.frames[0])[0, 0] == 0
    assert str(scan.frames[0].color).endswith("/cam/color/image_raw 000000")
    assert [
        text for text in list_warnings(scan) if "2 topics contain depth" in text and "aligned" in text
    ] == list(list_warnings(scan))


@pytest.mark.parametrize("form", ["bag", "sqlite3 none"])
def test_compressed_images(tmp_path, tiny, form):
    png = cv2.imencode(".png", depth_map(units=0.001))[1].tobytes()
    shown = cv2.imencode(".png", color_image()[:, :, ::-1])[1].tobytes()
    depths = [
        Image(
            START,
            depth_map(),
            "",
            compressed=("16UC1; compressedDepth png", bytes(12) + png),
            frame="depth_optical",
        )
    ]
    colors = [
        Image(
            START, color_image(), "", compressed=("rgb8; png compressed bgr8", shown), frame="color_optical"
        )
    ]
    bag = ros_bag(
        ros_depth(images=depths, topic="/image_raw/compressedDepth"),
        ros_color(images=colors, topic="/image_raw/compressed"),
        LINKS,
    )
    (frame,) = read_scan(written(bag, tmp_path, form), complete=False).frames
    assert read_depth(frame)[17, 26] == 2
    assert tiny.green_is_at_the_pixel(frame)
    (tmp_path / "other").mkdir()
    depths[0].compressed = ("16UC1; compressedDepth rvl", bytes(40))
    (frame,) = read_scan(written(bag, tmp_path / "other", form), complete=False).frames
    with pytest.raises(InputError, match="compressedDepth rvl"):
        read_depth(frame)


def test_rectified_images_have_the_projection_as_camera(tmp_path):
    projection = (90, 0, 15, 0, 0, 91, 11, 0, 0, 0, 1, 0)
    bent = {"projection": projection, "distortion": (0.1, 0, 0, 0, 0)}
    for topic, expected in (
        ("/image_rect", (90, 91, 15, 11, ())),
        ("/image_raw", (100, 100, 16, 12, (0.1, 0, 0, 0, 0))),
    ):
        bag = ros_bag(ros_depth(topic=topic, **bent))
        camera = read_scan(bag.write(tmp_path / "take.bag"), complete=False).frames[0].camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion) == expected


def test_a_ros_camera_that_is_not_known(tmp_path):
    odd = ros_color(model="ftheta", distortion=(0.1, 0, 0, 0))
    with pytest.raises(InputError, match="unknown lens model 'ftheta'"):
        read_scan(ros_bag(color=odd).write(tmp_path / "take.bag"), complete=False)
    file = ros_bag(ros_depth(intrinsics=None)).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"the topic /cam/depth/camera_info.*scan\.intrinsics"):
        read_scan(file, complete=False)
    camera = read_scan(file, ScanParams(intrinsics="50,60,15,11"), complete=False).frames[0].camera
    assert (camera.width, camera.fx) == (32, 50)


def drivers(depth, color, frame="color_optical", **others):
    """Make a recording of two topics; the cameras share a pose if `frame` is the frame of colour."""
    maps = [Image(START, depth_map(units=0.001), "16UC1", unit=None, frame=frame)]
    pair = {"intrinsics": (100, 100, 16, 12), "images": maps, "topic": depth.removeprefix("/cam")}
    bag = ros_bag(
        ros_depth(name="/cam", info=f"{depth.removeprefix('/cam').rpartition('/')[0]}/camera_info", **pair)
    )
    bag.streams = [bag.streams[0]]
    for name in color:
        images = [Image(START, color_image()[:, :, ::-1].copy(), "bgr8", unit=None, frame="color_optical")]
        bag.streams.append(
            ros_color(name=name.rpartition("/")[0], topic=f"/{name.rpartition('/')[2]}", images=images)
        )
    bag.others.update(others)
    return bag


@pytest.mark.parametrize(
    ("depth", "colors", "frame", "chosen"),
    [
        # Default topic names of the drivers of RealSense, Kinect, OAK and ZED.
        ("/cam/aligned_depth_to_color/image_raw", ["/cam/color/image_raw"], "color_optical", 0),
        (
            "/cam/depth_to_rgb/image_raw",
            ["/cam/rgb_to_depth/image_raw", "/cam/rgb/image_raw"],
            "color_optical",
            1,
        ),
        ("/cam/stereo/image_raw", ["/cam/rgb/image_raw"], "color_optical", 0),
        (
            "/cam/depth/depth_registered",
            ["/cam/right/image_rect_color", "/cam/left_raw/image_raw_color", "/cam/left/image_rect_color"],
            "color_optical",
            2,
        ),
    ],
)
def test_names_of_drivers(tmp_path, depth, colors, frame, chosen):
    scan = read_scan(drivers(depth, colors, frame).write_ros2(tmp_path / "take", "mcap"), complete=False)
    assert not list_warnings(scan)
    (one,) = scan.frames
    assert read_depth(one)[17, 26] == 2
    assert str(one.color).endswith(f"{colors[chosen]} 000000")
    assert one.color_from_depth is None


def test_infrared_in_16_bits_is_no_depth(tmp_path):
    bag = drivers("/cam/ir/image_raw", ["/cam/rgb/image_raw"])
    with pytest.raises(InputError, match="the recording has neither depth images"):
        read_scan(bag.write_ros2(tmp_path / "take", "sqlite3"), complete=False)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_recording_in_several_files(tmp_path, storage):
    depths = [
        Image(START + n * INTERVAL, depth_map(1 + n / 10, 0.001), "16UC1", unit=None, frame="color_optical")
        for n in range(6)
    ]
    colors = [
        Image(START + n * INTERVAL, color_image(10 * n), "rgb8", unit=None, frame="color_optical")
        for n in range(6)
    ]
    folder = ros_bag(ros_depth(images=depths), ros_color(images=colors)).write_ros2(
        tmp_path / "take", storage, parts=3
    )
    scan = read_scan(folder, complete=False)
    assert [one.name for one in scan.frames] == [f"{n:06d}" for n in range(6)]
    assert len({one.depth.file for one in scan.frames}) > 1
    for n, one in enumerate(scan.frames):
        assert read_depth(one)[9, 9] == pytest.approx(1 + n / 10)
        assert read_color(one)[0, 0, 0] == 10 * n
    next(folder.glob("*_1.*")).unlink()
    with pytest.raises(InputError, match=r"metadata\.yaml: the listed file take_1\S+ is missing"):
        read_scan(folder)


def test_a_recording_that_was_packed_as_a_file(tmp_path):
    file = ros_bag().write_ros2(tmp_path / "take", "sqlite3", "file")
    assert file.suffix == ".zstd"
    for place in (file, file.parent):
        with pytest.raises(InputError, match=r"\.db3\.zstd.*zstd --decompress"):
            read_scan(place)
    file.with_suffix("").write_bytes(zstd_blocks.decompress_zstd(file.read_bytes(), 1 << 24))
    assert read_scan(file.parent, complete=False).frames


def test_a_recording_of_other_messages_is_reported_with_its_content(tmp_path):
    others = {"/weather": ("std_msgs/Float32", {"data": 21.0})}
    for storage in ("sqlite3", "mcap"):
        file = Recording([], units=(), others=others).write_ros2(tmp_path / storage, storage)
        with pytest.raises(InputError, match=r"neither depth images .*/weather"):
            read_scan(file)


def test_colour_that_only_the_depth_has_a_camera_for(tmp_path):
    bag = drivers("/cam/aligned_depth_to_color/image_raw", ["/cam/color/image_raw"])
    bag.streams[1] = dataclasses.replace(bag.streams[1], intrinsics=None)
    (frame,) = read_scan(bag.write_ros2(tmp_path / "take", "mcap"), complete=False).frames
    assert frame.color_camera == frame.camera


@pytest.mark.parametrize(
    ("said", "expected"), [((0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)), ((), (0, 0, 0, 0))]
)
def test_a_fisheye_colour_camera(tmp_path, said, expected):
    fish = ros_color(model="equidistant", distortion=said)
    (frame,) = read_scan(ros_bag(color=fish).write(tmp_path / "take.bag"), complete=False).frames
    assert (frame.color_camera.fisheye, frame.color_camera.distortion) == (True, expected)
    assert not frame.camera.fisheye


def test_float_depth_that_is_compressed(tmp_path):
    """Depth z is stored as A / z + B in 16 bits: 2 m is 1000 / 2 + 3 = 503; 0 is missing."""
    stored = np.full((24, 32), 503, np.uint16)
    stored[0, 0] = 0
    data = struct.pack("<iff", 0, 1000, 3) + cv2.imencode(".png", stored)[1].tobytes()
    images = [
        Image(START, stored, "", compressed=("32FC1; compressedDepth png", data), frame="depth_optical")
    ]
    depth = ros_depth(images=images, topic="/image_raw/compressedDepth")
    file = ros_bag(depth, links=LINKS).write_ros2(tmp_path / "take", "mcap")
    (frame,) = read_scan(file, complete=False).frames
    assert read_depth(frame)[17, 26] == 2
    assert read_depth(frame)[0, 0] == 0
    images[0].compressed = ("32FC1; compressedDepth png", data[12:])
    (frame,) = read_scan(ros_bag(depth).write(tmp_path / "take.bag"), complete=False).frames
    with pytest.raises(InputError, match=r"quantisation parameters .* are missing"):
        read_depth(frame)
