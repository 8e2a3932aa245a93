"""Entries are whole or absent, damage is noticed, and processes do not harm each other."""

import builtins
import errno
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

from pipeline.cache import Cache
from pipeline.entry import Recipe
from stages.errors import StageError

RECIPE = Recipe("fuse", {"fuse": 1}, {"fuse": {"voxel_size": 0.01}}, {"frames": "abc"})


def make(folder: Path) -> dict:
    (folder / "maps").mkdir()
    (folder / "maps" / "0.bin").write_bytes(bytes(range(200)))
    (folder / "fused.ply").write_bytes(b"ply" * 1000)
    return {"figures": {"triangles": 7}, "made": {"seconds": 1.5}}


def fail(folder: Path) -> dict:
    raise AssertionError(f"made again in {folder}")


def stored(cache: Cache, recipe: Recipe = RECIPE, how=make, **options) -> Path:
    entry = cache.store(recipe, how, **options)
    entry.close()
    return entry.folder


def drafts(cache: Cache) -> list[Path]:
    return list((cache.folder / "drafts").iterdir())


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def cache(tmp_path: Path, warnings: list[str]) -> Cache:
    return Cache(tmp_path / "cache", warnings.append)


def test_entry_comes_back_as_it_was_stored(cache):
    assert cache.get(RECIPE) is None
    folder = stored(cache)
    entry = cache.get(RECIPE)
    assert entry.folder == folder
    assert entry.key == RECIPE.key == folder.name
    assert entry.figures == {"triangles": 7}
    assert entry.manifest["made"] == {"seconds": 1.5}
    assert entry.manifest["recipe"] == RECIPE.as_json()
    assert sorted(entry.files) == ["fused.ply", "maps/0.bin"]
    assert (folder / "maps" / "0.bin").read_bytes() == bytes(range(200))
    assert drafts(cache) == []


def test_content_digest_is_of_the_files_alone(cache):
    def later(folder):
        return {**make(folder), "made": {"seconds": 99}}

    first = cache.store(RECIPE, make)
    other = cache.store(Recipe("fuse", {"fuse": 2}), later)
    assert first.digest == other.digest
    assert first.key != other.key


def test_looking_up_makes_nothing(tmp_path):
    cache = Cache(tmp_path / "none")
    assert cache.get(RECIPE) is None
    assert cache.ls() == cache.verify() == cache.prune() == []
    assert not cache.folder.exists()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_failing_stage_leaves_nothing(cache, error):
    def break_off(folder):
        make(folder)
        raise error

    with pytest.raises(error):
        cache.store(RECIPE, break_off)
    assert cache.get(RECIPE) is None
    assert drafts(cache) == []


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


