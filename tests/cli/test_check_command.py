"""Command `check`: messages, exit codes, and files of defect locations."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.cli.check_output import COLORS
from scanloom.stages.cleaning.check import CLASSES
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh

Run = Callable[..., Any]


def test_a_sound_mesh_meets_its_requirements(scanloom: Run, clean_ball: Path) -> None:
    ran = scanloom("check", clean_ball, "--require", "watertight, outward,no-needles", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert ran.json["is_watertight"] is True
    assert {name: of["count"] for name, of in ran.json["classes"].items()} == dict.fromkeys(CLASSES, 0)


def test_each_unmet_requirement_is_reported(scanloom: Run, ball: Path) -> None:
    ran = scanloom("check", ball, "--require", "watertight,one-piece,manifold")
    assert ran.exit_code == 1
    first, second = ran.stderr.splitlines()
    assert first.startswith(f"scanloom: {ball}: it has edges with only one triangle: 3, the first at (9")
    assert second == f"scanloom: {ball}: it has 2 connected components."
    assert "border edges: edges with only one triangle" in ran.stdout
    assert scanloom("check", ball).exit_code == 0


def test_defects_are_saved_as_json_and_as_coloured_ply(scanloom: Run, ball: Path, tmp_path: Path) -> None:
    listed, coloured = tmp_path / "new" / "places.json", tmp_path / "new" / "places.ply"
    ran = scanloom("check", ball, "--save-places", listed, "--save-ply", coloured)
    assert ran.exit_code == 0, ran.stderr
    assert "border edges (3) are rgb(86, 180, 233)" in ran.stderr
    places = json.loads(listed.read_text())
    assert set(places) == set(CLASSES) == set(COLORS)
    count = len(read_mesh(ball).vertices)
    ends = [[count - 3, count - 2], [count - 3, count - 1], [count - 2, count - 1]]
    assert places["border_edges"]["places"] == ends
    assert len(places["border_edges"]["points_m"]) == 3
    colors = read_mesh(coloured).colors
    assert colors is not None
    is_blue = (colors == COLORS["border_edges"]).all(axis=1)
    assert np.flatnonzero(is_blue).tolist() == [len(colors) - 3, len(colors) - 2, len(colors) - 1]


def test_wrong_options_and_bad_input_have_exit_codes_2_and_3(
    scanloom: Run, ball: Path, tmp_path: Path
) -> None:
    ran = scanloom("check", ball, "--require", "waterproof")
    assert ran.exit_code == 2
    assert "unknown requirement 'waterproof'" in ran.stderr
    # Options are checked before files are read.
    ran = scanloom("check", tmp_path / "none.ply", "--require", "no-thin-triangles")
    assert (ran.exit_code, "needs min_thickness" in ran.stderr) == (2, True)
    assert scanloom("check", ball, "--set", "check.corner_angle=40").exit_code == 2
    assert scanloom("check", ball, "--save-ply", tmp_path / "places.obj").exit_code == 2
    assert scanloom("check", tmp_path / "none.ply").exit_code == 3
    far = tmp_path / "far.ply"
    write_ply(far, Mesh(np.eye(3) * 1e300, np.array([[0, 1, 2]], np.int32)))
    ran = scanloom("check", far)
    assert ran.exit_code == 3
    assert "far.ply: vertex 0 is at" in ran.stderr
