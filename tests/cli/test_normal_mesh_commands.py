"""Commands `remesh` and `decode`: metrics, files, damage, and bad input."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from scanloom.cli.app import run_command
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.surface.formats.ply import read_vertex_values, write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh

Run = Callable[..., Any]
SMALL = ("--levels", 2, "--base-triangles", 80)


@pytest.fixture(scope="module")
def made_kept(made_clean_ball: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write an .snm file with two levels, and remeshed.ply next to it."""
    path = tmp_path_factory.mktemp("kept") / "kept.snm"
    words = ("mesh", "remesh", made_clean_ball, path.with_name("remeshed.ply"), *SMALL, "--save", path)
    assert run_command([str(word) for word in words]) == 0
    return path


@pytest.fixture
def kept(made_kept: Path, clean_ball: Path) -> Path:
    """Copy both files for one test, next to the clean ball."""
    shutil.copy(made_kept.with_name("remeshed.ply"), clean_ball.parent)
    return Path(shutil.copy(made_kept, clean_ball.parent))


def test_remesh_writes_the_finest_level_all_levels_and_an_snm_file(
    scanloom: Run, clean_ball: Path, tmp_path: Path
) -> None:
    target, file, folder = tmp_path / "new" / "normal.ply", tmp_path / "files" / "n.snm", tmp_path / "levels"
    ran = scanloom(
        "mesh", "remesh", clean_ball, target, *SMALL, "--save", file, "--save-levels", folder, "--json"
    )
    assert ran.exit_code == 0
    assert ran.stderr == ""
    assert ran.json["output"] == str(target)
    finest = read_mesh(target)
    assert len(finest.triangles) == ran.json["triangles"] == 16 * ran.json["base_triangles"]
    assert finest.colors is not None
    assert ran.json["file_bytes"] == file.stat().st_size
    assert sorted(path.name for path in folder.iterdir()) == ["level_0.ply", "level_1.ply", "level_2.ply"]
    assert (folder / "level_2.ply").read_bytes() == target.read_bytes()
    metrics = scanloom("compare", clean_ball, target, "--set", "compare.samples=20000", "--json").json
    assert metrics["distance"]["symmetric"]["maximum_m"] < 0.02


