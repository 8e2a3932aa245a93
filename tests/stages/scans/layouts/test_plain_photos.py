"""Folders of photos without poses."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image
from PIL.DdsImagePlugin import DdsImageFile
from PIL.PngImagePlugin import PngImageFile

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.images import read_exif_number
from scanloom.stages.scans.model.images import read_mask
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import detect_layout, read_scan

NAMES = ("IMG_0009", "IMG_0010", "IMG_0101")


def write_photos(folder: Path, *, suffix: str = ".jpg", focal_35mm: int | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if focal_35mm is not None:
        exif.get_ifd(0x8769)[0xA405] = focal_35mm
    for number, name in enumerate(NAMES):
        Image.new("RGB", (36, 24), (40 * number, 90, 20)).save(folder / f"{name}{suffix}", exif=exif)
    return folder


@pytest.mark.parametrize("place", ["images", "photos", "."])
def test_photos_alone_are_a_scan_without_poses(tmp_path: Path, place: str) -> None:
    write_photos(tmp_path / place)
    layout, reason = detect_layout(tmp_path)
    assert layout.name == "photos"
    assert "3 photos" in reason
    scan = read_scan(tmp_path, complete=False)
    assert [frame.name for frame in scan.frames] == list(NAMES)
    assert scan.is_views
    assert not scan.has_poses
    assert not scan.is_metric
    camera = scan.frames[0].camera
    assert (camera.fx, camera.cx, camera.cy, camera.is_guess) == (1.2 * 36, 17.5, 11.5, True)
    with pytest.raises(
        InputError, match="no poses: the folder has photos alone; `scanloom run` estimates them"
    ):
        read_scan(tmp_path)


def test_photos_may_be_of_several_formats_if_all_are_in_color(tmp_path: Path) -> None:
    write_photos(tmp_path)
    Image.new("RGB", (36, 24)).save(tmp_path / "screenshot.png")
    layout, reason = detect_layout(tmp_path)
    assert (layout.name, reason) == ("photos", "4 photos in the folder, and nothing else")
    assert len(read_scan(tmp_path, complete=False).frames) == 4
    Image.new("I;16", (36, 24)).save(tmp_path / "depth.png")
    with pytest.raises(InputError, match="unknown layout"):
        detect_layout(tmp_path)


def test_masks_are_found_beside_the_photos(tmp_path: Path) -> None:
    write_photos(tmp_path / "images")
    (tmp_path / "masks").mkdir()
    half = np.zeros((24, 36), np.uint8)
    half[:, 20:] = 255
    for name in NAMES:
        Image.fromarray(half).save(tmp_path / "masks" / f"{name}_mask.JPG", quality=95)
    assert detect_layout(tmp_path)[0].name == "photos"
    for frame in read_scan(tmp_path, complete=False).frames:
        np.testing.assert_array_equal(
            read_mask(frame)[:, [0, 18, 22, 35]] > 0, [[False, False, True, True]] * 24
        )


def test_the_focal_length_comes_from_exif_or_from_the_user(tmp_path: Path) -> None:
    write_photos(tmp_path, focal_35mm=28)
    camera = read_scan(tmp_path, complete=False).frames[0].camera
    # 36 × 24 pixels are one pixel per millimetre of film.
    assert camera.fx == pytest.approx(28)
    assert not camera.is_guess
    stated = read_scan(tmp_path, ScanParams(intrinsics="50,50,17,12"), complete=False).frames[0].camera
    assert (stated.fx, stated.cx, stated.is_guess) == (50, 17, False)


@pytest.mark.parametrize("focal", [0, 4, 65535])
def test_implausible_exif_is_ignored(tmp_path: Path, focal: int) -> None:
    write_photos(tmp_path, focal_35mm=focal)
    assert read_scan(tmp_path, complete=False).frames[0].camera.is_guess


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_exif_is_read_from_each_format_of_photos(tmp_path: Path, suffix: str) -> None:
    exif = Image.Exif()
    exif[0x8769] = {0xA405: 28}
    Image.new("RGB", (36, 24)).save(tmp_path / f"a{suffix}", exif=exif)
    assert read_exif_number(tmp_path / f"a{suffix}", 0x8769, 0xA405) == 28


def test_exif_is_read_without_decoding_the_image(tmp_path: Path) -> None:
    """Pillow decodes a PNG without EXIF in front of its pixels, and chooses a decoder by content."""
    path = tmp_path / "a.png"
    Image.new("RGB", (36, 24)).save(path)
    with patch.object(PngImageFile, "load") as load:
        assert read_exif_number(path, 0x8769, 0xA405) is None
    load.assert_not_called()
    # DDS is a format that no reader supports, and whose header Pillow would parse.
    Image.new("RGB", (36, 24)).save(path, "DDS")
    with patch.object(DdsImageFile, "_open") as open_dds:
        assert read_exif_number(path, 0x8769, 0xA405) is None
    open_dds.assert_not_called()


def test_transparent_pixels_are_masked(tmp_path: Path) -> None:
    for name in NAMES:
        pixels = np.full((24, 36, 4), 200, np.uint8)
        pixels[:, :10, 3] = 0
        Image.fromarray(pixels).save(tmp_path / f"{name}.png")
    mask = read_mask(read_scan(tmp_path, complete=False).frames[0])
    assert (mask[:, :10] == 0).all()
    assert (mask[:, 10:] > 0).all()


def test_a_scale_is_stated_for_later(tmp_path: Path) -> None:
    write_photos(tmp_path)
    scan = read_scan(tmp_path, ScanParams(scale=0.5), complete=False)
    assert scan.is_metric
    assert scan.scale is not None
    assert scan.scale.metres_per_unit == 0.5
    assert read_scan(tmp_path, ScanParams(tag_size=0.1), complete=False).is_metric


@pytest.mark.parametrize("file", ["poses.txt", "images/track.json", "cameras.csv"])
def test_files_that_may_hold_poses_are_not_ignored(tmp_path: Path, file: str) -> None:
    write_photos(tmp_path / "images")
    (tmp_path / file).write_text("{}")
    with pytest.raises(InputError, match=r"scan\.layout=photos"):
        read_scan(tmp_path)
    assert len(read_scan(tmp_path, ScanParams(layout="photos"), complete=False).frames) == 3


@pytest.mark.parametrize("others", ["right", "things"])
def test_other_folders_are_not_ignored(tmp_path: Path, others: str) -> None:
    write_photos(tmp_path / "images")
    (tmp_path / others).mkdir()
    (tmp_path / others / "unknown.dat").write_bytes(b"")
    with pytest.raises(InputError, match="unknown layout"):
        detect_layout(tmp_path)


def test_two_streams_keep_their_advice(tmp_path: Path) -> None:
    for side in ("a", "b"):
        for number in range(3):
            Image.new("RGB", (36, 24)).save(tmp_path / f"{side}_{number}.png")
    with pytest.raises(InputError, match=r"named like a_0\.png and b_0\.png"):
        read_scan(tmp_path)


def test_images_of_two_formats_may_be_colour_and_depth(tmp_path: Path) -> None:
    write_photos(tmp_path)
    write_photos(tmp_path, suffix=".png")
    with pytest.raises(InputError, match="images without poses"):
        read_scan(tmp_path)


def test_a_folder_of_photo_folders_is_no_scan(tmp_path: Path) -> None:
    write_photos(tmp_path / "one")
    write_photos(tmp_path / "two")
    with pytest.raises(InputError, match="unknown layout"):
        read_scan(tmp_path)


def test_hold_out_requires_poses(tmp_path: Path) -> None:
    write_photos(tmp_path)
    with pytest.raises(UsageError, match="hold_out requires poses"):
        read_scan(tmp_path, ScanParams(hold_out=2), complete=False)


def test_equal_stems_are_told_apart_by_their_suffix(tmp_path: Path) -> None:
    write_photos(tmp_path)
    write_photos(tmp_path, suffix=".JPEG")
    names = [frame.name for frame in read_scan(tmp_path, complete=False).frames]
    assert len(set(names)) == 6
    assert "IMG_0009.jpg" in names
