"""Safe relative paths: names that stay inside a folder."""

import pytest

from scanloom.stages.files import path_safety
from scanloom.stages.files.path_safety import is_safe_relative_path

INSIDE = ["a", "a/b.png", "./a", "a..b", "a b", "ä/ö.png"]
OUTSIDE = ["", ".", "/", "/etc/passwd", "..", "a/../../b", "../a", "a\0b", "//host/a"]
# On Windows these names lead to other folders, other drives, or alternate data streams.
AWAY_ON_WINDOWS = ["..\\a", "C:a", "C:/a", "\\\\host\\a", "a\\..\\..\\b", "a.png:hidden"]


@pytest.mark.parametrize("name", INSIDE)
def test_names_inside_the_folder_are_safe(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_safe_relative_path(name)
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ("\\", ":"))
    assert is_safe_relative_path(name)


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_outside_the_folder_are_unsafe(name: str) -> None:
    assert not is_safe_relative_path(name)


@pytest.mark.parametrize("name", AWAY_ON_WINDOWS)
def test_names_outside_the_folder_on_windows_are_unsafe_there(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ("\\", ":"))
    assert not is_safe_relative_path(name)
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ())
    assert is_safe_relative_path(name), "a file of Linux may be called so"
