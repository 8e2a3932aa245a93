"""Locks: shared and exclusive, waiting, and released when their process ends."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from scanloom.pipeline.cache.locks import take_folder_lock, take_lock, try_folder_lock, try_lock


def test_a_lock_is_shared_by_several_or_exclusive(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    readers = [take_lock(path, shared=True) for _ in range(3)]
    assert try_lock(path) is None
    for reader in readers:
        reader.release()
    alone = try_lock(path)
    assert alone is not None
    assert try_lock(path) is None
    alone.release()
    alone.release()
    again = try_lock(path)
    assert again is not None
    again.release()


@pytest.mark.parametrize("shared", [False, True])
def test_a_lock_is_waited_for(tmp_path: Path, shared: bool) -> None:
    path = tmp_path / "a.lock"
    held = take_lock(path)
    taken: list[float] = []

    def wait() -> None:
        lock = take_lock(path, shared=shared)
        taken.append(time.monotonic())
        lock.release()

    waiting = threading.Thread(target=wait)
    waiting.start()
    time.sleep(0.1)
    assert taken == []
    released = time.monotonic()
    held.release()
    waiting.join(timeout=20)
    assert taken[0] >= released


def test_a_lock_is_released_when_its_process_ends(tmp_path: Path) -> None:
    script = (
        "import time; from pathlib import Path; from scanloom.pipeline.cache.locks import take_lock\n"
        f"lock = take_lock(Path({str(tmp_path / 'a.lock')!r})); print('held', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == b"held"
        assert try_lock(tmp_path / "a.lock") is None
        process.kill()
    take_lock(tmp_path / "a.lock").release()


def test_a_locked_folder_can_be_written_read_and_moved(tmp_path: Path) -> None:
    path = tmp_path / "draft"
    lock = take_lock(path)
    path.write_bytes(b"whole")
    assert path.read_bytes() == b"whole"
    assert lock.matches_path(path)
    path.replace(tmp_path / "done")
    assert not lock.matches_path(path)
    assert lock.matches_path(tmp_path / "done")
    (tmp_path / "done").unlink()
    lock.release()
    assert not lock.matches_path(tmp_path / "done")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_locked_without_a_file_in_it(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    held = take_folder_lock(tmp_path)
    assert try_folder_lock(tmp_path) is None
    other = try_folder_lock(tmp_path / "other")
    assert other is not None
    other.release()
    held.release()
    again = try_folder_lock(tmp_path)
    assert again is not None
    again.release()
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_taking_a_lock_updates_the_time_of_the_file(tmp_path: Path) -> None:
    lock = take_lock(tmp_path / "a.lock")
    before = time.time() - 5
    lock.touch()
    lock.release()
    assert (tmp_path / "a.lock").stat().st_mtime >= before
