"""Depth maps for refinement, which needs all of them several times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, SkippedFrame

# Memory for depth maps that are kept after the first reading, bytes. The others are read again.
MAX_KEPT_BYTES = 400_000_000
_NOTHING = np.zeros((0, 0), np.float32)


class DepthFrames:
    """Filtered depth maps of the frames of a scan.

    Attributes
    ----------
    skipped : frames that cannot be read, known after the first pass.
    """

    def __init__(self, frames: Sequence[Frame], limits: DepthLimits) -> None:
        self._frames = frames
        self._limits = limits
        self._kept: dict[int, PosedDepth] = {}
        self._kept_bytes = 0
        self.skipped: dict[int, SkippedFrame] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def show_all(self, on_frame: Callable[[PosedDepth], Any], on_progress: Callable[[int], Any]) -> None:
        """Call `on_frame` with each depth map, in order; unreadable frames are skipped.

        Parameters
        ----------
        on_progress : called with the number of frames done.
        """
        threads = get_worker_count()
        read = partial(_read, frames=self._frames, limits=self._limits, kept=self._kept)
        indices = [i for i in range(len(self._frames)) if i not in self.skipped]
        for number, (index, view) in enumerate(
            map_ordered(read, indices, threads=threads, max_pending=threads + 2)
        ):
            if isinstance(view, SkippedFrame):
                self.skipped[index] = view
            else:
                self._keep(index, view)
                on_frame(view)
            on_progress(number + 1)

    def _keep(self, index: int, view: PosedDepth) -> None:
        if index not in self._kept and self._kept_bytes + view.surface.depth.nbytes <= MAX_KEPT_BYTES:
            # Normals are not needed any more, and take four times the memory of the depth.
            surface = replace(view.surface, normal=(_NOTHING,) * 3, obliqueness=_NOTHING)
            self._kept[index] = replace(view, surface=surface)
            self._kept_bytes += view.surface.depth.nbytes


def _read(
    index: int, frames: Sequence[Frame], limits: DepthLimits, kept: dict[int, PosedDepth]
) -> tuple[int, PosedDepth | SkippedFrame]:
    if index in kept:
        return index, kept[index]
    frame = frames[index]
    try:
        return index, read_posed_depth(frame, limits)
    except InputError as error:
        return index, SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
