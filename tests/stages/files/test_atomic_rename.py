"""Atomic renames of files and folders, and retries while a file is in use."""

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
def rename(request: pytest.FixtureRequest) -> Callable[[Path, Path], None]:
    return rename_atomically if request.param == "here" else atomic_rename._rename_with_retries


def test_a_file_replaces_a_file(rename: Callable[[Path, Path], None], tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a")
    (tmp_path / "b").write_text("b")
    rename(tmp_path / "a", tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    assert (tmp_path / "b").read_text() == "a"


def test_a_folder_replaces_only_an_empty_folder(rename: Callable[[Path, Path], None], tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "file").write_text("a")
    (tmp_path / "b").mkdir()
    rename(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b" / "file").read_text() == "a"
    (tmp_path / "c").mkdir()
    with pytest.raises(OSError, match="not empty"):
        rename(tmp_path / "c", tmp_path / "b")
    assert (tmp_path / "b" / "file").read_text() == "a"


def test_a_file_in_use_is_retried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("a")
    real, calls = Path.replace, []

    def refuse_twice(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) < 3:
            raise PermissionError(errno.EACCES, "in use")
        return real(self, target)

    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(time, "sleep", lambda seconds: None)  # noqa: ARG005
    monkeypatch.setattr(Path, "replace", refuse_twice)
    rename_atomically(tmp_path / "a", tmp_path / "b")
    assert len(calls) == 3
    assert (tmp_path / "b").read_text() == "a"


def test_a_file_that_stays_in_use_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("a")

    def refuse(self: Path, target: Path) -> NoReturn:  # noqa: ARG001
        raise PermissionError(errno.EACCES, "in use")

    monkeypatch.setattr(atomic_rename, "_RETRY_DURATION_S", 0.1)
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(PermissionError):
        atomic_rename._rename_with_retries(tmp_path / "a", tmp_path / "b")
