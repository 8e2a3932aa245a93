"""Masks from a folder: one 8-bit image per frame, 0 outside the scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import decode_color, file_bytes
from scanloom.stages.scans.codes import SCAN_FILES_MISSING, SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.image_folders.image_files import images, numbers
from scanloom.stages.scans.model.scan import Frame, Packed, Scan

_NAMED = 3
# JPEG artefacts: black is not exactly 0, so JPEG masks are thresholded at `_HALF`.
_JPEG = (".jpg", ".jpeg")
_HALF = 128


def with_masks(scan: Scan, place: Path) -> Scan:
    """Assign the masks of a folder to the frames by name, or by the number in the name.

    Frames without a mask are reported as a warning.

    Raises
    ------
    InputError
        If the folder does not exist, holds several masks for a frame, or no mask for any frame.
    """
    if not place.is_dir():
        raise InputError(SCAN_FILES_MISSING, "the mask folder does not exist.", place)
    files = images(place)
    by_stem, by_number = _grouped(files, by_number=False), _grouped(files, by_number=True)
    found = [_of_frame(frame, by_stem, by_number, place) for frame in scan.frames]
    without = [frame.name for frame, path in zip(scan.frames, found, strict=True) if path is None]
    if len(without) == len(scan.frames):
        first = f", such as {without[0]}" if without else ""
        raise InputError(
            SCAN_FILES_MISSING,
            "none of its {files_count} images has the name or the number of a frame{first}.",
            place,
            files_count=len(files),
            first=first,
        )
    frames = [
        replace(frame, mask=_mask(path) or frame.mask) for frame, path in zip(scan.frames, found, strict=True)
    ]
    if without:
        emit(
            SCAN_FRAMES_SKIPPED.warning(
                "{count} frames have no mask in {folder}/: {names}",
                count=len(without),
                folder=place.name,
                names=", ".join(without[:_NAMED]) + (" …" if len(without) > _NAMED else ""),
            )
        )
    return replace(scan, frames=frames, read_from=scan.read_from | frozenset(files))


def _mask(path: Path | None) -> Path | Packed | None:
    """Return the mask of a file; JPEG masks are thresholded when read."""
    return Packed(path, "mask", partial(_halved, path)) if path and path.suffix.lower() in _JPEG else path


def _halved(path: Path) -> NDArray[np.uint8]:
    mask = decode_color(file_bytes(path), path).max(axis=2)
    return np.where(mask >= _HALF, 255, 0).astype(np.uint8)


def _grouped(files: list[Path], *, by_number: bool) -> dict[object, list[Path]]:
    groups: dict[object, list[Path]] = {}
    for path in files:
        stem = path.stem.removesuffix("_mask").removesuffix(".mask")
        groups.setdefault(numbers(stem) if by_number else stem, []).append(path)
    return groups


def _of_frame(
    frame: Frame,
    by_stem: Mapping[object, list[Path]],
    by_number: Mapping[object, list[Path]],
    place: Path,
) -> Path | None:
    """Find the mask file of a frame.

    By the name of its image or frame, else by the numbers in them.
    """
    file = frame.color.file if isinstance(frame.color, Packed) else frame.color
    names = [frame.name, *([file.stem, file.name] if isinstance(file, Path) else [])]
    for groups, keys in ((by_stem, names), (by_number, [numbers(name) for name in names])):
        for key in keys:
            masks = groups.get(key, []) if key else []
            if len(masks) > 1:
                two = f"{masks[0].name} and {masks[1].name}"
                raise InputError(
                    SCAN_FILES_MISSING,
                    "frame {frame_name} has {masks_count} masks, such as {two}; one is needed.",
                    place,
                    frame_name=frame.name,
                    masks_count=len(masks),
                    two=two,
                )
            if masks:
                return masks[0]
    return None
