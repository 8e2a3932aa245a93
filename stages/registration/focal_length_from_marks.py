"""Focal length estimation from marks on a turning sheet, seen by a static camera.

A wrong focal length distorts the plane of the sheet, so that fewer marks coincide after a rotation. The
focal length with most coinciding marks wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.registration.focal_length import FocalEstimate
from scanloom.stages.registration.frame_preview import read_previews
from scanloom.stages.registration.static_background import estimate_background
from scanloom.stages.registration.turntable_init import link_by_marks, list_frame_pairs
from scanloom.stages.scans.model.scan import Frame

# Number of sampled frames; all pairs of frames are compared.
_SAMPLE_COUNT = 8
# Logs of candidate focal lengths relative to the guess; then log offsets from the best candidate.
_CANDIDATE_LOGS, _LOG_OFFSETS = np.linspace(np.log(0.75), np.log(1.45), 11), np.linspace(-0.06, 0.06, 6)
# Minimum number of marks and of frame pairs for the best candidate, and the ratio to its marks below which a
# candidate gets no weight.
_MIN_MARKS, _MIN_PAIRS, _MIN_COUNT_RATIO = 30, 4, 0.5


def estimate_focal_length_from_marks(frames: Sequence[Frame]) -> FocalEstimate | None:
    """Estimate the focal length from marks on a turning support.

    Returns None if too few marks coincide.

    Parameters
    ----------
    frames : frames of one static camera with guessed intrinsics, in front of which something turns.
    """
    chosen = [frames[n] for n in sample_evenly(len(frames), _SAMPLE_COUNT)]
    found = {log: _count_coinciding_marks(chosen, float(log)) for log in _CANDIDATE_LOGS}
    best = max(found, key=lambda log: found[log])
    marks, couples = found[best]
    if marks < _MIN_MARKS or couples < _MIN_PAIRS or best in (_CANDIDATE_LOGS[0], _CANDIDATE_LOGS[-1]):
        return None
    found |= {best + step: _count_coinciding_marks(chosen, float(best + step)) for step in _LOG_OFFSETS}
    logs = np.array([log for log in found if abs(log - best) < 0.1])
    counts = np.array([found[log][0] for log in logs])
    weights = np.maximum(counts - _MIN_COUNT_RATIO * counts.max(), 0)
    mean = float(weights @ logs / weights.sum())
    spread = float(np.sqrt(weights @ (logs - mean) ** 2 / weights.sum()))
    guess = frames[0].camera.fx
    focal = guess * float(np.exp(mean))
    return FocalEstimate(guess, focal, spread * focal, couples)


def _count_coinciding_marks(frames: Sequence[Frame], log: float) -> tuple[int, int]:
    """Count coinciding marks and frame pairs for a log focal factor."""
    factor = float(np.exp(log))
    tried = [
        replace(frame, camera=replace(frame.camera, fx=frame.camera.fx * factor, fy=frame.camera.fy * factor))
        for frame in frames
    ]
    looks = read_previews(tried, range(len(tried)))
    if len(looks) < 2:
        return 0, 0
    links = link_by_marks(tried, looks, estimate_background(looks), list_frame_pairs(list(looks)))
    return int(sum(count for _, count in links.values())), len(links)
