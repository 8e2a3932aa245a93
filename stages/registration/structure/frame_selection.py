"""Selection of the frames of a video that structure from motion uses.

Frames are spaced evenly by the motion of the image, and each is the sharpest of its neighbourhood. Neighbours
then overlap, and few frames show the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.registration.structure.codes import STRUCTURE_VIDEO_TOO_FAST
from scanloom.stages.registration.structure.params import StructureParams
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.scans.model.sharpness import measure_sharpness

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import StructureKeywords

RESULT_VERSION = 1

# Motion between selected frames, in diagonals of the image. Orbits around an object rotate the camera by
# about 5°, which the farther background shows.
_MOTION_STEP = 0.08
# Motion at which neighbours no longer overlap by half.
_MAX_MOTION_STEP = 0.4
# Minimum number of frames if the image hardly moves: an object that turns before a plain background.
_MIN_FRAMES = 40
# Ratio of the distance between selected frames in which the sharpest is searched, on each side.
_SEARCH_RATIO = 0.35
# Image width in pixels, and number of points, for the measurement of motion.
_TRACKED_WIDTH_PX, _TRACKED_POINTS = 320, 200
# Quantile of the motion of points: before a static background, only the points on the object move.
_MOTION_QUANTILE = 0.75
# Motion in diagonals if too few points are found again: a step, because the camera turned fast or shook.
_LOST_MOTION, _MIN_TRACKED = _MOTION_STEP, 12
# Ratio of the stated frames that a complete video has: headers of some containers estimate the number.
_COMPLETE_RATIO = 0.95
_JPEG_QUALITY = 97


@dataclass(frozen=True, eq=False)
class _Preview:
    """Small grey image (h, w) of a frame, and its sharpness."""

    grey: NDArray[np.uint8]
    sharpness: float


def extract_frames(
    scan: Scan,
    folder: Path | str,
    params: StructureParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[StructureKeywords],
) -> Scan:
    """Extract sharp frames of a video that overlap, as photos.

    Parameters
    ----------
    scan : video, read by `read_scan(…, complete=False)`.
    folder : folder for the photos, created if needed. They are JPEG files named by their index in the video.
    params, changes : see `StructureParams`; `max_frames` limits the number of photos.
    progress : called with the number of finished steps and of all steps.

    Returns
    -------
    The selected frames with their photos.

    Raises
    ------
    InputError
        If no frame can be decoded.
    """
    import cv2

    params = resolve(StructureParams, params, changes)
    folder = Path(folder)
    with collecting() as diagnostics:
        total = 2 * len(scan.frames)
        selected = select_frames(scan, params.max_frames, lambda done: progress(done, total))
        folder.mkdir(parents=True, exist_ok=True)
        frames = []
        for index in selected:
            frame = scan.frames[index]
            color = read_color(frame)
            assert color is not None
            quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
            # Encoded in memory: cv2.imwrite only returns False on a full disk, write_bytes raises.
            _, data = cv2.imencode(".jpg", color[:, :, ::-1], quality)
            path = folder / f"{frame.name}.jpg"
            path.write_bytes(data.tobytes())
            frames.append(replace(frame, color=path))
            progress(len(scan.frames) + index + 1, total)
    progress(total, total)
    return replace(scan, frames=frames, diagnostics=(*scan.diagnostics, *diagnostics))


def select_frames(scan: Scan, max_count: int, report: Callable[[int], object]) -> list[int]:
    """Return the indices of the selected frames of a video in order.

    Parameters
    ----------
    max_count : maximum number of frames.
    report : called with the number of measured frames.
    """
    sharpness: list[float] = []
    travelled = [0.0]
    before: NDArray[np.uint8] | None = None
    for preview in _iterate_previews(scan):
        if before is not None:
            travelled.append(travelled[-1] + _measure_motion(before, preview.grey))
        before = preview.grey
        sharpness.append(preview.sharpness)
        report(len(sharpness))
    return _choose_frames(np.array(travelled), np.array(sharpness), max_count, scan)


def _iterate_previews(scan: Scan) -> Iterator[_Preview]:
    """Yield previews up to the end of the video, or to its first damage."""
    threads = get_worker_count()
    previews = map_ordered(_make_preview, scan.frames, threads=threads, max_pending=2 * threads)
    for count, preview in enumerate(previews):
        if isinstance(preview, InputError):
            if count == 0:
                raise preview
            if count < _COMPLETE_RATIO * len(scan.frames):
                emit(
                    RECORDING_DAMAGED.warning(
                        "the video ends or is damaged after {ratio:.0%} of its stated length; only the part "
                        "before is used",
                        scan.folder,
                        ratio=count / len(scan.frames),
                    )
                )
            return
        yield preview


def _make_preview(frame: Frame) -> _Preview | InputError:
    import cv2

    try:
        color = read_color(frame)
    except InputError as error:
        return error
    assert color is not None
    height, width = color.shape[:2]
    size = min(width, _TRACKED_WIDTH_PX), max(1, round(height * min(1.0, _TRACKED_WIDTH_PX / width)))
    small = cv2.resize(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA)
    return _Preview(np.asarray(small, np.uint8), measure_sharpness(color))


def _measure_motion(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """Measure the motion of points from one image to the next, in diagonals."""
    import cv2

    points = cv2.goodFeaturesToTrack(first, _TRACKED_POINTS, 0.01, 5)
    if points is None or len(points) < _MIN_TRACKED:
        return 0.0
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, second, points, np.empty_like(points))
    returned, found_again, _ = cv2.calcOpticalFlowPyrLK(second, first, moved, np.empty_like(points))
    agrees = np.linalg.norm(returned - points, axis=2).ravel() < 1.0
    kept = (found.ravel() > 0) & (found_again.ravel() > 0) & agrees
    if np.count_nonzero(kept) < _MIN_TRACKED:
        return _LOST_MOTION
    motion = np.linalg.norm(moved - points, axis=2).ravel()[kept]
    return float(np.quantile(motion, _MOTION_QUANTILE)) / math.hypot(*first.shape)


def _choose_frames(
    travelled: NDArray[np.float64], sharpness: NDArray[np.float64], max_count: int, scan: Scan
) -> list[int]:
    """Choose the sharpest frame near each of several positions that are evenly spaced by motion.

    Parameters
    ----------
    travelled : (n,) motion from the first frame to each frame, in diagonals.
    sharpness : (n,) sharpness of the frames.
    """
    count = len(sharpness)
    # Time counts a little, so that positions in a static part of a video are spaced by time.
    wanted = max(_MIN_FRAMES, math.ceil(travelled[-1] / _MOTION_STEP) + 1)
    number = min(wanted, max_count, count)
    if number == count:
        return list(range(count))
    if travelled[-1] / number > _MAX_MOTION_STEP:
        emit(
            STRUCTURE_VIDEO_TOO_FAST.warning(
                "the camera moves far for {number} frames, so neighbouring frames may not overlap",
                scan.folder,
                remedy="set structure.max_frames={more}, or record a part of the scene.",
                number=number,
                more=2 * max_count,
            )
        )
    position = travelled + 1e-3 * max(travelled[-1], 1.0) * np.arange(count) / count
    step = position[-1] / (number - 1)
    chosen = set()
    for target in range(number):
        first, last = np.searchsorted(
            position, ((target - _SEARCH_RATIO) * step, (target + _SEARCH_RATIO) * step)
        )
        if first < last:
            chosen.add(int(first + np.argmax(sharpness[first:last])))
        else:
            # The image moves by more than the distance between positions.
            chosen.add(min(int(first), count - 1))
    return sorted(chosen)
