"""Find the images of a folder, order them by number and pair two streams."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_PATH_OUTSIDE, FILE_UNREADABLE
from scanloom.stages.files.images import image_size
from scanloom.stages.files.inside import leads_inside
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_IMAGES_UNPAIRED,
)
from scanloom.stages.scans.model.scan import SkippedFrame

IMAGES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
DEPTHS = (*IMAGES, ".npy", ".pfm", ".exr")
# The folders of a stream, under the names that data sets and exports use.
COLOR_FOLDERS = ("color", "rgb", "image", "images", "colors", "mono", "gray", "grey")
DEPTH_FOLDERS = ("depth", "depths", "depth_images")
_LONGEST_NAME = 255
# Fewer pairs among the frames of the smaller side are a coincidence of numbers.
_LEAST_PAIRED = 0.1


def numbers(name: str) -> tuple[int, ...]:
    """Return the whole numbers in a file name, so that 10.png sorts after 2.png."""
    # No file system takes longer names, and Python no numbers of thousands of digits.
    return tuple(int(digits) for digits in re.findall(r"\d+", name[:_LONGEST_NAME]))


# What two names of one moment share: all numbers (0001-0002), the last (cam0_0001 and cam1_0001), or
# the first (frame 7 at two times).
_KEYS: tuple[Callable[[Path], object], ...] = (
    lambda path: numbers(path.stem) or path.stem,
    lambda path: (numbers(path.stem) or (path.stem,))[-1],
    lambda path: (numbers(path.stem) or (path.stem,))[0],
)


def images(folder: Path, suffixes: Sequence[str] = IMAGES) -> list[Path]:
    """Return the image files of a folder, ordered by the numbers in their names."""
    try:
        found = [p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".")]
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the folder cannot be listed ({strerror}).", folder, strerror=error.strerror
        ) from error
    return sorted(found, key=lambda path: (numbers(path.stem), path.name))


def first_existing(folder: Path, *names: str) -> Path | None:
    """Return the first of several names that is there, or None."""
    return next((folder / name for name in names if (folder / name).exists()), None)


def has(folder: Path, *names: str) -> bool:
    """Say whether all of these files or folders are there."""
    return all((folder / name).exists() for name in names)


def inside(folder: Path, value: object, what: str, file: Path) -> Path:
    """Return the path that a file names by `what`: the file may come from anywhere, so it stays inside.

    Raises
    ------
    InputError
        If it is no relative path, or leaves the folder.
    """
    name = value.replace("\\", "/") if isinstance(value, str) else "/"
    if not leads_inside(name) or not all(is_name(part) for part in PurePosixPath(name).parts):
        raise InputError(FILE_PATH_OUTSIDE, "{what} is not a path inside the folder.", file, what=what)
    return folder / PurePosixPath(name)


def is_name(part: str) -> bool:
    """Say whether a file can be called so: JSON can hold half a character, and any length."""
    try:
        return len(part.encode()) <= 255
    except UnicodeEncodeError:
        return False


def common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """Return the (width, height) in pixels that most of a few images of a stream have.

    A damaged, odd or missing image then costs its own frame and not the scan.

    Raises
    ------
    InputError
        If none of them can be read.
    """
    sizes: Counter[tuple[int, int]] = Counter()
    fault: InputError | None = None
    paths = [path for path in paths if path.exists()] or paths
    for path in paths[:: max(1, len(paths) // 8)]:
        with_size = _size_or_fault(path)
        if isinstance(with_size, InputError):
            fault = fault or with_size
        else:
            sizes[with_size] += 1
    if not sizes:
        raise fault or InputError(SCAN_FILES_MISSING, "there are no images.")
    return sizes.most_common(1)[0][0]


def _size_or_fault(path: Path) -> tuple[int, int] | InputError:
    try:
        return image_size(path)
    except InputError as error:
        return error


def pair(
    first: Sequence[Path], second: Sequence[Path], first_name: str, second_name: str, folder: Path
) -> tuple[list[tuple[Path, Path]], list[SkippedFrame]]:
    """Pair the files of two streams by the numbers in their names.

    The same numbers on both sides are a pair; a file whose number the other side lacks is left out and
    reported. Names without such numbers are paired in order, but only when the counts are equal.

    Raises
    ------
    InputError
        If a side is empty, or the counts differ and the names do not tell what belongs together.
    """
    for files, name in ((first, first_name), (second, second_name)):
        if not files:
            raise InputError(
                SCAN_FILES_MISSING, "no images in {name}; at least one is needed.", folder, name=name
            )
    candidates = [
        (left, right)
        for key in _KEYS
        if len(left := {key(path): path for path in first}) == len(first)
        and len(right := {key(path): path for path in second}) == len(second)
        and len(left.keys() & right.keys()) > _LEAST_PAIRED * min(len(left), len(right))
    ]
    if candidates:
        left, right = max(candidates, key=lambda sides: len(sides[0].keys() & sides[1].keys()))
        pairs = [(path, right[at]) for at, path in left.items() if at in right]
        alone = [
            SkippedFrame(
                path.stem, FRAME_IMAGE_MISSING.warning("{place} has no image of this number", place=name)
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
                "{first_name} holds {first_count} images and {second_name} {second_count}, "
                "and their names share too few numbers to pair them by."
            ),
            folder,
            remedy="Name the two images of a moment alike.",
            first_name=first_name,
            first_count=len(first),
            second_name=second_name,
            second_count=len(second),
        )
    return list(zip(first, second, strict=True)), []


def check_order(pairs: Sequence[tuple[Path, Path]], first_name: str, second_name: str) -> None:
    """Warn if `pair` had only the order of the names to go by."""
    agreeing = max((sum(key(left) == key(right) for left, right in pairs) for key in _KEYS), default=0)
    if len(pairs) < 2 or agreeing > _LEAST_PAIRED * len(pairs):
        return
    emit(
        SCAN_IMAGES_UNPAIRED.warning(
            "the names in {first} and {second} share no numbers: they are paired in their order",
            remedy="name the two images of a moment alike if that is wrong",
            first=first_name,
            second=second_name,
        )
    )
