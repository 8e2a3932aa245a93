"""Commands `run`, `config` and `cache`: caching, reruns, interruption, and help."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recordings

from scanloom.cli.version import describe_version
from scanloom.pipeline.config import Config
from scanloom.stages.params import describe_all, get_default

Run = Callable[..., Any]
SCANLOOM = [sys.executable, "-m", "scanloom.cli.app"]


def list_states(ran: Any) -> dict[str, str]:
    """List for each stage if it was cached or run."""
    return {name: "cached" if stage["cached"] else "run" for name, stage in ran.json["stages"].items()}


def test_a_repeated_run_is_cached_and_a_parameter_reruns_its_stages(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    small_report = (
        "--set",
        "compare.samples=1000",
        "--set",
        "report.viewpoints=1",
        "--set",
        "report.page=false",
        "--set",
        "report.width=64",
    )
    words = (
        "run",
        tiny_scan,
        "-o",
        tmp_path / "out",
        "--set",
        f"run.cache={tmp_path / 'cache'}",
        "--json",
        *small_report,
    )
    first = scanloom(*words)
    assert first.exit_code == 0, first.stderr
    assert first.stderr == ""
    assert set(list_states(first).values()) == {"run"}
    for name in ("fused.ply", "clean.ply", "simplified.ply", "report.json"):
        assert (tmp_path / "out" / name).is_file()

    assert set(list_states(scanloom(*words)).values()) == {"cached"}

    changed = list_states(scanloom(*words, "--set", "simplify.max_shape=0.02"))
    assert (changed["fuse"], changed["clean"], changed["simplify"]) == ("cached", "cached", "run")

    message = scanloom(*(word for word in words if word != "--json"), "--set", "simplify.ratio=0.5").stderr
    assert re.search(
        r"^simplify .* triangles, stopped by triangles; a level of colour .* m \(", message, re.MULTILINE
    )

    forced = list_states(scanloom(*words, "--set", "simplify.max_shape=0.02", "--set", "run.force=clean"))
    assert (forced["fuse"], forced["clean"]) == ("cached", "run")


def test_text_output_has_a_line_per_stage_and_the_output_folder(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    words = (
        "run",
        tiny_scan,
        "-o",
        tmp_path / "out",
        "--set",
        f"run.cache={tmp_path / 'cache'}",
        "--until",
        "clean",
    )
    ran = scanloom(*words)
    assert ran.exit_code == 0, ran.stderr
    assert re.search(r"^fuse +[\d.]+ s .*voxel size .* m.*first run", ran.stderr, re.MULTILINE)
    assert str(tmp_path / "out") in ran.stdout
    again = scanloom(*words)
    assert re.search(r"^fuse +cached", again.stderr, re.MULTILINE)
    assert scanloom(*words, "--quiet").stderr == ""


def test_inspect_reports_layout_and_frame_count(scanloom: Run, tiny_scan: Path) -> None:
    text = scanloom("inspect", tiny_scan).stdout
    assert "plain-rgbd" in text
    assert scanloom("inspect", tiny_scan, "--json").json["frames"] == 6


def test_a_recording_is_fused_with_given_poses(scanloom: Run, tmp_path: Path) -> None:
    rows, columns = np.mgrid[:48, :64]
    depth = (900 + 40 * np.sin(columns / 9) + 30 * np.cos(rows / 7)).astype(np.uint16)
    gray = (128 + 60 * np.sin(columns / 3) * np.cos(rows / 4)).astype(np.uint8)
    start = 1_700_000_000_000_000_000
    depths, colors = (
        [recordings.Image(start + n * 33_000_000, image, encoding) for n in range(3)]
        for image, encoding in ((depth, "mono16"), (gray, "mono8"))
    )
    streams = [
        recordings.Stream(name, images, (60, 60, 31.5, 23.5), (64, 48))
        for name, images in ((recordings.DEPTH, depths), (recordings.COLOR, colors))
    ]
    file = recordings.Recording(streams, units=(0.001,)).write(tmp_path / "take.bag")
    assert scanloom("inspect", file, "--json").json["frames"] == 3
    missing = scanloom("fuse", file, tmp_path / "fused.ply")
    assert missing.exit_code == 3
    assert "take.bag: no poses" in missing.stderr
    (tmp_path / "still.tum").write_text(
        "".join(f"{(start + n * 33_000_000) / 1e9:.9f} 0 0 {n / 1000} 0 0 0 1\n" for n in range(3))
    )
    words = (
        "run",
        file,
        "-o",
        tmp_path / "out",
        "--set",
        f"run.cache={tmp_path / 'cache'}",
        "--until",
        "fuse",
    )
    ran = scanloom(*words, "--set", f"scan.poses={tmp_path / 'still.tum'}", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["scan"]["frames"] == 3
    assert ran.json["stages"]["fuse"]["metrics"]["triangles"] > 1000


def test_a_damaged_frame_is_skipped_and_reported_once(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "scan"
    shutil.copytree(tiny_scan, folder)
    depth = folder / "depth-3.png"
    depth.write_bytes(depth.read_bytes()[:100])
    words = (
        "run",
        folder,
        "-o",
        tmp_path / "out",
        "--set",
        f"run.cache={tmp_path / 'cache'}",
        "--until",
        "fuse",
    )
    ran = scanloom(*words)
    assert ran.exit_code == 0, ran.stderr
    assert re.search(
        r"^warning: fuse: 1 frame skipped; the first is 3: .*depth-3\.png", ran.stderr, re.MULTILINE
    )
    assert ran.stderr.count("depth-3.png") == 1
    metrics = scanloom(*words, "--json").json["stages"]["fuse"]["metrics"]
    assert [skipped["frame"] for skipped in metrics["frames_skipped"]] == ["3"]


def test_run_accepts_the_scan_options_of_inspect(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    assert scanloom("inspect", tiny_scan, "--set", "scan.first=2", "--every", 2, "--json").json["frames"] == 2
    words = (
        "run",
        tiny_scan,
        "-o",
        tmp_path / "out",
        "--set",
        f"run.cache={tmp_path / 'cache'}",
        "--until",
        "fuse",
        "--json",
    )
    assert scanloom(*words, "--set", "scan.first=1").json["scan"]["frames"] == 5
    assert scanloom(*words, "--every", 2).json["scan"]["frames"] == 3
    twice = scanloom(*words, "--set", "scan.every=2", "--every", 1)
    assert twice.exit_code == 2
    assert "both --every and --set scan.every are given; omit one of them." in twice.stderr


def test_a_remedy_names_the_option_as_typed(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "lost"
    shutil.copytree(tiny_scan, folder)
    scan = json.loads((folder / "scan.json").read_text())
    for frame in scan["frames"]:
        frame["world_from_camera"] = np.eye(4).tolist()
    (folder / "scan.json").write_text(json.dumps(scan))
    ran = scanloom("run", folder, "-o", tmp_path / "out")
    assert ran.exit_code == 3
    assert "--poses=FILE" in ran.stderr


def test_inspect_lists_present_and_missing_data(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "lost"
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
        for image in tiny_scan.glob(f"{name}*.png"):
            (folder / name / image.name).symlink_to(image)
    ran = scanloom("inspect", folder)
    assert ran.exit_code == 0
    assert "frames    6" in ran.stdout
    assert (
        "missing   no poses: trajectory.log (or .json) is missing; name a trajectory with --poses"
        in ran.stdout
    )
    (missing,) = scanloom("inspect", folder, "--json").json["missing"]
    assert missing["message"].startswith("no poses: trajectory.log")
    assert missing["code"] == "pose.missing"
    assert scanloom("fuse", folder, tmp_path / "fused.ply").exit_code == 3
    assert scanloom("inspect", tiny_scan, "--json").json["missing"] == []


@pytest.mark.slow
def test_inverted_poses_stop_fuse(scanloom: Run, shared_data: Path, tmp_path: Path) -> None:
    poses = tmp_path / "inverse.txt"
    scan = shared_data / "rgbd" / "tabletop_box_realsense"
    given = sorted(scan.glob("*.pose.txt"))
    np.savetxt(poses, [np.linalg.inv(np.loadtxt(path)).ravel() for path in given])
    words = (
        "fuse",
        shared_data / "rgbd" / "tabletop_box_realsense",
        tmp_path / "fused.ply",
        "--poses",
        poses,
    )
    ran = scanloom(*words, "--voxel-size", 0.02)
    assert ran.exit_code == 3
    assert "the poses are probably world-to-camera" in ran.stderr
    assert scanloom(*words, "--voxel-size", 0.02, "--set", "scan.check_poses=false").exit_code == 0


def test_fuse_and_clean_work_on_files(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    fused, clean = tmp_path / "fused.ply", tmp_path / "clean.ply"
    ran = scanloom("fuse", tiny_scan, fused, "--voxel-size", "0.02", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["voxel_size_m"] == 0.02
    assert scanloom("clean", fused, clean).exit_code == 0


def test_depth_writes_a_folder_that_fuse_reads(scanloom: Run, tmp_path: Path) -> None:
    pairs = Path(__file__).parents[2] / "samples" / "stereo"
    ran = scanloom("depth", pairs, tmp_path / "depth", "--set", "scan.last=1", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["frames_used"] == 2
    assert [path.name for path in tmp_path.iterdir()] == ["depth"]
    assert scanloom("inspect", tmp_path / "depth", "--json").json["kind"] == "rgbd"
    assert scanloom("depth", pairs, tmp_path / "depth").exit_code == 3  # nothing is overwritten
    refused = scanloom("fuse", pairs, tmp_path / "fused.ply")
    assert refused.exit_code == 3
    assert "scanloom depth" in refused.stderr
    assert scanloom("fuse", tmp_path / "depth", tmp_path / "fused.ply", "--voxel-size", "0.05").exit_code == 0


@pytest.mark.parametrize(
    ("words", "exit_code", "sentence"),
    [
        (("run", "empty", "-o", "out"), 3, "empty"),
        (("run", "missing", "-o", "out"), 3, "missing: there is no such folder"),
        (("run", "file", "-o", "out"), 3, "file: this is a file"),
        (("inspect", "empty"), 3, "empty"),
        (("inspect", "empty", "--set", "scan.layout=cubist"), 2, "--set scan.layout is 'cubist'"),
        (("inspect", "empty", "--intrinsics", "1,2"), 2, "--intrinsics"),
        (("run", "empty"), 2, "--out"),
        (("run", "empty", "-o", "file/out"), 3, "file"),
        (("run", "empty", "-o", "out", "--config", "missing.toml"), 2, "missing.toml"),
        (("run", "empty", "-o", "out", "--set", "fuse.voxel_size"), 2, "fuse.voxel_size"),
        (("run", "empty", "-o", "out", "--set", "fuse.voxel_size=-1"), 2, "voxel_size"),
        (("run", "empty", "-o", "out", "--set", "fuse.voxle_size=1"), 2, "voxel_size"),
        (("run", "empty", "-o", "out", "--until", "lunch"), 2, "lunch"),
        (("run", "empty", "-o", "out", "--set", "run.force=lunch"), 2, "lunch"),
        (("config", "--check", "file"), 2, "file"),
        (("cache", "ls", "missing"), 3, "missing"),
        (("cache", "ls"), 2, "SCANLOOM_CACHE"),
    ],
)
def test_bad_input_is_one_error_in_text_and_json(
    scanloom: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    exit_code: int,
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SCANLOOM_CACHE", raising=False)
    Path("empty").mkdir()
    Path("file").write_text("not TOML")
    ran = scanloom(*words, *(("--set", "run.cache=cache") if words[0] == "run" else ()))
    assert ran.exit_code == exit_code, ran.stderr
    assert sentence in ran.stderr
    assert ran.stderr.count("\n") == 1
    as_json = scanloom(*words, *(("--set", "run.cache=cache") if words[0] == "run" else ()), "--json")
    assert as_json.json["exit_code"] == exit_code
    assert sentence in as_json.json["error"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "file"]


def test_an_unknown_layout_lists_the_known_ones(scanloom: Run, tmp_path: Path) -> None:
    (tmp_path / "holiday.txt").write_text("sun")
    ran = scanloom("inspect", tmp_path)
    assert ran.exit_code == 3
    assert ran.stderr.startswith(f"scanloom: {tmp_path}: unknown layout.")
    # Line breaks of a message would be escaped.
    assert "\\n" not in ran.stderr
    assert len(ran.stderr) < 1000
    assert "plain-rgbd" in ran.stderr


def test_a_missing_subcommand_is_reported(scanloom: Run) -> None:
    ran = scanloom("cache")
    assert (ran.exit_code, ran.stderr) == (2, "scanloom: Missing command. See `scanloom cache --help`.\n")
    bare = scanloom()
    assert bare.exit_code == 2
    assert "inspect" in bare.stdout


def test_depth_of_an_unsuitable_scan_leaves_no_folder(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    ran = scanloom("depth", tiny_scan, tmp_path / "depth")
    assert ran.exit_code == 3
    assert "stereo" in ran.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_printed_configuration_equals_the_defaults(scanloom: Run, tmp_path: Path) -> None:
    file = tmp_path / "defaults.toml"
    file.write_text(scanloom("config", "--all").stdout)
    assert Config.load(file) == Config()
    checked = scanloom("config", "--check", file, "--json")
    assert checked.json == scanloom("config", "--all", "--json").json


def test_the_cache_is_listed_verified_and_pruned(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    scanloom("run", tiny_scan, "-o", tmp_path / "out", "--set", f"run.cache={cache}", "--until", "clean")
    entries = scanloom("cache", "ls", cache, "--json").json["entries"]
    assert {"fuse", "clean"} <= {entry["stage"] for entry in entries}
    assert scanloom("cache", "verify", cache).exit_code == 0

    damaged = next(cache.glob("clean/*/*.ply"))
    damaged.write_bytes(damaged.read_bytes()[:-1])
    ran = scanloom("cache", "verify", cache, "--json")
    assert ran.exit_code == 1
    assert [entry["stage"] for entry in ran.json["entries"] if entry["problem"]] == ["clean"]

    assert scanloom("cache", "prune", cache, "--json").json["entries"] == []
    assert scanloom("cache", "prune", cache, "--max-size", "0", "--json").json["entries"] == []
    assert scanloom("cache", "prune", cache, "--max-size", "much").exit_code == 2
    assert len(scanloom("cache", "prune", cache, "--all", "--dry-run", "--json").json["entries"]) == len(
        entries
    )
    assert len(scanloom("cache", "prune", cache, "--all", "--json").json["entries"]) == len(entries)
    assert scanloom("cache", "ls", cache, "--json").json["entries"] == []


COMMANDS = [
    *(
        ("inspect",),
        ("run",),
        ("config",),
        ("depth",),
        ("fuse",),
        ("clean",),
        ("simplify",),
        ("compare",),
        ("render",),
        ("view",),
    ),
    *(("cache", "ls"), ("cache", "verify"), ("cache", "prune")),
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_shows_an_example(scanloom: Run, command: tuple[str, ...]) -> None:
    ran = scanloom(*command, "--help")
    assert ran.exit_code == 0
    assert f"\n  scanloom {' '.join(command)}" in ran.stdout
    assert "--json" in ran.stdout


@pytest.mark.parametrize("command", ["depth", "fuse", "clean", "simplify"])
def test_help_of_a_stage_names_unit_and_default_of_every_option(scanloom: Run, command: str) -> None:
    text = re.sub(r"\s+", " ", scanloom(command, "--help").stdout)
    text = " " + text.partition(" Options: ")[2].partition(" Common options: ")[0]
    helps = {option.split(" ", 1)[0]: option for option in re.split(r" --(?!no-)", text)}
    cls = Config.get_types()[command]
    for name, about in describe_all(cls).items():
        option = name.rpartition(".")[2].replace("_", "-")
        if not about.common:
            assert option not in helps
            continue
        facts = "".join(re.findall(r"\[([^\[\]]*)\]", helps[option]))
        assert about.unit in facts, name
        assert ("default: " in facts) == (get_default(cls, name) is not None), name


def test_an_unknown_option_that_is_a_parameter_is_reported_with_its_set_form(scanloom: Run) -> None:
    ran = scanloom("fuse", "scan", "out.ply", "--truncation", 0.1)
    assert ran.exit_code == 2
    assert "No such option: --truncation; use --set fuse.truncation=VALUE. See" in ran.stderr
    ran = scanloom("run", "scan", "-o", "out", "--no-page")
    assert "use --set tiles.page=VALUE or --set report.page=VALUE. See" in ran.stderr


@pytest.mark.slow
def test_the_installed_program_prints_its_version() -> None:
    ran = subprocess.run([*SCANLOOM, "--help"], capture_output=True, text=True, check=True)
    assert "inspect" in ran.stdout
    version = subprocess.run([*SCANLOOM, "--version"], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"scanloom \d+\.\d+\.\d+\nkernels \S+ [0-9a-f]{12}\n", version.stdout)


def test_version_imports_no_command_line_modules() -> None:
    # Importing typer, NumPy and all commands to parse the options takes over a second on a slow machine.
    code = (
        "import sys; sys.argv = ['scanloom', '--version']\n"
        "from scanloom.cli.start import main; main()\n"
        "print(sorted({'typer', 'numpy', 'scanloom.cli.app', 'scanloom.stages._kernels'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == f"{describe_version()}\n[]\n"


def test_help_imports_no_heavy_library() -> None:
    code = (
        "import sys, scanloom.cli.app; scanloom.cli.app.run_command(['--help']); "
        "print([name for name in ('cv2', 'open3d', 'scipy', 'trimesh') if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "[]"


def test_a_closed_pipe_causes_no_traceback() -> None:
    program = subprocess.Popen([*SCANLOOM, "config"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert program.stdout is not None
    assert program.stderr is not None
    program.stdout.close()
    assert program.stderr.read() == b""
    program.stderr.close()
    assert program.wait() == 1


@pytest.mark.slow
def test_ctrl_c_exits_with_130_and_leaves_no_partial_files(tiny_scan: Path, tmp_path: Path) -> None:
    out, cache = tmp_path / "out", tmp_path / "cache"
    words = ["run", str(tiny_scan), "-o", str(out), "--set", f"run.cache={cache}"]
    program = subprocess.Popen([*SCANLOOM, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stderr is not None
    assert "6 frames" in program.stderr.readline()
    program.send_signal(signal.SIGINT)
    stdout, stderr = program.communicate(timeout=30)
    assert program.returncode == 130
    assert stdout == ""
    assert stderr.splitlines()[-1] == "scanloom: Interrupted; finished results are kept."
    assert "Traceback" not in stderr
    assert list(out.rglob("*")) == []
    assert [path for path in cache.rglob("*") if path.is_dir() and path.name not in ("drafts", "runs")] == []


def test_a_dry_run_prints_its_plan_and_writes_nothing(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    words = ("run", tiny_scan, "-o", tmp_path / "out", "--dry-run")
    ran = scanloom(*words)
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert re.search(r"^fuse +runs +[\d.]+ +[\d.]+ MB +the size of the scan \(rough\)$", ran.stdout, re.M)
    assert "fuse: first run" in ran.stdout
    found = scanloom(*words, "--json").json
    assert found["dry_run"]
    assert list(found["stages"]) == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "texture",
        "report",
    ]
    assert found["stages"]["fuse"]["expected_seconds"] > 0
    assert list(tmp_path.iterdir()) == []
    scanloom(*words[:-1], "--until", "clean")
    again = scanloom(*words, "--set", "clean.keep_largest=true")
    assert re.search(r"^fuse +cached$", again.stdout, re.MULTILINE)
    assert "clean: params changed: keep_largest False → True" in again.stdout
    (tmp_path / "out" / "simplified.ply").write_text("mine")
    blocked = scanloom(*words)
    assert blocked.exit_code == 0
    assert "warning: the run would not start: " in blocked.stderr
    real = scanloom(*words[:-1])
    assert real.exit_code == 3
    assert real.stderr.splitlines()[-1].endswith(
        "simplified.ply: this file was not written by a run, or was edited since; move it, choose another "
        "output folder, or give --set run.overwrite=true."
    )


@pytest.mark.slow
def test_the_page_of_a_run_is_written_updated_and_removed(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    # The page does not need the images of the report.
    quick = ("--set", "report.pictures=false", "--set", "compare.samples=1000")
    words = ("run", tiny_scan, "-o", tmp_path / "out", *quick)
    assert scanloom(*words, "--set", "report.page=false").exit_code == 0
    page = tmp_path / "out" / "report.html"
    assert not page.exists()
    ran = scanloom(*words, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["page"] == str(page.resolve())
    assert 1_000_000 < page.stat().st_size < 5_000_000
    text = page.read_text()
    assert all(f'"{name}"' in text for name in ("result", "refined mesh", "deviation"))
    # Without changes the page is not rewritten.
    before = page.stat().st_mtime_ns
    assert scanloom(*words).exit_code == 0
    assert page.stat().st_mtime_ns == before
    assert scanloom(*words, "--set", "simplify.ratio=0.5").exit_code == 0
    assert page.stat().st_mtime_ns != before
    assert "proven bound for all points" not in page.read_text()
    # The page shows the proven bound next to the sampled deviation.
    assert scanloom(*words, "--set", "simplify.max_shape=0.02").exit_code == 0
    assert "proven bound for all points" in page.read_text()
    # Without `report.page` the page of an earlier result is removed, even if every stage is cached; with it,
    # the page is written again.
    assert scanloom(*words, "--set", "report.page=false").exit_code == 0
    assert not page.exists()
    back = scanloom(*words, "--set", "report.page=true", "--json")
    assert {stage["cached"] for stage in back.json["stages"].values()} == {True}
    assert "proven bound for all points" in page.read_text()
    assert scanloom(*words, "--set", "report.enabled=false").exit_code == 0
    assert not page.exists()
    assert scanloom(*words, "--set", "report.enabled=false", "--set", "report.enabled=true").exit_code == 0
    assert scanloom(*words, "--set", "report.page_size=1.3").exit_code == 0
    # The size varies by a few bytes, because the page contains run times.
    assert page.stat().st_size <= 1_300_000
    page.write_text("mine")
    refused = scanloom(*words, "--set", "simplify.ratio=0.4")
    assert (refused.exit_code, "this file was not written by a run" in refused.stderr) == (3, True)
    assert page.read_text() == "mine"
    assert scanloom(*words, "--set", "report.page=false").exit_code == 0
    assert page.read_text() == "mine"
    assert scanloom(*words, "--set", "run.overwrite=true").exit_code == 0
    assert page.read_text() != "mine"


def test_a_crop_is_given_as_numbers_and_reported_in_the_metrics(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    words = ("fuse", tiny_scan, tmp_path / "ball.ply", "--voxel-size", 0.02)
    box = (-0.4, -0.4, -0.1, 0.4, 0.4, 1.1)
    ran = scanloom(
        *words, "--box", *box, "--set", "fuse.center=0 0 0.9", "--set", "fuse.radius=0.6", "--json"
    )
    assert ran.exit_code == 0, ran.stderr
    crop = ran.json["crop"]
    assert (crop["box_m"], crop["center_m"], crop["radius_m"]) == (list(box), [0, 0, 0.9], 0.6)
    # The wall at 1.2 m is outside the crop.
    assert ran.json["highest_m"][2] < 1.0

    inspected = scanloom("inspect", tiny_scan, "--json").json["scene"]
    assert inspected["highest_m"][2] == pytest.approx(1.2, abs=0.01)
    assert inspected["lowest_m"][2] == pytest.approx(0.76, abs=0.02)
    message = scanloom("inspect", tiny_scan).stdout
    assert re.search(
        r"^extent    \(-0\.\d+, -0\.\d+, 0\.\d+\) to \(0\.\d+, 0\.\d+, 1\.2\) m, ", message, re.MULTILINE
    )
    assert re.search(r"^looks at  \(.*\) m, the centre of view$", message, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--box", 0, 0, 0, 1, 1), "Option '--box' requires 6 arguments"),
        (("--box", 1, 0, 0, 0, 1, 1), "--box is 1 0 0 0 1 1 m; the first three numbers must be the lowest"),
        (("--box", 8, 8, 8, 9, 9, 9), "the crop is empty: none of "),
        (("--set", "fuse.radius=0"), "--set fuse.radius is 0 m; it must be more than 0 m."),
    ],
)
def test_an_empty_or_malformed_crop_is_wrong_usage(
    scanloom: Run, tiny_scan: Path, tmp_path: Path, words: tuple[object, ...], message: str
) -> None:
    ran = scanloom("fuse", tiny_scan, tmp_path / "ball.ply", *words)
    assert ran.exit_code == 2
    assert message in ran.stderr
    assert not (tmp_path / "ball.ply").exists()


def test_a_missing_plane_is_a_warning(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    ran = scanloom(
        "fuse", tiny_scan, tmp_path / "ball.ply", "--voxel-size", 0.02, "--remove-plane", "--strict"
    )
    assert ran.exit_code == 1
    assert "warning: remove_plane: no plane is removed, because none was found" in ran.stderr
