"""RealSense recordings, and ROS 1 bags of others.

The colour camera is rolled by a quarter turn and moved against the depth camera: color_from_depth takes
(x, y, z) to (-y - 0.04, x + 0.02, z). So the known point (0.2, 0.1, 2) is at (-0.14, 0.22, 2), which its
camera, with focal lengths of 200 and 24.5, 32.5 as centre, sees at pixel (10.5, 54.5): between four pixels.
"""

import dataclasses
import random
import sqlite3

import cv2
import numpy as np
import pytest
from recordings import COLOR, DEPTH, INFRARED, Image, Recording, Stream, made, stamped, transform

from stages.errors import InputError
from stages.formats import ros_db3
from stages.fusion.posed_depth import read_matching_color
from stages.images import read_color, read_depth
from stages.layouts import ScanParams, read_scan
from stages.scan import Scan

START = 1_700_000_000_000_000_000
INTERVAL = 33_000_000
QUARTER = (0, 0, 0.5**0.5, 0.5**0.5)
# Both streams say how they stand to a third place: 1 m in front of the depth camera, turned about its y axis.
DEPTH_TURN = (0, 0.6, 0, 0.8)


def depth_map(metres=2.0, units=0.0001):
    image = np.full((24, 32), round(metres / units), np.uint16)
    image[0, 0] = 0
    return image


def color_image(grey=90):
    image = np.full((64, 48, 3), grey, np.uint8)
    image[54:56, 10:12] = (10, 240, 120)
    return image


def color_turn():
    """QUARTER after DEPTH_TURN, as a quaternion x y z w."""
    s = 0.5**0.5
    return (-s * 0.6, s * 0.6, s * 0.8, s * 0.8)


def depth_stream(count=2, **changes):
    images = [Image(START + n * INTERVAL, depth_map(), "mono16", unit=0.0001) for n in range(count)]
    stream = Stream(DEPTH, images, (100, 100, 16, 12), (32, 24), ((0, 0, 1), DEPTH_TURN))
    return dataclasses.replace(stream, **changes)


def color_stream(count=2, **changes):
    images = [Image(START + n * INTERVAL + 4_000_000, color_image(), "rgb8") for n in range(count)]
    # The quarter turn takes the depth camera's place in the reference, (0, 0, 1), along.
    stream = Stream(COLOR, images, (200, 200, 24.5, 32.5), (48, 64), ((-0.04, 0.02, 1), color_turn()))
    return dataclasses.replace(stream, **changes)


def recording(**changes):
    return dataclasses.replace(Recording([depth_stream(), color_stream()]), **changes)


@pytest.fixture
def trajectory(tmp_path, tiny):
    file = tmp_path / "mine.tum"
    lines = [
        (START, 0, 0, 0, 0, 0, 0, 1),
        (START + INTERVAL, 1, 2, 3, *tiny.second_quaternion),
    ]
    file.write_text("".join(f"{t / 1e9:.9f} {' '.join(map(str, row))}\n" for t, *row in lines))
    return ScanParams(poses=str(file))


@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
def test_known_points_and_colours_come_out(tmp_path, tiny, trajectory, compression):
    file = recording(compression=compression).write(tmp_path / "take.bag")
    scan = read_scan(file, trajectory)
    assert scan.layout == "ros-bag"
    assert not doubts(scan)
    assert not scan.skipped
    assert [one.name for one in scan.frames] == ["000000", "000001"]
    assert [one.timestamp for one in scan.frames] == [START, START + INTERVAL]
    for one, point in zip(scan.frames, tiny.points, strict=True):
        # Times in the trajectory are decimal seconds, which doubles hold to 0.2 microseconds only.
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-4)
        assert read_depth(one)[0, 0] == 0
        assert tiny.green_is_at_the_pixel(one)


