"""Videos as scans: containers, rotation, numbers of frames, and damaged files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.layouts import video_file
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

SIZE = (64, 48)


def write_video(path: Path, count: int, *, codec: str = "mp4v", fps: float = 10) -> Path:
    """Write a video whose frames are red, with a blue top left quarter; the green channel counts."""
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, SIZE)
    assert writer.isOpened()
    for number in range(count):
        image = np.full((SIZE[1], SIZE[0], 3), (0, 8 * (number % 30), 250), np.uint8)
        image[:24, :32] = (250, 0, 0)
        writer.write(image)
    writer.release()
    return path


def rotate_by_metadata(path: Path) -> None:
    """Write a rotation of 90° into the track header: first matrix of the file that is a unit matrix."""
    data = path.read_bytes()
    track = data.index(b"tkhd")
    unit = b"".join(one.to_bytes(4, "big") for one in (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30))
    turned = np.array([0, 1 << 16, 0, -1 << 16, 0, 0, SIZE[1] << 16, 0, 1 << 30], ">i4").tobytes()
    at = data.index(unit, track)
    path.write_bytes(data[:at] + turned + data[at + len(unit) :])


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.mp4", "mp4v"), ("a.MOV", "jpeg"), ("a.avi", "MJPG"), ("a.webm", "VP80"), ("a.mkv", "MJPG")],
)
def test_frames_of_common_containers_are_read(tmp_path: Path, name: str, codec: str) -> None:
    scan = read_scan(write_video(tmp_path / name, 6, codec=codec), complete=False)
    assert scan.layout == "video"
    assert [frame.name for frame in scan.frames] == [f"{number:06d}" for number in range(6)]
    assert scan.is_views
    assert not scan.has_poses
    assert not scan.is_metric
    camera = scan.frames[0].camera
    assert (camera.width, camera.height, camera.fx, camera.is_guess) == (64, 48, 1.2 * 64, True)
    image = read_color(scan.frames[5])
    np.testing.assert_allclose(image[40, 50], (250, 40, 0), atol=14)
    np.testing.assert_allclose(image[5, 5], (0, 0, 250), atol=14)


def test_rotation_metadata_are_applied(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", 3)
    rotate_by_metadata(path)
    frame = read_scan(path, complete=False).frames[0]
    assert (frame.camera.width, frame.camera.height) == (48, 64)
    image = read_color(frame)
    assert image.shape == (64, 48, 3)
    # Turned clockwise, the top left quarter is at the top right.
    assert image[5, 43, 2] > 200
    assert image[5, 5, 2] < 50


def test_frames_are_thinned_to_a_rate_and_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "a.mp4", 60, fps=30)
    names = [int(frame.name) for frame in read_scan(path, complete=False).frames]
    assert names == list(range(0, 60, 3))
    monkeypatch.setattr(video_file, "_MAX_FRAMES", 10)
    scan = read_scan(path, complete=False)
    assert [int(frame.name) for frame in scan.frames] == list(range(0, 60, 6))
    assert abs(int(read_color(scan.frames[2])[40, 50, 1]) - 8 * 12) < 14


def test_the_user_gives_the_camera_and_selects_frames(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", 8)
    scan = read_scan(path, ScanParams(intrinsics="50,50,32,24", first=2, every=2), complete=False)
    assert [frame.name for frame in scan.frames] == ["000002", "000004", "000006"]
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.is_guess) == (50, False)


def test_a_video_without_a_stated_number_of_frames_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_video(tmp_path / "a.mp4", 8)

    class WithoutCount(video_file.Video):
        def __init__(self, path: Path, **options: bool) -> None:
            super().__init__(path, **options)
            self.frame_count = 0

    monkeypatch.setattr(video_file, "Video", WithoutCount)
    assert len(read_scan(path, complete=False).frames) == 8


def test_too_long_videos_are_refused_with_a_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "a.mp4", 8)
    monkeypatch.setattr(video_file, "_MAX_STORED_FRAMES", 7)
    with pytest.raises(InputError, match=r"more than 7 frames\. .*`ffmpeg -ss 0 -t 600 -i a\.mp4") as caught:
        read_scan(path, complete=False)
    assert caught.value.diagnostic.code == "scan.video-too-long"


@pytest.mark.parametrize("name", ["a.mp4", "a.avi", "a.webm", "a.wmv"])
def test_files_that_are_no_videos_are_refused_with_advice(tmp_path: Path, name: str) -> None:
    whole = write_video(tmp_path / "whole.mp4", 8).read_bytes()
    for content in (b"", b"#EXTM3U\n/etc/passwd\n", b"RIFFxxxx", whole[:900], whole[: len(whole) // 2]):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}: .*ffmpeg -i {name}") as caught:
            read_scan(tmp_path / name, complete=False)
        assert caught.value.diagnostic.code == "recording.damaged"


def test_refusals_are_one_message_with_exit_code_3(tmp_path: Path) -> None:
    data = bytearray(write_video(tmp_path / "a.mp4", 8).read_bytes())
    at = data.index(b"stsd")
    data[at + 4 : at + 40] = b"\xff" * 36
    (tmp_path / "a.mp4").write_bytes(data)
    # A new process: FFmpeg reads its log level when it is first used.
    words = [sys.executable, "-c", "from scanloom.cli.start import main; main()", "run", "a.mp4", "-o", "out"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "a.mp4: the video does not open" in done.stderr
    assert not (tmp_path / "out").exists()


def test_damaged_bytes_do_not_crash(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", 20)
    whole, random = path.read_bytes(), np.random.default_rng(2)
    for _ in range(30):
        broken = np.frombuffer(whole, np.uint8).copy()
        broken[random.integers(8, len(whole), 20)] = random.integers(0, 256, 20)
        path.write_bytes(broken.tobytes())
        try:
            scan = read_scan(path, complete=False)
            images = [read_color(frame) for frame in scan.frames[:20]]
        except InputError:
            continue
        assert all(image.dtype == np.uint8 for image in images)
