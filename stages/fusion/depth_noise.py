"""Depth noise of a scan, for stages that do not fuse."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.fusion.fusion_plan import make_depth_limits, sample_depth_frames
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.scene_statistics import (
    SceneStatistics,
    compute_scene_statistics,
    estimate_noise,
)
from scanloom.stages.scans.model.prefetch import get_worker_count
from scanloom.stages.scans.model.scan import Frame

RESULT_VERSION = 2


def measure_depth_noise(frames: Sequence[Frame], folder: Path | None = None) -> SceneStatistics:
    """Measure the depth noise and other statistics of a scan.

    The noise compares neighbouring frames where they observe the same surface, so pose errors are included.
    It is 0 if too few points overlap.

    Parameters
    ----------
    frames : with depth and poses; only a sample is read.
    folder : folder of the scan, for messages.

    Raises
    ------
    InputError
        If no sampled frame can be used.
    """
    pairs = sample_depth_frames(frames, make_depth_limits(FuseParams()), folder, get_worker_count())
    return compute_scene_statistics([view for view, _ in pairs], estimate_noise(pairs))


def estimate_depth_noise(frames: Sequence[Frame], folder: Path | None = None) -> float:
    """Estimate the depth noise at the median depth.

    The noise is the standard deviation of a frame's depth along the surface normal, in metres. The result is
    0 if too few points overlap. Parameters and errors as in `measure_depth_noise`.
    """
    found = measure_depth_noise(frames, folder)
    return found.noise.compute_deviation(found.median_depth)
