"""Moving files and folders: what takes whose place, and patience with what is open for a moment."""

import errno
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from scanloom.stages.files import atomic_rename
from scanloom.stages.files.atomic_rename import rename_atomically


@pytest.fixture(params=["here", "as Windows is moved on"])
def way(request: pytest.FixtureRequest) -> Callable[[Path, Path], None]:
    return rename_atomically if request.param == "here" else atomic_rename._rename_with_retries


def test_a_file_takes_the_place_of_a_file(way: Callable[[Path, Path], None], tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a")
    (tmp_path / "b").write_text("b")
    way(tmp_path / "a", tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    assert (tmp_path / "b").read_text() == "a"


def test_a_folder_takes_the_place_of_an_empty_one_only(
    way: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "file").write_text("a")
    (tmp_path / "b").mkdir()
    way(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b" / "file").read_text() == "a"
    (tmp_path / "c").mkdir()
    with pytest.raises(OSError, match="not empty"):
        way(tmp_path / "c", tmp_path / "b")
    assert (tmp_path / "b" / "file").read_text() == "a"


def test_what_is_open_for_a_moment_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("a")
    real, calls = Path.replace, []

    def refused_twice(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) < 3:
            raise PermissionError(errno.EACCES, "in use")
        return real(self, target)

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(time, "sleep", lambda seconds: None)  # noqa: ARG005
    monkeypatch.setattr(Path, "replace", refused_twice)
    rename_atomically(tmp_path / "a", tmp_path / "b")
    assert len(calls) == 3
    assert (tmp_path / "b").read_text() == "a"


def test_what_stays_open_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("a")

    def refused(self: Path, target: Path) -> NoReturn:  # noqa: ARG001
        raise PermissionError(errno.EACCES, "in use")

    monkeypatch.setattr(atomic_rename, "_RETRY_DURATION_S", 0.1)
    monkeypatch.setattr(Path, "replace", refused)
    with pytest.raises(PermissionError):
        atomic_rename._rename_with_retries(tmp_path / "a", tmp_path / "b")
