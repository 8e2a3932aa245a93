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

ON_WINDOWS = sys.platform == "win32"
MAY_WRITE_ANYWHERE = ON_WINDOWS or os.geteuid() == 0

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


@pytest.mark.skipif(ON_WINDOWS, reason="Windows moves nothing that is open")
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


@pytest.mark.skipif(not ON_WINDOWS, reason="elsewhere what is open can be moved")
def test_entry_that_is_being_read_is_not_replaced_where_open_files_cannot_be_moved(cache):
    stored(cache)
    reader = cache.get(RECIPE)
    with pytest.raises(StageError, match=r"^the result of fuse cannot be written to the cache"):
        stored(cache, how=make, replace=True)
    assert (reader.folder / "fused.ply").read_bytes() == b"ply" * 1000
    assert drafts(cache) == []
    reader.close()
    stored(cache, how=make, replace=True)


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


def test_draft_of_another_machine_is_its_own_matter(cache, monkeypatch):
    # Its lock may be held where this machine cannot see it.
    with monkeypatch.context() as patched:
        patched.setattr("pipeline.cache.machine_mark", lambda: "m00000000")
        cache._new_draft("fuse")[1].release()
    stored(cache)
    cache.remove_abandoned()
    assert [draft.name.split("-")[1] for draft in drafts(cache)] == ["m00000000"]
    cache.prune(everywhere=True)
    assert drafts(cache) == []


@pytest.mark.skipif(ON_WINDOWS, reason="it has locks")
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_shared_folder_without_locks_is_used_all_the_same(cache, monkeypatch, code):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", refuse)
    first = stored(cache)
    assert cache.get(RECIPE).folder == first
    # Nobody can say whether somebody is at it.
    draft, lock = cache._new_draft("fuse")
    lock.release()
    cache.remove_abandoned()
    assert draft.exists()


@pytest.mark.skipif(ON_WINDOWS, reason="it has locks")
def test_of_two_that_make_one_entry_without_locks_the_first_has_it(cache, monkeypatch):
    monkeypatch.setattr("fcntl.flock", lambda *_: None)

    usual, looks = cache._is_entry, []

    def look(place):
        # The other comes in the moment between the look whether it is there and the move.
        looks.append(place)
        if len(looks) == 1:
            stored(Cache(cache.folder))
            return False
        return usual(place)

    monkeypatch.setattr(cache, "_is_entry", look)
    entry = cache.store(RECIPE, make)
    monkeypatch.undo()
    assert len(looks) > 1
    assert entry.folder == cache.get(RECIPE).folder
    assert drafts(cache) == []


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("nth", range(1, 4 if ON_WINDOWS else 5))
def test_full_disk_is_one_sentence_and_leaves_nothing(cache, monkeypatch, code, nth):
    calls = []

    def refuse(*arguments):
        calls.append(arguments)
        if len(calls) >= nth:
            raise OSError(code, os.strerror(code))

    # 3 files are flushed to the disk, then 2 folders, which Windows does not flush.
    monkeypatch.setattr("os.fsync", refuse)
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


@pytest.mark.skipif(MAY_WRITE_ANYWHERE, reason="root may write anywhere")
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


