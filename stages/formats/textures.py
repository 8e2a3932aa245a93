"""Texture images on disk."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.replacing import replacing


def beside(folder: Path, name: str) -> Path:
    """Return where a file that a mesh file names is looked for: in the mesh's own folder, nowhere else."""
    # Some names carry the folders of the machine they were written on, with slashes or backslashes.
    return folder / PureWindowsPath(PurePosixPath(name).name).name


def read_texture(path: Path) -> NDArray[np.uint8] | None:
    """Return the image as (h, w, 3) RGB or (h, w, 4) RGBA uint8, top row first; None if it cannot be read."""
    import cv2

    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
        image: Any = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except (OSError, ValueError, cv2.error):
        return None
    if image is None or image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        code = cv2.COLOR_GRAY2RGB
    else:
        code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), np.uint8)


def write_texture(path: Path, image: NDArray[np.uint8]) -> None:
    """Write an RGB or RGBA image as PNG, whole or not at all."""
    import cv2

    code = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image, code))
    with replacing(path) as part:
        part.write_bytes(encoded.tobytes())
