"""Which names lead to places inside a folder."""

import pytest

from scanloom.stages.files import path_safety
from scanloom.stages.files.path_safety import is_safe_relative_path

INSIDE = ["a", "a/b.png", "./a", "a..b", "a b", "ä/ö.png"]
OUTSIDE = ["", ".", "/", "/etc/passwd", "..", "a/../../b", "../a", "a\0b", "//host/a"]
# On Windows these lead to other folders, to another drive, and to what hangs on a file beside its content.
AWAY_ON_WINDOWS = ["..\\a", "C:a", "C:/a", "\\\\host\\a", "a\\..\\..\\b", "a.png:hidden"]


@pytest.mark.parametrize("name", INSIDE)
def test_names_inside(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_safe_relative_path(name)
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ("\\", ":"))
    assert is_safe_relative_path(name)


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_that_lead_elsewhere(name: str) -> None:
    assert not is_safe_relative_path(name)


@pytest.mark.parametrize("name", AWAY_ON_WINDOWS)
def test_names_that_lead_elsewhere_on_windows(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ("\\", ":"))
    assert not is_safe_relative_path(name)
    monkeypatch.setattr(path_safety, "_FORBIDDEN_CHARACTERS", ())
    assert is_safe_relative_path(name), "a file of Linux may be called so"
