"""Image files of a folder: listing, numeric order, and pairing of streams."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_PATH_OUTSIDE, FILE_UNREADABLE
from scanloom.stages.files.images import read_image_size
from scanloom.stages.files.path_safety import is_safe_relative_path
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_IMAGES_UNPAIRED,
)
from scanloom.stages.scans.model.scan import SkippedFrame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
DEPTH_SUFFIXES = (*IMAGE_SUFFIXES, ".npy", ".pfm", ".exr")
# Folder names of colour images, masks and depth images in data sets and exports.
COLOR_FOLDERS = ("color", "rgb", "image", "images", "colors", "mono", "gray", "grey")
MASK_FOLDERS = ("masks", "mask")
DEPTH_FOLDERS = ("depth", "depths", "depth_images")
_MAX_NAME_LENGTH = 255
# Minimum ratio of matched frames on the smaller side. Fewer matches are coincidental equal numbers.
_MIN_PAIRED_RATIO = 0.1


def extract_numbers(name: str) -> tuple[int, ...]:
    """Extract the whole numbers of a file name as a sort key.

    As a sort key, they put 10.png after 2.png.
    """
    # File systems allow 255 bytes; Python refuses to convert numbers of several thousand digits.
    return tuple(int(digits) for digits in re.findall(r"\d+", name[:_MAX_NAME_LENGTH]))


# Candidate keys to pair two file names: all numbers (0001-0002), the last number (cam0_0001 and cam1_0001),
# or the first number (one frame number, two timestamps).
_PAIRING_KEYS: tuple[Callable[[Path], object], ...] = (
    lambda path: extract_numbers(path.stem) or path.stem,
    lambda path: (extract_numbers(path.stem) or (path.stem,))[-1],
    lambda path: (extract_numbers(path.stem) or (path.stem,))[0],
)


def list_images(folder: Path, suffixes: Sequence[str] = IMAGE_SUFFIXES) -> list[Path]:
    """Return the image files of a folder, ordered by their numbers.

    Raises
    ------
    InputError
        If the folder cannot be listed.
    """
    try:
        found = [p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".")]
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the folder cannot be listed ({strerror}).", folder, strerror=error.strerror
        ) from error
    return sorted(found, key=lambda path: (extract_numbers(path.stem), path.name))


def find_first_existing(folder: Path, *names: str) -> Path | None:
    """Return the first of several names that exists, or None."""
    return next((folder / name for name in names if (folder / name).exists()), None)


def has_all(folder: Path, *names: str) -> bool:
    """Return True if all of these files or folders exist."""
    return all((folder / name).exists() for name in names)


def resolve_inside(folder: Path, value: object, label: str, file: Path) -> Path:
    r"""Resolve an untrusted path and keep it inside the folder.

    Parameters
    ----------
    value : the path as read from `file`; `\` counts as `/`.
    label : name of the entry, for the error message.
    file : the file that contains the path, for the error message.

    Raises
    ------
    InputError
        If the value is not a relative path inside the folder.
    """
    name = value.replace("\\", "/") if isinstance(value, str) else "/"
    if not is_safe_relative_path(name) or not all(
        is_valid_file_name(part) for part in PurePosixPath(name).parts
    ):
        raise InputError(FILE_PATH_OUTSIDE, "{what} is not a path inside the folder.", file, what=label)
    return folder / PurePosixPath(name)


def is_valid_file_name(part: str) -> bool:
    """Return True if the text can be a file name.

    File names must be encodable in UTF-8 and have at most 255 bytes.

    JSON strings may hold lone surrogates and have any length.
    """
    try:
        return len(part.encode()) <= 255
    except UnicodeEncodeError:
        return False


def find_common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """Return the most frequent image size (width, height), in pixels.

    A sample of about eight images is read.

    A damaged, missing or differently sized image then invalidates only its own frame, not the scan.

    Raises
    ------
    InputError
        If no sampled image can be read.
    """
    sizes: Counter[tuple[int, int]] = Counter()
    fault: InputError | None = None
    paths = [path for path in paths if path.exists()] or paths
    for path in paths[:: max(1, len(paths) // 8)]:
        with_size = _read_size_or_error(path)
        if isinstance(with_size, InputError):
            fault = fault or with_size
        else:
            sizes[with_size] += 1
    if not sizes:
        raise fault or InputError(SCAN_FILES_MISSING, "no image files found.")
    return sizes.most_common(1)[0][0]


def _read_size_or_error(path: Path) -> tuple[int, int] | InputError:
    try:
        return read_image_size(path)
    except InputError as error:
        return error


def match_by_number(
    first: Sequence[Path], second: Sequence[Path], first_name: str, second_name: str, folder: Path
) -> tuple[list[tuple[Path, Path]], list[SkippedFrame]]:
    """Pair the files of two streams by the numbers in their names.

    Files with equal numbers form a pair. Files without a counterpart are skipped and reported. Names
    without common numbers are paired by position, which requires equal counts.

    Parameters
    ----------
    first, second : image files of both streams.
    first_name, second_name : names of the streams in messages.

    Raises
    ------
    InputError
        If a stream is empty, or the names share too few numbers and the counts differ.
    """
    for files, name in ((first, first_name), (second, second_name)):
        if not files:
            raise InputError(
                SCAN_FILES_MISSING, "no images in {name}; at least one is needed.", folder, name=name
            )
    candidates = [
        (left, right)
        for key in _PAIRING_KEYS
        if len(left := {key(path): path for path in first}) == len(first)
        and len(right := {key(path): path for path in second}) == len(second)
        and len(left.keys() & right.keys()) > _MIN_PAIRED_RATIO * min(len(left), len(right))
    ]
    if candidates:
        left, right = max(candidates, key=lambda sides: len(sides[0].keys() & sides[1].keys()))
        pairs = [(path, right[at]) for at, path in left.items() if at in right]
        alone = [
            SkippedFrame(
                path.stem, FRAME_IMAGE_MISSING.warning("{place} has no image with this number", place=name)
            )
            for side, other, name in ((left, right, second_name), (right, left, first_name))
            for at, path in side.items()
            if at not in other
        ]
        return pairs, alone
    if len(first) != len(second):
        raise InputError(
            SCAN_IMAGES_UNPAIRED,
            (
                "{first_name} has {first_count} images and {second_name} has {second_count}, and their "
                "names share too few numbers to pair them."
            ),
            folder,
            remedy="Give the two images of a frame the same number.",
            first_name=first_name,
            first_count=len(first),
            second_name=second_name,
            second_count=len(second),
        )
    return list(zip(first, second, strict=True)), []


def warn_if_paired_by_position(pairs: Sequence[tuple[Path, Path]], first_name: str, second_name: str) -> None:
    """Warn if `match_by_number` paired the files by position, for lack of common numbers."""
    agreeing = max(
        (sum(key(left) == key(right) for left, right in pairs) for key in _PAIRING_KEYS), default=0
    )
    if len(pairs) < 2 or agreeing > _MIN_PAIRED_RATIO * len(pairs):
        return
    emit(
        SCAN_IMAGES_UNPAIRED.warning(
            "the names in {first} and {second} share no numbers: the images are paired by position",
            remedy="if that is wrong, give the two images of a frame the same number",
            first=first_name,
            second=second_name,
        )
    )
