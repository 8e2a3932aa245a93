"""A run over bricks: kept one by one, fused again where a frame is new, and large results piece by piece."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from sample_in_pieces import part_of_sample, small_pieces

from pipeline.config import Config
from pipeline.run import run
from stages.errors import StageError
from stages.scans.layouts.scan_json import write_scan_json
from stages.scans.read import read_scan
from stages.surface.formats.ply import read_ply
from stages.surface.topology import topology

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rgbd"
# All that would be derived of the frames together is given: a frame more changes no brick it does not touch.
QUICK = (
    "adjust.enabled=false",
    "texture.enabled=false",
    "report.enabled=false",
    "fuse.voxel_size=0.015",
    "fuse.brick_size=0.3",
    "fuse.min_weight=1",
)


def figures(scan: Path, out: Path, *more: str, until: str = "fuse") -> dict[str, Any]:
    result = run(scan, out, Config().set([*QUICK, *more]), until=until, cache_dir=f"{out}-cache")
    stages: Any = result.report["stages"]
    return {name: stage["figures"] for name, stage in stages.items()}


def test_a_killed_run_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = part_of_sample(tmp_path / "scan", list(range(0, 24, 6)))
    quiet = figures(scan, tmp_path / "quiet")["fuse"]
    assert quiet["bricks"] == quiet["bricks_fused"] > 10

    from pipeline import bricks

    store, left = bricks.KeptBricks.store, [7]

    def some(self: Any, *words: Any) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise StageError("killed")
        return store(self, *words)

    monkeypatch.setattr(bricks.KeptBricks, "store", some)
    with pytest.raises(StageError, match="killed"):
        figures(scan, tmp_path / "out")
    monkeypatch.setattr(bricks.KeptBricks, "store", store)
    again = figures(scan, tmp_path / "out")["fuse"]
    assert again["bricks_fused"] == quiet["bricks"] - 7
    assert (tmp_path / "out" / "fused.ply").read_bytes() == (tmp_path / "quiet" / "fused.ply").read_bytes()


def test_a_new_frame_fuses_again_only_what_it_touches(tmp_path: Path) -> None:
    # What would be derived of all frames together is given.
    given = ("fuse.truncation=0.045", "fuse.max_depth=2.2")
    scan = part_of_sample(tmp_path / "scan", list(range(0, 24, 6)))
    out = tmp_path / "out"
    first = figures(scan, out, *given)["fuse"]
    # It sees a corner of the scene.
    frames = [*read_scan(scan).frames]
    new = read_scan(SAMPLE).frames[20]
    depth = cv2.imread(str(new.depth), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    depth[:, 60:] = 0
    cv2.imwrite(str(scan / "depth" / "new.png"), depth)
    color = scan / "color" / Path(str(new.color)).name
    frames.append(replace(new, name="new", color=color, depth=scan / "depth" / "new.png"))
    write_scan_json(scan, frames)
    again = figures(scan, out, *given)["fuse"]
    assert again["frames_used"] == first["frames_used"] + 1
    assert 0 < again["bricks_fused"] < 0.7 * again["bricks"]
    alone = figures(scan, tmp_path / "alone", *given)["fuse"]
    assert alone["bricks_fused"] == alone["bricks"] == again["bricks"]
    assert (out / "fused.ply").read_bytes() == (tmp_path / "alone" / "fused.ply").read_bytes()


def test_large_meshes_go_on_in_pieces_whatever_the_memory(tmp_path: Path) -> None:
    scan = part_of_sample(tmp_path / "scan", list(range(0, 24, 6)))
    ratio = "simplify.ratio=0.2"
    at_once = figures(scan, tmp_path / "at-once", ratio, until="simplify")
    whole = "fuse.brick_size=none"
    ways = {"bricks": ("fuse.brick_size=0.16",), "one": (whole,), "tight": (whole, "fuse.memory=1")}
    with small_pieces():
        for way, settings in ways.items():
            in_pieces = figures(scan, tmp_path / way, ratio, *settings, until="simplify")
            assert ("bricks" in in_pieces["fuse"]) == (way != "one")
            assert in_pieces["simplify"]["parts"] > 5
        with pytest.raises(StageError, match=r"bake reads all of clean\.ply at once"):
            figures(scan, tmp_path / "one", ratio, "bake.enabled=true", until="bake")
    assert in_pieces["simplify"]["triangles"] == pytest.approx(at_once["simplify"]["triangles"], abs=2)
    for name in ("fused.ply", "clean.ply", "simplified.ply"):
        assert len({(tmp_path / way / name).read_bytes() for way in ways}) == 1
    for name in ("fused.ply", "clean.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "at-once" / name).read_bytes()
    one, other = (topology(read_ply(tmp_path / out / "simplified.ply")) for out in ("at-once", "one"))
    assert (one.euler, one.components) == (other.euler, other.components)
    assert one.boundary_loops == other.boundary_loops
