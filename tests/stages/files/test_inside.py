"""Which names lead to places inside a folder."""

import pytest

from scanloom.stages.files import inside
from scanloom.stages.files.inside import leads_inside

INSIDE = ["a", "a/b.png", "./a", "a..b", "a b", "ä/ö.png"]
OUTSIDE = ["", ".", "/", "/etc/passwd", "..", "a/../../b", "../a", "a\0b", "//host/a"]
# On Windows these lead to other folders, to another drive, and to what hangs on a file beside its content.
AWAY_ON_WINDOWS = ["..\\a", "C:a", "C:/a", "\\\\host\\a", "a\\..\\..\\b", "a.png:hidden"]


@pytest.mark.parametrize("name", INSIDE)
def test_names_inside(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert leads_inside(name)
    monkeypatch.setattr(inside, "_LEADING_AWAY", ("\\", ":"))
    assert leads_inside(name)


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_that_lead_elsewhere(name: str) -> None:
    assert not leads_inside(name)


@pytest.mark.parametrize("name", AWAY_ON_WINDOWS)
def test_names_that_lead_elsewhere_on_windows(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inside, "_LEADING_AWAY", ("\\", ":"))
    assert not leads_inside(name)
    monkeypatch.setattr(inside, "_LEADING_AWAY", ())
    assert leads_inside(name), "a file of Linux may be called so"