def what_is_outside(tmp_path: Path) -> Path:
    """A folder that is none of the cache's, with a file in it."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_bytes(b"mine")
    return outside


def untouched(outside: Path) -> bool:
    return {path.name: path.read_bytes() for path in outside.iterdir()} == {"file": b"mine"}


def become_a_file(path: Path, outside: Path) -> None:  # noqa: ARG001
    path.write_bytes(b"x")


def lead_nowhere(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "none")


def lead_to_a_file(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "file")


def lead_to_a_folder(path: Path, outside: Path) -> None:
    path.symlink_to(outside, target_is_directory=True)


def become_a_pipe(path: Path, outside: Path) -> None:  # noqa: ARG001
    os.mkfifo(path)


def become_an_empty_folder(path: Path, outside: Path) -> None:  # noqa: ARG001
    path.mkdir()


IN_THE_WAY = [become_a_file, lead_nowhere, lead_to_a_file, lead_to_a_folder]
if not ON_WINDOWS:
    IN_THE_WAY.append(become_a_pipe)


@pytest.mark.parametrize("become", IN_THE_WAY)
@pytest.mark.parametrize("looked_up", [False, True])
def test_what_is_no_folder_in_an_entrys_place_is_removed(cache, warnings, tmp_path, become, looked_up):
    """A file there was no hit and kept the new entry out, for ever."""
    outside = what_is_outside(tmp_path)
    place = cache.folder / "fuse" / RECIPE.key
    place.parent.mkdir(parents=True)
    become(place, outside)
    [listed] = cache.ls()
    assert listed.problem == "it is no folder"
    if looked_up:
        assert cache.get(RECIPE) is None
    assert stored(cache) == place
    assert "was no folder; it is removed" in warnings[0]
    assert cache.get(RECIPE) is not None
    assert untouched(outside)


@pytest.mark.parametrize("become", [*IN_THE_WAY[1:], become_an_empty_folder])
@pytest.mark.parametrize("name", ["names.lock", f"fuse/{RECIPE.key}/in-use.lock"])
def test_what_is_no_file_in_a_locks_place_is_removed_and_not_followed(cache, tmp_path, name, become):
    outside = what_is_outside(tmp_path)
    stored(cache)
    (cache.folder / name).unlink()
    become(cache.folder / name, outside)
    entry = cache.get(RECIPE)
    assert entry is not None
    assert (cache.folder / name).is_file()
    assert not (cache.folder / name).is_symlink()
    assert untouched(outside)


def test_folder_with_something_in_it_in_a_locks_place_is_one_sentence(cache):
    stored(cache)
    (cache.folder / "names.lock").unlink()
    (cache.folder / "names.lock" / "mine").mkdir(parents=True)
    with pytest.raises(StageError, match=r"cannot be used: Directory not empty .*names\.lock"):
        cache.get(RECIPE)
    assert (cache.folder / "names.lock" / "mine").is_dir()


@pytest.mark.parametrize("become", [*IN_THE_WAY[1:], become_an_empty_folder])
def test_lock_of_an_output_folder_is_healed(cache, tmp_path, become):
    outside = what_is_outside(tmp_path)
    cache.sole_run(tmp_path / "out", lambda: None).release()
    [lock] = (cache.folder / "runs").glob("*.lock")
    lock.unlink()
    become(lock, outside)
    cache.sole_run(tmp_path / "out", lambda: None).release()
    assert untouched(outside)


@pytest.mark.parametrize("become", IN_THE_WAY)
@pytest.mark.parametrize("name", ["fuse", "drafts", "runs"])
def test_folders_of_the_cache_that_lead_elsewhere_are_refused(cache, tmp_path, name, become):
    outside = what_is_outside(tmp_path)
    cache.folder.mkdir()
    become(cache.folder / name, outside)
    with pytest.raises(StageError, match=rf"/{name}: a folder of the cache is expected here.*; remove it"):
        stored(cache)
    assert cache.ls() == []
    cache.remove_abandoned()
    assert untouched(outside)


def test_files_of_an_entry_that_lead_elsewhere_are_damage(cache, warnings, tmp_path):
    for name, other in (("fused.ply", "file"), ("maps", "folder")):
        folder = stored(cache)
        moved = tmp_path / f"moved-{other}"
        (folder / name).rename(moved)
        (folder / name).symlink_to(moved)
        assert cache.get(RECIPE) is None
        assert "leads elsewhere" in warnings.pop()
        assert moved.exists()


def test_marks_and_drafts_are_not_followed(cache, tmp_path):
    outside = what_is_outside(tmp_path)
    (cache.folder / "drafts").mkdir(parents=True)
    (cache.folder / "CACHEDIR.TAG").symlink_to(outside / "none")
    (cache.folder / "drafts" / "fuse-abc").symlink_to(outside, target_is_directory=True)
    stored(cache)
    cache.remove_abandoned()
    assert untouched(outside)


@pytest.fixture
def read_only(cache, monkeypatch) -> None:
    """Have the system refuse what it refuses below the cache's folder on a disk that is mounted read-only."""

    def refusing(real, writes):
        def call(path, *arguments, **options):
            inside = (
                Path(os.fsdecode(path)).is_relative_to(cache.folder) if isinstance(path, (str, Path)) else 0
            )
            if inside and writes(path, *arguments):
                raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
            return real(path, *arguments, **options)

        return call

    def to_write(path, flags, *more):  # noqa: ARG001
        return flags & (os.O_RDWR | os.O_WRONLY | os.O_CREAT)

    def always(*arguments):  # noqa: ARG001
        return True

    def absent(path, *more):  # noqa: ARG001
        return not os.path.lexists(path)

    monkeypatch.setattr(os, "open", refusing(os.open, to_write))
    monkeypatch.setattr(os, "mkdir", refusing(os.mkdir, absent))
    for name in ("rename", "replace", "unlink", "rmdir"):
        monkeypatch.setattr(os, name, refusing(getattr(os, name), always))
    real_utime = os.utime

    def utime(path, *arguments, **options):
        if isinstance(path, int):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        real_utime(path, *arguments, **options)

    monkeypatch.setattr(os, "utime", utime)


