"""Resource estimates for a scan, from its size and cached results, without reading images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import compute_digest
from scanloom.pipeline.cache.entry import DamagedEntryError, read_manifest
from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import ResourceEstimate, count_megapixels, estimate_cost, scale_from_result
from scanloom.pipeline.graph import plan_stages
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.scan import Scan

# Maximum number of cached results read per stage: a large cache has thousands.
_MAX_RESULTS = 32

Manifest = Mapping[str, Any]


def estimate_stages(
    scan: Scan, config: Config, planned: Sequence[str], cache: Path
) -> dict[str, ResourceEstimate]:
    """Estimate the cost of the stages of a scan.

    Cached results of scans of similar size are preferred. For another voxel size, memory and disk are scaled
    by the number of voxels on the surface (inverse square of the voxel size).

    Parameters
    ----------
    planned : names of the stages to run.
    cache : cache folder, which need not exist.
    """
    size = count_megapixels(scan)
    estimates = {}
    voxels: dict[str, tuple[float, FuseParams]] = {}
    for stage in plan_stages(scan, config):
        if stage.name not in planned:
            continue
        earlier = _sort_by_similarity(
            list(islice(_iterate_manifests(cache / stage.name), _MAX_RESULTS)), size
        )
        for one in earlier:
            _record_voxel_size(one, voxels)
        estimate = estimate_cost(stage.name, size, None, earlier[:1], stage.cost)
        if not earlier and stage.cost.depends_on_voxel_size and config.fuse.voxel_size is None:
            estimate = estimate.scale(1 / config.fuse.voxel_factor**2)
        if earlier and stage.cost.depends_on_voxel_size:
            earlier_size = earlier[0]["made"].get("megapixels")
            factor = _compute_voxel_ratio(earlier[0], voxels, config.fuse)
            if factor is not None:
                estimate = scale_from_result(
                    earlier[0], factor * (size / earlier_size if earlier_size else 1.0), "scaled", stage.cost
                )
        estimates[stage.name] = estimate.cap_memory(stage.memory_bound(config))
    return estimates


def _iterate_manifests(folder: Path) -> Iterator[Manifest]:
    if not folder.is_dir():
        return
    for place in folder.iterdir():
        with suppress(DamagedEntryError):
            manifest = read_manifest(place)
            if "seconds" in manifest["made"]:
                yield manifest


def _sort_by_similarity(manifests: list[Manifest], size: float) -> list[Manifest]:
    def compute_dissimilarity(one: Manifest) -> float:
        then = one["made"].get("megapixels")
        return abs(math.log(size / then)) if then and size else math.inf

    return sorted(manifests, key=compute_dissimilarity)


def _record_voxel_size(one: Manifest, voxels: dict[str, tuple[float, FuseParams]]) -> None:
    """Record the voxel size behind a result, by the content digest of the result."""
    recipe = one["recipe"]
    voxel_size = next((voxels[content] for content in recipe["inputs"].values() if content in voxels), None)
    if one["metrics"].get("voxel_size_m"):
        stated = recipe["params"].get(recipe["stage"], {})
        known = {name: stated[name] for name in ("voxel_size", "voxel_factor") if name in stated}
        voxel_size = (float(one["metrics"]["voxel_size_m"]), FuseParams(**known))
    if voxel_size is not None:
        voxels[_compute_content_digest(one)] = voxel_size


def _compute_content_digest(one: Manifest) -> str:
    return compute_digest({name: about["sha256"] for name, about in one["files"].items()})


def _compute_voxel_ratio(
    one: Manifest, voxels: Mapping[str, tuple[float, FuseParams]], now: FuseParams
) -> float | None:
    """Return the ratio of new to old voxel count on a surface.

    Returns None if unknown.
    """
    if _compute_content_digest(one) not in voxels:
        return None
    size, then = voxels[_compute_content_digest(one)]
    if now.voxel_size is not None:
        return (size / now.voxel_size) ** 2
    if then.voxel_size is not None:
        return None
    return (then.voxel_factor / now.voxel_factor) ** 2
