"""Every message of the sources is explained on a page, and no page explains what nothing says."""

import re
from pathlib import Path

import pytest
from making import messages

PYTHON = '''
"""Nothing is told by a docstring that is long."""
TITLE = f"a name in capitals that nobody is told"


def check(path, warnings, out):
    """Say that something is wrong with it."""
    if not path:
        raise InputError(f"the file {path.name[:3]!r} is empty; "
            "get another one.", path)
    warnings.append(f"{path}: half of it is missing")
    out.warn("`code` in it is told, too.")
    print("what is printed here is no message")
    said = "three words only" if path else f"or {path} in other words."
    return Frame(missing=("poses: there are none of them",), text="what it is named in lists")


def _warnings(frames):
    yield f"{len(frames)} frames are of no use"


def named(frames):
    return "something else that is returned"
'''
RUST = """match self {
    // "no, not this one"
    Self::A => write!(f, "the mesh {name} is no good: \\"{why}\\""),
    Self::B => "a word",
}"""
FORMS = {
    "the file … is empty; get another one.",
    "…: half of it is missing",
    "`code` in it is told, too.",
    "three words only",
    "or … in other words.",
    "poses: there are none of them",
    "… frames are of no use",
    'the mesh … is no good: \\"…\\"',
}
PAGE = """# A page

What it is about: `…: half of it is missing` is no point.

## Files

- `the file … is empty; get another one.`
- `` `code` in it is told, too.``
- `three words only`, and more: an ordinary point.

Why that is.
"""


@pytest.fixture
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "cli").mkdir()
    (tmp_path / "cli" / "told.py").write_text(PYTHON)
    (tmp_path / "errors.rs").write_text(RUST)
    (tmp_path / "page.md").write_text(PAGE)
    monkeypatch.setattr(messages, "ROOT", tmp_path)
    monkeypatch.setattr(messages, "KERNELS", ("errors.rs",))
    monkeypatch.setattr(messages, "PAGES", tmp_path)
    return tmp_path


@pytest.mark.usefixtures("made_up")
def test_messages_are_found_where_they_are_made():
    found = list(messages.messages())

    assert {message.form for message in found} == FORMS
    (empty,) = [message for message in found if message.form.startswith("the file")]
    assert (empty.file, empty.line) == ("cli/told.py", 9)


@pytest.mark.usefixtures("made_up")
def test_points_of_nothing_but_code_are_what_a_page_lists():
    listed = list(messages.entries())

    assert [entry.form for entry in listed] == [
        "the file … is empty; get another one.",
        "`code` in it is told, too.",
    ]
    assert {(entry.page, entry.heading) for entry in listed} == {("page.md", "Files")}


def test_what_no_page_has_and_what_nothing_says_are_told(made_up: Path):
    (made_up / "page.md").write_text(PAGE.replace("empty", "void"))

    missing = {message.form for message in messages.unexplained()}
    (old,) = messages.outdated()

    assert missing == FORMS - {"`code` in it is told, too."}
    assert old.form == "the file … is void; get another one."


def test_every_message_is_explained_and_no_page_explains_what_nothing_says(monkeypatch: pytest.MonkeyPatch):
    said = list(messages.messages())
    monkeypatch.setattr(messages, "messages", lambda: said)

    missing = [f"{message.file}:{message.line}: {message.form}" for message in messages.unexplained()]

    # `PYTHONPATH=.:docs python -m making.messages` prints them as points for docs/when-it-goes-wrong/.
    assert missing == []
    assert messages.outdated() == []
    assert len(said) > 800


@pytest.mark.parametrize("page", sorted(messages.PAGES.glob("*.md")), ids=lambda page: page.stem)
def test_whatever_is_listed_is_followed_by_what_to_do(page: Path):
    for group in re.split(r"^## ", page.read_text(), flags=re.MULTILINE)[1:]:
        heading, *lines = group.splitlines()
        points = [number for number, line in enumerate(lines) if line.startswith("- `")]
        if points:
            assert len(" ".join(lines[points[-1] + 1 :])) > 25, heading
