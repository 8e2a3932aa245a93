"""Diagnostics that only differ in their file become one, which says how many there are."""

from scanloom.stages.diagnostics.collector import merge_repeated
from scanloom.stages.files.codes import FILE_DAMAGED


def test_equal_sentences_of_several_files_are_one() -> None:
    found = [FILE_DAMAGED.warning("it is {what}", f"{name}.png", what="odd") for name in "abc"]
    other = FILE_DAMAGED.warning("it is {what}", "b.png", remedy="copy it", what="odd")
    whole = FILE_DAMAGED.warning("nothing is known")
    first, second, third = merge_repeated([found[0], whole, found[1], other, found[2]])
    assert str(first) == "a.png: it is odd (and 2 more files)"
    assert (first.code, first.values) == ("file.damaged", {"what": "odd", "more_files": 2})
    assert (second, third) == (whole, other)
