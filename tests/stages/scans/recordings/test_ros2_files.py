"""Damaged ROS 2 files are refused in one sentence or lose frames."""

import random

import pytest
from recordings import Image
from tiny_recordings import (
    INTERVAL,
    START,
    color_image,
    depth_map,
    ros_bag,
    ros_color,
    ros_depth,
    summarise_scan,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.recordings import chunked

FORMS = [
    ("mcap", "none"),
    ("mcap", "message"),
    ("mcap", "storage"),
    ("sqlite3", "none"),
    ("sqlite3", "message"),
]


def take(folder, storage, packed, count=3):
    depths = [
        Image(START + n * INTERVAL, depth_map(1 + n / 10, 0.001), "16UC1", unit=None) for n in range(count)
    ]
    colors = [Image(START + n * INTERVAL, color_image(n), "rgb8", unit=None) for n in range(count)]
    bag = ros_bag(ros_depth(images=depths), ros_color(images=colors))
    return bag.write_ros2(folder / "take", storage, packed)


@pytest.mark.slow
@pytest.mark.parametrize(("storage", "packed"), FORMS)
def test_damaged_bytes_are_refused_or_cost_frames(tmp_path, storage, packed):
    file = take(tmp_path, storage, packed)
    data = file.read_bytes()
    chosen = random.Random(11)
    whole = summarise_scan(file)
    assert len(whole[0]) == 3
    refused = 0
    for _ in range(60):
        damaged = bytearray(data)
        for _ in range(chosen.choice((1, 1, 3, 30))):
            damaged[chosen.randrange(len(data))] = chosen.choice((0, 0x7F, 0xFF, chosen.randrange(256)))
        file.write_bytes(damaged)
        refused += summarise_scan(file) is None
    assert refused < 60


@pytest.mark.parametrize(("storage", "packed"), FORMS)
def test_files_that_are_cut_short(tmp_path, storage, packed):
    file = take(tmp_path, storage, packed)
    data = file.read_bytes()
    whole, _ = summarise_scan(file)
    for end in range(0, len(data), len(data) // 25):
        file.write_bytes(data[:end])
        kept = summarise_scan(file)
        assert kept is None or kept[0] == whole[: len(kept[0])]


def test_an_unclosed_mcap_keeps_its_complete_messages(tmp_path):
    file = take(tmp_path, "mcap", "none")
    data = file.read_bytes()
    whole = summarise_scan(file)
    # The last record before the summary is DataEnd with a checksum of 4 bytes.
    summary = data.rindex(b"\x0f" + (4).to_bytes(8, "little"))
    file.write_bytes(data[:summary])
    assert summarise_scan(file) == whole
    file.write_bytes(data[: summary - 1])
    assert summarise_scan(file)[0] == whole[0]
    assert summarise_scan(file)[1] == whole[1] + 1


def test_messages_without_chunk(tmp_path):
    """Fast recorders write messages directly, without index and summary."""
    file = take(tmp_path, "mcap", "none")
    whole = summarise_scan(file)
    data = file.read_bytes()
    for unchunked in (True, False):
        parts, at = [data[:8]], 8
        while at < len(data) - 8:
            operation, size = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
            body = data[at + 9 : at + 9 + size]
            if operation == 6 and unchunked:
                words = int.from_bytes(body[28:32], "little")
                parts.append(body[40 + words :])
            elif operation in (1, 6):
                parts.append(data[at : at + 9 + size])
            at += 9 + size
        file.write_bytes(b"".join(parts))
        assert summarise_scan(file) == whole


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "no message in the recording is readable"),
        (b"x" * 99, "not an MCAP"),
    ],
)
def test_files_that_are_no_mcap(tmp_path, data, words):
    (tmp_path / "take.mcap").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_scan(tmp_path / "take.mcap")


def test_a_chunk_that_claims_too_much_is_not_unpacked(tmp_path, monkeypatch):
    file = take(tmp_path, "mcap", "storage")
    monkeypatch.setattr(chunked, "_MAX_CHUNK_BYTES", 100)
    with pytest.raises(InputError, match=r"take\S*\.mcap"):
        read_scan(file)
