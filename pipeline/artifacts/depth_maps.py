"""Depth maps of a scan, as files of an RGB-D scan folder.

    scan.json                scan description, read back by stages.layouts as RGB-D frames
    color/000000.png         rectified left image, 8-bit RGB or grey
    depth/000000.png         16-bit depth; 0 is missing, the units per metre are in scan.json
    confidence/000000.png    8-bit confidence, 0 to 255; 1 for depth filled in by a monocular network
    mask/000000.png          8-bit foreground mask, 0 is background; only for scans with depth and masks
    points.ply               coloured points of all frames, subsampled

Frames are numbered instead of named after their source files: file names are not part of the cache key, so
the result must not depend on them.
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
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCALE_NOT_METRIC, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import DepthMap, depth_scan
from scanloom.stages.stereo.depth_completion import completed_scan
from scanloom.stages.stereo.views_depth import views_depth
from scanloom.stages.surface.formats.ply import write_ply_cloud

# Points in the cloud of a scan: dense enough to inspect, small enough for any viewer (15 bytes per point).
MAX_POINTS = 1_000_000
_MAX_UINT16 = np.iinfo(np.uint16).max


@dataclass(frozen=True)
class DepthMaps(Artifact):
    """RGB-D frames written by the stage `depth`."""

    NAME = "frames"

    def load(self) -> Scan:
        """Load the frames as a scan."""
        with collecting(forward=False) as diagnostics:
            scan = read_scan(self.folder, complete=False)
        # The reader of the source scan has reported the missing scale.
        emit(*(one for one in diagnostics if one.code != SCALE_NOT_METRIC.name))
        # Messages must not name the cache folder.
        return replace(scan, folder=None)


@dataclass(frozen=True, eq=False)
class _WrittenFrame:
    frame: Frame
    points: NDArray[np.float32]
    colors: ColorImage
    metrics: dict[str, Any]


def choose_matcher(scan: Scan) -> Callable[..., Any]:
    """Choose the depth function: stereo matching, multi-view matching, or depth completion."""
    if scan.is_views:
        return views_depth
    return depth_scan if scan.is_stereo else completed_scan


def write_depth_maps(
    folder: Path, measured: Iterable[tuple[Frame, DepthMap | SkippedFrame]], scan: Scan
) -> dict[str, Any]:
    """Write depth maps as they are computed, in threads, and return metrics.

    Parameters
    ----------
    folder : empty folder.
    measured : pairs of a frame and its result, as `scanloom.stages.stereo.depth.depth_scan` yields them.
    scan : scan that the frames belong to.

    Raises
    ------
    InputError
        If no frame has a depth map.
    """
    for name in ("color", "depth", "confidence"):
        (folder / name).mkdir()
    skipped: list[SkippedFrame] = []
    count = len(scan.frames)
    max_points = max(1, MAX_POINTS // max(1, count))

    def iterate_usable() -> Iterator[tuple[int, Frame, DepthMap]]:
        for number, (frame, result) in enumerate(measured):
            if isinstance(result, SkippedFrame):
                skipped.append(result)
            else:
                yield number, frame, result

    def write(item: tuple[int, Frame, DepthMap]) -> _WrittenFrame:
        return _write(folder, *item, max_points)

    threads = get_thread_count()
    written = list(map_ordered(write, iterate_usable(), threads=threads, max_pending=threads + 1))
    if not written:
        first = f" The first, {skipped[0].name}: {skipped[0].reason}" if skipped else ""
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            "depth could not be computed for any of {count} frames.{first}",
            count=count,
            first=first,
        )
    write_scan_json(folder, [one.frame for one in written], up=scan.up, is_metric=scan.is_metric)
    points = np.concatenate([one.points for one in written])
    write_ply_cloud(folder / "points.ply", points, np.concatenate([one.colors for one in written]))
    return {
        "frames_used": len(written),
        "frames_skipped": [one.to_dict() for one in skipped],
        **_average_metrics([one.metrics for one in written]),
        "points": len(points),
    }


def _write(folder: Path, number: int, frame: Frame, result: DepthMap, max_points: int) -> _WrittenFrame:
    scale = choose_depth_scale(result.max_depth)
    raw = np.rint(result.depth * np.float32(scale))
    raw[raw > _MAX_UINT16] = 0
    name = f"{number:06d}.png"
    # A separate colour camera keeps its full photo; `result.color` only has colours at depth resolution.
    photo = frame.color if isinstance(frame.color, np.ndarray) else result.color
    _write_png(folder / "color" / name, _to_grey_or_bgr(photo))
    _write_png(folder / "depth" / name, raw.astype(np.uint16))
    _write_png(folder / "confidence" / name, result.confidence)
    if isinstance(frame.mask, np.ndarray):
        (folder / "mask").mkdir(exist_ok=True)
        _write_png(folder / "mask" / name, frame.mask)
        frame = replace(frame, mask=folder / "mask" / name)
    if result.filled is not None:
        # The confidence map lets users exclude filled-in depth: scan.min_confidence=2.
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
    return _WrittenFrame(
        kept, *sample_point_cloud(result.depth, result.color, frame, max_points), result.to_dict()
    )


def choose_depth_scale(max_depth: float) -> float:
    """Choose the depth units per metre that use the full 16-bit range.

    `max_depth` is the largest depth to encode, in metres.
    """
    scale = _MAX_UINT16 / max_depth
    # Round to an integer if the loss is at most 1 %: other programs expect an integer scale.
    return float(math.floor(scale)) if scale >= 100 else scale


def _write_png(path: Path, image: NDArray[Any]) -> None:
    import cv2

    # Fast compression: higher levels take longer than the matching and save a tenth of the size.
    quick = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    # Encode in memory: cv2.imwrite only returns False on a full disk, write_bytes raises.
    _, data = cv2.imencode(".png", image, quick)
    path.write_bytes(data.tobytes())


def _to_grey_or_bgr(color: ColorImage) -> ColorImage:
    """Convert an RGB image for PNG encoding.

    The result has one channel if all channels are equal, else BGR.
    """
    grey = color[:, :, 0]
    is_grey = np.array_equal(grey, color[:, :, 1]) and np.array_equal(grey, color[:, :, 2])
    return grey if is_grey else color[:, :, ::-1]


def sample_point_cloud(
    depth: DepthImage, color: ColorImage, frame: Frame, max_points: int
) -> tuple[NDArray[np.float32], ColorImage]:
    """Unproject an evenly spaced sample of a depth map to world coordinates.

    Parameters
    ----------
    depth : (h, w) depth in metres, 0 is missing.
    color : (h, w, 3) colours.
    frame : camera and pose; without a pose, points stay in camera coordinates.
    max_points : maximum number of points.

    Returns
    -------
    Points (n, 3) in metres and colours (n, 3).
    """
    valid = np.flatnonzero(depth)
    chosen = valid[:: max(1, math.ceil(len(valid) / max_points))]
    rows, columns = np.divmod(chosen, depth.shape[1])
    z = depth.ravel()[chosen].astype(np.float64)
    camera = frame.camera
    points = np.stack([(columns - camera.cx) * z / camera.fx, (rows - camera.cy) * z / camera.fy, z], axis=1)
    if frame.world_from_camera is not None:
        points = points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
    return points.astype(np.float32), color.reshape(-1, 3)[chosen]


def _average_metrics(metrics: list[dict[str, Any]]) -> dict[str, Any]:
    """Aggregate per-frame metrics: the common value if all frames agree, else the mean."""
    summary = {}
    for name in metrics[0]:
        values = [one[name] for one in metrics if one[name] is not None]
        equal = all(value == values[0] for value in values[1:])
        summary[name] = None if not values else values[0] if equal else float(np.mean(values))
    return summary
