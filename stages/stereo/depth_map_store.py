"""Disk store for depth maps of many views.

Thousands of maps would not fit in memory.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import MACHINE_DISK_FAILED
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.numpy_files import map_array
from scanloom.stages.scans.model.scan import DepthImage


class DepthMapStore:
    """Files with depth and confidence maps by view index.

    The caller removes the folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)

    def store(self, at: int, depth: DepthImage, confidence: NDArray[np.uint8]) -> None:
        """Store the maps of a view.

        Raises
        ------
        StageError
            If the files cannot be written, such as on a full disk.
        """
        try:
            np.save(self._folder / f"depth{at}.npy", depth, allow_pickle=False)
            np.save(self._folder / f"confidence{at}.npy", confidence, allow_pickle=False)
        except OSError as error:
            raise StageError(
                MACHINE_DISK_FAILED,
                "temporary depth maps cannot be written to {folder} ({detail})",
                remedy="free disk space, or set TMPDIR to another folder.",
                folder=self._folder,
                detail=error.strerror or error,
            ) from error

    def load_depth(self, at: int) -> DepthImage:
        """Return the stored depth of a view, (h, w) float32 metres."""
        return np.array(map_array(self._folder / f"depth{at}.npy"), np.float32)

    def load_confidence(self, at: int) -> NDArray[np.uint8]:
        """Return the stored confidence of a view, (h, w) uint8."""
        return np.array(map_array(self._folder / f"confidence{at}.npy"), np.uint8)
