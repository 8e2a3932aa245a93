"""Unexpected files, links and read-only folders at the paths of cache entries and locks."""

import errno
import os
from pathlib import Path

import pytest
from cache_entries import MAY_WRITE_ANYWHERE, ON_WINDOWS, RECIPE, store_entry, write_result

from scanloom.pipeline.cache.entry import Recipe
from scanloom.stages.diagnostics.errors import StageError


def make_outside_folder(tmp_path: Path) -> Path:
    """Make a folder outside the cache with a file in it."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_bytes(b"mine")
    return outside


def is_untouched(outside: Path) -> bool:
    return {path.name: path.read_bytes() for path in outside.iterdir()} == {"file": b"mine"}


def make_file(path: Path, outside: Path) -> None:  # noqa: ARG001
    path.write_bytes(b"x")


def make_broken_link(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "none")


def make_link_to_file(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "file")


def make_link_to_folder(path: Path, outside: Path) -> None:
    path.symlink_to(outside, target_is_directory=True)


def make_pipe(path: Path, outside: Path) -> None:  # noqa: ARG001
    os.mkfifo(path)


def make_empty_folder(path: Path, outside: Path) -> None:  # noqa: ARG001
    path.mkdir()


IN_THE_WAY = [make_file, make_broken_link, make_link_to_file, make_link_to_folder]
if not ON_WINDOWS:
    IN_THE_WAY.append(make_pipe)


@pytest.mark.parametrize("become", IN_THE_WAY)
@pytest.mark.parametrize("looked_up", [False, True])
def test_other_files_at_the_path_of_an_entry_are_removed(cache, warnings, tmp_path, become, looked_up):
    """A file at the path of an entry once blocked the new entry permanently."""
    outside = make_outside_folder(tmp_path)
    place = cache.folder / "fuse" / RECIPE.key
    place.parent.mkdir(parents=True)
    become(place, outside)
    [listed] = cache.ls()
    assert listed.problem == "it is not a folder"
    if looked_up:
        assert cache.get(RECIPE) is None
    assert store_entry(cache) == place
    assert "was not a folder; it is removed" in warnings[0]
    assert cache.get(RECIPE) is not None
    assert is_untouched(outside)


@pytest.mark.parametrize("become", [*IN_THE_WAY[1:], make_empty_folder])
@pytest.mark.parametrize("name", ["names.lock", f"fuse/{RECIPE.key}/in-use.lock"])
def test_other_files_at_the_path_of_a_lock_are_removed_and_not_followed(cache, tmp_path, name, become):
    outside = make_outside_folder(tmp_path)
    store_entry(cache)
    (cache.folder / name).unlink()
    become(cache.folder / name, outside)
    entry = cache.get(RECIPE)
    assert entry is not None
    assert (cache.folder / name).is_file()
    assert not (cache.folder / name).is_symlink()
    assert is_untouched(outside)


def test_a_non_empty_folder_at_the_path_of_a_lock_is_one_sentence(cache):
    store_entry(cache)
    (cache.folder / "names.lock").unlink()
    (cache.folder / "names.lock" / "mine").mkdir(parents=True)
    with pytest.raises(StageError, match=r"cannot be used: Directory not empty .*names\.lock"):
        cache.get(RECIPE)
    assert (cache.folder / "names.lock" / "mine").is_dir()


@pytest.mark.parametrize("become", [*IN_THE_WAY[1:], make_empty_folder])
def test_the_lock_of_an_output_folder_is_repaired(cache, tmp_path, become):
    outside = make_outside_folder(tmp_path)
    cache.lock_output_folder(tmp_path / "out", lambda: None).release()
    [lock] = (cache.folder / "runs").glob("*.lock")
    lock.unlink()
    become(lock, outside)
    cache.lock_output_folder(tmp_path / "out", lambda: None).release()
    assert is_untouched(outside)


@pytest.mark.parametrize("become", IN_THE_WAY)
@pytest.mark.parametrize("name", ["fuse", "drafts", "runs"])
def test_linked_folders_in_the_cache_are_refused(cache, tmp_path, name, become):
    outside = make_outside_folder(tmp_path)
    cache.folder.mkdir()
    become(cache.folder / name, outside)
    with pytest.raises(StageError, match=rf"/{name}: a folder of the cache is expected here.*; remove it"):
        store_entry(cache)
    assert cache.ls() == []
    cache.remove_abandoned()
    assert is_untouched(outside)


def test_linked_files_in_an_entry_are_damage(cache, warnings, tmp_path):
    for name, other in (("fused.ply", "file"), ("maps", "folder")):
        folder = store_entry(cache)
        moved = tmp_path / f"moved-{other}"
        (folder / name).rename(moved)
        (folder / name).symlink_to(moved)
        assert cache.get(RECIPE) is None
        assert "is a link" in warnings.pop()
        assert moved.exists()


def test_links_at_marks_and_drafts_are_not_followed(cache, tmp_path):
    outside = make_outside_folder(tmp_path)
    (cache.folder / "drafts").mkdir(parents=True)
    (cache.folder / "CACHEDIR.TAG").symlink_to(outside / "none")
    (cache.folder / "drafts" / "fuse-abc").symlink_to(outside, target_is_directory=True)
    store_entry(cache)
    cache.remove_abandoned()
    assert is_untouched(outside)


@pytest.fixture
def read_only(cache, monkeypatch) -> None:
    """Make the system refuse writing to the cache's folder, like a disk that is mounted read-only."""

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


def test_a_read_only_cache_serves_hits(cache, warnings, tmp_path, request):
    store_entry(cache)
    (cache.folder / "names.lock").unlink()
    request.getfixturevalue("read_only")
    cache.remove_abandoned()
    (tmp_path / "out").mkdir()
    sole = cache.lock_output_folder(tmp_path / "out", lambda: pytest.fail("nobody else is there"))

    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.lock_output_folder(tmp_path / "out", interrupt)
    entry = cache.get(RECIPE)
    assert entry.metrics == {"triangles": 7}
    for _ in range(2):
        cache.record_run(tmp_path / "out", {"keys": [entry.key]})
    assert [text.partition(":")[0] for text in warnings] == [f"the cache {cache.folder} is read-only"]
    with pytest.raises(StageError, match=r"^the result of fuse cannot be written to the cache .*Read-only"):
        cache.store(Recipe("fuse", {"fuse": 2}), write_result)
    sole.release()


@pytest.mark.skipif(MAY_WRITE_ANYWHERE, reason="root may write anywhere")
def test_folder_without_permission_to_write_serves_hits(cache):
    folder = store_entry(cache)
    for path in (folder, folder.parent, cache.folder):
        path.chmod(0o555)
    assert cache.get(RECIPE) is not None
    for path in (cache.folder, folder.parent, folder):
        path.chmod(0o755)
