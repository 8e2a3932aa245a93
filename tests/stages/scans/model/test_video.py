from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model import video
from scanloom.stages.scans.model.video import Video

COUNT = 40


@pytest.fixture
def path(tmp_path):
    """Write a video whose frames encode their number in six black or white columns, on red."""
    writer = cv2.VideoWriter(
        str(tmp_path / "a.mp4"), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), 30, (64, 48)
    )
    for number in range(COUNT):
        image = np.full((48, 64, 3), (0, 0, 255), np.uint8)
        for bit in range(6):
            image[:32, 8 * bit : 8 * bit + 8] = 255 * (number >> bit & 1)
        writer.write(image)
    writer.release()
    return tmp_path / "a.mp4"


def number_of(image):
    return sum(int(image[8:24, 8 * bit + 4, 1].mean() > 128) << bit for bit in range(6))


def test_a_frame_is_had_by_its_number_in_any_order(path, monkeypatch):
    monkeypatch.setattr(video, "_DECODED_BYTES", 3 * 64 * 48 * 3)
    opened = Video(path)
    assert (opened.width, opened.height, opened.frame_count) == (64, 48, COUNT)
    for number in (0, 1, 5, 3, 4, 39, 38, 0, 20, 2):
        assert number_of(opened.read_frame(number)) == number
        assert len(opened._decoded) <= 3
    np.testing.assert_allclose(opened.read_frame(7)[44, 60], (255, 0, 0), atol=12)


def test_changing_a_frame_does_not_affect_the_cache(path):
    opened = Video(path)
    opened.read_frame(3)[:] = 0
    assert number_of(opened.read_frame(3)) == 3


def test_threads_get_the_frames_they_asked_for(path, monkeypatch):
    monkeypatch.setattr(video, "_DECODED_BYTES", 4 * 64 * 48 * 3)
    opened = Video(path)
    order = list(np.random.default_rng(0).permutation(COUNT))
    with ThreadPoolExecutor(8) as threads:
        assert [number_of(image) for image in threads.map(opened.read_frame, order)] == order


def test_a_frame_beyond_the_end_is_always_an_error(path):
    opened = Video(path)
    for number in (COUNT, COUNT + 5, COUNT):
        with pytest.raises(InputError, match=rf"a\.mp4: frame {number} is missing: .* after {COUNT} frames"):
            opened.read_frame(number)
    assert number_of(opened.read_frame(3)) == 3


def test_a_file_that_is_not_a_video_is_reported(path):
    data = path.read_bytes()
    for content in (
        b"",
        b"hello",
        data[:1000],
        data[: len(data) // 2],
        b"#EXTM3U\n/etc/passwd\n",
        data[100:],
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a\.mp4: "):
            Video(path)
    with pytest.raises(InputError, match="cannot be opened"):
        Video(path.with_name("gone.mp4"))


def test_damage_inside_is_an_error_or_another_picture_and_no_crash(path):
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    for _ in range(20):
        broken = bytearray(data)
        for at in rng.integers(8, len(data), 30):
            broken[at] = rng.integers(256)
        path.write_bytes(broken)
        try:
            image = Video(path).read_frame(COUNT - 1)
        except InputError:
            continue
        assert image.dtype == np.uint8