def test_cache_that_may_only_be_read_serves_hits(cache, warnings, tmp_path, request):
    stored(cache)
    (cache.folder / "names.lock").unlink()
    request.getfixturevalue("read_only")
    cache.remove_abandoned()
    (tmp_path / "out").mkdir()
    sole = cache.sole_run(tmp_path / "out", lambda: pytest.fail("nobody else is there"))

    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.sole_run(tmp_path / "out", interrupt)
    entry = cache.get(RECIPE)
    assert entry.figures == {"triangles": 7}
    for _ in range(2):
        cache.remember_run(tmp_path / "out", {"keys": [entry.key]})
    assert [text.partition(":")[0] for text in warnings] == [f"the cache {cache.folder} may only be read"]
    with pytest.raises(StageError, match=r"^the result of fuse cannot be written to the cache .*Read-only"):
        cache.store(Recipe("fuse", {"fuse": 2}), make)
    sole.release()


@pytest.mark.skipif(MAY_WRITE_ANYWHERE, reason="root may write anywhere")
def test_folder_without_permission_to_write_serves_hits(cache):
    folder = stored(cache)
    for path in (folder, folder.parent, cache.folder):
        path.chmod(0o555)
    assert cache.get(RECIPE) is not None
    for path in (cache.folder, folder.parent, folder):
        path.chmod(0o755)


def test_limit_takes_the_longest_unused_and_never_what_a_latest_run_used(cache, warnings, tmp_path):
    first, second, third = recipes(cache)
    (tmp_path / "out").mkdir()
    cache.remember_run(tmp_path / "out", {"keys": [first.key]})
    size = cache.ls()[0].size
    cache.limit(2 * size)
    assert {entry.key for entry in cache.ls()} == {first.key, third.key}
    assert warnings == []
    cache.limit(size // 2)
    assert {entry.key for entry in cache.ls()} == {first.key}
    assert "more than cache.max_size" in warnings[0]
    assert second.key not in {entry.key for entry in cache.ls()}


def test_entry_in_use_is_not_taken_for_its_size(cache):
    entry = cache.store(RECIPE, make)
    cache.limit(0)
    assert [listed.key for listed in cache.ls()] == [entry.key]


@pytest.mark.parametrize("name", ["manifest.json", "runs"])
def test_nested_lists_in_files_of_the_cache_are_damage(cache, warnings, tmp_path, name):
    folder = stored(cache)
    cache.remember_run(tmp_path, {"keys": []})
    [record] = (cache.folder / "runs").glob("*.json")
    path = record if name == "runs" else folder / name
    for depth in (500, 5000, 200_000):
        for nested in ("[" * depth + "]" * depth, '{"digest":' * depth + "1" + "}" * depth):
            path.write_text(nested)
            assert cache.ls()
            cache.latest_run(tmp_path)
    if name == "manifest.json":
        assert cache.get(RECIPE) is None
        assert "manifest.json" in warnings[0]
