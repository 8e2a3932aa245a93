from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.image_folders.image_files import list_images, match_by_number


def paths(*names):
    return [Path(f"{name}.png") for name in names]


def paired(left, right):
    pairs, alone = match_by_number(paths(*left), paths(*right), "left/", "right/", Path("scan"))
    return [(one.stem, other.stem) for one, other in pairs], sorted(frame.name for frame in alone)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (["1", "2", "10"], ["1", "2", "10"]),
        (["left01", "left02"], ["right01", "right02"]),
        (["cam0_0001", "cam0_0002"], ["cam1_0001", "cam1_0002"]),
        # The first two only agree in time by chance; the frame number agrees for all.
        (["0001-000000", "0002-033369", "0003-066704"], ["0001-000000", "0002-041667", "0003-075001"]),
        (["a", "b"], ["a", "b"]),
        (["dawn", "noon"], ["early", "late"]),
    ],
)
def test_names_of_one_moment_are_paired(left, right):
    assert paired(left, right) == (list(zip(left, right, strict=True)), [])


def test_images_without_partner_are_skipped_on_both_sides():
    assert paired(["1", "2", "3"], ["2", "3", "4"]) == ([("2", "2"), ("3", "3")], ["1", "4"])


def test_counts_that_differ_are_never_paired_in_order():
    with pytest.raises(InputError, match="left/ has 2 images and right/ has 3"):
        paired(["dawn", "noon"], ["x", "y", "z"])


def test_images_are_ordered_by_number(tmp_path):
    for name in ("10.png", "2.png", "1.JPG", ".hidden.png", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in list_images(tmp_path)] == ["1.JPG", "2.png", "10.png"]


def test_numbers_that_agree_by_chance_give_no_pairs():
    # Two clocks: one of twenty names has the same ending.
    left = [f"{100 + i}-{7000 + i}" for i in range(20)]
    right = [f"{300 + i}-{9000 + i}" for i in range(18)] + ["318-7004"]
    with pytest.raises(InputError, match="left/ has 20 images and right/ has 19"):
        paired(left, right)
    assert paired(left[:19], right) == (list(zip(left[:19], right, strict=True)), [])
