"""Every code is explained on a page and emitted somewhere, and every diagnostic has a code."""

import re
from collections import Counter

import pytest
from making import diagnostics


def test_topics_are_on_one_page_each():
    topics = Counter(topic for page in diagnostics.PAGE_TABLE.values() for topic in page.topics)
    assert set(topics.values()) == {1}
    assert {one.name.partition(".")[0] for one in diagnostics.find_codes()} == set(topics)


def test_there_are_few_codes_with_stable_names():
    codes = diagnostics.find_codes()
    assert len(codes) > 100
    # Programs distinguish codes and people look them up; a longer list would be too fine for both.
    assert len(codes) < 300
    for one in codes:
        assert re.fullmatch(r"[a-z]+\.[a-z]+(-[a-z]+)*", one.name), one.name
    names = diagnostics.find_constants()
    assert set(names.values()) == {one.name for one in codes}
    for constant, name in names.items():
        assert constant == name.upper().replace(".", "_").replace("-", "_")


@pytest.mark.parametrize("code", diagnostics.find_codes(), ids=lambda one: one.name)
def test_codes_are_explained(code):
    assert len(code.explanation.split()) > 5
    assert "…" not in code.example
    assert len(code.example.split()) > 2


def test_each_code_is_used():
    """An unused code must not be documented."""
    used = set()
    for path in diagnostics._find_sources():
        if path.name != "codes.py":
            used |= set(re.findall(r"\b[A-Z][A-Z0-9_]+\b", path.read_text(encoding="utf-8")))
    assert sorted(set(diagnostics.find_constants()) - used) == []


def test_messages_are_found_next_to_their_codes():
    found = list(diagnostics.find_messages())
    assert len(found) > 800
    constants = {one.constant for one in found if one.text == "the folder is empty."}
    constants |= {one.constant for one in found if one.text == "this is a folder"}
    assert "FILE_PATH_INVALID" in constants
    assert all("{" not in one.text for one in found if one.text.count("…") == 1)


@pytest.mark.parametrize("page", diagnostics.PAGE_TABLE)
def test_pages_are_current(page):
    # Regenerate them with `PYTHONPATH=.:docs python -m making.diagnostics`.
    assert (diagnostics.PAGES / f"{page}.md").read_text(encoding="utf-8") == diagnostics.write_page(page)
