"""What a stage will take, in time and memory: as it took before, else by the size of the scan."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from scanloom.stages.scans.model.scan import Scan

# What the process holds before any frame is read: the interpreter and the libraries.
BASE_BYTES = 300_000_000
# Memory of stages that process large meshes in parts, measured on a building of a hundred million triangles.
MAX_BYTES_IN_PARTS = 1.7e9


@dataclass(frozen=True)
class Cost:
    """A rough guess for a stage nobody has run yet: a fixed part, and one for a million pixels of the scan.

    Attributes
    ----------
    seconds, seconds_per_megapixel : on two cores without a GPU.
    bytes, bytes_per_megapixel : beyond what the process holds anyway.
    disk, disk_per_megapixel : bytes that are written, into the cache and the output folder.
    by_voxels : memory and disk follow from how fine the voxels are.
    most_bytes : beyond what the process holds anyway, for a stage that takes large work piece by piece.
    """

    seconds: float = 0.5
    seconds_per_megapixel: float = 0.1
    bytes: float = 0.0
    bytes_per_megapixel: float = 20e6
    disk: float = 1e6
    disk_per_megapixel: float = 2e6
    by_voxels: bool = True
    most_bytes: float = math.inf


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
    disk_bytes: int = 0

    def scaled(self, factor: float) -> Expectation:
        """Return what so many times as much work of the same kind will take."""
        beyond = max(self.memory_bytes - BASE_BYTES, 0)
        memory = int(min(self.memory_bytes, BASE_BYTES) + factor * beyond)
        return Expectation(self.seconds * factor, memory, self.basis, int(self.disk_bytes * factor))

    def bounded(self, memory_bytes: float) -> Expectation:
        """Return it for a stage that keeps to so much memory."""
        return replace(self, memory_bytes=int(min(self.memory_bytes, memory_bytes)))


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
            return as_before(one, 1.0, "measured", cost)
    for one in same_stage:
        then = one["made"].get("megapixels")
        if then:
            return as_before(one, size / then, "scaled", cost)
    if same_stage:
        return as_before(same_stage[0], 1.0, "scaled", cost)
    return Expectation(
        cost.seconds + cost.seconds_per_megapixel * size,
        int(BASE_BYTES + min(cost.bytes + cost.bytes_per_megapixel * size, cost.most_bytes)),
        "estimated",
        int(cost.disk + cost.disk_per_megapixel * size),
    )


def as_before(manifest: Mapping[str, Any], factor: float, basis: str, cost: Cost) -> Expectation:
    """Return what a stage of such cost will take that does so many times the work of a cached result."""
    made = manifest["made"]
    # The result, and its copy in the output folder.
    disk = 2 * sum(about["size"] for about in manifest.get("files", {}).values())
    peak = int(made.get("peak_memory_bytes", BASE_BYTES))
    most = max(BASE_BYTES + cost.most_bytes, peak)
    return Expectation(made["seconds"], peak, basis, disk).scaled(factor).bounded(most)
