"""The comparison of two checkouts reports differences and ignores values that change in each run."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import same_outputs
from outputs import inputs
from outputs.differences import Difference, ExpectedDifference, find_differences, matches
from outputs.jobs import QUICK_PATTERNS, Job, list_jobs
from outputs.leaves import collect_folder_leaves, collect_json_leaves, count_lines
from same_outputs import Side, compare_job, conclude


def list_differences(first, second):
    return [str(one) for one in find_differences(first, second)]


def test_json_is_compared_by_values_without_values_of_one_run():
    document = {
        "b": [1, {"c": None}],
        "seconds": 3.1,
        "stage": {"compute_seconds": 1, "path": "/here/out/a.ply"},
        "e": [],
    }
    places = {"/here": "{a}", "/here/out": "{out}"}
    assert collect_json_leaves(document, "r.json", places) == {
        "r.json:b.0": "1",
        "r.json:b.1.c": "null",
        "r.json:stage.path": '"{out}/a.ply"',
        "r.json:e": "[]",
    }


def test_lines_are_counted_without_their_seconds():
    assert count_lines("done in 1.2 s\ndone in 31 s\n\n5 sheets", "log", {}) == {
        "log: done in SECONDS": "2",
        "log: 5 sheets": "1",
    }


def test_archives_are_compared_by_members(tmp_path: Path):
    arrays = {"same": np.arange(50), "other": np.ones(50)}
    np.savez(tmp_path / "record.npz", **arrays)
    plain = collect_folder_leaves(tmp_path, {})
    np.savez_compressed(tmp_path / "record.npz", **arrays)
    assert set(plain) == {"record.npz:same.npy", "record.npz:other.npy"}
    assert list_differences(plain, collect_folder_leaves(tmp_path, {})) == []
    np.savez(tmp_path / "record.npz", same=arrays["same"], other=np.zeros(50))
    assert list_differences(plain, collect_folder_leaves(tmp_path, {})) == ["changed record.npz:other.npy"]


def test_cache_entries_are_compared_by_stage(tmp_path: Path):
    for side, keys in (("a", "12"), ("b", "43")):
        for key, text in zip(keys, ("one", "two"), strict=True):
            entry = tmp_path / side / "cache" / "fuse" / (64 * key)
            entry.mkdir(parents=True)
            (entry / "fused.ply").write_text(text)
            (entry / "manifest.json").write_text(f'{{"key": "{key}"}}')
    first, second = (collect_folder_leaves(tmp_path / side, {}) for side in "ab")
    assert set(first) == {"cache/fuse/KEY/fused.ply #0", "cache/fuse/KEY/fused.ply #1"}
    assert first == second


def test_a_difference_is_changed_gone_or_new():
    first = {"a.ply": "1", "j:x": "1", "j:y": "2", "same": "0"}
    second = {"a.ply": "2", "j:x": "1", "j:z": "3", "same": "0", "b.ply": "2"}
    assert list_differences(first, second) == ["changed a.ply", "new b.ply", "gone j:y", "new j:z"]


def test_a_value_under_another_name_is_moved():
    nested = (
        {"j:proven": "true", "j:fitted": "true"},
        {"j:details.proven": "true", "j:details.fitted": "true"},
    )
    assert list_differences(*nested) == [
        "moved j:fitted -> j:details.fitted",
        "moved j:proven -> j:details.proven",
    ]
    assert list_differences({"j:max_texture": "30"}, {"j:max_color": "30"}) == [
        "moved j:max_texture -> j:max_color"
    ]
    # Ambiguous: either of the two new values may be the moved value.
    assert list_differences({"j:a": "0"}, {"j:b": "0", "j:c": "0"}) == ["gone j:a", "new j:b", "new j:c"]
    assert list_differences({"j:a.0": "0", "j:b.0": "0"}, {"j:d.a.0": "0", "j:d.b.0": "0"}) == [
        "moved j:a.0 -> j:d.a.0",
        "moved j:b.0 -> j:d.b.0",
    ]
    # With a changed value, a move needs the same last part of the name.
    assert list_differences({"j:a": "0"}, {"j:d.a": "1"}) == ["changed j:a -> j:d.a"]
    assert list_differences({"j:a": "0"}, {"j:b": "1"}) == ["gone j:a", "new j:b"]
    # Values do not move between documents; files and lines have no nested names.
    assert list_differences({"j:a": "0"}, {"k:a": "0"}) == ["gone j:a", "new k:a"]
    assert list_differences({"a.ply": "0", "log: a": "1"}, {"b.ply": "0", "log: b": "1"}) == [
        "gone a.ply",
        "new b.ply",
        "gone log: a",
        "new log: b",
    ]


def test_expected_differences_match_job_and_name():
    moved = Difference("moved", "1 simplify:proven -> 1 simplify:details.proven")
    assert matches("a[0]*", "a[0] and more")
    assert not matches("a*", "ba")
    assert ExpectedDifference("methods/*", "moved * -> *:details.*", "").covers("methods/horse/seams", moved)
    assert not ExpectedDifference("run/*", "moved *", "").covers("methods/horse/seams", moved)
    assert not ExpectedDifference("methods/*", "changed *", "").covers("methods/horse/seams", moved)


def write_checkout(folder: Path, vertices: int) -> Path:
    """Write a replacement for the program that writes a file and prints its path."""
    ours = folder / "scanloom"
    for package in (ours, ours / "stages", ours / "cli"):
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("")
    (ours / "cli" / "app.py").write_text(
        "import json, os, sys\n"
        f"open(sys.argv[1], 'w').write('{vertices} vertices')\n"
        "out = os.path.abspath(sys.argv[1])\n"
        "print(json.dumps({'out': out, 'read': sys.argv[2:], 'seconds': os.getpid()}))\n"
        "print('careful', file=sys.stderr)\n"
        "sys.exit(3)\n"
    )
    return folder


@pytest.fixture
def sides(tmp_path: Path) -> list[Side]:
    # The last side is another program.
    return [
        Side(write_checkout(tmp_path / f"checkout{n}", 3 + n // 2), tmp_path / f"work{n}", identity=str(n))
        for n in range(3)
    ]


JOB = Job("words/one", ("mesh.ply {first}/mesh.ply '{data}/a b.ply'", "other.ply"))


def test_a_job_is_the_same_wherever_it_runs(sides: list[Side], tmp_path: Path):
    row = compare_job(JOB, sides[0], sides[1], {"data": tmp_path})
    assert (row.unexpected, row.expected) == ((), ())
    assert not row.first.is_kept
    assert row.second.leaves == row.first.leaves
    assert row.first.leaves["1 mesh.ply exit code"] == "3"
    assert row.first.leaves["1 mesh.ply:out"] == '"{folder}/mesh.ply"'
    assert row.first.leaves["1 mesh.ply:read.1"] == '"{data}/a b.ply"'
    assert row.first.leaves["2 other.ply stderr: careful"] == "1"
    assert "other.ply" in row.first.leaves
    # Outputs of the first side are kept; outputs of the second side only if they differ.
    assert (sides[0].folder_of(JOB) / "mesh.ply").is_file()
    assert not sides[1].folder_of(JOB).exists()
    assert conclude([row]) == 0


def test_the_first_side_is_kept_until_its_code_or_the_job_changes(sides: list[Side], tmp_path: Path):
    places = {"data": tmp_path}
    before = compare_job(JOB, sides[0], sides[1], places).first
    after = compare_job(JOB, sides[0], sides[1], places).first
    assert after.is_kept
    assert after.leaves == before.leaves
    assert not compare_job(Job(JOB.name, JOB.steps[:1]), sides[0], sides[1], places).first.is_kept
    for identity in ("another commit", None):
        changed = Side(sides[0].checkout, sides[0].work, identity)
        assert not compare_job(JOB, changed, sides[1], places).first.is_kept


def test_another_program_differs_unless_that_is_expected(
    sides: list[Side], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(same_outputs, "EXPECTED", ())
    row = compare_job(JOB, sides[0], sides[2], {"data": tmp_path})
    assert [str(one) for one in row.unexpected] == ["changed mesh.ply", "changed other.ply"]
    assert (sides[2].folder_of(JOB) / "mesh.ply").read_text() == "4 vertices"
    assert conclude([row]) == 1
    assert "changed mesh.ply: 10 bytes" in capsys.readouterr().out
    meant = (
        ExpectedDifference("words/*", "changed *.ply", "four is better"),
        ExpectedDifference("words/*", "gone *", "none"),
    )
    monkeypatch.setattr(same_outputs, "EXPECTED", meant)
    row = compare_job(JOB, sides[0], sides[2], {"data": tmp_path})
    assert (row.unexpected, len(row.expected)) == ((), 2)
    assert conclude([row]) == 0
    out = capsys.readouterr().out
    assert "four is better" in out
    assert "expected, but not seen: words/*: gone *" in out


def test_job_names_are_unique_and_their_snippets_exist(shared_data: Path):
    jobs = list_jobs(shared_data)
    assert len({job.name for job in jobs}) == len(jobs)
    # Folders of jobs must not be nested.
    assert not {str(Path(job.name).parent) for job in jobs} & {job.name for job in jobs}
    for pattern in QUICK_PATTERNS:
        assert any(matches(pattern, job.name) for job in jobs)
    snippets = {
        word for job in jobs for step in job.steps for word in step.split()[:1] if word.endswith(".py")
    }
    assert snippets == {path.name for path in same_outputs.SNIPPETS.iterdir() if path.suffix == ".py"}


@pytest.mark.slow
def test_made_inputs_are_deterministic(tmp_path: Path):
    sample = Path(__file__).parents[2] / "samples" / "rgbd"
    for name in "ab":
        inputs.write_inputs(tmp_path / name, sample)
    first, second = (collect_folder_leaves(tmp_path / name, {}) for name in "ab")
    assert first == second
    assert {"realsense.bag", "ros2.mcap", "cut_0.5_ros2.db3"} <= set(first)
