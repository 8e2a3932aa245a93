"""System information and platform notes."""

import os
import sys
from pathlib import Path

import pytest

from scanloom.stages.inspecting import system


def test_memory_is_reported() -> None:
    total, available = system.query_memory_bytes()
    assert total is not None
    assert total > 1 << 28
    assert available is None or 0 < available <= total


def test_memory_without_a_proc_file_system(monkeypatch: pytest.MonkeyPatch) -> None:
    told = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 16384}
    monkeypatch.setattr(system, "_read_first_value", lambda path, key: None)  # noqa: ARG005
    monkeypatch.setattr(os, "sysconf", told.__getitem__)
    assert system.query_memory_bytes() == (16_384_000, None)

    def refuse(name: str) -> int:
        raise ValueError(name)

    monkeypatch.setattr(os, "sysconf", refuse)
    assert system.query_memory_bytes() == (None, None)


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux")
def test_a_usual_machine_has_no_platform_notes(tmp_path: Path) -> None:
    assert system.list_platform_notes(tmp_path) == []


def test_a_case_insensitive_file_system_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "Scan 1" / "0123"
    folder.mkdir(parents=True)
    assert not system.is_case_insensitive(folder)
    # Imitate a case-insensitive file system.
    (tmp_path / "sCAN 1").symlink_to(tmp_path / "Scan 1")
    assert system.is_case_insensitive(folder)
    assert any("upper and lower case" in sentence for sentence in system.list_platform_notes(folder))
    monkeypatch.chdir("/")
    assert not system.is_case_insensitive(Path("/"))


def test_an_unsupported_platform_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert [text.partition(",")[0] for text in system.list_platform_notes(tmp_path)] == [
        "scanloom is tested on Linux; on macOS it is expected to work"
    ]
