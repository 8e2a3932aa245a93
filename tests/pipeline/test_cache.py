"""Cache entries are complete or absent, damage is detected, and unused entries are removed."""

import builtins
import errno
import json
import os
import shutil
import time
from pathlib import Path

import pytest
from cache_entries import (
    MAY_WRITE_ANYWHERE,
    ON_WINDOWS,
    RECIPE,
    flip_byte,
    list_drafts,
    store_entry,
    write_result,
)

from scanloom.pipeline.cache import store as cache_module
from scanloom.pipeline.cache.entry import Recipe
from scanloom.pipeline.cache.store import Cache
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError


def test_an_entry_is_returned_as_stored(cache):
    assert cache.get(RECIPE) is None
    folder = store_entry(cache)
    entry = cache.get(RECIPE)
    assert entry.folder == folder
    assert entry.key == RECIPE.key == folder.name
    assert entry.metrics == {"triangles": 7}
    assert entry.manifest["made"] == {"seconds": 1.5}
    assert entry.manifest["recipe"] == RECIPE.to_json()
    assert sorted(entry.files) == ["fused.ply", "maps/0.bin"]
    assert (folder / "maps" / "0.bin").read_bytes() == bytes(range(200))
    assert list_drafts(cache) == []


def test_the_content_digest_covers_only_the_files(cache):
    def later(folder):
        return {**write_result(folder), "made": {"seconds": 99}}

    first = cache.store(RECIPE, write_result)
    other = cache.store(Recipe("fuse", {"fuse": 2}), later)
    assert first.digest == other.digest
    assert first.key != other.key


def test_a_lookup_creates_no_files(tmp_path):
    cache = Cache(tmp_path / "none")
    assert cache.get(RECIPE) is None
    assert cache.ls() == cache.verify() == cache.prune() == []
    assert not cache.folder.exists()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_failing_stage_leaves_no_entry(cache, error):
    def fail_midway(folder):
        write_result(folder)
        raise error

    with pytest.raises(error):
        cache.store(RECIPE, fail_midway)
    assert cache.get(RECIPE) is None
    assert list_drafts(cache) == []


