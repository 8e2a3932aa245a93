"""Frames of rendered videos: spacing by motion, sharpness, limits, and videos that end early."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.registration.structure import frame_selection
from scanloom.stages.registration.structure.frame_selection import extract_frames, select_frames
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.reader import read_scan

CAMERA = Camera(160, 120, 192, 192, 79.5, 59.5, is_guess=True)
DIAGONAL = 200.0


def make_texture() -> np.ndarray:
    noise = np.random.default_rng(1).integers(0, 256, (120, 8000), np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 3)


TEXTURE = cv2.normalize(make_texture(), None, 0, 255, cv2.NORM_MINMAX)


def make_frame(number: int, shift: float, blur: float = 0.0) -> Frame:
    image = TEXTURE[:, int(shift) : int(shift) + 160]
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    return Frame(f"{number:06d}", CAMERA, color=np.repeat(image[..., None], 3, axis=2))


def make_scan(shifts: np.ndarray, blurred: set[int] | None = None) -> Scan:
    frames = [
        make_frame(number, shift, 2.0 if number in (blurred or ()) else 0.0)
        for number, shift in enumerate(shifts)
    ]
    return Scan("video", frames, is_metric=False)


def select(scan: Scan, max_count: int = 120) -> list[int]:
    return select_frames(scan, max_count, lambda _: None)


@pytest.mark.slow
def test_frames_are_spaced_by_motion_not_by_time() -> None:
    # 400 frames in which the image moves by 2 pixels, then 200 in which it moves by 4.
    shifts = np.cumsum([0] + [2] * 400 + [4] * 200)
    selected = np.array(select(make_scan(shifts)))
    steps = np.diff(shifts[selected])
    expected = 1600 / 200 / 0.08
    assert len(selected) == pytest.approx(expected, abs=4)
    assert np.median(steps) == pytest.approx(0.08 * DIAGONAL, rel=0.15)
    assert steps.max() < 0.16 * DIAGONAL


def test_blurred_frames_are_avoided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_selection, "_MIN_FRAMES", 10)
    shifts = np.arange(201) * 2.0
    blurred = {number for number in range(201) if number % 4}
    selected = select(make_scan(shifts, blurred))
    assert 20 <= len(selected) <= 30
    assert not blurred & set(selected)


def test_an_image_that_does_not_move_is_spaced_by_time() -> None:
    selected = select(make_scan(np.zeros(200)))
    assert len(selected) == 40
    assert np.diff(selected).min() >= 3
    assert np.diff(selected).max() <= 8


def test_short_videos_are_used_completely() -> None:
    assert select(make_scan(np.arange(10) * 3.0)) == list(range(10))


@pytest.mark.slow
def test_too_much_motion_for_the_number_of_frames_is_reported() -> None:
    scan = make_scan(np.arange(120) * 40.0)
    with collecting(forward=False) as diagnostics:
        selected = select(scan, 10)
    assert len(selected) == 10
    (warning,) = diagnostics
    assert warning.code == "structure.video-too-fast"
    assert "structure.max_frames=20" in str(warning)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "pan.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 10, (160, 120))
    for number in range(60):
        writer.write(make_frame(number, 4 * number).color)
    writer.release()
    return path


def test_selected_frames_become_photos(video: Path, tmp_path: Path) -> None:
    scan = read_scan(video, complete=False)
    steps: list[tuple[int, int]] = []
    photos = extract_frames(scan, tmp_path / "photos", progress=lambda *step: steps.append(step))
    files = sorted((tmp_path / "photos").iterdir())
    assert [frame.color for frame in photos.frames] == files
    assert len(files) == 40
    assert [file.stem for file in files] == [frame.name for frame in photos.frames]
    for frame in photos.frames[::9]:
        stored = read_color(frame)
        np.testing.assert_allclose(stored, make_frame(0, 4 * int(frame.name)).color, atol=40)
    assert steps == sorted(steps)
    assert steps[-1] == (120, 120)
    again = extract_frames(scan, tmp_path / "again", max_frames=7)
    assert len(again.frames) == 7


def test_a_video_that_ends_early_is_used_up_to_its_end(video: Path, tmp_path: Path) -> None:
    scan = read_scan(video, complete=False)

    def fail() -> np.ndarray:
        raise InputError(frame_selection.RECORDING_DAMAGED, "the video ends.")

    broken = [replace(frame, color=replace(frame.color, load=fail)) for frame in scan.frames]
    cut = replace(scan, frames=[*scan.frames[:30], *broken[30:]])
    photos = extract_frames(cut, tmp_path / "photos")
    assert [int(frame.name) for frame in photos.frames] == list(range(30))
    (warning,) = [one for one in photos.diagnostics if one.code == "recording.damaged"]
    assert "after 50%" in str(warning)
    with pytest.raises(InputError, match="the video ends"):
        extract_frames(replace(scan, frames=broken), tmp_path / "none")
