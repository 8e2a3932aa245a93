"""Photos alone, without poses and depth.

    images/IMG_0001.jpg  …     or photos/, frames/ and so on, or in the scan folder itself
    masks/IMG_0001.png         optional, or masks/IMG_0001_mask.png: 0 where the photo is not used

Transparent pixels are masked. A folder with files that may hold poses does not match, so that poses
are not ignored by accident.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import is_surely_color, read_exif_number, read_image_size
from scanloom.stages.scans.advice import describe_streams
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.calibration.discovery import list_trajectory_candidates
from scanloom.stages.scans.codes import SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    MASK_FOLDERS,
    find_common_size,
    list_images,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import scale_to_size
from scanloom.stages.scans.layouts.shared.photo_masks import find_photo_mask
from scanloom.stages.scans.layouts.shared.posed_views import find_transparency_mask
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, SkippedFrame

_PHOTO_FOLDERS = (*COLOR_FOLDERS, "photos", "frames", "imgs")
_SAME_FORMAT = {".jpeg": ".jpg", ".tiff": ".tif"}
# Minimum number of photos for structure from motion.
_MIN_PHOTO_COUNT = 3
# Focal length without evidence, in longer sides of the image; COLMAP's start value.
_DEFAULT_FOCAL_RATIO = 1.2
# EXIF tags. Photos of one lens have equal focal lengths, so maker and model of the device are not needed.
_EXIF_FOLDER, _FOCAL_35MM = 0x8769, 0xA405
# Diagonal of 35 mm film, mm.
_FILM_DIAGONAL_MM = math.hypot(36, 24)


def _matches(folder: Path) -> str | None:
    photos = _find_photos(folder)
    if photos is None:
        return None
    others = [
        one for one in folder.iterdir() if one.is_dir() and one != photos and not one.name.startswith(".")
    ]
    if any(one.name not in MASK_FOLDERS for one in others):
        return None
    files = list_images(photos)
    formats = {_SAME_FORMAT.get(file.suffix.lower(), file.suffix.lower()) for file in files}
    if len(formats) > 1 and not _are_different_photos(files):
        return None
    if list_trajectory_candidates(folder) or list_trajectory_candidates(photos):
        return None
    if describe_streams(folder) is not None or describe_streams(photos) is not None:
        return None
    where = "the folder" if photos == folder else f"{photos.name}/"
    return f"{len(files)} photos in {where}, and nothing else"


def _are_different_photos(files: Sequence[Path]) -> bool:
    """Test if files of several formats are photos; depth images or masks may be among them."""
    stems = {file.stem for file in files}
    return len(stems) == len(files) and all(is_surely_color(file) for file in files)


def _find_photos(folder: Path) -> Path | None:
    """Return the only folder with photos, or None."""
    places = [folder, *(folder / name for name in _PHOTO_FOLDERS if (folder / name).is_dir())]
    found = [place for place in places if len(list_images(place)) >= _MIN_PHOTO_COUNT]
    return found[0] if len(found) == 1 else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    photos = _find_photos(folder)
    if photos is None:
        raise InputError(
            SCAN_FILES_MISSING,
            "at least {minimum} photos are required, in the folder or in one folder images/.",
            folder,
            minimum=_MIN_PHOTO_COUNT,
        )
    files = list_images(photos)
    stated = get_stated_camera(options, folder, *find_common_size(files))
    found = [_create_frame(folder, file, stated) for file in files]
    frames = [one for one in found if isinstance(one, Frame)]
    skipped = tuple(one for one in found if isinstance(one, SkippedFrame))
    missing = describe_missing_poses(
        "the folder has photos alone",
        remedy="`scanloom run` estimates them; other commands need the poses from scan.poses=FILE",
    )
    return Scan(
        LAYOUT.name,
        _rename_repeated(frames),
        None,
        folder,
        skipped,
        missing=(missing,),
        is_metric=False,
    )


def _create_frame(folder: Path, file: Path, stated: Camera | None) -> Frame | SkippedFrame:
    try:
        camera = choose_camera(file, stated)
        mask = find_photo_mask(folder, file) or find_transparency_mask(file)
        return Frame(file.stem, camera, color=file, mask=mask)
    except InputError as error:
        return SkippedFrame(file.stem, error.diagnostic)


def choose_camera(file: Path, stated: Camera | None) -> Camera:
    """Return the start value of the camera: from the user, from EXIF, or a guess."""
    size = width, height = read_image_size(file)
    if stated is not None:
        return (
            stated
            if size == (stated.width, stated.height)
            else scale_to_size(stated, size, "the photo", file)
        )
    focal = _read_exif_focal(file, width, height)
    guess = guess_camera(width, height)
    return guess if focal is None else replace(guess, fx=focal, fy=focal, is_guess=False)


def guess_camera(width: int, height: int) -> Camera:
    """Guess the camera of a photo without evidence of the focal length."""
    focal = _DEFAULT_FOCAL_RATIO * max(width, height)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)


def _read_exif_focal(file: Path, width: int, height: int) -> float | None:
    """Return the focal length in pixels from EXIF's equivalent for 35 mm film, or None."""
    equivalent = read_exif_number(file, _EXIF_FOLDER, _FOCAL_35MM)
    if equivalent is None or not 5 <= equivalent <= 1000:
        return None
    return equivalent / _FILM_DIAGONAL_MM * math.hypot(width, height)


def _rename_repeated(frames: Sequence[Frame]) -> list[Frame]:
    """Name frames after their files if stems repeat (a.jpg, a.jpeg)."""
    stems = [frame.name for frame in frames]
    if len(set(stems)) == len(stems):
        return list(frames)
    return [replace(frame, name=frame.color.name) for frame in frames if isinstance(frame.color, Path)]


LAYOUT = Layout(
    name="photos",
    description="photos (in images/, photos/ and so on, or in the folder itself) and nothing else: their "
    "poses are estimated",
    matches=_matches,
    read=_read,
)
