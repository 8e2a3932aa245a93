"""The focal length of a camera that stands still before a sheet that turns: with it most marks agree.

With a wrong one a plane is seen as another, and what turned on it as if it had been drawn out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.registration.focal import Focal
from scanloom.stages.registration.looks import read_looks
from scanloom.stages.registration.still import backdrop_of
from scanloom.stages.registration.turning import couples_of, marked_links
from scanloom.stages.scans.model.scan import Frame

# Frames spread over the scan that are compared, each with each.
_FRAMES = 8
# Focal lengths that are tried, as multiples of the guess by logarithms, and then about the best.
_TRIED, _CLOSE = np.linspace(np.log(0.75), np.log(1.45), 11), np.linspace(-0.06, 0.06, 6)
# Marks and couples that must agree for the best, and the share of these marks from which on a trial counts.
_LEAST_MARKS, _LEAST_COUPLES, _COUNTS = 30, 4, 0.5


def focal_by_marks(frames: Sequence[Frame]) -> Focal | None:
    """Return the focal length with which most marks on what turns agree; None if hardly any do.

    Parameters
    ----------
    frames : with one camera that is a guess, and stands still while something turns.
    """
    chosen = [frames[n] for n in sample_evenly(len(frames), _FRAMES)]
    found = {log: _agreeing(chosen, float(log)) for log in _TRIED}
    best = max(found, key=lambda log: found[log])
    marks, couples = found[best]
    if marks < _LEAST_MARKS or couples < _LEAST_COUPLES or best in (_TRIED[0], _TRIED[-1]):
        return None
    found |= {best + step: _agreeing(chosen, float(best + step)) for step in _CLOSE}
    logs = np.array([log for log in found if abs(log - best) < 0.1])
    counts = np.array([found[log][0] for log in logs])
    weights = np.maximum(counts - _COUNTS * counts.max(), 0)
    mean = float(weights @ logs / weights.sum())
    spread = float(np.sqrt(weights @ (logs - mean) ** 2 / weights.sum()))
    guess = frames[0].camera.fx
    focal = guess * float(np.exp(mean))
    return Focal(guess, focal, spread * focal, couples)


def _agreeing(frames: Sequence[Frame], log: float) -> tuple[int, int]:
    """Return how many marks agree on turns, and of how many couples of frames."""
    factor = float(np.exp(log))
    tried = [
        replace(frame, camera=replace(frame.camera, fx=frame.camera.fx * factor, fy=frame.camera.fy * factor))
        for frame in frames
    ]
    looks = read_looks(tried, range(len(tried)))
    if len(looks) < 2:
        return 0, 0
    links = marked_links(tried, looks, backdrop_of(looks), couples_of(list(looks)))
    return int(sum(count for _, count in links.values())), len(links)
