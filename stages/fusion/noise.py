"""Depth noise of a scan, for stages that do not fuse."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.plan import limits_of, look
from scanloom.stages.fusion.survey import measured_noise, survey
from scanloom.stages.scans.model.prefetch import workers
from scanloom.stages.scans.model.scan import Frame

RESULT_VERSION = 2


def depth_noise(frames: Sequence[Frame], where: Path | None = None) -> float:
    """Estimate the depth noise at the median depth.

    The noise is the standard deviation of a frame's depth along the surface normal, in metres. The estimate
    compares neighbouring frames where they observe the same surface, so pose errors are included. The result
    is 0 if too few points overlap.

    Parameters
    ----------
    frames : with depth and poses; only a sample is read.
    where : folder of the scan, for messages.

    Raises
    ------
    InputError
        If no sampled frame can be used.
    """
    pairs = look(frames, limits_of(FuseParams()), where, workers())
    found = survey([view for view, _ in pairs], measured_noise(pairs))
    return found.noise.at(found.median)
