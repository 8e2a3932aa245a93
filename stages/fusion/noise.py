"""How exact the depth of a scan is, for stages that ask for nothing else of fusion."""

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
    """Return the standard deviation of a frame's depth at the median depth, along the surface's normal, m.

    It is what neighbouring frames differ by where they see the same, and so also holds what their poses are
    off; 0 where too few of them do.

    Parameters
    ----------
    frames : with depth and poses; a few of them are read.
    where : the scan's folder, for messages.

    Raises
    ------
    InputError
        If none of the frames looked at can be used.
    """
    pairs = look(frames, limits_of(FuseParams()), where, workers())
    found = survey([view for view, _ in pairs], measured_noise(pairs))
    return found.noise.at(found.median)
