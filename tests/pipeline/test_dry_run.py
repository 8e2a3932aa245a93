"""A dry run writes no files and predicts exactly the actions of the run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import BASE_BYTES, CostModel, estimate_cost
from scanloom.pipeline.run.dry_run import DryRun, predict_run
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import UsageError

SCAN = Path(__file__).parents[2] / "samples" / "rgbd"
QUICK = (
    "texture.enabled=false",
    "scan.every=3",
    "fuse.voxel_size=0.04",
    "simplify.ratio=0.3",
    "compare.samples=1000",
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
)


def config(*more: str) -> Config:
    return Config().set([*QUICK, *more])


def list_file_states(folder: Path) -> dict[str, tuple[int, int, int]]:
    """List size, inode and time of all files in a folder, by name."""
    return {
        str(path): (found.st_size, found.st_ino, found.st_mtime_ns)
        for path in sorted([folder, *folder.rglob("*")])
        for found in [os.lstat(path)]
    }


def get_cached_by_stage(found: DryRun) -> dict[str, bool]:
    return {one.stage: one.cached for one in found.stages}


def test_a_dry_run_creates_no_folder(tmp_path: Path) -> None:
    found = predict_run(SCAN, tmp_path / "out", config())
    assert list(tmp_path.iterdir()) == []
    assert get_cached_by_stage(found) == dict.fromkeys(
        ("adjust", "fuse", "clean", "refine", "upright", "simplify", "export", "report"), False
    )
    assert [one.reason for one in found.stages] == ["first run"] * 8
    assert {one.estimate.basis for one in found.stages if one.estimate} == {"estimated"}
    assert found.seconds > 0
    assert found.memory_bytes > BASE_BYTES


@pytest.mark.slow
def test_the_run_does_what_the_dry_run_predicted(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(SCAN, out, config())
    for more, reasons in (
        ((), {}),
        (
            ("simplify.ratio=0.4",),
            {
                "simplify": "params changed: ratio 0.3 → 0.4",
                "export": "follows simplify, which runs",
                "report": "follows simplify, which runs",
            },
        ),
        (
            ("fuse.voxel_size=0.05", "report.width=65"),
            {
                "fuse": "params changed: voxel_size 0.04 → 0.05",
                "clean": "follows fuse, which runs",
                "refine": "follows clean, which runs",
                "simplify": "params changed: ratio 0.4 → 0.3; follows refine, which runs",
                "upright": "follows fuse, clean, which run",
                "export": "follows simplify, upright, which run",
                "report": "params changed: report.width 64 → 65; follows fuse, refine, simplify, which run",
            },
        ),
    ):
        before = list_file_states(tmp_path)
        found = predict_run(SCAN, out, config(*more))
        assert list_file_states(tmp_path) == before
        assert {one.stage: one.reason for one in found.stages if not one.cached} == reasons
        bases = [one.estimate.basis for one in found.stages if one.estimate is not None]
        assert set(bases) <= {"measured", "scaled"}
        did = run(SCAN, out, config(*more))
        assert {outcome.stage: outcome.cached for outcome in did.stages} == get_cached_by_stage(found)


@pytest.mark.slow
def test_forced_stages_damage_and_foreign_files_are_predicted(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(SCAN, out, config(), until="clean")
    forced = predict_run(SCAN, out, config(), until="clean", force=("fuse",))
    assert [one.reason for one in forced.stages] == ["", "forced", "follows fuse, which runs"]
    assert [one.estimate.basis for one in forced.stages if one.estimate] == ["measured", "scaled"]
    (entry,) = (out / "cache" / "clean").iterdir()
    (entry / "clean.ply").write_bytes(b"ply")
    (out / "simplified.ply").write_text("mine")
    before = list_file_states(tmp_path)
    found = predict_run(SCAN, out, config())
    assert list_file_states(tmp_path) == before
    assert [one.cached for one in found.stages] == [True, True, False, False, False, False, False, False]
    assert found.stages[2].reason.startswith("cached result damaged: clean.ply")
    assert found.refusal_reason is not None
    assert found.refusal_reason.startswith(f"{out / 'simplified.ply'}: this file was not written by a run")
    assert predict_run(SCAN, out, config(), overwrite=True).refusal_reason is None
    assert predict_run(SCAN, out, config(), until="clean").refusal_reason is None


def test_a_dry_run_reports_the_errors_of_the_run(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean clean"):
        predict_run(SCAN, tmp_path / "out", config(), until="cleen")


def test_estimates_grow_with_the_scan() -> None:
    made = {"seconds": 10.0, "peak_memory_bytes": BASE_BYTES + 1000, "megapixels": 2.0}
    known = [{"recipe": {"stage": "fuse", "inputs": {"frames": "a"}}, "made": made}]
    measured = estimate_cost("fuse", 2.0, {"frames": "a"}, known, CostModel())
    assert (measured.seconds, measured.memory_bytes, measured.basis) == (10.0, BASE_BYTES + 1000, "measured")
    scaled = estimate_cost("fuse", 6.0, {"frames": "b"}, known, CostModel())
    assert (scaled.seconds, scaled.memory_bytes, scaled.basis) == (30.0, BASE_BYTES + 3000, "scaled")
    cost = CostModel(seconds=1, seconds_per_megapixel=2, bytes=5, bytes_per_megapixel=7)
    guessed = estimate_cost("clean", 10.0, None, known, cost)
    assert (guessed.seconds, guessed.memory_bytes) == (21.0, BASE_BYTES + 75)
    assert guessed.basis == "estimated"
    # Chunked stages have a memory limit that is independent of the scan, or the memory of the earlier run.
    pieces = CostModel(bytes=5, bytes_per_megapixel=7, max_bytes=60)
    assert estimate_cost("clean", 10.0, None, known, pieces).memory_bytes == BASE_BYTES + 60
    assert estimate_cost("fuse", 60.0, None, known, pieces).memory_bytes == BASE_BYTES + 1000
    wide = CostModel(max_bytes=20_000)
    assert estimate_cost("fuse", 60.0, None, known, wide).memory_bytes == BASE_BYTES + 20_000
    # Results of an earlier version lack the size of their scan.
    del made["megapixels"]
    assert estimate_cost("fuse", 6.0, None, known, CostModel()).seconds == 10.0
