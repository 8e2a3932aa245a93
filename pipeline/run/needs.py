"""Resource estimates for a scan, from its size and cached results, without reading images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import digest
from scanloom.pipeline.cache.entry import DamagedError, read_manifest
from scanloom.pipeline.config import Config
from scanloom.pipeline.expectation import Expectation, as_before, expected, megapixels
from scanloom.pipeline.graph import plan_for
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.scan import Scan

# Maximum number of cached results read per stage: a large cache has thousands.
_MOST = 32

Manifest = Mapping[str, Any]


def expected_of(scan: Scan, config: Config, planned: Sequence[str], cache: Path) -> dict[str, Expectation]:
    """Estimate the cost of the stages of a scan.

    Cached results of scans of similar size are preferred. For another voxel size, memory and disk are scaled
    by the number of voxels on the surface (inverse square of the voxel size).

    Parameters
    ----------
    planned : names of the stages to run.
    cache : cache folder, which need not exist.
    """
    size = megapixels(scan)
    found = {}
    voxels: dict[str, tuple[float, FuseParams]] = {}
    for stage in plan_for(scan, config):
        if stage.name not in planned:
            continue
        earlier = _alike(list(islice(_manifests(cache / stage.name), _MOST)), size)
        for one in earlier:
            _note_voxels(one, voxels)
        take = expected(stage.name, size, None, earlier[:1], stage.cost)
        if not earlier and stage.cost.by_voxels and config.fuse.voxel_size is None:
            take = take.scaled(1 / config.fuse.voxel_factor**2)
        if earlier and stage.cost.by_voxels:
            then = earlier[0]["made"].get("megapixels")
            factor = _finer(earlier[0], voxels, config.fuse)
            if factor is not None:
                take = as_before(earlier[0], factor * (size / then if then else 1.0), "scaled", stage.cost)
        found[stage.name] = take.bounded(stage.memory_bound(config))
    return found


def _manifests(folder: Path) -> Iterator[Manifest]:
    if not folder.is_dir():
        return
    for place in folder.iterdir():
        with suppress(DamagedError):
            manifest = read_manifest(place)
            if "seconds" in manifest["made"]:
                yield manifest


def _alike(manifests: list[Manifest], size: float) -> list[Manifest]:
    def unlike(one: Manifest) -> float:
        then = one["made"].get("megapixels")
        return abs(math.log(size / then)) if then and size else math.inf

    return sorted(manifests, key=unlike)


def _note_voxels(one: Manifest, voxels: dict[str, tuple[float, FuseParams]]) -> None:
    """Record the voxel size behind a result, by the content digest of the result."""
    recipe = one["recipe"]
    at = next((voxels[content] for content in recipe["inputs"].values() if content in voxels), None)
    if one["figures"].get("voxel_size_m"):
        stated = recipe["params"].get(recipe["stage"], {})
        known = {name: stated[name] for name in ("voxel_size", "voxel_factor") if name in stated}
        at = (float(one["figures"]["voxel_size_m"]), FuseParams(**known))
    if at is not None:
        voxels[_content(one)] = at


def _content(one: Manifest) -> str:
    return digest({name: about["sha256"] for name, about in one["files"].items()})


def _finer(one: Manifest, voxels: Mapping[str, tuple[float, FuseParams]], now: FuseParams) -> float | None:
    """Return the ratio of new to old voxel count on a surface.

    Returns None if unknown.
    """
    if _content(one) not in voxels:
        return None
    size, then = voxels[_content(one)]
    if now.voxel_size is not None:
        return (size / now.voxel_size) ** 2
    if then.voxel_size is not None:
        return None
    return (then.voxel_factor / now.voxel_factor) ** 2
