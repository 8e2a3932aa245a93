"""What a stage will take, in time and memory: as it took before, else by the size of the scan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from stages.scans.scan import Scan

# What the process holds before any frame is read: the interpreter and the libraries.
BASE_BYTES = 300_000_000


@dataclass(frozen=True)
class Cost:
    """A rough guess for a stage nobody has run yet: a fixed part, and one for a million pixels of the scan.

    Attributes
    ----------
    seconds, seconds_per_megapixel : on two cores without a GPU.
    bytes, bytes_per_megapixel : beyond what the process holds anyway.
    """

    seconds: float = 0.5
    seconds_per_megapixel: float = 0.1
    bytes: float = 0.0
    bytes_per_megapixel: float = 20e6


@dataclass(frozen=True)
class Expectation:
    """What a stage will take.

    Attributes
    ----------
    basis : "measured" when the stage worked on the same before, with other parameters; "scaled" from work on
        something else, by the sizes of the scans where they are known; "estimated" from the size alone.
    """

    seconds: float
    memory_bytes: int
    basis: str


def megapixels(scan: Scan) -> float:
    """Return how many million pixels the frames of a scan have, of depth or of their left images."""
    return sum(frame.camera.width * frame.camera.height for frame in scan.frames) / 1e6


def expected(
    stage: str,
    size: float,
    inputs: Mapping[str, str] | None,
    earlier: Iterable[Mapping[str, Any]],
    cost: Cost,
) -> Expectation:
    """Return what a stage will take.

    Parameters
    ----------
    size : megapixels of the scan.
    inputs : digests of what the stage will read, None if not known yet.
    earlier : manifests of results in the cache, the latest used first.
    cost : for a stage that none of them is of.
    """
    same_stage = [one for one in earlier if one["recipe"]["stage"] == stage and "seconds" in one["made"]]
    for one in same_stage:
        if inputs is not None and one["recipe"]["inputs"] == inputs:
            return _as_before(one["made"], 1.0, "measured")
    for one in same_stage:
        then = one["made"].get("megapixels")
        if then:
            return _as_before(one["made"], size / then, "scaled")
    if same_stage:
        return _as_before(same_stage[0]["made"], 1.0, "scaled")
    return Expectation(
        cost.seconds + cost.seconds_per_megapixel * size,
        int(BASE_BYTES + cost.bytes + cost.bytes_per_megapixel * size),
        "estimated",
    )


def _as_before(made: Mapping[str, Any], factor: float, basis: str) -> Expectation:
    peak = float(made.get("peak_memory_bytes", BASE_BYTES))
    grown = min(peak, BASE_BYTES) + factor * max(peak - BASE_BYTES, 0)
    return Expectation(made["seconds"] * factor, int(grown), basis)