@pytest.mark.parametrize("form", ["raw", "png", "zstd"])
def test_known_points_and_colours_of_a_newer_recording(tmp_path, tiny, trajectory, form):
    scan = read_scan(recording(started=START - 5).write_db3(tmp_path / "take.db3", form), trajectory)
    assert scan.layout == "ros-bag"
    assert not doubts(scan)
    assert not scan.skipped
    # Times are decimal milliseconds there, which doubles hold to 0.2 microseconds only.
    np.testing.assert_allclose([one.timestamp - START for one in scan.frames], (0, INTERVAL), atol=1000)
    for one, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-4)
        assert read_depth(one)[0, 0] == 0
        assert tiny.green_is_at_the_pixel(one)


def test_what_a_newer_recording_says_of_its_cameras(tmp_path):
    bent = (-0.05, 0.06, 0.001, -0.002, -0.02)
    lens = {"model": "Inverse Brown Conrady", "distortion": bent}
    made_so = recording(streams=[depth_stream(), color_stream(**lens)], units=(0.001, 0.00025))
    scan = read_scan(made_so.write_db3(tmp_path / "take.db3"), complete=False)
    assert scan.frames[0].color_camera.distortion == bent
    assert scan.frames[0].depth_scale == pytest.approx(4000)
    assert ["changes within" in text for text in doubts(scan)] == [True]
    bare = recording(streams=[depth_stream(), color_stream(from_reference=None)], units=())
    scan = read_scan(bare.write_db3(tmp_path / "take.db3"), complete=False)
    assert ["millimetres" in text or "stands to that of" in text for text in doubts(scan)] == [True, True]
    unknown = recording(streams=[depth_stream(intrinsics=None), color_stream()])
    with pytest.raises(InputError, match=r"scan\.intrinsics"):
        read_scan(unknown.write_db3(tmp_path / "take.db3"), complete=False)


def database(file, words):
    connection = sqlite3.connect(file)
    connection.execute(words)
    connection.commit()
    connection.close()


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("DROP TABLE messages", "no recording: it has no table `messages`"),
        ("ALTER TABLE messages RENAME data TO blob", "no recording: it has no table `messages`"),
        ("UPDATE topics SET name = '/cam' || name", "ROS 2's own.*rosbags-convert"),
        ("DELETE FROM messages WHERE timestamp > 0", "ROS 2's own"),
        ("UPDATE messages SET data = x'0001'", "cut short"),
        ("UPDATE messages SET data = 5", "damaged"),
        ("UPDATE messages SET data = x'28b52ffd00'", "does not decompress|damaged"),
        ("UPDATE messages SET timestamp = 'noon'", "ROS 2's own"),
        ("UPDATE messages SET timestamp = timestamp + id", "of one moment.*nothing says when image 0"),
    ],
)
def test_a_newer_recording_that_is_damaged(tmp_path, change, words):
    file = recording().write_db3(tmp_path / "take.db3")
    database(file, change)
    with pytest.raises(InputError, match=words):
        read_scan(file, complete=False)


def test_a_message_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    file = recording().write_db3(tmp_path / "take.db3")
    monkeypatch.setattr(ros_db3, "_LARGEST_MESSAGE", 2000)
    scan = read_scan(file, complete=False)
    with pytest.raises(InputError, match=r"take\.db3: message \d+ is missing or too large"):
        read_color(scan.frames[0])


def test_a_table_that_would_compute_for_ever_is_none(tmp_path):
    file = recording().write_db3(tmp_path / "take.db3")
    database(file, "DROP TABLE messages")
    database(
        file,
        f"CREATE VIEW messages AS {ENDLESS} "
        "SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n",
    )
    with pytest.raises(InputError, match="no table `messages`"):
        read_scan(file, complete=False)


