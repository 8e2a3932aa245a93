"""Scan discovery: which folders are scans, and their names."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from small_scans import write_small_scan

from scanloom.pipeline.batch.scan_discovery import find_scans
from scanloom.stages.diagnostics.errors import InputError


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    folder = tmp_path / "scans"
    for name in ("kitchen", "floor-1/hall", "floor-1/room", "floor-2/deep/cellar"):
        write_small_scan(folder / name, frames=2)
    return folder


def list_names(folder: Path, **how: object) -> list[str]:
    return [one.name for one in find_scans(folder, **how)[0]]  # type: ignore[arg-type]


def test_scans_are_named_by_their_relative_path(scans: Path):
    assert list_names(scans) == ["floor-1/hall", "floor-1/room", "floor-2/deep/cellar", "kitchen"]
    assert {one.layout for one in find_scans(scans)[0]} == {"plain-rgbd"}


def test_subfolders_of_a_scan_are_not_searched(scans: Path):
    write_small_scan(scans / "kitchen" / "again", frames=2)
    assert "kitchen/again" not in list_names(scans)


def test_a_folder_that_is_a_scan_is_the_only_one(scans: Path):
    assert list_names(scans / "kitchen") == ["kitchen"]


def test_folders_without_scans_are_reported_once(scans: Path):
    (scans / "notes" / "of" / "may").mkdir(parents=True)
    (scans / "notes" / "of" / "may" / "text.txt").write_text("rain")
    (scans / "floor-1" / "empty").mkdir()
    (scans / "zed").mkdir()
    (scans / "zed" / "take.svo").write_bytes(b"svo")
    (scans / ".hidden").mkdir()
    reasons = {one.path.relative_to(scans).as_posix(): one.reason for one in find_scans(scans)[1]}
    assert reasons.keys() == {"notes", "floor-1/empty", "zed"}
    assert reasons["notes"] == "its layout is unknown"
    assert reasons["floor-1/empty"] == "it is empty"
    assert reasons["zed"].startswith("this looks like a ZED recording (.svo)")


def test_each_recording_of_a_folder_is_a_scan(scans: Path):
    (scans / "one").mkdir()
    (scans / "one" / "take.bag").write_bytes(b"#ROSBAG V2.0\n")
    (scans / "two").mkdir()
    for name in ("a.bag", "b.mcap"):
        (scans / "two" / name).write_bytes(b"")
    (scans / "top.r3d").write_bytes(b"")
    found = {one.name: one.layout for one in find_scans(scans)[0]}
    # A single recording gets the name of its folder, as in `run`.
    assert found["one"] == found["two/a.bag"] == found["two/b.mcap"]
    assert found["top.r3d"] == "record3d"
    assert "kitchen" in found


def test_the_files_of_a_split_recording_are_one_scan(tmp_path: Path):
    folder = tmp_path / "scans" / "take"
    folder.mkdir(parents=True)
    for name in ("take_0.db3", "take_1.db3"):
        (folder / name).write_bytes(b"")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    assert list_names(tmp_path / "scans") == ["take"]


def test_links_are_followed_without_endless_loops(scans: Path, tmp_path: Path):
    shutil.move(scans / "kitchen", tmp_path / "elsewhere")
    (scans / "kitchen").symlink_to(tmp_path / "elsewhere")
    (scans / "floor-1" / "up").symlink_to(scans)
    assert list_names(scans) == ["floor-1/hall", "floor-1/room", "floor-2/deep/cellar", "kitchen"]


def test_patterns_include_and_exclude_scans(scans: Path):
    assert list_names(scans, include=["floor-1/*"]) == ["floor-1/hall", "floor-1/room"]
    assert list_names(scans, include=["floor-1/*", "kitchen"], exclude=["*/room"]) == [
        "floor-1/hall",
        "kitchen",
    ]


def test_excluded_folders_are_not_searched(scans: Path):
    write_small_scan(scans / "out" / "copy", frames=2)
    assert "out/copy" not in list_names(scans, excluded_folders=[scans / "out"])


def test_a_given_layout_makes_every_folder_a_scan(scans: Path):
    (scans / "bare").mkdir()
    assert list_names(scans, layout="tum") == ["bare", "floor-1", "floor-2", "kitchen"]


@pytest.mark.parametrize(
    ("name", "message"), [("none", "there is no such folder"), ("file", "this is a file")]
)
def test_a_missing_folder_is_refused(tmp_path: Path, name: str, message: str):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=message):
        find_scans(tmp_path / name)
