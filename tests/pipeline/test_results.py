"""Files in the output folder, and events during a run."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

from scanloom.pipeline.cache.digest import compute_file_digest
from scanloom.pipeline.run.events import StageFinished, StageProgress, StageStarted
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import InputError, StageError

NAMES = ["cut.bin", "mixed.bin", "tables/counts.txt"]


def list_files(out):
    """List the visible files in the output folder."""
    found = [path.relative_to(out) for path in out.rglob("*") if path.is_file()]
    return sorted(str(path) for path in found if path.parts[0] != "cache")


def read_files(out):
    return [(out / name).read_bytes() for name in list_files(out)]


def fail(inputs, params, context):  # noqa: ARG001
    raise InputError(MACHINE_BUG, "no such luck", context.folder)


@pytest.fixture
def out(toy, scan, tmp_path):
    """Make an output folder with the results of a first run."""
    toy.run(scan, tmp_path / "out")
    return tmp_path / "out"


def test_results_have_plain_names(toy, scan, out):
    assert list_files(out) == NAMES
    outcomes = toy.run(scan, out)
    assert [path.relative_to(out).as_posix() for o in outcomes for path in o.results] == [
        "mixed.bin",
        "cut.bin",
        "tables/counts.txt",
    ]


def test_unchanged_results_are_not_written_again(toy, scan, out):
    before = [(out / name).stat() for name in NAMES]
    toy.run(scan, out)
    after = [(out / name).stat() for name in NAMES]
    assert [(s.st_ino, s.st_mtime_ns) for s in after] == [(s.st_ino, s.st_mtime_ns) for s in before]


def test_changed_and_deleted_results_are_restored(toy, scan, out):
    expected = read_files(out)
    (out / "mixed.bin").write_bytes(b"edited")
    (out / "cut.bin").unlink()
    data = bytearray((out / "tables" / "counts.txt").read_bytes())
    data[0] ^= 1
    (out / "tables" / "counts.txt").write_bytes(data)
    assert all(outcome.cached for outcome in toy.run(scan, out, overwrite=True))
    assert read_files(out) == expected


def test_editing_a_result_does_not_change_the_cache(toy, scan, out):
    with (out / "mixed.bin").open("r+b") as file:
        file.write(b"edited in place")
    warnings = []
    assert all(outcome.cached for outcome in toy.run(scan, out, warnings=warnings, overwrite=True))
    assert warnings == []


def test_edited_files_are_replaced_only_on_request(toy, scan, out):
    edited = out / "tables" / "counts.txt"
    edited.write_bytes(b"edited")
    with pytest.raises(
        InputError, match=r"counts\.txt: this file was not written by a run, or was edited since"
    ):
        toy.run(scan, out)
    with pytest.raises(InputError, match=r"counts\.txt"):
        toy.run(scan, out, "cut.far=3")
    assert edited.read_bytes() == b"edited"
    assert toy.run(scan, out, "cut.far=3", overwrite=True)
    assert edited.read_bytes() != b"edited"
    # A replaced file belongs to the run again.
    assert toy.run(scan, out)


def test_old_results_are_removed_before_their_stage_runs(toy, scan, out):
    plan = (toy.PLAN[0], replace(toy.PLAN[1], run=fail), toy.PLAN[2])
    with pytest.raises(InputError, match="no such luck"):
        toy.run(scan, out, "cut.far=3", plan=plan)
    assert list_files(out) == ["mixed.bin"]
    assert toy.run(scan, out)
    assert list_files(out) == NAMES


def test_files_of_users_stay(toy, scan, out):
    (out / "mine.txt").write_text("mine")
    (out / "tables" / "mine.txt").write_text("mine")
    (out / "cut.bin").write_bytes(b"edited")
    plan = (toy.PLAN[0], replace(toy.PLAN[1], run=fail), toy.PLAN[2])
    with pytest.raises(InputError):
        toy.run(scan, out, "cut.far=3", plan=plan)
    assert list_files(out) == ["cut.bin", "mine.txt", "mixed.bin", "tables/mine.txt"]
    assert (out / "cut.bin").read_bytes() == b"edited"


def test_until_removes_outdated_later_results(toy, scan, out):
    assert [o.stage for o in toy.run(scan, out, "mix.gain=0.25", until="cut")] == ["mix", "cut"]
    assert list_files(out) == ["cut.bin", "mixed.bin"]


def test_until_keeps_valid_later_results(toy, scan, out):
    assert [o.cached for o in toy.run(scan, out, until="mix")] == [True]
    assert list_files(out) == NAMES


def test_files_that_a_stage_no_longer_writes_are_removed(toy, scan, out):
    def count_otherwise(inputs, params, context):  # noqa: ARG001
        (context.folder / "tables").mkdir()
        (context.folder / "tables" / "other.txt").write_text("4")
        return {}

    plan = (*toy.PLAN[:2], replace(toy.PLAN[2], versions=toy.at(count=2), run=count_otherwise))
    toy.run(scan, out, plan=plan)
    assert list_files(out) == ["cut.bin", "mixed.bin", "tables/other.txt"]


def test_output_inside_the_scan_folder_changes_nothing(toy, scan):
    before = list_files(scan)
    toy.run(scan, scan / "out")
    assert all(outcome.cached for outcome in toy.run(scan, scan / "out"))
    assert [name for name in list_files(scan) if not name.startswith("out/")] == before


def test_cache_elsewhere_is_shared_by_output_folders(toy, scan, tmp_path):
    cache = tmp_path / "shared"
    toy.run(scan, tmp_path / "a", cache=cache)
    assert all(outcome.cached for outcome in toy.run(scan, tmp_path / "b", cache=cache))
    assert list_files(tmp_path / "b") == NAMES
    assert not (tmp_path / "b" / "cache").exists()


def test_drafts_of_killed_copies_are_removed(toy, scan, out):
    (out / ".cut.bin.0123abcd.part").write_bytes(b"half")
    toy.run(scan, out)
    assert list_files(out) == NAMES


def test_full_disk_while_results_are_placed(toy, scan, out, monkeypatch):
    (out / "cut.bin").unlink()

    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("scanloom.pipeline.cache.atomic_files.shutil.copyfile", refuse)
    with pytest.raises(StageError, match=r"results cannot be written to .*: the disk is full"):
        toy.run(scan, out)
    assert list_files(out) == ["mixed.bin", "tables/counts.txt"]


def test_system_failures_in_a_stage_are_one_sentence(toy, scan, tmp_path):
    def starve(*_):
        raise MemoryError

    def lose(inputs, params, context):  # noqa: ARG001
        (context.folder / "none").read_bytes()

    for work, message in (
        (starve, "cut failed: out of memory"),
        (lose, r"cut failed: No such file.*none"),
    ):
        with pytest.raises(StageError, match=message):
            toy.run(scan, tmp_path / "out", plan=(toy.PLAN[0], replace(toy.PLAN[1], run=work), toy.PLAN[2]))


def test_scan_that_changes_while_a_stage_reads_it_is_not_kept(toy, scan, tmp_path):
    def slow(inputs, params, context):
        metrics = toy.mix(inputs, params, context)
        (scan / "01.raw").write_bytes(bytes(64))
        return metrics

    plan = (replace(toy.PLAN[0], run=slow), *toy.PLAN[1:])
    with pytest.raises(StageError, match=r"01\.raw changed while it was being read"):
        toy.run(scan, tmp_path / "out", plan=plan)
    assert list_files(tmp_path / "out") == []
    assert [o.cached for o in toy.run(scan, tmp_path / "out")] == [False] * 3


def test_events_report_the_progress_of_a_run(toy, scan, tmp_path):
    told = []
    toy.run(scan, tmp_path / "out", events=told.append, until="mix")
    assert told[:4] == [
        StageStarted("mix", "first run"),
        StageProgress("mix", 1, 3),
        StageProgress("mix", 2, 3),
        StageProgress("mix", 3, 3),
    ]
    [finished] = told[4:]
    assert isinstance(finished, StageFinished)
    assert (finished.stage, finished.cached, finished.reason) == ("mix", False, "first run")
    assert finished.metrics["worst_m"] is None, "infinity is no JSON"
    assert finished.results == (tmp_path / "out" / "mixed.bin",)
    told.clear()
    toy.run(scan, tmp_path / "out", events=told.append, until="mix")
    assert [(e.stage, e.cached, e.reason) for e in told] == [("mix", True, "")]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the peak is that of the whole run")
def test_peak_memory_is_measured_per_stage(toy, scan, tmp_path):
    def hungry(inputs, params, context):
        block = bytearray(200_000_000)
        block[::4096] = b"x" * len(block[::4096])
        return toy.mix(inputs, params, context)

    plan = (replace(toy.PLAN[0], run=hungry), *toy.PLAN[1:])
    mix, cut, _ = toy.run(scan, tmp_path / "out", plan=plan)
    assert mix.compute_cost["peak_memory_bytes"] > 200_000_000
    assert cut.compute_cost["peak_memory_bytes"] < mix.compute_cost["peak_memory_bytes"] - 100_000_000


@pytest.mark.slow
def test_two_runs_with_other_parameters_take_turns(toy, scan, tmp_path):
    out = tmp_path / "out"
    commands = [
        [sys.executable, toy.__file__, str(scan), str(out), f"mix.gain={gain}"] for gain in (0.1, 0.2, 0.3)
    ]
    processes = [subprocess.Popen(command) for command in commands]
    assert [process.wait() for process in processes] == [0, 0, 0]
    alone = []
    for gain in (0.1, 0.2, 0.3):
        toy.run(scan, tmp_path / str(gain), f"mix.gain={gain}")
        alone.append(read_files(tmp_path / str(gain)))
    assert read_files(out) in alone


NESTED = "[" * 500 + "]" * 500


def format_record(text):
    return f'{{"mix": {{"placed": {{}}, "decided": {text}}}}}'


@pytest.mark.parametrize(
    "stages",
    [
        *("[]", "1", '{"mix": 1}', '{"mix": {}}', '{"mix": {"placed": [], "decided": {}}}', NESTED),
        '{"mix": {"placed": {}, "decided": {"recipe": 1, "parts": 2}}}',
        format_record('{"recipe": {"params": {"mix": 1}, "libraries": {}}, "parts": {}}'),
        format_record('{"recipe": {"params": {}, "libraries": 1}, "parts": {"frames": 1}}'),
        format_record(NESTED),
    ],
)
def test_a_damaged_record_gives_no_reasons(toy, scan, out, stages):
    [record] = (out / "cache" / "runs").glob("*.json")
    record.write_text(f'{{"schema": 1, "keys": [], "stages": {stages}}}')
    (scan / "01.raw").write_bytes(bytes(64))
    # Without a valid record, the owner of the files is unknown.
    outcomes = toy.run(scan, out, overwrite=True)
    assert outcomes[0].reason == "first run"
    assert list_files(out) == NAMES


def test_a_record_cannot_remove_files_outside_the_folder(toy, scan, out):
    mine = out.parent / "mine.txt"
    mine.write_bytes(b"mine")
    [record] = (out / "cache" / "runs").glob("*.json")
    content = compute_file_digest(mine)
    for name in ("../mine.txt", str(mine)):
        document = json.loads(record.read_text())
        document["stages"]["other"] = document["stages"]["mix"] | {"placed": {name: content}}
        record.write_text(json.dumps(document))
        toy.run(scan, out, "cut.far=3" if name.startswith(".") else "cut.far=4")
        assert mine.exists()
