"""Commands `lod build`, `lod info` and `lod cut`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom import bake
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from tests.made.coloured_meshes import sheet

Run = Callable[..., Any]


@pytest.fixture
def built(scanloom: Run, tmp_path: Path) -> Path:
    write_ply(tmp_path / "m.ply", sheet(40))
    ran = scanloom(
        "lod", "build", tmp_path / "m.ply", tmp_path / "new" / "m.slod", "--set", "lod.cell_triangles=500"
    )
    assert ran.exit_code == 0, ran.stderr
    return tmp_path / "new" / "m.slod"


def test_build_and_info_report_the_same_levels(scanloom: Run, built: Path, tmp_path: Path) -> None:
    again = scanloom(
        "lod", "build", tmp_path / "m.ply", tmp_path / "n.slod", "--set", "lod.cell_triangles=500", "--json"
    )
    result = scanloom("lod", "info", built, "--json").json
    assert again.json["levels"] == result["levels"]
    assert result["base_triangles"] == result["input_triangles"] == 3200
    assert [level["shape_bound_m"] for level in result["levels"]] == sorted(
        (level["shape_bound_m"] for level in result["levels"]), reverse=True
    )
    assert "proven error m" in scanloom("lod", "info", built).stdout


def test_cut_reaches_a_triangle_count_an_error_and_a_view(scanloom: Run, built: Path, tmp_path: Path) -> None:
    out = tmp_path / "cut.ply"
    ran = scanloom("lod", "cut", built, out, "--triangles", 700, "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["triangles"] == len(read_mesh(out).triangles) <= 700
    ran = scanloom("lod", "cut", built, out, "--max-shape", 0)
    assert (ran.exit_code, len(read_mesh(out).triangles)) == (0, 3200)
    assert "proven." in ran.stdout
    view = (
        "--eye",
        0.5,
        0.5,
        3,
        "--look",
        0.5,
        0.5,
        0,
        "--set",
        "view.width=640",
        "--set",
        "view.height=480",
    )
    near = scanloom("lod", "cut", built, out, *view, "--error-px", 0.5, "--json").json["triangles"]
    far = scanloom("lod", "cut", built, out, *view, "--error-px", 50, "--json").json["triangles"]
    assert near > far
    ran = scanloom("lod", "cut", built, out, "--region", "sphere 0 0 0 0.1", "--json")
    assert ran.exit_code == 0, ran.stderr
    exact = {tuple(v) for v in read_mesh(tmp_path / "m.ply").vertices}
    found = read_mesh(out).vertices
    assert all(tuple(v) in exact for v in found[np.linalg.norm(found, axis=1) < 0.1])


def test_a_cut_gets_the_texture_of_a_model(scanloom: Run, built: Path, tmp_path: Path) -> None:
    out, model = tmp_path / "cut.glb", tmp_path / "m.ply"
    ran = scanloom("lod", "cut", built, out, "--triangles", 700, "--texture", model, "--json")
    assert ran.exit_code == 0, ran.stderr
    mesh = read_mesh(out)
    assert mesh.texture is not None
    assert mesh.texture.images
    assert ran.json["triangles"] == len(mesh.triangles) <= 700
    assert ran.json["texture"]["color"]["rmse_levels"] < ran.json["texture"]["vertex_color"]["rmse_levels"]
    assert ran.json["color_bound_levels"] is None
    ran = scanloom("lod", "cut", built, tmp_path / "cut.stl", "--triangles", 700, "--texture", model)
    assert ran.exit_code == 2
    assert "unknown file extension .stl; use .glb, .obj, .ply." in ran.stderr


def test_a_cut_of_a_textured_mesh_is_baked_again(scanloom: Run, tmp_path: Path) -> None:
    source, slod, out = tmp_path / "m.glb", tmp_path / "m.slod", tmp_path / "cut.glb"
    write_mesh(source, bake(sheet(16), sheet(16), normal_map=False, occlusion_map=False).mesh)
    ran = scanloom(
        "lod", "build", source, slod, "--set", "lod.cell_triangles=128", "--set", "lod.root_triangles=100"
    )
    assert (ran.exit_code, ran.stderr) == (0, "")
    ran = scanloom("lod", "cut", slod, out, "--triangles", 300, "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    mesh = read_mesh(out)
    assert mesh.texture is not None
    assert mesh.texture.images
    assert mesh.up == (0.0, 1.0, 0.0)
    assert ran.json["texture"]["color"]["rmse_levels"] < 10
    ran = scanloom("lod", "cut", slod, out, "--triangles", 300, "--texture", "none", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert read_mesh(out).texture is None
    assert "texture" not in ran.json
    # Geometry-only formats warn about what they cannot store.
    ran = scanloom("lod", "cut", slod, tmp_path / "cut.stl", "--triangles", 300)
    assert ran.exit_code == 0
    assert "colours" in ran.stderr


def test_dropped_islands_are_reported_by_build_info_and_cut(scanloom: Run, tmp_path: Path) -> None:
    whole = sheet(40)
    # One triangle, 1 mm wide and 1 m above.
    speck = np.array([(0, 0, 1), (0.001, 0, 1), (0, 0.001, 1)])
    mesh = whole.with_(
        vertices=np.concatenate([whole.vertices, speck]),
        triangles=np.concatenate([whole.triangles, np.arange(3)[None] + len(whole.vertices)]).astype(
            np.int32
        ),
        colors=np.concatenate([whole.colors, np.zeros((3, 3), np.uint8)]),
    )
    write_ply(tmp_path / "m.ply", mesh)
    slod = tmp_path / "m.slod"
    ran = scanloom(
        "lod",
        "build",
        tmp_path / "m.ply",
        slod,
        "--set",
        "lod.cell_triangles=500",
        "--set",
        "lod.drop_islands=0.01",
    )
    assert ran.exit_code == 0, ran.stderr
    assert "1 connected components" in ran.stderr
    ran = scanloom("lod", "info", slod)
    assert "1 small components, 1 triangles, were dropped" in ran.stdout
    result = scanloom("lod", "info", slod, "--json").json
    assert (result["one_sided"], result["dropped_islands"], result["dropped_triangles"]) == (True, 1, 1)
    ran = scanloom("lod", "cut", slod, tmp_path / "cut.ply", "--max-shape", 0)
    assert "dropped components are not covered" in ran.stdout
    assert scanloom("lod", "tiles", slod, tmp_path / "tiles", "--json").json["one_sided"]


def test_a_count_below_the_coarsest_level_is_reported(scanloom: Run, built: Path, tmp_path: Path) -> None:
    ran = scanloom("lod", "cut", built, tmp_path / "o.ply", "--triangles", 3)
    assert ran.exit_code == 1
    assert "the coarsest level has" in ran.stderr


def test_wrong_options_and_bad_files_have_exit_codes(scanloom: Run, built: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.ply"
    assert scanloom("lod", "cut", built, out).exit_code == 2
    assert scanloom("lod", "cut", built, out, "--error-px", 1).exit_code == 2
    assert scanloom("lod", "cut", built, out, "--eye", 0, 0, 0, "--triangles", 10).exit_code == 2
    assert scanloom("lod", "build", tmp_path / "m.ply", tmp_path / "o.ply").exit_code == 2
    ran = scanloom("lod", "info", tmp_path / "m.ply")
    assert ran.exit_code == 3
    assert "not a .slod file" in ran.stderr
    ran = scanloom("lod", "info", tmp_path / "none.slod")
    assert ran.exit_code == 3
    built.write_bytes(built.read_bytes()[:-100])
    ran = scanloom("lod", "info", built)
    assert ran.exit_code == 0
    assert "finer levels are missing" in ran.stderr