def cut_short(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def make_empty(path: Path) -> None:
    path.write_bytes(b"")


def become_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def become_json(path: Path) -> None:
    path.write_text("[1, 2]")


@pytest.mark.parametrize("damage", [flip, cut_short, make_empty, Path.unlink, become_a_folder, become_json])
@pytest.mark.parametrize("name", ["fused.ply", "maps/0.bin", "manifest.json"])
def test_damaged_entry_is_reported_dropped_and_made_anew(cache, warnings, name, damage):
    folder = stored(cache)
    damage(folder / name)
    [listed] = cache.verify()
    assert name in listed.problem
    assert folder.exists(), "verify changes nothing"
    assert cache.get(RECIPE) is None
    assert len(warnings) == 1
    assert "the cached result of fuse is damaged" in warnings[0]
    assert name in warnings[0]
    assert not folder.exists()
    assert drafts(cache) == []
    assert (stored(cache) / "fused.ply").read_bytes() == b"ply" * 1000
    assert cache.verify()[0].problem is None
    assert len(warnings) == 1


@pytest.mark.parametrize("position", range(0, 1000, 37))
def test_any_flipped_byte_of_the_manifest_is_noticed(cache, warnings, position):
    manifest = stored(cache) / "manifest.json"
    data = bytearray(manifest.read_bytes())
    data[position % len(data)] ^= 0x01
    changed = json.loads(data) if _is_json(data) else None
    same = changed == json.loads(manifest.read_bytes())
    manifest.write_bytes(data)
    entry = cache.get(RECIPE)
    # A changed blank between two values changes nothing that is said.
    assert (entry is not None) == same
    assert bool(warnings) != same


def _is_json(data: bytes) -> bool:
    try:
        json.loads(data)
    except ValueError:
        return False
    return True


def test_entry_under_another_key_is_no_hit(cache, warnings):
    folder = stored(cache)
    other = Recipe("fuse", {"fuse": 2})
    shutil.copytree(folder, folder.with_name(other.key))
    assert cache.get(other) is None
    assert "belongs to another entry" in warnings[0]
    assert cache.get(RECIPE) is not None


def test_files_a_person_adds_do_no_harm(cache, warnings):
    (stored(cache) / "notes.txt").write_text("mine")
    assert cache.get(RECIPE) is not None
    assert warnings == []


def test_slower_of_two_makers_uses_the_entry_of_the_faster(cache):
    def slow(folder):
        stored(Cache(cache.folder))
        (folder / "fused.ply").write_bytes(b"of the slower one")
        return {"figures": {"triangles": 8}}

    entry = cache.store(RECIPE, slow)
    assert entry.figures == {"triangles": 7}
    assert drafts(cache) == []


def test_slower_maker_replaces_an_entry_that_is_damaged(cache, warnings):
    def slow(folder):
        flip(stored(Cache(cache.folder)) / "fused.ply")
        (folder / "fused.ply").write_bytes(b"of the slower one")
        return {"figures": {"triangles": 8}}

    entry = cache.store(RECIPE, slow)
    assert entry.figures == {"triangles": 8}
    assert len(warnings) == 1


def test_forced_result_takes_the_place_of_the_old_one(cache):
    stored(cache)

    def again(folder):
        (folder / "fused.ply").write_bytes(b"again")
        return {"figures": {}}

    assert (stored(cache, how=again, replace=True) / "fused.ply").read_bytes() == b"again"
    assert drafts(cache) == []


def test_entry_in_use_is_not_pruned(cache):
    entry = cache.store(RECIPE, make)
    reader = Cache(cache.folder).get(RECIPE)
    entry.close()
    assert cache.prune() == []
    assert entry.folder.exists()
    reader.close()
    assert [removed.key for removed in cache.prune()] == [RECIPE.key]
    assert not entry.folder.exists()
    assert drafts(cache) == []


def test_entry_replaced_while_it_is_read_stays_until_the_reader_lets_go(cache):
    stored(cache)
    reader = cache.get(RECIPE)
    with (reader.folder / "fused.ply").open("rb") as file:
        stored(cache, how=make, replace=True)
        assert file.read() == b"ply" * 1000
    assert len(drafts(cache)) == 1, "put aside, not deleted"
    reader.close()
    cache.remove_abandoned()
    assert drafts(cache) == []


def test_draft_of_a_living_process_is_left_alone_and_of_a_killed_one_removed(cache):
    script = (
        "import time; from pathlib import Path\n"
        "from pipeline.cache import Cache; from pipeline.entry import Recipe\n"
        "def make(folder):\n"
        "    (folder / 'part').write_bytes(b'half'); print('made', flush=True); time.sleep(60)\n"
        f"Cache(Path({str(cache.folder)!r})).store(Recipe('fuse', {{'fuse': 1}}), make)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"made\n"
        cache.remove_abandoned()
        assert [(draft / "part").exists() for draft in drafts(cache)] == [True]
        process.kill()
    cache.remove_abandoned()
    assert drafts(cache) == []
    assert cache.ls() == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("nth", range(1, 5))
def test_full_disk_is_one_sentence_and_leaves_nothing(cache, monkeypatch, code, nth):
    calls = []

    def refuse(*arguments):
        calls.append(arguments)
        if len(calls) >= nth:
            raise OSError(code, os.strerror(code))

    # 3 files are flushed to the disk, then 2 folders.
    monkeypatch.setattr("pipeline.files.os.fsync", refuse)
    with pytest.raises(
        StageError, match=r"^the result of fuse cannot be written to the cache .*: the disk .*free some"
    ):
        cache.store(RECIPE, make)
    monkeypatch.undo()
    assert drafts(cache) == []
    assert cache.get(RECIPE) is None
    stored(cache)


def test_disk_that_fills_while_a_stage_writes(cache):
    def write(folder):
        (folder / "begun").write_bytes(b"x")
        raise StageError("fused.ply: cannot be written") from OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(StageError, match="the disk is full; free some space"):
        cache.store(RECIPE, write)
    assert drafts(cache) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_cache_that_may_not_be_written(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(StageError, match=r"cannot be written to the cache .*Permission denied"):
        Cache(tmp_path / "cache").store(RECIPE, make)
    tmp_path.chmod(0o700)


def test_file_where_the_cache_should_be(tmp_path):
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(StageError, match="cannot be written to the cache"):
        Cache(tmp_path / "cache").store(RECIPE, make)


def test_listing_names_size_parameters_and_use(cache, tmp_path):
    stored(cache)
    stored(cache, Recipe("clean", {"clean": 1}))
    cache.remember_run(tmp_path, {"keys": [RECIPE.key]})
    clean, fuse = cache.ls()
    assert (clean.stage, fuse.stage) == ("clean", "fuse")
    assert (clean.in_latest_run, fuse.in_latest_run) == (False, True)
    assert fuse.size > 3200
    assert fuse.manifest["recipe"]["params"] == {"fuse": {"voxel_size": 0.01}}
    assert abs(fuse.last_used.timestamp() - time.time()) < 60


def recipes(cache: Cache) -> list[Recipe]:
    """Three entries, the first unused for longest."""
    made = [Recipe("fuse", {"fuse": version}) for version in (1, 2, 3)]
    for i, recipe in enumerate(made):
        os.utime(stored(cache, recipe) / "in-use.lock", (1000 + i, 1000 + i))
    return made


def test_prune_removes_what_no_latest_run_used(cache, tmp_path):
    first, second, third = recipes(cache)
    (tmp_path / "out").mkdir()
    cache.remember_run(tmp_path / "out", {"keys": [second.key]})
    cache.remember_run(tmp_path / "deleted", {"keys": [third.key]})
    assert {e.key for e in cache.prune(dry_run=True)} == {first.key, third.key}
    assert len(cache.ls()) == 3
    assert {e.key for e in cache.prune()} == {first.key, third.key}
    assert [e.key for e in cache.ls()] == [second.key]


def test_prune_by_age_and_by_size(cache):
    first, second, third = recipes(cache)
    cache.get(third).close()  # looking it up makes it young
    assert {e.key for e in cache.prune(unused=False, older_than=3600)} == {first.key, second.key}
    stored(cache, second)
    size = cache.ls()[0].size
    os.utime(cache.folder / "fuse" / third.key / "in-use.lock", (1000, 1000))
    assert [e.key for e in cache.prune(unused=False, max_size=size + 1)] == [third.key]
    assert cache.prune(unused=False, max_size=size + 1) == []


def test_unreadable_record_of_a_run_counts_as_none(cache, tmp_path):
    cache.remember_run(tmp_path, {"keys": [RECIPE.key]})
    [record] = (cache.folder / "runs").iterdir()
    for text in ("", "{", "[]", "{}", '{"out": 1, "keys": 2}'):
        record.write_text(text)
        assert cache.latest_run(tmp_path) in ({}, {"out": 1, "keys": 2})
        assert cache.ls() == []


@pytest.mark.slow
def test_two_processes_at_once_make_one_whole_entry_each(toy: ModuleType, scan, tmp_path):
    expected = [outcome.folder.name for outcome in toy.run(scan, tmp_path / "alone")]
    shared = tmp_path / "out"
    processes = [
        subprocess.Popen([sys.executable, toy.__file__, str(scan), str(shared)], stderr=subprocess.PIPE)
        for _ in range(4)
    ]
    errors = [process.communicate()[1] for process in processes]
    assert [process.returncode for process in processes] == [0] * 4, errors
    cache = Cache(shared / "cache")
    assert sorted(e.key for e in cache.verify()) == sorted(expected)
    assert [e.problem for e in cache.verify()] == [None] * 3
    assert drafts(cache) == []
    for name in ("mixed.bin", "cut.bin", "tables/counts.txt"):
        assert (shared / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()
    assert not list(shared.rglob("*.part"))


def test_writing_never_happens_in_an_entrys_place(cache, monkeypatch):
    """No file below a stage's folder is ever opened for writing, but for locks."""
    opened = []
    real = builtins.open

    def watch(file, mode="r", *arguments, **options):
        if set(mode) & set("wax+"):
            opened.append(Path(str(file)))
        return real(file, mode, *arguments, **options)

    monkeypatch.setattr("io.open", watch)
    stored(cache)
    assert opened
    assert all("drafts" in path.parts for path in opened if path.parent != cache.folder)
