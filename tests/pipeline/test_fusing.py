"""Cropping and plane removal during fusion, and their effects on later stages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from object_on_table import BALL, frames

from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.dry_run import predict_run
from scanloom.pipeline.run.run import RunResult, run
from scanloom.pipeline.steps.fuse import FusedMesh, fuse_separate_components, write_fused
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.formats.ply import read_ply

QUICK = ("adjust.enabled=false", "texture.enabled=false", "fuse.voxel_size=0.02")
# Small enough that level cameras give no better estimate of up.
TILT = np.radians(7)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a ball on a table, in a world that is not level."""
    folder = tmp_path_factory.mktemp("table")
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(TILT), -np.sin(TILT)], [np.sin(TILT), np.cos(TILT)]]
    written = []
    for frame in frames("ball"):
        depth, color = folder / f"{frame.name}-depth.png", folder / f"{frame.name}.png"
        cv2.imwrite(str(depth), np.rint(np.asarray(frame.depth) * 1000).astype(np.uint16))
        cv2.imwrite(str(color), np.asarray(frame.color))
        pose = turn @ frame.world_from_camera
        written.append(Frame(frame.name, frame.camera, color=color, depth=depth, world_from_camera=pose))
    write_scan_json(folder, written)
    return folder


def run_table(table: Path, out: Path, *more: str, until: str = "fuse") -> RunResult:
    return run(table, out, Config().set([*QUICK, *more]), until=until)


def test_the_removed_plane_gives_the_up_direction(table: Path, tmp_path: Path) -> None:
    result = run_table(table, tmp_path / "out", "fuse.remove_plane=true", until="upright")
    stages: Any = result.report["stages"]
    told = stages["upright"]["metrics"]
    assert told["up_source"] == "plane"
    assert told["up"] == pytest.approx([0, -np.sin(TILT), np.cos(TILT)], abs=0.003)
    plane = stages["fuse"]["metrics"]["crop"]["plane"]
    assert plane["normal"] == pytest.approx(told["up"], abs=1e-6)
    heights = read_ply(tmp_path / "out" / "clean.ply").vertices @ plane["normal"] - plane["offset_m"]
    assert plane["margin_m"] - 1e-4 <= heights.min() < plane["margin_m"] + 0.02
    assert heights.max() == pytest.approx(2 * BALL, abs=0.01)
    without = run_table(table, tmp_path / "out", until="upright").report["stages"]["upright"]["metrics"]
    assert without["up_source"] == "surface"


@pytest.mark.parametrize(
    ("assignment", "reason"),
    [
        ("fuse.box=-0.2 -0.2 0 0.3 0.2 0.3", "box not set → [-0.2, -0.2, 0.0, 0.3, 0.2, 0.3]"),
        ("fuse.radius=0.3", "radius not set → 0.3"),
        ("fuse.center=0 0 0.1", "center not set → [0.0, 0.0, 0.1]"),
        ("fuse.remove_plane=true", "remove_plane False → True"),
        ("fuse.plane_margin=0.02", "plane_margin not set → 0.02"),
    ],
)
def test_changing_the_crop_reruns_fusion(table: Path, made: Path, assignment: str, reason: str) -> None:
    config = Config().set([*QUICK, assignment])
    (fused,) = predict_run(table, made, config, until="fuse").stages
    assert (fused.cached, fused.reason) == (False, f"params changed: {reason}")
    assert predict_run(table, made, Config().set(QUICK), until="fuse").stages[0].cached


@pytest.fixture(scope="module")
def made(table: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made")
    run_table(table, out)
    return out


def test_a_crop_that_leaves_nothing_stops_the_run(table: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the crop is empty: none of "):
        run_table(table, tmp_path / "out", "fuse.box=5 5 5 6 6 6")
    assert not (tmp_path / "out" / "fused.ply").exists()


def test_only_a_removed_plane_gives_the_up_direction(tmp_path: Path) -> None:
    scan = Scan("plain-rgbd", frames("ball")[::2])
    fused = write_fused(tmp_path, scan, FuseParams(voxel_size=0.03, radius=0.4), None)
    assert FusedMesh(tmp_path).load_plane_normal() is None
    assert len(read_ply(tmp_path / "fused.ply").triangles) == fused.to_dict()["triangles"]


def test_a_given_position_is_not_used_in_other_components(tmp_path: Path) -> None:
    scan = Scan("plain-rgbd", frames("ball"))
    poses = {str(k): np.asarray(frame.world_from_camera).tolist() for k, frame in enumerate(scan.frames)}
    (tmp_path / "registration.json").write_text(json.dumps({"poses": {}, "apart": {"2": poses}}))
    given = FuseParams(box=(0, 0, 0, 1, 1, 1))
    for params, said in (
        (given, "component 2 is not fused: fuse.box and fuse.center apply to the main one"),
        (FuseParams(radius=0.01), "component 2 is not fused: "),
    ):
        with collecting() as diagnostics:
            fuse_separate_components(tmp_path, scan, Poses(tmp_path), params)
        assert str(diagnostics[0]).startswith(said)
    assert not (tmp_path / "pieces").exists()
    with collecting() as diagnostics:
        fuse_separate_components(
            tmp_path, scan, Poses(tmp_path), FuseParams(voxel_size=0.03, radius=0.3, center=None)
        )
    assert [str(one) for one in diagnostics] == [
        "component 2 with 16 frames is fused separately: pieces/fused-2.ply"
    ]
