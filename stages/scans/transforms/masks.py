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
from scanloom.stages.files.images import decode_color, read_image_bytes
from scanloom.stages.scans.codes import SCAN_FILES_MISSING, SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.image_folders.image_files import extract_numbers, list_images
from scanloom.stages.scans.model.scan import Frame, PackedImage, Scan

_MAX_NAMED_FRAMES = 3
# JPEG artefacts: black is not exactly 0, so JPEG masks are thresholded at `_MASK_THRESHOLD`.
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_MASK_THRESHOLD = 128


def apply_masks(scan: Scan, folder: Path) -> Scan:
    """Assign the masks of a folder to the frames by name, or by the number in the name.

    Frames without a mask are reported as a warning.

    Raises
    ------
    InputError
        If the folder does not exist, holds several masks for a frame, or no mask for any frame.
    """
    if not folder.is_dir():
        raise InputError(SCAN_FILES_MISSING, "the mask folder does not exist.", folder)
    files = list_images(folder)
    by_stem, by_number = _group_by_name(files, by_number=False), _group_by_name(files, by_number=True)
    found = [_find_mask_file(frame, by_stem, by_number, folder) for frame in scan.frames]
    without = [frame.name for frame, path in zip(scan.frames, found, strict=True) if path is None]
    if len(without) == len(scan.frames):
        first = f", such as {without[0]}" if without else ""
        raise InputError(
            SCAN_FILES_MISSING,
            "none of its {files_count} images has the name or the number of a frame{first}.",
            folder,
            files_count=len(files),
            first=first,
        )
    frames = [
        replace(frame, mask=_load_mask(path) or frame.mask)
        for frame, path in zip(scan.frames, found, strict=True)
    ]
    if without:
        emit(
            SCAN_FRAMES_SKIPPED.warning(
                "{count} frames have no mask in {folder}/: {names}",
                count=len(without),
                folder=folder.name,
                names=", ".join(without[:_MAX_NAMED_FRAMES])
                + (" …" if len(without) > _MAX_NAMED_FRAMES else ""),
            )
        )
    return replace(scan, frames=frames, source_files=scan.source_files | frozenset(files))


def _load_mask(path: Path | None) -> Path | PackedImage | None:
    """Return the mask of a file; JPEG masks are thresholded when read."""
    return (
        PackedImage(path, "mask", partial(_threshold_mask, path))
        if path and path.suffix.lower() in _JPEG_SUFFIXES
        else path
    )


def _threshold_mask(path: Path) -> NDArray[np.uint8]:
    mask = decode_color(read_image_bytes(path), path).max(axis=2)
    return np.where(mask >= _MASK_THRESHOLD, 255, 0).astype(np.uint8)


def _group_by_name(files: list[Path], *, by_number: bool) -> dict[object, list[Path]]:
    groups: dict[object, list[Path]] = {}
    for path in files:
        stem = path.stem.removesuffix("_mask").removesuffix(".mask")
        groups.setdefault(extract_numbers(stem) if by_number else stem, []).append(path)
    return groups


def _find_mask_file(
    frame: Frame,
    by_stem: Mapping[object, list[Path]],
    by_number: Mapping[object, list[Path]],
    folder: Path,
) -> Path | None:
    """Find the mask file of a frame.

    By the name of its image or frame, else by the numbers in them.
    """
    file = frame.color.file if isinstance(frame.color, PackedImage) else frame.color
    names = [frame.name, *([file.stem, file.name] if isinstance(file, Path) else [])]
    for groups, keys in ((by_stem, names), (by_number, [extract_numbers(name) for name in names])):
        for key in keys:
            masks = groups.get(key, []) if key else []
            if len(masks) > 1:
                two = f"{masks[0].name} and {masks[1].name}"
                raise InputError(
                    SCAN_FILES_MISSING,
                    "frame {frame_name} has {masks_count} masks, such as {two}; one is needed.",
                    folder,
                    frame_name=frame.name,
                    masks_count=len(masks),
                    two=two,
                )
            if masks:
                return masks[0]
    return None
