"""Inputs that decide about a cache hit, and inputs that do not."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from scanloom.pipeline.cache.entry import Recipe

ALL = ["mix", "cut", "count"]


def list_computed(outcomes):
    return [outcome.stage for outcome in outcomes if not outcome.cached]


@pytest.fixture
def out(toy: ModuleType, scan: Path, tmp_path: Path) -> Path:
    """Make an output folder with the results of a first run."""
    assert list_computed(toy.run(scan, tmp_path / "out")) == ALL
    return tmp_path / "out"


def test_second_run_is_all_cached(toy, scan, out):
    assert list_computed(toy.run(scan, out)) == []


def test_touched_files_keep_the_cache(toy, scan, out):
    for path in scan.iterdir():
        os.utime(path, (1, 1))
    assert list_computed(toy.run(scan, out)) == []


def test_rewritten_files_of_the_same_content_keep_the_cache(toy, scan, out):
    for path in scan.iterdir():
        data = path.read_bytes()
        path.unlink()
        path.write_bytes(data)
    assert list_computed(toy.run(scan, out)) == []


def test_moved_scan_keeps_the_cache(toy, scan, out, tmp_path):
    moved = tmp_path / "elsewhere" / "renamed scan"
    moved.parent.mkdir()
    scan.rename(moved)
    assert list_computed(toy.run(moved, out)) == []


def test_moved_output_folder_keeps_its_cache_and_its_record(toy, scan, out, tmp_path):
    moved = tmp_path / "other" / "results"
    shutil.move(out, moved)
    outcomes = toy.run(scan, moved, "cut.far=3")
    assert list_computed(outcomes) == ["cut", "count"]
    assert outcomes[1].reason == "params changed: far not set → 3"


def test_renamed_frames_in_the_same_order_keep_the_cache(toy, scan, out):
    for path in scan.iterdir():
        path.rename(path.with_name(f"image-{path.name}"))
    assert list_computed(toy.run(scan, out)) == []


def test_current_folder_does_not_matter(toy, scan, out, monkeypatch):
    monkeypatch.chdir(scan)
    assert list_computed(toy.run(Path(), Path("..") / out.name)) == []


def test_thread_count_keeps_the_cache(toy, scan, out):
    assert list_computed(toy.run(scan, out, "mix.threads=7", "cut.soft.previews=3")) == []


@pytest.mark.parametrize(
    ("assignment", "expected", "reason"),
    [
        ("mix.gain=0.25", ALL, "params changed: gain 0.5 → 0.25"),
        ("cut.far=3", ["cut", "count"], "params changed: far not set → 3"),
        ("cut.mode=soft", ["cut"], "params changed: mode hard → soft"),
        ("cut.soft.width=0.2", ["cut"], "params changed: soft.width 0.1 → 0.2"),
        ("count.bins=5", ["count"], "params changed: bins 4 → 5"),
        ("count.exact=no", ["count"], "params changed: exact True → False"),
    ],
)
def test_a_changed_parameter_reruns_its_stage_and_later_stages(toy, scan, out, assignment, expected, reason):
    # `mode` leaves the bytes of cut.bin unchanged, so count does not run again.
    outcomes = toy.run(scan, out, assignment)
    assert list_computed(outcomes) == expected
    assert next(o for o in outcomes if not o.cached).reason == reason
    assert list_computed(toy.run(scan, out)) == [], "the earlier results are still there"


def test_whole_number_and_number_are_one_value(toy, scan, out):
    toy.run(scan, out, "cut.far=3")
    assert list_computed(toy.run(scan, out, "cut.far=3.0")) == []


@pytest.mark.parametrize("keep_stamp", [False, True])
def test_changed_content_reruns_even_under_the_old_time_stamp(toy, scan, out, keep_stamp):
    path = scan / "01.raw"
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[5] ^= 1
    path.write_bytes(data)
    if keep_stamp:
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    outcomes = toy.run(scan, out)
    assert list_computed(outcomes) == ALL
    assert outcomes[0].reason == "input changed: frame 1 (01)"


def test_swapping_frames_changes_the_scan(toy, scan, out):
    (scan / "00.raw").rename(scan / "aside")
    (scan / "01.raw").rename(scan / "00.raw")
    (scan / "aside").rename(scan / "01.raw")
    assert list_computed(toy.run(scan, out)) == ALL


def test_adding_or_removing_frames_changes_the_scan(toy, scan, out):
    (scan / "02.raw").unlink()
    outcomes = toy.run(scan, out)
    assert list_computed(outcomes) == ALL
    assert outcomes[0].reason == "input changed: frame 2 (02)"


def test_raised_version_of_a_result_reruns(toy, scan, out):
    plan = (toy.PLAN[0], replace(toy.PLAN[1], versions=toy.at(cut=2)), toy.PLAN[2])
    outcomes = toy.run(scan, out, plan=plan)
    assert list_computed(outcomes) == ["cut"]
    assert outcomes[1].reason == "stage changed: version of cut 1 → 2"


def test_versions_of_a_stage_may_depend_on_its_parameters(toy, scan, out):
    # Like simplify, which runs one of several methods.
    def versions(inputs, config):  # noqa: ARG001
        return {"cut": 1, **({"soft": 7} if config.cut.mode == "soft" else {})}

    plan = (toy.PLAN[0], replace(toy.PLAN[1], versions=versions), toy.PLAN[2])
    assert list_computed(toy.run(scan, out, plan=plan)) == []
    outcomes = toy.run(scan, out, "cut.mode=soft", plan=plan)
    assert outcomes[1].reason == "params changed: mode hard → soft", "no reason of its own"
    plan = (toy.PLAN[0], replace(toy.PLAN[1], versions=toy.at(cut=1, soft=8)), toy.PLAN[2])
    outcomes = toy.run(scan, out, "cut.mode=soft", plan=plan)
    assert outcomes[1].reason == "stage changed: version of soft 7 → 8"


def test_an_additional_version_reruns(toy, scan, out):
    plan = (toy.PLAN[0], replace(toy.PLAN[1], versions=toy.at(cut=1, inner=3)), toy.PLAN[2])
    outcomes = toy.run(scan, out, plan=plan)
    assert list_computed(outcomes) == ["cut"]
    assert outcomes[1].reason == "stage changed: version of inner unknown → 3"


def test_other_library_reruns(toy, scan, out):
    plan = (replace(toy.PLAN[0], libraries={"numpy": "0.1"}), *toy.PLAN[1:])
    outcomes = toy.run(scan, out, plan=plan)
    assert list_computed(outcomes) == ["mix"]
    assert outcomes[0].reason.startswith("library changed: numpy ")


def test_a_forced_stage_runs_and_later_stages_hit_the_cache(toy, scan, out):
    outcomes = toy.run(scan, out, force=("cut",))
    assert list_computed(outcomes) == ["cut"]
    assert outcomes[1].reason == "forced"


def test_every_field_of_a_recipe_decides_the_key():
    base = Recipe("fuse", {"fuse": 1}, {"fuse": {"voxel_size": 0.01}}, {"scan": "a"}, {"open3d": "0.20"})
    others = [
        replace(base, stage="clean"),
        replace(base, versions={"fuse": 2}),
        replace(base, versions={"fuse": 1, "survey": 1}),
        replace(base, params={"fuse": {"voxel_size": 0.02}}),
        replace(base, params={"fuse": {"voxel_size": None}}),
        replace(base, inputs={"scan": "b"}),
        replace(base, inputs={"frames": "a"}),
        replace(base, libraries={"open3d": "0.19"}),
    ]
    assert len({base.key, *(other.key for other in others)}) == 1 + len(others)
    assert replace(base, params={"fuse": {"voxel_size": 0.01}}).key == base.key


def test_only_a_result_deleted_from_the_cache_is_computed_again(toy, scan, out):
    shutil.rmtree(out / "cache" / "cut")
    outcomes = toy.run(scan, out)
    assert list_computed(outcomes) == ["cut"]
    assert outcomes[1].reason == "no longer in the cache"


@pytest.mark.parametrize("stage", ALL)
def test_only_a_damaged_result_is_computed_again_with_the_same_bytes(toy, scan, out, stage):
    def contents():
        return {path.name: path.read_bytes() for path in out.rglob("*") if path.suffix in (".bin", ".txt")}

    before = contents()
    [damaged] = [path for path in (out / "cache" / stage).rglob("*") if path.suffix in (".bin", ".txt")][:1]
    damaged.write_bytes(b"\0" * damaged.stat().st_size)
    warnings = []
    assert list_computed(toy.run(scan, out, warnings=warnings)) == [stage]
    assert damaged.name in warnings[0]
    assert contents() == before
