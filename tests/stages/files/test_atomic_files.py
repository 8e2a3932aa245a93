"""A single output is replaced as `cp` does, links and permissions too; but whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.atomic_files import write_file_atomically


def write(path: Path, text: str) -> None:
    with write_file_atomically(path) as part:
        part.write_text(text)


def test_of_a_link_the_file_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    file, link = tmp_path / "there" / "mesh.ply", tmp_path / "mesh.ply"
    file.write_text("old")
    link.symlink_to(file)
    write(link, "new")
    assert link.is_symlink()
    assert file.read_text() == "new"
    assert [path.name for path in file.parent.iterdir()] == ["mesh.ply"]
    assert [path.name for path in tmp_path.iterdir() if not path.is_dir()] == ["mesh.ply"]


def test_a_link_to_a_file_that_is_not_there_yet_is_followed_too(tmp_path: Path) -> None:
    link = tmp_path / "mesh.ply"
    link.symlink_to("other.ply")
    write(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "other.ply").read_text() == "new"


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755])
def test_permissions_stay(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "mesh.ply"
    file.write_text("old")
    file.chmod(mode)
    write(file, "new")
    assert file.read_text() == "new"
    assert file.stat().st_mode & 0o777 == mode


def test_a_new_file_is_as_open_as_any_other(tmp_path: Path) -> None:
    write(tmp_path / "mesh.ply", "new")
    (tmp_path / "plain").write_text("new")
    assert (tmp_path / "mesh.ply").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_what_is_no_file_is_refused_in_a_sentence(tmp_path: Path) -> None:
    folder, pipe = tmp_path / "folder.ply", tmp_path / "pipe.ply"
    folder.mkdir()
    os.mkfifo(pipe)
    with pytest.raises(InputError, match=r"folder\.ply: this is a folder; "):
        write(folder, "new")
    with pytest.raises(InputError, match=r"pipe\.ply: this is not a regular file"):
        write(pipe, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.ply", "pipe.ply"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_a_file_that_may_not_be_written_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mesh.ply"
    file.write_text("old")
    file.chmod(0o444)
    with pytest.raises(InputError, match=r"mesh\.ply: this file is not writable"):
        write(file, "new")
    assert file.read_text() == "old"


def test_what_fails_leaves_what_was_there(tmp_path: Path) -> None:
    file, link = tmp_path / "mesh.ply", tmp_path / "link.ply"
    file.write_text("old")
    link.symlink_to(file)

    def fail(path: Path) -> None:
        with write_file_atomically(path) as part:
            part.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(StageError, match="No space left"):
        fail(link)
    assert file.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.ply", "mesh.ply"]