@pytest.mark.parametrize("when", ["as it is locked", "as its name is known"])
def test_ctrl_c_after_creating_a_draft_leaves_no_files(cache, monkeypatch, when):
    take_lock = cache_module.take_lock

    def interrupted(path, **how):
        lock = take_lock(path, **how)
        release = lock.release

        def release_and_interrupt():
            release()
            if list_drafts(cache):
                raise KeyboardInterrupt

        is_of_draft = path.name == cache_module.IN_USE_LOCK
        if is_of_draft and when == "as it is locked":
            release_and_interrupt()
        if not is_of_draft and when == "as its name is known":
            monkeypatch.setattr(lock, "release", release_and_interrupt)
        return lock

    monkeypatch.setattr(cache_module, "take_lock", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cache.store(RECIPE, write_result)
    monkeypatch.undo()
    assert list_drafts(cache) == []
    assert store_entry(cache) is not None


def truncate_file(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def make_empty(path: Path) -> None:
    path.write_bytes(b"")


def replace_by_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def replace_by_json(path: Path) -> None:
    path.write_text("[1, 2]")


@pytest.mark.parametrize(
    "damage", [flip_byte, truncate_file, make_empty, Path.unlink, replace_by_folder, replace_by_json]
)
@pytest.mark.parametrize("name", ["fused.ply", "maps/0.bin", "manifest.json"])
def test_a_damaged_entry_is_reported_removed_and_computed_again(cache, warnings, name, damage):
    folder = store_entry(cache)
    damage(folder / name)
    [listed] = cache.verify()
    assert name in listed.problem
    assert folder.exists(), "verify changes nothing"
    assert cache.get(RECIPE) is None
    assert len(warnings) == 1
    assert "the cached result of fuse is damaged" in warnings[0]
    assert name in warnings[0]
    assert not folder.exists()
    assert list_drafts(cache) == []
    assert (store_entry(cache) / "fused.ply").read_bytes() == b"ply" * 1000
    assert cache.verify()[0].problem is None
    assert len(warnings) == 1


@pytest.mark.parametrize("position", range(0, 1000, 37))
def test_any_flipped_byte_of_the_manifest_is_detected(cache, warnings, position):
    manifest = store_entry(cache) / "manifest.json"
    data = bytearray(manifest.read_bytes())
    data[position % len(data)] ^= 0x01
    changed = json.loads(data) if _is_json(data) else None
    same = changed == json.loads(manifest.read_bytes())
    manifest.write_bytes(data)
    entry = cache.get(RECIPE)
    # A changed blank between two values does not change the content.
    assert (entry is not None) == same
    assert bool(warnings) != same


def _is_json(data: bytes) -> bool:
    try:
        json.loads(data)
    except ValueError:
        return False
    return True


def test_an_entry_under_another_key_is_not_a_hit(cache, warnings):
    folder = store_entry(cache)
    other = Recipe("fuse", {"fuse": 2})
    shutil.copytree(folder, folder.with_name(other.key))
    assert cache.get(other) is None
    assert "belongs to another entry" in warnings[0]
    assert cache.get(RECIPE) is not None


def test_files_added_by_users_are_ignored(cache, warnings):
    (store_entry(cache) / "notes.txt").write_text("mine")
    assert cache.get(RECIPE) is not None
    assert warnings == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("nth", range(1, 4 if ON_WINDOWS else 5))
def test_a_full_disk_is_one_sentence_and_leaves_no_entry(cache, monkeypatch, code, nth):
    calls = []

    def refuse(*arguments):
        calls.append(arguments)
        if len(calls) >= nth:
            raise OSError(code, os.strerror(code))

    # 3 files are flushed to the disk, then 2 folders, which Windows does not flush.
    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(
        StageError, match=r"^the result of fuse cannot be written to the cache .*: the disk .*free disk space"
    ):
        cache.store(RECIPE, write_result)
    monkeypatch.undo()
    assert list_drafts(cache) == []
    assert cache.get(RECIPE) is None
    store_entry(cache)


def test_disk_that_fills_while_a_stage_writes(cache):
    def write(folder):
        (folder / "begun").write_bytes(b"x")
        raise StageError(MACHINE_BUG, "fused.ply: cannot be written") from OSError(
            errno.ENOSPC, "No space left on device"
        )

    with pytest.raises(StageError, match="the disk is full; free disk space"):
        cache.store(RECIPE, write)
    assert list_drafts(cache) == []


@pytest.mark.skipif(MAY_WRITE_ANYWHERE, reason="root may write anywhere")
def test_cache_that_may_not_be_written(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(StageError, match=r"cannot be written to the cache .*Permission denied"):
        Cache(tmp_path / "cache").store(RECIPE, write_result)
    tmp_path.chmod(0o700)


def test_file_where_the_cache_should_be(tmp_path):
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(StageError, match="cannot be written to the cache"):
        Cache(tmp_path / "cache").store(RECIPE, write_result)


def test_listing_names_size_parameters_and_use(cache, tmp_path):
    store_entry(cache)
    store_entry(cache, Recipe("clean", {"clean": 1}))
    cache.record_run(tmp_path, {"keys": [RECIPE.key]})
    clean, fuse = cache.ls()
    assert (clean.stage, fuse.stage) == ("clean", "fuse")
    assert (clean.in_latest_run, fuse.in_latest_run) == (False, True)
    assert fuse.size > 3200
    assert fuse.manifest["recipe"]["params"] == {"fuse": {"voxel_size": 0.01}}
    assert abs(fuse.last_used.timestamp() - time.time()) < 60


def store_three_entries(cache: Cache) -> list[Recipe]:
    """Store three entries; the first is unused for the longest time."""
    made = [Recipe("fuse", {"fuse": version}) for version in (1, 2, 3)]
    for i, recipe in enumerate(made):
        os.utime(store_entry(cache, recipe) / "in-use.lock", (1000 + i, 1000 + i))
    return made


def test_prune_removes_entries_unused_by_latest_runs(cache, tmp_path):
    first, second, third = store_three_entries(cache)
    (tmp_path / "out").mkdir()
    cache.record_run(tmp_path / "out", {"keys": [second.key]})
    cache.record_run(tmp_path / "deleted", {"keys": [third.key]})
    assert {e.key for e in cache.prune(dry_run=True)} == {first.key, third.key}
    assert len(cache.ls()) == 3
    assert {e.key for e in cache.prune()} == {first.key, third.key}
    assert [e.key for e in cache.ls()] == [second.key]


def test_prune_by_age_and_by_size(cache):
    first, second, third = store_three_entries(cache)
    cache.get(third).close()  # the lookup updates its time of use
    assert {e.key for e in cache.prune(unused=False, older_than=3600)} == {first.key, second.key}
    store_entry(cache, second)
    size = cache.ls()[0].size
    os.utime(cache.folder / "fuse" / third.key / "in-use.lock", (1000, 1000))
    assert [e.key for e in cache.prune(unused=False, max_size=size + 1)] == [third.key]
    assert cache.prune(unused=False, max_size=size + 1) == []


def test_an_unreadable_record_of_a_run_is_ignored(cache, tmp_path):
    cache.record_run(tmp_path, {"keys": [RECIPE.key]})
    [record] = (cache.folder / "runs").iterdir()
    for text in ("", "{", "[]", "{}", '{"out": 1, "keys": 2}'):
        record.write_text(text)
        assert cache.read_latest_run(tmp_path) in ({}, {"out": 1, "keys": 2})
        assert cache.ls() == []


def test_entries_are_never_written_in_place(cache, monkeypatch):
    """No file inside a stage's folder is opened for writing, except locks."""
    opened = []
    real = builtins.open

    def watch(file, mode="r", *arguments, **options):
        if set(mode) & set("wax+"):
            opened.append(Path(str(file)))
        return real(file, mode, *arguments, **options)

    monkeypatch.setattr("io.open", watch)
    store_entry(cache)
    assert opened
    assert all("drafts" in path.parts for path in opened if path.parent != cache.folder)


def test_the_limit_removes_oldest_entries_except_those_of_latest_runs(cache, warnings, tmp_path):
    first, second, third = store_three_entries(cache)
    (tmp_path / "out").mkdir()
    cache.record_run(tmp_path / "out", {"keys": [first.key]})
    size = cache.ls()[0].size
    cache.limit_size(2 * size)
    assert {entry.key for entry in cache.ls()} == {first.key, third.key}
    assert warnings == []
    cache.limit_size(size // 2)
    assert {entry.key for entry in cache.ls()} == {first.key}
    assert "more than cache.max_size" in warnings[0]
    assert second.key not in {entry.key for entry in cache.ls()}


def test_the_limit_keeps_entries_in_use(cache):
    entry = cache.store(RECIPE, write_result)
    cache.limit_size(0)
    assert [listed.key for listed in cache.ls()] == [entry.key]


@pytest.mark.parametrize("name", ["manifest.json", "runs"])
def test_nested_lists_in_files_of_the_cache_are_damage(cache, warnings, tmp_path, name):
    folder = store_entry(cache)
    cache.record_run(tmp_path, {"keys": []})
    [record] = (cache.folder / "runs").glob("*.json")
    path = record if name == "runs" else folder / name
    for depth in (500, 5000, 200_000):
        for nested in ("[" * depth + "]" * depth, '{"digest":' * depth + "1" + "}" * depth):
            path.write_text(nested)
            assert cache.ls()
            cache.read_latest_run(tmp_path)
    if name == "manifest.json":
        assert cache.get(RECIPE) is None
        assert "manifest.json" in warnings[0]