@pytest.mark.parametrize("form", ["raw", "png", "zstd"])
def test_damaged_bytes_of_a_newer_recording_are_refused_or_cost_frames(tmp_path, form):
    file = recording().write_db3(tmp_path / "take.db3", form)
    data = file.read_bytes()
    chosen = random.Random(5)
    for end in range(0, len(data), len(data) // 20):
        file.write_bytes(data[:end])
        assert outcome(file) is None
    for _ in range(40):
        damaged = bytearray(data)
        for _ in range(chosen.choice((1, 5, 50))):
            damaged[chosen.randrange(len(data))] = chosen.choice((0, 0x7F, 0xFF, chosen.randrange(256)))
        file.write_bytes(damaged)
        outcome(file)


def test_the_folder_of_a_recording_is_the_scan_too(tmp_path, tiny):
    recording().write(tmp_path / "take.bag")
    scan = read_scan(tmp_path, complete=False)
    assert [text.split(":")[0] for text in scan.missing] == ["poses"]
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
    ("encoding", "order"),
    [("rgb8", (0, 1, 2)), ("bgr8", (2, 1, 0)), ("rgba8", (0, 1, 2, 0)), ("bgra8", (2, 1, 0, 0))],
)
def test_orders_of_colours(tmp_path, encoding, order):
    pixels = np.ascontiguousarray(color_image()[:, :, order])
    images = [Image(START, pixels, encoding, padding=5)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    np.testing.assert_array_equal(read_color(read_scan(file, complete=False).frames[0]), color_image())


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_images(tmp_path, encoding):
    images = [Image(START, np.arange(64 * 48, dtype=np.uint16).reshape(64, 48).astype(np.uint8), encoding)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    color = read_color(read_scan(file, complete=False).frames[0])
    np.testing.assert_array_equal(color, np.repeat(images[0].pixels[:, :, None], 3, axis=2))


@pytest.mark.parametrize(("encoding", "places"), [("yuv422", "uyvy"), ("UYVY", "uyvy"), ("YUYV", "yuyv")])
def test_colours_in_half_resolution(tmp_path, encoding, places):
    # Video's red: luma 81, chroma 90 and 240.
    row = [{"u": 90, "v": 240}.get(letter, 81) for letter in places] * 24
    images = [Image(START, np.tile(np.array(row, np.uint8).reshape(1, 48, 2), (64, 1, 1)), encoding)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    color = read_color(read_scan(file, complete=False).frames[0]).reshape(-1, 3)
    np.testing.assert_allclose(color, np.tile((255, 0, 0), (64 * 48, 1)), atol=3)


@pytest.mark.parametrize(
    ("pixels", "encoding", "big_endian", "scale"),
    [
        (depth_map(), "16UC1", False, None),
        (depth_map(), "mono16", True, None),
        (np.full((24, 32), 2, np.float32), "32FC1", False, 1),
    ],
)
def test_forms_of_depth(tmp_path, pixels, encoding, big_endian, scale):
    images = [Image(START, pixels, encoding, big_endian=big_endian, padding=6)]
    file = recording(streams=[depth_stream(images=images), color_stream(1)]).write(tmp_path / "take.bag")
    scan = read_scan(file, ScanParams(depth_scale=scale), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == pytest.approx(2)


@pytest.mark.parametrize(
    ("units", "behind", "metres", "words"),
    [
        ((0.001,), 0.0001, 20.0, None),
        ((0.00025,), None, 5.0, None),
        ((), 0.0001, 2.0, None),
        ((), 0.0, 20.0, "millimetres are assumed; scan.depth_scale"),
        ((), None, 20.0, "millimetres are assumed; scan.depth_scale"),
        ((0.001, 0.0001), 0.0001, 2.0, "changes within the recording"),
    ],
)
def test_the_unit_of_depth_is_read(tmp_path, units, behind, metres, words):
    images = [Image(START, depth_map(), "mono16", unit=behind)]
    made = recording(streams=[depth_stream(images=images), color_stream(1)], units=units)
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == pytest.approx(metres)
    assert [words in text for text in doubts(scan)] == [True] * (words is not None)


@pytest.mark.parametrize("units", [float("nan"), -0.001, 1e12])
def test_a_unit_that_cannot_be_right(tmp_path, units):
    file = recording(units=(units,)).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"depth unit is .* scan\.depth_scale"):
        read_scan(file, complete=False)
    assert read_depth(read_scan(file, ScanParams(depth_scale=1e4), complete=False).frames[0])[17, 26] == 2


def test_images_of_one_moment_are_paired_whatever_was_dropped(tmp_path):
    depths = [Image(START + n * INTERVAL, depth_map(1 + n / 10), "mono16") for n in (0, 1, 2, 4, 5)]
    # The colour camera runs a little ahead, and lost other images; recorded in another order.
    colors = [
        Image(START + n * INTERVAL - 5_000_000, color_image(10 * n), "rgb8", recorded=START + at)
        for at, n in enumerate((3, 0, 2, 1, 5))
    ]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    seen = [(round(10 * read_depth(one)[9, 9] - 10), read_color(one)[0, 0, 0] // 10) for one in scan.frames]
    assert seen == [(0, 0), (1, 1), (2, 2), (5, 5)]
    assert [text for text in doubts(scan) if "4 of 5 depth maps and of 5 colour images" in text]


def test_streams_of_other_rates(tmp_path):
    # The fourth depth map was lost, and the next one shows another moment than the second colour image.
    depths = [Image(START + n * INTERVAL // 3, depth_map(1 + n / 10), "mono16") for n in range(12) if n != 3]
    colors = [Image(START + n * INTERVAL + 1_000_000, color_image(n), "rgb8") for n in range(4)]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert [one.name for one in scan.frames] == ["000000", "000005", "000008"]


def test_clocks_that_do_not_agree(tmp_path):
    depths = [Image(n * INTERVAL, depth_map(), "mono16", recorded=START + n * INTERVAL) for n in range(3)]
    colors = [Image(START + n * INTERVAL, color_image(n), "rgb8") for n in range(3)]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert [read_color(one)[0, 0, 0] for one in scan.frames] == [0, 1, 2]
    assert [one.timestamp for one in scan.frames] == [START + n * INTERVAL for n in range(3)]
    assert any("clocks" in text for text in doubts(scan))


def test_poses_of_another_time_and_poses_by_number(tmp_path, tiny, matrix_text):
    file = recording().write(tmp_path / "take.bag")
    (tmp_path / "early.tum").write_text("5 0 0 0 0 0 0 1\n6 1 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"early\.tum: none of its poses is within 0\.02 s"):
        read_scan(file, ScanParams(poses="early.tum"))
    (tmp_path / "mine.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    for one, point in zip(read_scan(file, ScanParams(poses="mine.log")).frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-6)


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
    with pytest.raises(InputError, match="Color_0 is described as 'Ftheta'"):
        read_scan(made.write(tmp_path / "take.bag"), complete=False)


def test_cameras_of_unknown_places(tmp_path):
    made = recording(streams=[depth_stream(), color_stream(from_reference=None)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert scan.frames[0].color_from_depth is None
    assert any("stands to that of" in text for text in doubts(scan))


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
    assert (read_matching_color(scan.frames[0], read_depth(scan.frames[0])) == 77).all()
    assert any("no colour stream" in text for text in doubts(scan))
    with pytest.raises(InputError, match=r"no depth.*infrared pairs cannot be read yet"):
        read_scan(recording(streams=[left, right]).write(tmp_path / "take.bag"), complete=False)
    with pytest.raises(InputError, match=r"no depth, only .*Color_0"):
        read_scan(recording(streams=[color_stream()]).write(tmp_path / "take.bag"), complete=False)


def test_a_bag_without_images_says_what_it_holds(tmp_path):
    others = {"/weather": ("std_msgs/Float32", {"data": 21.0})}
    file = recording(streams=[], units=(), others=others).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"take\.bag: there are no depth images .*/weather"):
        read_scan(file)


def ros_depth(**changes):
    images = [Image(START, depth_map(units=0.001), "16UC1", unit=None, frame="depth_optical")]
    stream = Stream("/cam/depth", images, (100, 100, 16, 12), (32, 24), None, "plumb_bob")
    return dataclasses.replace(stream, **{"topic": "/image_raw", "info": "/camera_info", **changes})


def ros_color(**changes):
    images = [Image(START, color_image(), "bgr8", unit=None, frame="color_optical")]
    images[0].pixels = np.ascontiguousarray(images[0].pixels[:, :, ::-1])
    stream = Stream("/cam/color", images, (200, 200, 24.5, 32.5), (48, 64), None, "plumb_bob")
    return dataclasses.replace(stream, **{"topic": "/image_raw", "info": "/camera_info", **changes})


def ros_bag(depth=None, color=None, links=(), **others):
    """A bag of any camera; `links` of the tree of frames are (parent, child, translation, quaternion)."""
    transforms = [
        made(
            "geometry_msgs/TransformStamped",
            header=stamped(0, parent),
            child_frame_id=child,
            transform=made("geometry_msgs/Transform", **transform(*place)),
        )
        for parent, child, *place in links
    ]
    if links:
        others["/tf_static"] = ("tf2_msgs/TFMessage", {"transforms": transforms})
    return Recording([depth or ros_depth(), color or ros_color()], units=(), others=others)


# color_from_depth is a quarter turn about z and then (-0.04, 0.02, 0): so the colour camera stands in the
# depth camera at -(a quarter turn back of that), (-0.02, -0.04, 0), turned back.
LINKS = [
    ("base", "depth_optical", (0, 0, 1), DEPTH_TURN),
    ("depth_optical", "arm", (-0.02, -0.04, 0), (0, 0, 0, 1)),
    ("/arm", "color_optical", (0, 0, 0), (0, 0, -(0.5**0.5), 0.5**0.5)),
]


def test_known_points_and_colours_of_a_ros_bag(tmp_path, tiny):
    scan = read_scan(ros_bag(links=LINKS).write(tmp_path / "take.bag"), complete=False)
    assert not doubts(scan)
    (frame,) = scan.frames
    np.testing.assert_allclose(
        tiny.seen(dataclasses.replace(frame, world_from_camera=tiny.second)), tiny.points[1], atol=1e-6
    )
    assert tiny.green_is_at_the_pixel(frame)
    assert read_depth(frame)[0, 0] == 0


@pytest.mark.parametrize(
    "links", [[], LINKS[:2], [*LINKS, ("color_optical", "base", (0, 0, 0), (0, 0, 0, 1))]]
)
def test_frames_that_nothing_joins(tmp_path, links):
    scan = read_scan(ros_bag(links=links).write(tmp_path / "take.bag"), complete=False)
    assert scan.frames[0].color_from_depth is None
    assert ["stands to that of" in text for text in doubts(scan)] == [True]


def test_aligned_depth_and_float_depth(tmp_path):
    pixels = np.full((24, 32), 2, np.float32)
    pixels[0, 0] = np.nan
    images = [Image(START, pixels, "32FC1", unit=None, frame="color_optical")]
    depth = ros_depth(name="/cam/aligned_depth_to_color", images=images)
    # Another depth topic and the colour of another camera are in it, too.
    made_bag = ros_bag(depth)
    made_bag.streams = [ros_color(name="/bar/color"), ros_depth(name="/cam/a_depth"), *made_bag.streams]
    scan = read_scan(made_bag.write(tmp_path / "take.bag"), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == 2
    assert read_depth(scan.frames[0])[0, 0] == 0
    assert str(scan.frames[0].color).endswith("/cam/color/image_raw 000000")
    assert [text for text in doubts(scan) if "of 2 topics" in text and "aligned" in text] == list(
        doubts(scan)
    )


def test_compressed_images(tmp_path, tiny):
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
    (frame,) = read_scan(bag.write(tmp_path / "take.bag"), complete=False).frames
    assert read_depth(frame)[17, 26] == 2
    assert tiny.green_is_at_the_pixel(frame)
    depths[0].compressed = ("16UC1; compressedDepth rvl", bytes(40))
    (frame,) = read_scan(bag.write(tmp_path / "take.bag"), complete=False).frames
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
    fish = ros_color(model="equidistant", distortion=(0.1, 0, 0, 0))
    with pytest.raises(InputError, match="described as 'equidistant'"):
        read_scan(ros_bag(color=fish).write(tmp_path / "take.bag"), complete=False)
    file = ros_bag(ros_depth(intrinsics=None)).write(tmp_path / "take.bag")
    with pytest.raises(InputError, match=r"no /cam/depth/camera_info.*scan\.intrinsics"):
        read_scan(file, complete=False)
    camera = read_scan(file, ScanParams(intrinsics="50,60,15,11"), complete=False).frames[0].camera
    assert (camera.width, camera.fx) == (32, 50)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no ROS bag"),
        (b"a shopping bag\n" * 9, "no ROS bag"),
        (b"#ROSBAG V1.2\n" + bytes(99), "another version"),
        (b"#ROSBAG V2.0\n", "not one message"),
        (b"#ROSBAG V2.0\n" + b"\xff" * 99, "not one message.*byte 13 of 112"),
    ],
)
def test_files_that_are_no_bag(tmp_path, data, words):
    (tmp_path / "take.bag").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_scan(tmp_path / "take.bag")


def test_an_encrypted_bag(tmp_path):
    file = recording().write(tmp_path / "take.bag")
    data = file.read_bytes()
    head = int.from_bytes(data[13:17], "little")
    field = b"encryptor=aes"
    longer = (head + 4 + len(field)).to_bytes(4, "little")
    file.write_bytes(
        data[:13]
        + longer
        + data[17 : 17 + head]
        + len(field).to_bytes(4, "little")
        + field
        + data[17 + head :]
    )
    with pytest.raises(InputError, match="encrypted"):
        read_scan(file)


def or_fault(read, *arguments, **options):
    """What a function returns, or the one sentence of its error, which names the file."""
    try:
        return read(*arguments, **options)
    except InputError as error:
        return str(error)


def doubts(scan: Scan) -> list[str]:
    """Return what is told of the recording, beside that one frame alone needs no pose."""
    return [text for text in scan.warnings if not text.startswith("a single frame without a pose")]


def outcome(file):
    """Sums of the scan's readable frames, and the number of its warnings; None where it is refused."""
    scan = or_fault(read_scan, file, complete=False)
    if isinstance(scan, str):
        assert str(file) in scan
        return None
    frames = []
    for one in scan.frames:
        images = [or_fault(read_depth, one), or_fault(read_color, one)]
        faults = [image for image in images if isinstance(image, str)]
        assert all(str(file) in fault for fault in faults)
        if not faults and images[1] is not None:
            frames.append((one.name, *(float(image.sum()) for image in images)))
    return frames, len(doubts(scan))


def test_a_recording_that_was_not_closed_keeps_what_came_before(tmp_path):
    made = recording(streams=[depth_stream(4), color_stream(4)], compression="lz4")
    file = made.write(tmp_path / "take.bag")
    data = file.read_bytes()
    whole, warnings = outcome(file)
    assert (len(whole), warnings) == (4, 0)
    # Without the summary at the end: what is left when the recorder dies after the last chunk.
    summary = int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
    file.write_bytes(data[:summary])
    assert outcome(file) == (whole, 0)
    counts = []
    for end in range(summary - 1, 4096, -97):
        file.write_bytes(data[:end])
        kept = outcome(file)
        counts.append(0 if kept is None else len(kept[0]))
        if kept is not None:
            assert kept[0] == whole[: len(kept[0])]
            assert kept[1] > 0
    assert set(counts) == {0, 1, 2, 3}
    assert counts == sorted(counts, reverse=True)


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_damaged_bytes_are_refused_or_cost_frames(tmp_path, compression):
    file = recording(compression=compression).write(tmp_path / "take.bag")
    data = file.read_bytes()
    # The padding of the first record holds nothing.
    places = [*range(13, 100), *range(4109, len(data))]
    chosen = random.Random(7)
    refused = 0
    for _ in range(100):
        damaged = bytearray(data)
        for _ in range(chosen.choice((1, 1, 3))):
            damaged[chosen.choice(places)] = chosen.choice((0, 0x7F, 0xFF, chosen.randrange(256)))
        file.write_bytes(damaged)
        refused += outcome(file) is None
    assert 0 < refused < 100


def test_a_chunk_that_claims_gigabytes_is_not_unpacked(tmp_path):
    file = recording(chunk_bytes=1 << 20).write(tmp_path / "take.bag")
    data = file.read_bytes()
    at = data.index(b"size=", 4109) + 5
    file.write_bytes(data[:at] + (3 << 30).to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(InputError, match=r"take\.bag"):
        read_scan(file, complete=False)