def test_the_table_has_a_row_for_each_level(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    ran = scanloom(
        "mesh", "remesh", clean_ball, tmp_path / "out.ply", *SMALL, "--set", "remesh.max_error=1e-6"
    )
    rows = [line.split() for line in ran.stdout.splitlines()]
    assert rows[0][:3] == ["level", "triangles", "vertices"]
    assert [row[0] for row in rows[1:4]] == ["0", "1", "2"]
    assert rows[0][-3:] == ["largest", "distance", "m"]
    assert float(rows[1][-1]) > float(rows[3][-1]) > 0
    assert f"scanloom: {clean_ball}: the finest level is up to" in ran.stderr


def test_decode_restores_the_remeshed_file_byte_for_byte(scanloom: Run, kept: Path, tmp_path: Path) -> None:
    again, coarse, folder = tmp_path / "again.ply", tmp_path / "coarse.ply", tmp_path / "levels"
    ran = scanloom("mesh", "decode", kept, again, "--save-levels", folder, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert again.read_bytes() == kept.with_name("remeshed.ply").read_bytes()
    assert (ran.json["levels"], ran.json["levels_encoded"], ran.json["damage"]) == (2, 2, None)
    ran = scanloom("mesh", "decode", kept, coarse, "--level", 1, "--json")
    assert ran.json["levels"] == 1
    assert coarse.read_bytes() == (folder / "level_1.ply").read_bytes()


def test_decode_returns_the_intact_levels_of_a_damaged_file_with_a_warning(
    scanloom: Run, kept: Path, tmp_path: Path
) -> None:
    target = tmp_path / "out.ply"
    data = kept.read_bytes()
    end = decode(data).level_ends[1]
    kept.write_bytes(data[: end + 3])
    ran = scanloom("mesh", "decode", kept, target)
    assert ran.exit_code == 0
    assert f"warning: {kept}: only levels 0 to 1 are intact: " in ran.stderr
    assert len(read_mesh(target).triangles) == 4 * 80
    ran = scanloom("mesh", "decode", kept, target, "--json")
    assert ran.json["levels"] == 1
    assert ran.json["damage"]
    ran = scanloom("mesh", "decode", kept, tmp_path / "none.ply", "--level", 2)
    assert ran.exit_code == 3
    assert ran.stderr.startswith(f"scanloom: {kept}: has no level 2; only levels 0 to 1 are intact")
    assert not (tmp_path / "none.ply").exists()
    kept.write_bytes(data[:end])
    assert "warning" not in scanloom("mesh", "decode", kept, target).stderr


def test_confidence_of_a_ply_file_is_remeshed(scanloom: Run, tmp_path: Path) -> None:
    shape = trimesh.creation.icosphere(subdivisions=3)
    mesh = Mesh(np.array(shape.vertices), np.array(shape.faces, np.int32))
    source, target, file, again = (tmp_path / name for name in ("in.ply", "out.ply", "out.snm", "again.ply"))
    write_ply(source, mesh, vertex_values={"confidence": 0.5 + 0.5 * mesh.vertices[:, 2]})
    ran = scanloom("mesh", "remesh", source, target, *SMALL, "--save", file)
    assert ran.exit_code == 0, ran.stderr
    confidence = read_vertex_values(target, "confidence")
    heights = 0.5 + 0.5 * read_mesh(target).vertices[:, 2]
    np.testing.assert_allclose(confidence, heights, atol=0.003)
    scanloom("mesh", "decode", file, again)
    assert again.read_bytes() == target.read_bytes()
    assert scanloom("mesh", "remesh", source, tmp_path / "out.obj", *SMALL).exit_code == 0
    write_ply(source, mesh, vertex_values={"confidence": np.full(len(mesh.vertices), np.nan)})
    ran = scanloom("mesh", "remesh", source, target)
    assert ran.exit_code == 3
    assert f"{source}: the vertex property `confidence` has values that are not finite" in ran.stderr


@pytest.mark.parametrize(
    ("words", "exit_code", "sentence"),
    [
        (("mesh", "remesh", "missing.ply", "out.ply"), 3, "missing.ply: there is no such file."),
        (("mesh", "remesh", "clean.ply", "out.xyz"), 2, "unknown file extension .xyz"),
        (("mesh", "remesh", "clean.ply", "out.ply", "--save", "out.npz"), 2, "use .snm"),
        (("mesh", "remesh", "clean.ply", "out.ply", "--save-levels", "clean.ply"), 3, "clean.ply"),
        (
            ("mesh", "remesh", "clean.ply", "out.ply", "--levels", "11"),
            2,
            "--levels is 11; it must be at most 10",
        ),
        (
            ("mesh", "remesh", "clean.ply", "out.ply", "--set", "remesh.scheme=loop"),
            2,
            "--set remesh.scheme is 'loop'; it must be one of",
        ),
        (
            ("mesh", "remesh", "clean.ply", "out.ply", "--set", "remesh.tolerance=0"),
            2,
            "--set remesh.tolerance is 0",
        ),
        (("mesh", "decode", "missing.snm", "out.ply"), 3, "missing.snm: there is no such file."),
        (("mesh", "decode", "clean.ply", "out.ply"), 3, "clean.ply: "),
        (
            ("mesh", "decode", "kept.snm", "out.ply", "--level", "3"),
            2,
            "kept.snm was encoded with levels 0 to 2",
        ),
        (("mesh", "decode", "kept.snm", "out.ply", "--level", "-1"), 2, "level is -1"),
        (("mesh", "decode", "kept.snm", "out.snm"), 2, "unknown file extension .snm"),
    ],
)
def test_bad_input_is_one_error(
    scanloom: Run,
    kept: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    exit_code: int,
    sentence: str,
) -> None:
    monkeypatch.chdir(kept.parent)
    ran = scanloom(*words)
    assert ran.exit_code == exit_code
    assert sentence in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert ran.stdout == ""
    assert not Path("out.ply").exists()


def test_remesh_splits_a_non_manifold_mesh_with_a_warning(scanloom: Run, tmp_path: Path) -> None:
    fan = tmp_path / "fan.ply"
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]], float)
    write_ply(fan, Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)))
    ran = scanloom("mesh", "remesh", fan, tmp_path / "out.ply")
    assert ran.exit_code == 0
    assert f"warning: {fan}: 2 pinched vertices were split" in ran.stderr


def test_pinched_vertices_are_split_with_a_warning(scanloom: Run, tmp_path: Path) -> None:
    hourglass = tmp_path / "hourglass.ply"
    corners = [[0, 0, 0], [1, 0, 1], [-1, 1, 1], [-1, -1, 1], [1, 0, -1], [-1, 1, -1], [-1, -1, -1]]
    upper = [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]
    lower = [[0, 4, 5], [0, 5, 6], [0, 6, 4], [4, 6, 5]]
    write_ply(hourglass, Mesh(np.array(corners, float), np.array(upper + lower, np.int32)))
    ran = scanloom("mesh", "remesh", hourglass, tmp_path / "out.ply", "--levels", 1)
    assert ran.exit_code == 0, ran.stderr
    assert f"warning: {hourglass}: 1 pinched vertex was split" in ran.stderr
