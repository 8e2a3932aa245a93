"""Atomic folder output: replaced completely or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.atomic_folders import write_folder_atomically


def is_ours(folder: Path) -> bool:
    return (folder / "ours").exists()


def list_tree(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_a_folder_is_created_and_then_replaced(tmp_path: Path) -> None:
    target = tmp_path / "new" / "out"
    for name in ("first", "second"):
        with write_folder_atomically(target, is_ours, "a set") as draft:
            (draft / "ours").touch()
            (draft / name).touch()
            assert not (target / name).exists()
        assert list_tree(tmp_path / "new") == sorted(["out", f"out/{name}", "out/ours"])


def test_the_target_of_a_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "ours").touch()
    (tmp_path / "link").symlink_to("real")
    with write_folder_atomically(tmp_path / "link", is_ours, "a set") as draft:
        (draft / "later").touch()
    assert list_tree(tmp_path / "real") == ["later"]
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("when", ["inside", "first", "second"])
def test_a_failure_keeps_the_old_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, when: str
) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "ours").touch()
    rename, calls = Path.replace, []

    def replace_or_fail(path: Path, other: Path) -> Path:
        calls.append(path)
        if len(calls) == {"first": 1, "second": 2}.get(when):
            raise error
        return rename(path, other)

    monkeypatch.setattr(Path, "replace", replace_or_fail)
    with (  # noqa: PT012 - what is inside fails too
        pytest.raises((StageError, KeyboardInterrupt)) as caught,
        write_folder_atomically(target, is_ours, "a set") as draft,
    ):
        (draft / "later").touch()
        if when == "inside":
            raise error
    if isinstance(error, OSError):
        assert str(caught.value) == f"{target}: cannot be written: No space left on device."
    assert list_tree(tmp_path) == ["out", "out/ours"]


def test_other_files_and_folders_are_refused_before_writing(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    for name, message in (
        ("file", "this is a file; a set is a folder"),
        ("full", "is not a set; give a new folder"),
    ):
        with (
            pytest.raises(InputError, match=message),
            write_folder_atomically(tmp_path / name, is_ours, "a set"),
        ):
            pytest.fail("begun")
    assert list_tree(tmp_path) == ["file", "full", "full/mine"]
