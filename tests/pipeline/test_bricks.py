"""A run over bricks.

Bricks are cached one by one, new frames rebuild only their bricks, large results are chunked.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from chunked_sample import use_small_chunks, write_partial_sample

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.topology import topology

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rgbd"
# All parameters that would be derived from all frames are given, so a new frame only changes the bricks it
# touches.
QUICK = (
    "adjust.enabled=false",
    "texture.enabled=false",
    "report.enabled=false",
    "fuse.voxel_size=0.015",
    "fuse.brick_size=0.3",
    "fuse.min_weight=1",
)


def run_and_get_metrics(scan: Path, out: Path, *more: str, until: str = "fuse") -> dict[str, Any]:
    result = run(scan, out, Config().set([*QUICK, *more]), until=until, cache_dir=f"{out}-cache")
    stages: Any = result.report["stages"]
    return {name: stage["metrics"] for name, stage in stages.items()}


@pytest.mark.slow
def test_a_killed_run_resumes_with_its_cached_bricks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = write_partial_sample(tmp_path / "scan", list(range(0, 24, 6)))
    quiet = run_and_get_metrics(scan, tmp_path / "quiet")["fuse"]
    assert quiet["bricks"] == quiet["bricks_fused"] > 10

    from scanloom.pipeline.artifacts import fused_bricks as bricks

    store, left = bricks.CachedBrickStore.store, [7]

    def some(self: Any, *words: Any) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise StageError(MACHINE_BUG, "killed")
        return store(self, *words)

    monkeypatch.setattr(bricks.CachedBrickStore, "store", some)
    with pytest.raises(StageError, match="killed"):
        run_and_get_metrics(scan, tmp_path / "out")
    monkeypatch.setattr(bricks.CachedBrickStore, "store", store)
    again = run_and_get_metrics(scan, tmp_path / "out")["fuse"]
    assert again["bricks_fused"] == quiet["bricks"] - 7
    assert (tmp_path / "out" / "fused.ply").read_bytes() == (tmp_path / "quiet" / "fused.ply").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["gone", "another"])
def test_bricks_of_frames_that_change_during_the_run_are_not_cached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    # Several passes, so that frames are read after the first bricks were cached.
    tight = ("fuse.memory=1", "fuse.voxel_size=0.01", "fuse.max_skipped_ratio=0.9")
    scan = write_partial_sample(tmp_path / "scan", list(range(0, 24, 6)))
    quiet = run_and_get_metrics(scan, tmp_path / "quiet", *tight)["fuse"]
    first, _, third, _ = (Path(str(frame.depth)) for frame in read_scan(scan).frames)

    from scanloom.pipeline.artifacts import fused_bricks as bricks

    whole, store, left = third.read_bytes(), bricks.CachedBrickStore.store, [7]

    def until_it_changes(self: Any, *words: Any) -> Path:
        left[0] -= 1
        if left[0] == 0:
            third.unlink()
            if how == "another":
                shutil.copy(first, third)
        return store(self, *words)

    monkeypatch.setattr(bricks.CachedBrickStore, "store", until_it_changes)
    with pytest.raises(StageError, match=r"0012\.png changed while it was being read; run again"):
        run_and_get_metrics(scan, tmp_path / "out", *tight)
    monkeypatch.setattr(bricks.CachedBrickStore, "store", store)
    third.write_bytes(whole)
    again = run_and_get_metrics(scan, tmp_path / "out", *tight)["fuse"]
    assert 0 < again["bricks_fused"] < again["bricks"] == quiet["bricks"]
    assert (tmp_path / "out" / "fused.ply").read_bytes() == (tmp_path / "quiet" / "fused.ply").read_bytes()


@pytest.mark.slow
def test_a_damaged_brick_is_fused_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan, out = write_partial_sample(tmp_path / "scan", list(range(0, 24, 6))), tmp_path / "out"
    quiet = run_and_get_metrics(scan, out)["fuse"]
    before = (out / "fused.ply").read_bytes()
    kept = tmp_path / "out-cache"

    def again(*, force: Sequence[str] = ()) -> int:
        fused = run(scan, out, Config().set(QUICK), until="fuse", cache_dir=kept, force=force).stages[-1]
        assert (out / "fused.ply").read_bytes() == before
        return int(fused.metrics["bricks_fused"])

    # Damage before the lookup, a different one for each of the files.
    shutil.rmtree(kept / "fuse")
    hurt = sorted((kept / "brick").iterdir())[:3]
    (hurt[0] / "surface.npz").write_bytes(b"")
    (hurt[1] / "joint.npz").unlink()
    (hurt[2] / "skipped.json").write_text("{ }")
    assert again() == 3

    # Damage after the lookup, detectable only by content.
    from scanloom.pipeline.artifacts import fused_bricks as bricks

    get = bricks.CachedBrickStore.get
    for name in ("surface.npz", "frame_counts.npy"):
        shutil.rmtree(kept / "fuse")

        def found(self: Any, *words: Any, name: str = name) -> Path | None:
            folder = get(self, *words)
            assert folder is not None
            (folder / name).write_bytes(b"what is no array, and no text")
            return folder

        with monkeypatch.context() as patched:
            patched.setattr(bricks.CachedBrickStore, "get", found)
            with pytest.raises(StageError, match="the brick was damaged during the run"):
                again()
        assert again() == quiet["bricks"]
    assert again(force=["fuse"]) == quiet["bricks"]


@pytest.mark.slow
def test_a_new_frame_fuses_only_the_bricks_it_touches(tmp_path: Path) -> None:
    # Parameters that would be derived from all frames are given.
    given = ("fuse.truncation=0.045", "fuse.max_depth=2.2")
    scan = write_partial_sample(tmp_path / "scan", list(range(0, 24, 6)))
    out = tmp_path / "out"
    first = run_and_get_metrics(scan, out, *given)["fuse"]
    # The new frame shows a corner of the scene.
    frames = [*read_scan(scan).frames]
    new = read_scan(SAMPLE).frames[20]
    depth = cv2.imread(str(new.depth), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    depth[:, 60:] = 0
    cv2.imwrite(str(scan / "depth" / "new.png"), depth)
    color = scan / "color" / Path(str(new.color)).name
    frames.append(replace(new, name="new", color=color, depth=scan / "depth" / "new.png"))
    write_scan_json(scan, frames)
    again = run_and_get_metrics(scan, out, *given)["fuse"]
    assert again["frames_used"] == first["frames_used"] + 1
    assert 0 < again["bricks_fused"] < 0.7 * again["bricks"]
    alone = run_and_get_metrics(scan, tmp_path / "alone", *given)["fuse"]
    assert alone["bricks_fused"] == alone["bricks"] == again["bricks"]
    assert (out / "fused.ply").read_bytes() == (tmp_path / "alone" / "fused.ply").read_bytes()


@pytest.mark.slow
def test_large_meshes_stay_chunked_for_any_memory_limit(tmp_path: Path) -> None:
    scan = write_partial_sample(tmp_path / "scan", list(range(0, 24, 6)))
    ratio = "simplify.ratio=0.2"
    at_once = run_and_get_metrics(scan, tmp_path / "at-once", ratio, until="simplify")
    whole = "fuse.brick_size=none"
    ways = {
        "bricks": ("fuse.brick_size=0.16",),
        "large": ("fuse.brick_size=1",),
        "one": (whole,),
        "tight": (whole, "fuse.memory=1"),
    }
    with use_small_chunks():
        for way, settings in ways.items():
            in_pieces = run_and_get_metrics(scan, tmp_path / way, ratio, *settings, until="simplify")
            assert ("bricks" in in_pieces["fuse"]) == (way != "one")
            assert in_pieces["simplify"]["parts"] > 5
        with pytest.raises(StageError, match=r"bake cannot process chunks, and refined\.ply has"):
            run_and_get_metrics(scan, tmp_path / "one", ratio, "bake.enabled=true", until="bake")
    assert in_pieces["simplify"]["triangles"] == pytest.approx(at_once["simplify"]["triangles"], abs=2)
    for name in ("fused.ply", "clean.ply", "refined.ply", "simplified.ply"):
        assert len({(tmp_path / way / name).read_bytes() for way in ways}) == 1
    for name in ("fused.ply", "clean.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "at-once" / name).read_bytes()
    one, other = (topology(read_ply(tmp_path / out / "simplified.ply")) for out in ("at-once", "one"))
    assert (one.euler, one.components) == (other.euler, other.components)
    assert one.boundary_loops == other.boundary_loops
