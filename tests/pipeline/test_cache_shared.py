"""Processes and machines that share a cache do not damage each other's results."""

import errno
import os
import subprocess
import sys
from types import ModuleType

import pytest
from cache_entries import ON_WINDOWS, RECIPE, flip_byte, list_drafts, store_entry, write_result

from scanloom.pipeline.cache.store import Cache
from scanloom.stages.diagnostics.errors import StageError


def test_the_slower_of_two_processes_uses_the_entry_of_the_faster(cache):
    def slow(folder):
        store_entry(Cache(cache.folder))
        (folder / "fused.ply").write_bytes(b"of the slower one")
        return {"metrics": {"triangles": 8}}

    entry = cache.store(RECIPE, slow)
    assert entry.metrics == {"triangles": 7}
    assert list_drafts(cache) == []


def test_the_slower_process_replaces_a_damaged_entry(cache, warnings):
    def slow(folder):
        flip_byte(store_entry(Cache(cache.folder)) / "fused.ply")
        (folder / "fused.ply").write_bytes(b"of the slower one")
        return {"metrics": {"triangles": 8}}

    entry = cache.store(RECIPE, slow)
    assert entry.metrics == {"triangles": 8}
    assert len(warnings) == 1


def test_a_forced_result_replaces_the_old_one(cache):
    store_entry(cache)

    def again(folder):
        (folder / "fused.ply").write_bytes(b"again")
        return {"metrics": {}}

    assert (store_entry(cache, how=again, replace=True) / "fused.ply").read_bytes() == b"again"
    assert list_drafts(cache) == []


def test_entry_in_use_is_not_pruned(cache):
    entry = cache.store(RECIPE, write_result)
    reader = Cache(cache.folder).get(RECIPE)
    entry.close()
    assert cache.prune() == []
    assert entry.folder.exists()
    reader.close()
    assert [removed.key for removed in cache.prune()] == [RECIPE.key]
    assert not entry.folder.exists()
    assert list_drafts(cache) == []


@pytest.mark.skipif(ON_WINDOWS, reason="Windows moves nothing that is open")
def test_an_entry_replaced_while_it_is_read_stays_until_released(cache):
    store_entry(cache)
    reader = cache.get(RECIPE)
    with (reader.folder / "fused.ply").open("rb") as file:
        store_entry(cache, how=write_result, replace=True)
        assert file.read() == b"ply" * 1000
    assert len(list_drafts(cache)) == 1, "put aside, not deleted"
    reader.close()
    cache.remove_abandoned()
    assert list_drafts(cache) == []


@pytest.mark.skipif(not ON_WINDOWS, reason="elsewhere what is open can be moved")
def test_an_open_entry_is_not_replaced_if_open_files_cannot_be_moved(cache):
    store_entry(cache)
    reader = cache.get(RECIPE)
    with pytest.raises(StageError, match=r"^the result of fuse cannot be written to the cache"):
        store_entry(cache, how=write_result, replace=True)
    assert (reader.folder / "fused.ply").read_bytes() == b"ply" * 1000
    assert list_drafts(cache) == []
    reader.close()
    store_entry(cache, how=write_result, replace=True)


def test_drafts_of_killed_processes_are_removed_and_others_kept(cache):
    script = (
        "import time; from pathlib import Path\n"
        "from scanloom.pipeline.cache.store import Cache; from scanloom.pipeline.cache.entry import Recipe\n"
        "def make(folder):\n"
        "    (folder / 'part').write_bytes(b'half'); print('made', flush=True); time.sleep(60)\n"
        f"Cache(Path({str(cache.folder)!r})).store(Recipe('fuse', {{'fuse': 1}}), make)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"made\n"
        cache.remove_abandoned()
        assert [(draft / "part").exists() for draft in list_drafts(cache)] == [True]
        process.kill()
    cache.remove_abandoned()
    assert list_drafts(cache) == []
    assert cache.ls() == []


def test_drafts_of_other_machines_are_kept(cache, monkeypatch):
    # Its lock may be held on another machine and invisible here.
    with monkeypatch.context() as patched:
        patched.setattr("scanloom.pipeline.cache.store.get_host_id", lambda: "m00000000")
        cache._create_draft("fuse")[1].release()
    store_entry(cache)
    cache.remove_abandoned()
    assert [draft.name.split("-")[1] for draft in list_drafts(cache)] == ["m00000000"]
    cache.prune(everywhere=True)
    assert list_drafts(cache) == []


@pytest.mark.skipif(ON_WINDOWS, reason="it has locks")
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_shared_folder_without_locks_is_usable(cache, monkeypatch, code):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", refuse)
    first = store_entry(cache)
    assert cache.get(RECIPE).folder == first
    # Without locks it is unknown if another process uses the draft.
    draft, lock = cache._create_draft("fuse")
    lock.release()
    cache.remove_abandoned()
    assert draft.exists()


@pytest.mark.skipif(ON_WINDOWS, reason="it has locks")
def test_without_locks_the_first_of_two_equal_entries_is_kept(cache, monkeypatch):
    monkeypatch.setattr("fcntl.flock", lambda *_: None)

    usual, looks = cache._is_entry, []

    def look(place):
        # The other process stores its entry between the check for existence and the move.
        looks.append(place)
        if len(looks) == 1:
            store_entry(Cache(cache.folder))
            return False
        return usual(place)

    monkeypatch.setattr(cache, "_is_entry", look)
    entry = cache.store(RECIPE, write_result)
    monkeypatch.undo()
    assert len(looks) > 1
    assert entry.folder == cache.get(RECIPE).folder
    assert list_drafts(cache) == []


@pytest.mark.slow
def test_two_simultaneous_processes_store_complete_entries(toy: ModuleType, scan, tmp_path):
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
    assert list_drafts(cache) == []
    for name in ("mixed.bin", "cut.bin", "tables/counts.txt"):
        assert (shared / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()
    assert not list(shared.rglob("*.part"))
