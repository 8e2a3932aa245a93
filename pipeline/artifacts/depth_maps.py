"""Depth maps of a scan as files: an RGB-D scan folder of our own layout, and a coloured point cloud.

    scan.json                what stages.layouts reads back as RGB-D frames
    color/000000.png         the rectified left image, 8-bit RGB or grey
    depth/000000.png         16-bit; the units of a metre are in scan.json, 0 is missing
    confidence/000000.png    8-bit, 0 to 255; 1 where a network of single images filled depth in
    mask/000000.png          8-bit, 0 where nothing is; of a scan with depth and masks
    points.ply               coloured points of all frames, thinned out

Frames are numbered, not named after their files: names decide nothing, so a result must not hold them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.stage import Artifact
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import threads_to_use
from scanloom.stages.scans.read import read_scan
from scanloom.stages.stereo.completed_scan import completed_scan
from scanloom.stages.stereo.depth import DepthMap, depth_scan
from scanloom.stages.stereo.views_depth import views_depth
from scanloom.stages.surface.formats.ply import write_ply_cloud

# Points in the cloud of a whole scan: enough to judge it by, and quick to open anywhere (15 bytes each).
MAX_POINTS = 1_000_000
_LARGEST = np.iinfo(np.uint16).max


@dataclass(frozen=True)
class DepthMaps(Artifact):
    """RGB-D frames that the stage `depth` has written."""

    NAME = "frames"

    def load(self) -> Scan:
        """Load the frames as a scan."""
        # No message should name the folder of the cache.
        return replace(read_scan(self.folder, complete=False), folder=None)


@dataclass(frozen=True, eq=False)
class _Written:
    frame: Frame
    points: NDArray[np.float32]
    colors: ColorImage
    figures: dict[str, Any]


def choose_matcher(scan: Scan) -> Callable[..., Any]:
    """Choose the function that computes depth: from stereo pairs, from posed views, or by completion."""
    if scan.is_views:
        return views_depth
    return depth_scan if scan.is_stereo else completed_scan


def write_depth_maps(
    folder: Path, measured: Iterable[tuple[Frame, DepthMap | SkippedFrame]], scan: Scan
) -> dict[str, Any]:
    """Write the frames that come, a few ahead and in threads, and return figures.

    Parameters
    ----------
    folder : an empty folder.
    measured : as `scanloom.stages.stereo.depth.depth_scan` yields them.
    scan : whose frames they are.

    Raises
    ------
    InputError
        If no frame has a depth map.
    """
    for name in ("color", "depth", "confidence"):
        (folder / name).mkdir()
    skipped: list[SkippedFrame] = []
    count = len(scan.frames)
    budget = max(1, MAX_POINTS // max(1, count))

    def usable() -> Iterator[tuple[int, Frame, DepthMap]]:
        for number, (frame, result) in enumerate(measured):
            if isinstance(result, SkippedFrame):
                skipped.append(result)
            else:
                yield number, frame, result

    def write(item: tuple[int, Frame, DepthMap]) -> _Written:
        return _write(folder, *item, budget)

    threads = threads_to_use()
    written = list(read_ahead(write, usable(), threads=threads, ahead=threads + 1))
    if not written:
        first = f" The first, {skipped[0].name}: {skipped[0].reason}" if skipped else ""
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            "none of the {count} pairs can be used.{first}",
            count=count,
            first=first,
        )
    write_scan_json(folder, [one.frame for one in written], up=scan.up, is_metric=scan.is_metric)
    points = np.concatenate([one.points for one in written])
    write_ply_cloud(folder / "points.ply", points, np.concatenate([one.colors for one in written]))
    return {
        "frames_used": len(written),
        "frames_skipped": [one.figures() for one in skipped],
        **_summary([one.figures for one in written]),
        "points": len(points),
    }


def _write(folder: Path, number: int, frame: Frame, result: DepthMap, budget: int) -> _Written:
    scale = depth_scale(result.max_depth)
    raw = np.rint(result.depth * np.float32(scale))
    raw[raw > _LARGEST] = 0
    name = f"{number:06d}.png"
    # A photo of a camera of its own is kept as it is; depth has but the colours it needs.
    photo = frame.color if isinstance(frame.color, np.ndarray) else result.color
    _write_png(folder / "color" / name, _grey_or_bgr(photo))
    _write_png(folder / "depth" / name, raw.astype(np.uint16))
    _write_png(folder / "confidence" / name, result.confidence)
    if isinstance(frame.mask, np.ndarray):
        (folder / "mask").mkdir(exist_ok=True)
        _write_png(folder / "mask" / name, frame.mask)
        frame = replace(frame, mask=folder / "mask" / name)
    if result.filled is not None:
        # So that what was filled in can be left out: scan.least_confidence=2.
        frame = replace(frame, confidence=folder / "confidence" / name)
    kept = replace(
        frame,
        name=f"{number:06d}",
        color=folder / "color" / name,
        depth=folder / "depth" / name,
        depth_scale=scale,
        depth_missing=(),
        timestamp=None,
    )
    return _Written(kept, *cloud_of(result.depth, result.color, frame, budget), result.figures())


def depth_scale(max_depth: float) -> float:
    """Return the units of a metre that make the most of 16 bits for depths up to `max_depth` metres."""
    scale = _LARGEST / max_depth
    # A whole number where that costs nothing: people read it, and other programs ask for it.
    return float(math.floor(scale)) if scale >= 100 else scale


def _write_png(path: Path, image: NDArray[Any]) -> None:
    import cv2

    # Quick rather than small: at higher levels this takes longer than matching does, for a tenth of the size.
    quick = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    # Encoded in memory and written here, so that a full disk is an error and not a False nobody looks at.
    _, data = cv2.imencode(".png", image, quick)
    path.write_bytes(data.tobytes())


def _grey_or_bgr(color: ColorImage) -> ColorImage:
    """Return the image as PNG writing wants it; one channel is enough for that of a grey camera."""
    grey = color[:, :, 0]
    is_grey = np.array_equal(grey, color[:, :, 1]) and np.array_equal(grey, color[:, :, 2])
    return grey if is_grey else color[:, :, ::-1]


def cloud_of(
    depth: DepthImage, color: ColorImage, frame: Frame, budget: int
) -> tuple[NDArray[np.float32], ColorImage]:
    """Return at most `budget` of a frame's points in the world, evenly taken from its pixels."""
    valid = np.flatnonzero(depth)
    chosen = valid[:: max(1, math.ceil(len(valid) / budget))]
    rows, columns = np.divmod(chosen, depth.shape[1])
    z = depth.ravel()[chosen].astype(np.float64)
    camera = frame.camera
    points = np.stack([(columns - camera.cx) * z / camera.fx, (rows - camera.cy) * z / camera.fy, z], axis=1)
    if frame.world_from_camera is not None:
        points = points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
    return points.astype(np.float32), color.reshape(-1, 3)[chosen]


def _summary(figures: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean of what is measured for each frame; what is equal in all is said once."""
    summary = {}
    for name in figures[0]:
        values = [one[name] for one in figures if one[name] is not None]
        equal = all(value == values[0] for value in values[1:])
        summary[name] = None if not values else values[0] if equal else float(np.mean(values))
    return summary
