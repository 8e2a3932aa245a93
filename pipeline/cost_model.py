"""Estimates of the time and memory of a stage.

Estimates are based on earlier results, or else on the size of the scan.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from scanloom.stages.scans.model.scan import Scan

# Bytes of memory of the interpreter and the libraries before any frame is read.
BASE_BYTES = 300_000_000
# Bytes of memory of stages that process large meshes in chunks, measured on a mesh of 100 million triangles.
MAX_BYTES_IN_CHUNKS = 1.7e9


@dataclass(frozen=True)
class CostModel:
    """Linear cost model of a stage for its first run.

    The cost is a constant plus a rate per megapixel of the scan.

    Attributes
    ----------
    seconds, seconds_per_megapixel : time on two cores without a GPU.
    bytes, bytes_per_megapixel : memory above BASE_BYTES.
    disk, disk_per_megapixel : bytes written to the cache and the output folder.
    depends_on_voxel_size : True if memory and disk depend on the voxel size.
    max_bytes : upper bound of the memory above BASE_BYTES, for stages that process large meshes in chunks.
    """

    seconds: float = 0.5
    seconds_per_megapixel: float = 0.1
    bytes: float = 0.0
    bytes_per_megapixel: float = 20e6
    disk: float = 1e6
    disk_per_megapixel: float = 2e6
    depends_on_voxel_size: bool = True
    max_bytes: float = math.inf


@dataclass(frozen=True)
class ResourceEstimate:
    """Expected time, memory and disk use of a stage.

    Attributes
    ----------
    basis : "measured" from a result with the same inputs and other parameters, "scaled" from results of other
        scans by scan size, or "estimated" from the cost model.
    """

    seconds: float
    memory_bytes: int
    basis: str
    disk_bytes: int = 0

    def scale(self, factor: float) -> ResourceEstimate:
        """Scale time, disk and the memory above BASE_BYTES by a factor."""
        beyond = max(self.memory_bytes - BASE_BYTES, 0)
        memory = int(min(self.memory_bytes, BASE_BYTES) + factor * beyond)
        return ResourceEstimate(self.seconds * factor, memory, self.basis, int(self.disk_bytes * factor))

    def cap_memory(self, memory_bytes: float) -> ResourceEstimate:
        """Cap the memory, for a stage with a memory bound in bytes."""
        return replace(self, memory_bytes=int(min(self.memory_bytes, memory_bytes)))


def count_megapixels(scan: Scan) -> float:
    """Return the size of all frames of a scan in megapixels.

    The depth images count, or the left images without depth.
    """
    return sum(frame.camera.width * frame.camera.height for frame in scan.frames) / 1e6


def estimate_cost(
    stage: str,
    size: float,
    inputs: Mapping[str, str] | None,
    earlier: Iterable[Mapping[str, Any]],
    cost: CostModel,
) -> ResourceEstimate:
    """Estimate the cost of a stage.

    Parameters
    ----------
    stage : name of the stage.
    size : megapixels of the scan.
    inputs : input digests of the stage; None if not known yet.
    earlier : manifests of cached results, most recently used first.
    cost : cost model, used if there is no cached result of the stage.
    """
    same_stage = [one for one in earlier if one["recipe"]["stage"] == stage and "seconds" in one["made"]]
    for one in same_stage:
        if inputs is not None and one["recipe"]["inputs"] == inputs:
            return scale_from_result(one, 1.0, "measured", cost)
    for one in same_stage:
        earlier_size = one["made"].get("megapixels")
        if earlier_size:
            return scale_from_result(one, size / earlier_size, "scaled", cost)
    if same_stage:
        return scale_from_result(same_stage[0], 1.0, "scaled", cost)
    return ResourceEstimate(
        cost.seconds + cost.seconds_per_megapixel * size,
        int(BASE_BYTES + min(cost.bytes + cost.bytes_per_megapixel * size, cost.max_bytes)),
        "estimated",
        int(cost.disk + cost.disk_per_megapixel * size),
    )


def scale_from_result(
    manifest: Mapping[str, Any], factor: float, basis: str, cost: CostModel
) -> ResourceEstimate:
    """Estimate the cost of a stage by scaling the cost of a cached result.

    Parameters
    ----------
    manifest : manifest of the cached result.
    factor : amount of work relative to the cached result.
    basis : see `ResourceEstimate`.
    cost : cost model, for its memory bound.
    """
    made = manifest["made"]
    # Counted twice: cache entry and copy in the output folder.
    disk = 2 * sum(about["size"] for about in manifest.get("files", {}).values())
    peak = int(made.get("peak_memory_bytes", BASE_BYTES))
    max_memory = max(BASE_BYTES + cost.max_bytes, peak)
    return ResourceEstimate(made["seconds"], peak, basis, disk).scale(factor).cap_memory(max_memory)
