"""Memory and disk limits of a run, enforced without affecting its results.

Before the first computed stage, the expected cost of the remaining stages is checked. During a stage, the
actual use is checked. Exceeding a limit ends the run with a message that names a fitting voxel size.
Estimates based on the scan size alone are too rough for that: they only cause a warning. Finished stages stay
in the cache.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from scanloom.pipeline.cache.entry import Entry
from scanloom.pipeline.cache.system import get_peak_bytes
from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import BASE_BYTES, ResourceEstimate
from scanloom.pipeline.run.codes import BATCH_LIMIT_EXCEEDED
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import StageError

# Seconds between two checks of memory and of disk use during a stage.
_MEMORY_CHECK_INTERVAL, _DISK_CHECK_INTERVAL = 0.05, 1.0
# The voxel volume may use one third of the memory limit.
_VOLUME_DIVISOR = 3
# Minimum completed ratio for extrapolation: early use of a stage is a poor predictor of its total.
_MIN_COMPLETED_RATIO = 0.25
_BASIS_TEXTS = {
    "measured": "measured in an earlier run",
    "scaled": "scaled from other scans",
    "estimated": "estimated from the scan size",
}


@dataclass(frozen=True)
class Limits:
    """Limits of a run in bytes; None for no limit.

    Attributes
    ----------
    memory : peak resident memory of the process.
    disk : bytes written to the cache and the output folder.
    """

    memory: int | None = None
    disk: int | None = None

    def __bool__(self) -> bool:
        return self.memory is not None or self.disk is not None


NO_LIMITS = Limits()


def limit_stage_memory(config: Config, limits: Limits) -> Config:
    """Limit fuse.memory to a third of the memory limit, and refine.memory to all of it.

    The remainder is needed for mesh extraction and per-frame data. `fuse.memory` does not affect results;
    `refine.memory` only if a mesh is too large to be refined, which is a warning.
    """
    if limits.memory is None:
        return config
    available_mb = max((limits.memory - BASE_BYTES) / 1e6, 1.0)
    max_volume_mb = max(available_mb / _VOLUME_DIVISOR, 1.0)
    return replace(
        config,
        fuse=replace(config.fuse, memory=min(config.fuse.memory, max_volume_mb)),
        refine=replace(config.refine, memory=min(config.refine.memory, available_mb)),
    )


class LimitGuard:
    """Guard that enforces the limits of one run.

    Parameters
    ----------
    expected : expected cost of each stage, in order.
    by_voxels : stages whose memory and disk depend on the voxel size.
    peak : function that returns the peak memory in bytes.
    """

    def __init__(
        self,
        limits: Limits,
        config: Config,
        expected: Mapping[str, ResourceEstimate],
        by_voxels: Sequence[str],
        peak: Callable[[], int] = get_peak_bytes,
    ) -> None:
        self._limits = limits
        self._config = config
        self._expected = expected
        self._by_voxels = by_voxels
        self._peak = peak
        self._written = 0
        self._reported_peak = 0
        self._has_begun = False
        self._last_checks = {"memory": -math.inf, "disk": -math.inf}

    @property
    def written(self) -> int:
        """Bytes written by the run so far."""
        return self._written

    def check_before(self, stage: str) -> None:
        """Check the expected cost of the remaining stages, once, before the first computed stage.

        Raises
        ------
        StageError
            If a limit will be exceeded; the message names the stage, the amount, and a fitting voxel size.
        """
        if self._has_begun:
            return
        self._has_begun = True
        names = [*self._expected]
        remaining = names[names.index(stage) :] if stage in names else []
        if self._limits.memory is not None and remaining:
            largest_stage = max(remaining, key=lambda name: self._expected[name].memory_bytes)
            estimate = self._expected[largest_stage]
            if estimate.memory_bytes > self._limits.memory or self._limits.memory <= BASE_BYTES:
                why = self._describe_memory_excess(
                    largest_stage, estimate.memory_bytes, _BASIS_TEXTS[estimate.basis]
                )
                self._end_or_warn(why, estimate.basis)
        if self._limits.disk is not None:
            total = sum(self._expected[name].disk_bytes for name in remaining)
            if total > self._limits.disk - self._written:
                bases = {self._expected[name].basis for name in remaining}
                self._end_or_warn(
                    "the run is expected to write {total}, but only {left} of the disk limit of {limit} "
                    "remain; increase the limit, or use larger voxels: {lighter}.",
                    "estimated" if "estimated" in bases else "scaled",
                    total=_format_size(total),
                    left=_format_size(self._limits.disk - self._written),
                    limit=_format_size(self._limits.disk),
                    lighter=self._suggest_reduction(total, self._limits.disk - self._written),
                )

    def _end_or_warn(self, message: str, basis: str, **values: str) -> None:
        if basis != "estimated" or (self._limits.memory or math.inf) <= BASE_BYTES:
            raise StageError(BATCH_LIMIT_EXCEEDED, message, **values)
        estimate = "This is an estimate; the stage is only stopped if it exceeds the limit."
        emit(BATCH_LIMIT_EXCEEDED.warning(f"{message} {estimate}", **values))

    def check_during(self, stage: str, folder: Path, share: float) -> None:
        """Stop a stage that has exceeded a limit.

        Parameters
        ----------
        folder : folder the stage writes to.
        share : completed ratio of the stage.

        Raises
        ------
        StageError
            If a limit is exceeded; the message names the amount and a fitting voxel size.
        """
        if self._limits.memory is not None and self._is_check_due("memory", _MEMORY_CHECK_INTERVAL):
            taken = self._peak()
            if taken > self._limits.memory:
                raise StageError(
                    BATCH_LIMIT_EXCEEDED, self._describe_memory_excess(stage, taken, None, share)
                )
        if self._limits.disk is not None and self._is_check_due("disk", _DISK_CHECK_INTERVAL):
            self._check_disk(stage, 2 * _count_bytes(folder), share)

    def check_stored(self, stage: str, entry: Entry) -> None:
        """Add the bytes written by a stage.

        The cache entry and its copies in the output folder count.
        """
        self.warn_if_exceeded(stage)
        size = 2 * sum(about["size"] for about in entry.manifest["files"].values())
        self._check_disk(stage, size)
        self._written += size

    def warn_if_exceeded(self, what: str) -> None:
        """Warn if a finished step exceeded the memory limit after its last progress report."""
        limit, taken = self._limits.memory, self._peak()
        if limit is not None and taken > max(limit, self._reported_peak):
            self._reported_peak = taken
            emit(
                BATCH_LIMIT_EXCEEDED.warning(
                    "{work} used {taken} of memory at its end, more than the limit of {limit}.",
                    work=what,
                    taken=_format_size(taken),
                    limit=_format_size(limit),
                )
            )

    def _check_disk(self, stage: str, more: int, share: float = 1.0) -> None:
        limit = self._limits.disk
        if limit is not None and self._written + more > limit:
            total = self._written + more
            raise StageError(
                BATCH_LIMIT_EXCEEDED,
                "with {stage}, the run has written {size}, more than the disk limit of {limit}",
                remedy="increase the limit, or use larger voxels: {lighter}.",
                stage=stage,
                size=_format_size(total),
                limit=_format_size(limit),
                lighter=self._suggest_reduction(self._extrapolate(total, share), limit),
            )

    def _is_check_due(self, what: str, pause: float) -> bool:
        now = time.monotonic()
        if now - self._last_checks[what] < pause:
            return False
        self._last_checks[what] = now
        return True

    def _describe_memory_excess(self, stage: str, needed: int, basis: str | None, share: float = 1.0) -> str:
        limit = self._limits.memory or 0
        takes = "has used" if basis is None else f"is expected to use ({basis})"
        what = (
            f"{stage} {takes} {_format_size(needed)} of memory, more than the limit of "
            f"{_format_size(limit)}; "
        )
        if limit <= BASE_BYTES:
            return f"{what}no voxel size fits, because the libraries alone use {_format_size(BASE_BYTES)}."
        if stage not in self._by_voxels:
            return f"{what}the voxel size has no influence: increase the limit, or disable the stage."
        estimate = self._extrapolate(needed - BASE_BYTES, share)
        return f"{what}{self._suggest_voxel_size(estimate, limit - BASE_BYTES)} would fit."

    def _extrapolate(self, taken: float, share: float) -> float:
        """Extrapolate the use at the end of a stage from its completed ratio."""
        return taken / max(share, _MIN_COMPLETED_RATIO)

    def _suggest_reduction(self, needed: float, limit: int) -> str:
        if limit <= 0:
            return "no voxel size fits"
        return f"{self._suggest_voxel_size(needed, limit)} would fit"

    def _suggest_voxel_size(self, needed: float, limit: float) -> str:
        """Suggest a voxel size that meets a limit.

        Memory and disk use are proportional to the inverse square of the voxel size.
        """
        times = math.sqrt(max(needed / limit, 1.0))
        fuse = self._config.fuse
        if fuse.voxel_size is not None:
            return f"fuse.voxel_size={_round_up(times * fuse.voxel_size):g}"
        return f"fuse.voxel_factor={_round_up(times * fuse.voxel_factor):g}"


def _count_bytes(folder: Path) -> int:
    sizes = 0
    for path in folder.rglob("*"):
        # Files may disappear during the walk.
        with suppress(OSError):
            sizes += path.lstat().st_size
    return sizes


def _round_up(value: float) -> float:
    """Round up to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    # The tolerance keeps values that have two digits already, despite floating-point error.
    return math.ceil(value / step - 1e-9) * step


def _format_size(count: float) -> str:
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{max(count, 0) / 1e6:.3g} MB"
