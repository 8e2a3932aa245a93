"""Atomic file output: complete or not at all; links and permissions are kept, as by `cp`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.atomic_files import write_file_atomically


def write_text_file(path: Path, text: str) -> None:
    with write_file_atomically(path) as part:
        part.write_text(text)


def test_the_target_of_a_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    file, link = tmp_path / "there" / "mesh.ply", tmp_path / "mesh.ply"
    file.write_text("old")
    link.symlink_to(file)
    write_text_file(link, "new")
    assert link.is_symlink()
    assert file.read_text() == "new"
    assert [path.name for path in file.parent.iterdir()] == ["mesh.ply"]
    assert [path.name for path in tmp_path.iterdir() if not path.is_dir()] == ["mesh.ply"]


def test_a_link_to_a_missing_file_is_followed(tmp_path: Path) -> None:
    link = tmp_path / "mesh.ply"
    link.symlink_to("other.ply")
    write_text_file(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "other.ply").read_text() == "new"


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755])
def test_permissions_are_kept(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "mesh.ply"
    file.write_text("old")
    file.chmod(mode)
    write_text_file(file, "new")
    assert file.read_text() == "new"
    assert file.stat().st_mode & 0o777 == mode


def test_a_new_file_has_default_permissions(tmp_path: Path) -> None:
    write_text_file(tmp_path / "mesh.ply", "new")
    (tmp_path / "plain").write_text("new")
    assert (tmp_path / "mesh.ply").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_folders_and_pipes_are_refused(tmp_path: Path) -> None:
    folder, pipe = tmp_path / "folder.ply", tmp_path / "pipe.ply"
    folder.mkdir()
    os.mkfifo(pipe)
    with pytest.raises(InputError, match=r"folder\.ply: this is a folder; "):
        write_text_file(folder, "new")
    with pytest.raises(InputError, match=r"pipe\.ply: this is not a regular file"):
        write_text_file(pipe, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.ply", "pipe.ply"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_read_only_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mesh.ply"
    file.write_text("old")
    file.chmod(0o444)
    with pytest.raises(InputError, match=r"mesh\.ply: this file is not writable"):
        write_text_file(file, "new")
    assert file.read_text() == "old"


def test_a_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    file, link = tmp_path / "mesh.ply", tmp_path / "link.ply"
    file.write_text("old")
    link.symlink_to(file)

    def write_half_and_fail(path: Path) -> None:
        with write_file_atomically(path) as part:
            part.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(StageError, match="No space left"):
        write_half_and_fail(link)
    assert file.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.ply", "mesh.ply"]
