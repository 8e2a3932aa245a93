"""Memory and disk limits of a run: an exceeded limit ends the run with a suggestion that fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from small_scans import write_small_scan

from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import BASE_BYTES, ResourceEstimate
from scanloom.pipeline.run.limits import LimitGuard, Limits, limit_stage_memory
from scanloom.pipeline.run.resource_estimation import estimate_stages
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.scans.reader import read_scan

STAGES = ("adjust", "fuse", "clean")
MB = 10**6


def make_guard(
    limits: Limits,
    *needs: int,
    disk: int = 0,
    assignments: tuple[str, ...] = (),
    peak: int = 0,
    basis: str = "scaled",
) -> LimitGuard:
    expected = {
        name: ResourceEstimate(1.0, need, basis, disk) for name, need in zip(STAGES, needs, strict=False)
    }
    return LimitGuard(limits, Config().set(assignments), expected, ("fuse", "clean"), lambda: peak)


def make_entry(size: int) -> Any:
    return SimpleNamespace(manifest={"files": {"a.ply": {"size": size}}})


def test_a_stage_that_fits_starts():
    make_guard(Limits(memory=900 * MB), 400 * MB, 900 * MB, 800 * MB).check_before("adjust")


def test_a_fitting_voxel_size_is_suggested():
    # The stage needs four times the memory that is available in addition to the libraries, so voxels of twice
    # the edge.
    needs = (0, BASE_BYTES + 400 * MB, 0)
    limits = Limits(memory=BASE_BYTES + 100 * MB)
    with pytest.raises(
        StageError, match=r"fuse is expected to use .*700 MB .* 400 MB; fuse\.voxel_size=0\.02 would"
    ):
        make_guard(limits, *needs, assignments=("fuse.voxel_size=0.01",)).check_before("adjust")
    with pytest.raises(StageError, match=r"fuse\.voxel_factor=2 would fit"):
        make_guard(limits, *needs).check_before("fuse")
    with pytest.raises(StageError, match=r"fuse\.voxel_factor=3 would fit"):
        make_guard(limits, *needs, assignments=("fuse.voxel_factor=1.5",)).check_before("fuse")


def test_only_remaining_stages_count():
    make_guard(Limits(memory=400 * MB), 900 * MB, 400 * MB, 300 * MB).check_before("fuse")


def test_no_voxel_size_is_suggested_for_unaffected_stages():
    with pytest.raises(
        StageError, match=r"adjust is expected .*the voxel size has no influence: increase the"
    ):
        make_guard(Limits(memory=400 * MB), 900 * MB, 0, 0).check_before("adjust")


def test_below_the_memory_of_the_libraries_no_voxel_size_fits():
    with pytest.raises(StageError, match="no voxel size fits, because the libraries alone use 300 MB"):
        make_guard(Limits(memory=200 * MB), 0, 900 * MB, 0).check_before("fuse")


def test_a_stage_above_the_limit_is_stopped(tmp_path: Path):
    taken = make_guard(Limits(memory=400 * MB), 0, 0, 0, peak=500 * MB)
    taken.check_before("fuse")
    with pytest.raises(StageError, match=r"fuse has used 500 MB of memory, .*voxel_factor=1\.5 would fit"):
        taken.check_during("fuse", tmp_path, 1.0)


@pytest.mark.parametrize(("peak", "is_told"), [(400 * MB, False), (500 * MB, True)])
def test_a_stage_above_the_limit_at_its_end_is_reported(peak: int, is_told: bool, warnings: list[str]):
    make_guard(Limits(memory=400 * MB), 0, 0, 0, peak=peak).check_stored("fuse", make_entry(1))
    expected = "fuse used 500 MB of memory at its end, more than the limit of 400 MB."
    assert warnings == ([expected] if is_told else [])


def test_the_memory_of_the_page_is_reported_once(warnings: list[str]) -> None:
    taken = make_guard(Limits(memory=400 * MB), 0, 0, 0, peak=500 * MB)
    taken.warn_if_exceeded("the page")
    taken.warn_if_exceeded("the page")
    assert warnings == ["the page used 500 MB of memory at its end, more than the limit of 400 MB."]


@pytest.mark.parametrize(("share", "times"), [(1.0, "1.5"), (0.5, "2"), (0.25, "2.9"), (0.01, "2.9")])
def test_the_suggestion_is_extrapolated_from_the_progress(tmp_path: Path, share: float, times: str):
    taken = make_guard(Limits(memory=400 * MB), 0, 0, 0, peak=500 * MB)
    with pytest.raises(StageError, match=rf"voxel_factor={times} would fit"):
        taken.check_during("fuse", tmp_path, share)


def test_estimates_from_the_scan_size_only_warn(warnings: list[str]):
    needs = (0, 900 * MB, 0)
    make_guard(Limits(memory=600 * MB, disk=MB), *needs, disk=MB, basis="estimated").check_before("adjust")
    assert len(warnings) == 2
    assert warnings[0].startswith(
        "fuse is expected to use (estimated from the scan size) 900 MB of memory, more than the"
    )
    assert "fuse.voxel_factor=1.5 would fit. This is an estimate; the stage is only stopped" in warnings[0]
    assert warnings[1].startswith(
        "the run is expected to write 3 MB, but only 1 MB of the disk limit of 1 MB"
    )
    with pytest.raises(StageError, match="no voxel size fits"):
        make_guard(Limits(memory=200 * MB), *needs, basis="estimated").check_before("adjust")


def test_expected_and_written_disk_space_are_limited(tmp_path: Path):
    with pytest.raises(
        StageError,
        match=r"expected to write 300 MB, but only 100 MB of the disk limit of 100 MB remain; .*=1\.8",
    ):
        make_guard(Limits(disk=100 * MB), 0, 0, 0, disk=100 * MB).check_before("adjust")
    counted = make_guard(Limits(disk=100), 0, 0, 0)
    counted.check_stored("adjust", make_entry(30))
    assert counted.written == 60
    (tmp_path / "draft.bin").write_bytes(bytes(19))
    counted.check_during("fuse", tmp_path, 1.0)
    with pytest.raises(StageError, match=r"with fuse, the run has written .*more than the disk limit"):
        counted.check_stored("fuse", make_entry(21))


def test_a_draft_that_grows_too_large_is_stopped(tmp_path: Path):
    (tmp_path / "draft.bin").write_bytes(bytes(60))
    with pytest.raises(StageError, match="with fuse, the run"):
        make_guard(Limits(disk=100), 0, 0, 0).check_during("fuse", tmp_path, 1.0)


def test_the_memory_of_the_volume_follows_the_limit():
    assert limit_stage_memory(Config(), Limits()).fuse.memory == 4000
    # Frames and meshes need twice the memory in addition to the volume.
    assert limit_stage_memory(Config(), Limits(memory=BASE_BYTES + 75 * MB)).fuse.memory == 25
    assert limit_stage_memory(Config(), Limits(memory=90 * 10**9)).fuse.memory == 4000


def test_refinement_may_use_memory_left_by_the_libraries():
    limited = [limit_stage_memory(Config(), Limits(memory=BASE_BYTES + mb * MB)) for mb in (75, 90_000)]
    assert [config.refine.memory for config in limited] == [75, Config().refine.memory]


@pytest.mark.slow
def test_a_run_stops_at_its_limit_and_keeps_finished_stages(tmp_path: Path):
    scan, out = write_small_scan(tmp_path / "scan"), tmp_path / "out"
    with pytest.raises(StageError, match="more than the limit of 250 MB"):
        run(scan, out, until="clean", limits=Limits(memory=250 * MB))
    run(scan, out, until="clean", limits=Limits(memory=3000 * MB, disk=500 * MB))
    # Cached stages need no memory.
    again = run(scan, out, until="clean", limits=Limits(memory=250 * MB, disk=1))
    assert all(one.cached for one in again.stages)

    # Estimates for finer voxels are scaled from the measured memory.
    finer = ("fuse.voxel_size={}", "fuse.memory=90000")
    expected = {
        size: estimate_stages(
            read_scan(scan), Config().set([one.format(size) for one in finer]), STAGES, out / "cache"
        )
        for size in (0.02, 0.01)
    }
    assert expected[0.01]["fuse"].seconds == pytest.approx(4 * expected[0.02]["fuse"].seconds, rel=1e-3)
    beyond = {size: max(found["fuse"].memory_bytes - BASE_BYTES, 0) for size, found in expected.items()}
    assert beyond[0.01] == pytest.approx(4 * beyond[0.02], rel=1e-3, abs=4)
    assert expected[0.01]["clean"].disk_bytes == pytest.approx(
        4 * expected[0.02]["clean"].disk_bytes, rel=1e-3
    )
    assert {one.basis for one in expected[0.01].values()} == {"scaled"}


def test_the_estimate_of_fusion_in_bricks_is_limited(tmp_path: Path):
    scan = read_scan(write_small_scan(tmp_path / "scan"))
    scan = replace(scan, frames=scan.frames * 100_000)
    needs = estimate_stages(scan, Config().set(("fuse.memory=50",)), STAGES, tmp_path / "cache")
    assert needs["fuse"].memory_bytes == BASE_BYTES + 100 * MB < needs["clean"].memory_bytes
