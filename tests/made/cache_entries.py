"""Cache entry for tests, and helpers that make, store and damage it."""

import os
import sys
from pathlib import Path

from scanloom.pipeline.cache.entry import Recipe
from scanloom.pipeline.cache.store import Cache

ON_WINDOWS = sys.platform == "win32"
MAY_WRITE_ANYWHERE = ON_WINDOWS or os.geteuid() == 0

RECIPE = Recipe("fuse", {"fuse": 1}, {"fuse": {"voxel_size": 0.01}}, {"frames": "abc"})


def write_result(folder: Path) -> dict:
    (folder / "maps").mkdir()
    (folder / "maps" / "0.bin").write_bytes(bytes(range(200)))
    (folder / "fused.ply").write_bytes(b"ply" * 1000)
    return {"metrics": {"triangles": 7}, "made": {"seconds": 1.5}}


def fail_on_call(folder: Path) -> dict:
    raise AssertionError(f"made again in {folder}")


def store_entry(cache: Cache, recipe: Recipe = RECIPE, how=write_result, **options) -> Path:
    entry = cache.store(recipe, how, **options)
    entry.close()
    return entry.folder


def list_drafts(cache: Cache) -> list[Path]:
    return list((cache.folder / "drafts").iterdir())


def flip_byte(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
