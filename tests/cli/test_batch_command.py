"""Commands `batch` and `worker`: discovery, messages, written files and exit codes."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import browsers
import pytest
from small_scans import write_small_scan, write_small_scans

from scanloom.pipeline.batch import open_batch
from scanloom.pipeline.batch.claims import RELEASED, Claim, Claims
from scanloom.pipeline.batch.job_queue import read_current_queue
from scanloom.pipeline.batch.job_records import FAILED, UNUSABLE, JobRecord, JobRecords

Run = Callable[..., Any]
SCANLOOM = [sys.executable, "-m", "scanloom.cli.app"]
QUICK = ("--until", "adjust", "--jobs", 1, "--set", "worker.threads=1")


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """Write two scans, one unreadable scan, and a folder that is not a scan."""
    folder = write_small_scans(tmp_path / "scans", 2)
    write_small_scan(folder / "more" / "broken", 7)
    (folder / "more" / "broken" / "scan.json").write_text("{")
    (folder / "notes").mkdir()
    (folder / "notes" / "plan.txt").write_text("tomorrow")
    return folder


@pytest.mark.slow
def test_batch_reports_the_state_of_every_scan(scanloom: Run, scans: Path, tmp_path: Path):
    out = tmp_path / "out"
    ran = scanloom("batch", scans, "-o", out, *QUICK)
    assert ran.exit_code == 1
    assert f"not a scan: {scans / 'notes'}: its layout is unknown" in ran.stderr
    assert re.search(r"^scan-0001  done, [\d.]+ s", ran.stderr, re.MULTILINE)
    assert "scanloom: 1 of 3 scans are not done: 1 unusable; the table has the reasons." in ran.stderr
    assert re.search(r"^more/broken +unusable", ran.stdout, re.MULTILINE)
    assert re.search(r"^more/broken: .*scan\.json: the file is not valid JSON", ran.stdout, re.MULTILINE)
    assert "2 done, 1 unusable" in ran.stdout
    for name in ("index.html", "batch.csv", "scan-0000/report.json", "cache/adjust"):
        assert (out / name).exists()

    # The second batch only processes changed scans, and reports them in JSON.
    (scans / "more" / "broken").rename(tmp_path / "away")
    again = scanloom("batch", scans, "-o", out, *QUICK, "--json")
    assert again.exit_code == 0
    assert again.json["counts"] == {"done": 2}
    assert [one["scan"] for one in again.json["scans"]] == ["scan-0000", "scan-0001"]
    assert all(one["stages_cached"] == one["stages"] == 1 for one in again.json["scans"])
    assert again.json["no_scans"][-1]["folder"] == str(scans / "notes")


@pytest.mark.slow
def test_a_warning_names_its_scan(scanloom: Run, scans: Path, tmp_path: Path):
    frame = scans / "scan-0001" / "depth-1.png"
    frame.write_bytes(frame.read_bytes()[:80])
    words = ("batch", scans, "-o", tmp_path / "out", "--include", "scan-*", "--until", "fuse", "--jobs", 1)
    words += ("--set", "fuse.max_skipped_ratio=0.5")
    assert scanloom(*words).exit_code == 0
    strict = scanloom(*words, "--strict", "--json")
    assert strict.exit_code == 1
    (warning,) = strict.warnings
    assert warning.startswith("scan-0001: fuse: 1 frame skipped; the first is 1: ")
    assert [len(one["diagnostics"]) for one in strict.json["scans"]] == [0, 1]


@pytest.mark.slow
def test_batch_exits_with_3_if_no_scan_is_usable(scanloom: Run, scans: Path, tmp_path: Path):
    ran = scanloom("batch", scans / "more", "-o", tmp_path / "out", *QUICK, "--json")
    assert ran.exit_code == 3
    assert ran.json["counts"] == {"unusable": 1}
    assert ran.unmet == ["1 of 1 scans are not done: 1 unusable; the table has the reasons."]


def test_a_dry_run_plans_each_scan_and_writes_nothing(scanloom: Run, scans: Path, tmp_path: Path):
    before = sorted(tmp_path.rglob("*"))
    ran = scanloom("batch", scans, "-o", tmp_path / "out", "--dry-run", "--json")
    assert sorted(tmp_path.rglob("*")) == before
    assert ran.exit_code == 0, ran.stderr
    first = ran.json["scans"][1]
    assert (first["scan"], first["layout"], first["refused"]) == ("scan-0000", "plain-rgbd", None)
    assert first["stages"]["fuse"]["reason"] == "first run"
    assert "not valid JSON" in ran.json["scans"][0]["error"]
    assert ran.json["expected_memory_mb"] > 100
    text = scanloom("batch", scans, "-o", tmp_path / "out", "--dry-run").stdout
    assert re.search(r"^scan-0000 +plain-rgbd +4 +8 +0 +", text, re.MULTILINE)


@pytest.mark.slow
def test_any_worker_processes_a_queue(
    scanloom: Run, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out"
    queued = scanloom(
        "batch", scans, "-o", out, "--queue-only", "--until", "adjust", "--set", "worker.worker_timeout=7"
    )
    assert queued.exit_code == 0
    assert f"3 scans queued; start on each machine: scanloom worker {out}" in queued.stdout
    assert not (out / "index.html").exists()
    queue = read_current_queue(out)
    assert queue is not None
    assert queue.settings.take_over_after == 7
    # Scans and results may be moved together.
    shutil.move(scans, tmp_path / "elsewhere" / "scans")
    shutil.move(out, tmp_path / "elsewhere" / "out")
    # The number of concurrent jobs follows from their expected memory, within the total limit.
    monkeypatch.chdir(tmp_path / "elsewhere")
    worked = scanloom("worker", "out", "--set", "limits.memory=1 GB", "--set", "worker.worker_timeout=30")
    assert worked.exit_code == 1
    assert re.search(r"^1 at a time, in 1\.0 GB of memory$", worked.stderr, re.MULTILINE)
    assert re.search(r"^worker \S+, 3 scans$", worked.stderr, re.MULTILINE)
    assert "2 done, 1 unusable" in worked.stdout
    assert (tmp_path / "elsewhere" / "out" / "index.html").is_file()


def test_an_unfinished_batch_is_resumed(scanloom: Run, scans: Path, tmp_path: Path):
    words = ("batch", scans, "-o", tmp_path / "out", "--queue-only", "--until", "adjust")
    assert scanloom(*words).exit_code == 0
    first = read_current_queue(tmp_path / "out")
    again = scanloom(*words)
    assert "an unfinished batch of the same scans is resumed" in again.stderr
    assert read_current_queue(tmp_path / "out") == first
    # No worker is running, and other options make another batch.
    assert scanloom(*words[:-1], "fuse").exit_code == 0
    assert read_current_queue(tmp_path / "out") != first


def test_a_resumed_batch_repeats_failed_scans(scanloom: Run, scans: Path, tmp_path: Path):
    words = ("batch", scans, "-o", tmp_path / "out", "--queue-only", "--until", "adjust")
    assert scanloom(*words).exit_code == 0
    queue = read_current_queue(tmp_path / "out")
    assert queue is not None
    claims, records = Claims(queue.folder / "claims", "gone"), JobRecords(queue.folder / "done")
    for number, state in ((0, UNUSABLE), (1, FAILED)):
        assert claims.take(Claim(number, 0))
        records.write(JobRecord(number, "x", state, "the disk was full"))
    assert "1 scan that failed: run again" in scanloom(*words).stderr
    assert read_current_queue(tmp_path / "out") == queue
    # The claim is released, so that any worker may take the scan although the first worker's state is
    # unknown.
    assert list(records.list_ended()) == [0]
    assert claims.read_claim(Claim(1, 0)).end == RELEASED


def test_a_second_batch_in_the_same_folder_is_refused(
    scanloom: Run, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(open_batch, "_WATCH_SECONDS", 1.0)
    words = ("batch", scans, "-o", tmp_path / "out", "--queue-only", "--until")
    assert scanloom(*words, "adjust").exit_code == 0
    queue = read_current_queue(tmp_path / "out")
    assert queue is not None
    alive, stop = queue.folder / "workers" / "other.alive", threading.Event()
    alive.write_text("000000000000 beats, one each 00002.000 s\n")
    # The heartbeat file of a killed worker does not change, so the folder counts as free after a while.
    assert scanloom(*words, "fuse").exit_code == 0
    queue = read_current_queue(tmp_path / "out")
    assert queue is not None
    alive = queue.folder / "workers" / "other.alive"

    def write_heartbeats() -> None:
        count = 0
        while not stop.wait(0.02):
            count += 1
            alive.write_text(f"{count:012d} beats, one each 00002.000 s\n")

    other = threading.Thread(target=write_heartbeats)
    other.start()
    time.sleep(0.1)
    refused = scanloom(*words, "clean")
    stop.set()
    other.join()
    assert refused.exit_code == 3
    assert "another batch is running in this folder (worker other); wait for its end" in refused.stderr
    assert read_current_queue(tmp_path / "out") == queue


@pytest.mark.slow
def test_sigint_and_sigterm_make_a_worker_release_its_scan(scans: Path, tmp_path: Path):
    out = tmp_path / "out"
    for sent in (signal.SIGINT, signal.SIGTERM):
        shutil.rmtree(out, ignore_errors=True)
        with subprocess.Popen(
            [*SCANLOOM, "batch", str(scans), "-o", str(out), "--include", "scan-*", "--jobs", "1"],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        ) as process:
            deadline = time.monotonic() + 60
            while not list(out.glob("cache/drafts/*/*")) and time.monotonic() < deadline:
                time.sleep(0.01)
            process.send_signal(sent)
            _, message = process.communicate(timeout=60)
        assert process.returncode == 130, message
        assert "scanloom: Interrupted; finished results are kept." in message
        assert not list((out / "cache" / "drafts").iterdir())
        queue = read_current_queue(out)
        assert queue is not None
        assert (queue.folder / "claims" / "000000.0").read_text().endswith("released\n")


@pytest.mark.usefixtures("scans")
@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("batch", "none", "-o", "out"), 3, "none: there is no such folder"),
        (("batch", "empty", "-o", "out"), 3, "empty: the folder contains no scan"),
        (
            ("batch", "scans", "-o", "out", "--include", "x*"),
            3,
            "the folder contains no scan that --include and --exclude select",
        ),
        (
            ("batch", "scans", "-o", "scans"),
            2,
            "the output folder and the cache cannot be the folder of the scans",
        ),
        (
            ("batch", "scans", "-o", "out", "--set", "run.cache=scans"),
            2,
            "the output folder and the cache cannot be",
        ),
        (("batch", "scans", "-o", "out", "--jobs", "many"), 2, "--jobs is many; it must be a number"),
        (("batch", "scans", "-o", "out", "--jobs", "0"), 2, "--jobs is 0"),
        (
            ("batch", "scans", "-o", "out", "--set", "limits.memory=lots"),
            2,
            "limits.memory is 'lots'; it must be a size",
        ),
        (
            ("batch", "scans", "-o", "out", "--set", "limits.memory=0"),
            2,
            "limits.memory is 0, which would exclude every scan; omit it for no limit.",
        ),
        (
            ("batch", "scans", "-o", "out", "--set", "worker.timeout=inf"),
            2,
            "--set worker.timeout is inf s; it must be at most 1e+09 s.",
        ),
        (
            ("batch", "scans", "-o", "out", "--set", "worker.worker_timeout=inf"),
            2,
            "--set worker.worker_timeout is inf",
        ),
        (("batch", "scans", "-o", "out", "--until", "cleen"), 2, "did you mean clean?"),
        (("batch", "scans", "-o", "out", "--queue-only", "--jobs", "2"), 2, "--queue-only processes nothing"),
        (("batch", "scans", "-o", "out", "--set", "batch.dusk=slurm"), 2, "did you mean batch.dask?"),
        (("batch", "scans", "-o", "taken"), 3, "index.html: this file was not written by a batch"),
        (("batch", "scans", "-o", "taken/index.html"), 3, "this is a file; results need a folder"),
        (("worker", "empty"), 3, "this folder contains no batch"),
        (("worker", "none"), 3, "this folder contains no batch"),
    ],
)
def test_wrong_batch_options_are_one_error_and_write_nothing(
    scanloom: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "index.html").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    ran = scanloom(*words)
    assert ran.exit_code == code, ran.stderr
    lines = [line for line in ran.stderr.splitlines() if line.startswith("scanloom: ")]
    assert len(lines) == 1
    assert message in lines[0]
    assert sorted(tmp_path.rglob("*")) == before


def test_queued_paths_of_existing_files_are_absolute(
    scanloom: Run, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "poses.txt").write_text("")
    words = ("--set", "scan.poses=poses.txt", "--set", "scan.calibration=camera.toml", "--queue-only")
    assert scanloom("batch", scans, "-o", "out", *words).exit_code == 0
    queue = read_current_queue(tmp_path / "out")
    assert queue is not None
    assert f'poses = "{tmp_path / "poses.txt"}"' in queue.settings.config
    # A missing path is relative to the folder of each scan.
    assert 'calibration = "camera.toml"' in queue.settings.config


def test_a_run_over_the_memory_limit_reports_that_no_voxel_size_fits(
    scanloom: Run, scans: Path, tmp_path: Path
):
    ran = scanloom(
        "run", scans / "scan-0000", "-o", tmp_path / "out", "--set", "limits.memory=200 MB", "--json"
    )
    assert ran.exit_code == 1
    assert "more than the limit of 200 MB; no voxel size fits, because" in ran.json["error"]
    assert not (tmp_path / "out" / "fused.ply").exists()


@pytest.mark.slow
def test_the_batch_page_opens_from_disk_and_lists_every_scan(scanloom: Run, scans: Path, tmp_path: Path):
    name = "ball & <b>wall #1? 50%"
    (scans / "scan-0000").rename(scans / name)
    words = ("--set", "report.viewpoints=1", "--set", "report.width=64", "--set", "compare.samples=1000")
    assert scanloom("batch", scans, "-o", tmp_path / "out", *words, "--jobs", 1).exit_code == 1
    with browsers.launch_browser() as chromium:
        page = chromium.new_page()
        failed: list[str] = []
        page.on("requestfailed", lambda request: failed.append(request.url))
        page.on("pageerror", lambda error: failed.append(str(error)))
        page.goto((tmp_path / "out" / "index.html").as_uri())
        assert page.locator("tbody tr").count() == 3
        assert page.locator("tbody strong").all_inner_texts() == [name, "more/broken", "scan-0001"]
        assert "not valid JSON" in page.locator("tbody tr", has_text="more/broken").inner_text()
        # Images are loaded lazily.
        page.wait_for_function(
            "() => [...document.querySelectorAll('tbody img')].every(one => one.naturalWidth === 64)"
        )
        assert page.locator("tbody img").count() == 2
        page.get_by_label("state").select_option("unusable")
        assert page.locator("tbody strong").all_inner_texts() == ["more/broken"]
        page.get_by_label("state").select_option("")
        page.get_by_role("button", name="triangles").click()
        assert page.locator("tbody strong").all_inner_texts()[-1] == "more/broken"
        page.get_by_label("Find").fill("SCAN-0001")
        assert page.locator("#counts").inner_text().endswith("; 1 shown")
        page.locator("tbody tr a", has_text="page").first.click()
        page.wait_for_url("**/report.html")
        assert failed == []
    content = json.loads(
        re.findall(r'id="content">(.*?)</script>', (tmp_path / "out/index.html").read_text())[0]
    )
    assert content["title"] == "out"
