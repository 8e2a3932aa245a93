"""Recordings of librealsense in SQLite databases, with cameras described as text."""

import random
import sqlite3

import numpy as np
import pytest
from tiny_recordings import (
    INTERVAL,
    START,
    color_stream,
    depth_stream,
    list_warnings,
    recording,
    summarise_scan,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.recordings import db3 as ros_db3


@pytest.mark.parametrize("form", ["raw", "png", "zstd"])
def test_known_points_and_colours_of_a_newer_recording(tmp_path, tiny, trajectory, form):
    scan = read_scan(recording(started=START - 5).write_db3(tmp_path / "take.db3", form), trajectory)
    assert scan.layout == "ros-bag"
    assert not list_warnings(scan)
    assert not scan.skipped_frames
    # Times are decimal milliseconds there, which doubles represent to 0.2 microseconds only.
    np.testing.assert_allclose([one.timestamp - START for one in scan.frames], (0, INTERVAL), atol=1000)
    for one, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-4)
        assert read_depth(one)[0, 0] == 0
        assert tiny.green_is_at_the_pixel(one)


def test_cameras_of_a_newer_recording(tmp_path):
    bent = (-0.05, 0.06, 0.001, -0.002, -0.02)
    lens = {"model": "Inverse Brown Conrady", "distortion": bent}
    made_so = recording(streams=[depth_stream(), color_stream(**lens)], units=(0.001, 0.00025))
    scan = read_scan(made_so.write_db3(tmp_path / "take.db3"), complete=False)
    assert scan.frames[0].color_camera.distortion == bent
    assert scan.frames[0].depth_scale == pytest.approx(4000)
    assert ["changes within" in text for text in list_warnings(scan)] == [True]
    bare = recording(streams=[depth_stream(), color_stream(from_reference=None)], units=())
    scan = read_scan(bare.write_db3(tmp_path / "take.db3"), complete=False)
    assert [
        "millimetres" in text or "does not contain the extrinsics" in text for text in list_warnings(scan)
    ] == [
        True,
        True,
    ]
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
        ("DROP TABLE messages", "not a recording: table `messages`"),
        ("ALTER TABLE messages RENAME data TO blob", "not a recording: table `messages`"),
        ("UPDATE topics SET name = '/cam' || name", "the topic /cam/device_0"),
        (
            "DELETE FROM messages WHERE timestamp > 0",
            "neither depth images|no message in the recording is readable",
        ),
        ("UPDATE messages SET data = x'0001'", "truncated"),
        ("UPDATE messages SET data = 5", "damaged"),
        ("UPDATE messages SET data = x'28b52ffd00'", "does not decompress|damaged"),
        (
            "UPDATE messages SET timestamp = 'noon'",
            "neither depth images|no message in the recording is readable",
        ),
        (
            "UPDATE messages SET timestamp = timestamp + id",
            "at the same time.*image 0 of .* has no metadata with its capture time",
        ),
    ],
)
def test_a_newer_recording_that_is_damaged(tmp_path, change, words):
    file = recording().write_db3(tmp_path / "take.db3")
    database(file, change)
    with pytest.raises(InputError, match=words):
        read_scan(file, complete=False)


def test_a_message_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    file = recording().write_db3(tmp_path / "take.db3")
    monkeypatch.setattr(ros_db3, "MAX_MESSAGE_BYTES", 2000)
    scan = read_scan(file, complete=False)
    with pytest.raises(InputError, match=r"take\.db3: message \d+ is missing or exceeds the size limit"):
        read_color(scan.frames[0])


def test_an_endless_view_is_not_read_as_table(tmp_path):
    file = recording().write_db3(tmp_path / "take.db3")
    database(file, "DROP TABLE messages")
    database(
        file,
        f"CREATE VIEW messages AS {ENDLESS} "
        "SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n",
    )
    with pytest.raises(InputError, match="table `messages`"):
        read_scan(file, complete=False)


@pytest.mark.parametrize("form", ["raw", "png", "zstd"])
def test_damaged_bytes_of_a_newer_recording_are_refused_or_cost_frames(tmp_path, form):
    file = recording().write_db3(tmp_path / "take.db3", form)
    data = file.read_bytes()
    chosen = random.Random(5)
    for end in range(0, len(data), len(data) // 20):
        file.write_bytes(data[:end])
        assert summarise_scan(file) is None
    for _ in range(40):
        damaged = bytearray(data)
        for _ in range(chosen.choice((1, 5, 50))):
            damaged[chosen.randrange(len(data))] = chosen.choice((0, 0x7F, 0xFF, chosen.randrange(256)))
        file.write_bytes(damaged)
        summarise_scan(file)
