"""Masks of photos in a folder next to them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_IMAGE_FORMAT
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.scans.image_folders.image_files import MASK_FOLDERS
from scanloom.stages.scans.model.scan import PackedImage

# Threshold of a mask pixel; masks saved as JPEG are grey where they were black.
_MASK_THRESHOLD = 128


def find_photo_mask(folder: Path, color: Path) -> PackedImage | None:
    """Return the mask of a photo, named like IMG_1.png or IMG_1_mask.JPG; None if there is none.

    Parameters
    ----------
    folder : folder that contains masks/ or mask/.
    """
    places = [folder / name for name in MASK_FOLDERS if (folder / name).is_dir()]
    for stem in (color.stem, f"{color.stem}_mask", f"{color.stem}.mask", color.name):
        for found in (path for place in places for path in place.glob("*") if path.stem == stem):
            return PackedImage(found, "mask", partial(_read_mask, found))
    return None


def _read_mask(path: Path) -> NDArray[np.uint8]:
    mask = read_stored_image(path)
    if mask.dtype != np.uint8:
        raise InputError(FILE_IMAGE_FORMAT, "an 8-bit mask is expected.", path)
    grey = mask if mask.ndim == 2 else mask[:, :, :3].max(axis=2)
    return np.asarray(np.where(grey >= _MASK_THRESHOLD, 255, 0), np.uint8)
