"""Image sharpness as the variance of the Laplacian.

Blur lowers the variance, but so does a lack of texture. So the measure only ranks frames of one scan.

References
----------
Pech-Pacheco, Cristobal, Chamorro-Martinez and Fernandez-Valdivia, "Diatom autofocusing in brightfield
microscopy: a comparative study", 2000.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import ColorImage, Frame

# Maximum number of frames to read, evenly spaced; more would take too long for an interactive command.
_MAX_FRAMES = 150
# Pixels. Downscaling removes blur, so all images are compared at the same width.
_MEASURED_WIDTH_PX = 640


def find_least_sharp(frames: Sequence[Frame], ratio: float = 0.05) -> tuple[list[tuple[Frame, float]], int]:
    """Find the least sharp frames of a scan.

    Parameters
    ----------
    frames : frames with colour; unreadable images are skipped.
    ratio : ratio of the measured frames to return, rounded up.

    Returns
    -------
    Frames, worst first, each with the ratio of its sharpness to the median; and the number of measured
    frames. The list is empty if fewer than two frames were measured.
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, _MAX_FRAMES).round().astype(int))
    threads = get_worker_count()
    found = map_ordered(_measure_frame, [frames[i] for i in chosen], threads=threads, max_pending=2 * threads)
    measured = [(i, value) for i, value in zip(chosen.tolist(), found, strict=True) if value is not None]
    if len(measured) < 2:
        return [], len(measured)
    median = float(np.median([value for _, value in measured]))
    count = int(np.ceil(ratio * len(measured)))
    worst = sorted(measured, key=lambda one: one[1])[:count]
    return [(frames[i], value / median if median > 0 else 1.0) for i, value in worst], len(measured)


def _measure_frame(frame: Frame) -> float | None:
    try:
        color = read_color(frame)
    except InputError:
        return None
    return None if color is None else measure_sharpness(color)


def measure_sharpness(color: ColorImage) -> float:
    """Compute the sharpness of an image (h, w, 3): Laplacian variance in grey levels²."""
    import cv2

    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    if gray.shape[1] > _MEASURED_WIDTH_PX:
        size = (_MEASURED_WIDTH_PX, max(round(gray.shape[0] * _MEASURED_WIDTH_PX / gray.shape[1]), 1))
        gray = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(gray, cv2.CV_64F).var())
