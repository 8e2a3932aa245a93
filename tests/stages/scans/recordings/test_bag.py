"""Invalid ROS 1 bags: other files, encrypted, unclosed, damaged."""

import random

import pytest
from tiny_recordings import (
    color_stream,
    depth_stream,
    recording,
    summarise_scan,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.reader import read_scan


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a ROS bag"),
        (b"a shopping bag\n" * 9, "not a ROS bag"),
        (b"#ROSBAG V1.2\n" + bytes(99), "another version"),
        (b"#ROSBAG V2.0\n", "no message in the recording is readable"),
        (b"#ROSBAG V2.0\n" + b"\xff" * 99, "no message in the recording is readable.*byte 13 of 112"),
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


def test_an_unclosed_recording_keeps_its_complete_messages(tmp_path):
    made = recording(streams=[depth_stream(4), color_stream(4)], compression="lz4")
    file = made.write(tmp_path / "take.bag")
    data = file.read_bytes()
    whole, warnings = summarise_scan(file)
    assert (len(whole), warnings) == (4, 0)
    # Without the summary at the end, like after a crash of the recorder after the last chunk.
    summary = int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
    file.write_bytes(data[:summary])
    assert summarise_scan(file) == (whole, 0)
    counts = []
    for end in range(summary - 1, 4096, -97):
        file.write_bytes(data[:end])
        kept = summarise_scan(file)
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
    # The padding of the first record is unused.
    places = [*range(13, 100), *range(4109, len(data))]
    chosen = random.Random(7)
    refused = 0
    for _ in range(100):
        damaged = bytearray(data)
        for _ in range(chosen.choice((1, 1, 3))):
            damaged[chosen.choice(places)] = chosen.choice((0, 0x7F, 0xFF, chosen.randrange(256)))
        file.write_bytes(damaged)
        refused += summarise_scan(file) is None
    assert 0 < refused < 100


def test_a_chunk_that_claims_gigabytes_is_not_unpacked(tmp_path):
    file = recording(chunk_bytes=1 << 20).write(tmp_path / "take.bag")
    data = file.read_bytes()
    at = data.index(b"size=", 4109) + 5
    file.write_bytes(data[:at] + (3 << 30).to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(InputError, match=r"take\.bag"):
        read_scan(file, complete=False)
