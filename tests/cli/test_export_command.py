"""Command `export`: written files, messages, and bad input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coloured_sheet import UP, ball, sheet, textured_sheet

from scanloom.stages.surface.mesh_files import read_mesh, write_mesh

Run = Callable[..., Any]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "model.glb", textured_sheet(40))
    return tmp_path / "model.glb"


def test_preset_web_writes_a_small_file(scanloom: Run, model: Path, tmp_path: Path) -> None:
    target = tmp_path / "new" / "web.glb"
    ran = scanloom("export", model, target, "--preset", "web", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["bytes"] == target.stat().st_size < 0.7 * model.stat().st_size
    assert ran.json["up"] == list(UP)
    assert 0 < ran.json["position_error_m"] < 2e-4
    np.testing.assert_allclose(
        np.sort(read_mesh(target).vertices, axis=0), np.sort(read_mesh(model).vertices, axis=0), atol=2e-4
    )
    (image,) = read_mesh(target).texture.images
    assert image.mime == "image/webp"
    # Explicit options override the preset.
    assert scanloom("export", model, target, "--preset", "web", "--set", "export.images=jpeg").exit_code == 0
    (image,) = read_mesh(target).texture.images
    assert image.mime == "image/jpeg"
    # So do explicit options with their default value.
    errors = [
        scanloom("export", model, target, "--preset", "web", *words, "--json").json["position_error_m"]
        for words in ((), ("--set", "export.position_bits=16"), ("--compress", "none"))
    ]
    assert errors[0] > 3 * errors[1] > errors[2] == 0


def test_preset_print_reports_an_open_mesh(scanloom: Run, model: Path, tmp_path: Path) -> None:
    ran = scanloom("export", model, tmp_path / "a.stl", "--preset", "print")
    assert ran.exit_code == 1
    assert "edges with only one triangle" in ran.stderr
    assert "geometry only" in ran.stderr
    write_mesh(tmp_path / "ball.ply", ball())
    ran = scanloom("export", tmp_path / "ball.ply", tmp_path / "b.stl", "--preset", "print", "--up", "-y")
    assert (ran.exit_code, "unmet" in ran.stderr) == (0, False)
    assert read_mesh(tmp_path / "b.stl").vertices[:, 2].max() == pytest.approx(100, abs=0.01)


def test_gltf_files_of_other_programs_are_y_up(scanloom: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.glb", sheet())
    ran = scanloom("export", tmp_path / "a.glb", tmp_path / "a.ply", "--set", "export.axes=z-up")
    assert ran.exit_code == 0
    heights = np.sort(read_mesh(tmp_path / "a.ply").vertices[:, 2])
    np.testing.assert_allclose(heights, np.sort(sheet().vertices[:, 1]), atol=1e-6)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("out.fbx",), 2, "extension .fbx is unknown"),
        (("out.glb", "--preset", "paper"), 2, "unknown preset"),
        (("out.glb", "--up", "sideways"), 2, "up"),
        (("out.glb", "--unit", "mm"), 2, "in metres"),
        (("out.stl", "--compress", "meshopt"), 2, "only to glTF"),
        (("folder.glb",), 3, "this is a folder"),
        (("sim", "--preset", "sim", "--compress", "meshopt"), 2, "compress does not apply to --preset sim"),
        (("out.glb", "--set", "simulation.density=5"), 2, "require --preset sim"),
        (("sim", "--preset", "sim", "--set", "simulation.density=0"), 2, "density"),
        (("model.glb", "--preset", "sim"), 3, "this is a file"),
    ],
)
def test_bad_export_input_is_one_error_and_writes_nothing(
    scanloom: Run, model: Path, tmp_path: Path, words: tuple[str, ...], code: int, message: str
) -> None:
    (tmp_path / "folder.glb").mkdir()
    before = sorted(tmp_path.iterdir())
    ran = scanloom("export", model, tmp_path / words[0], *words[1:])
    assert ran.exit_code == code
    assert message in ran.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_a_missing_ktx2_encoder_is_one_error(
    scanloom: Run, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    target = tmp_path / "web.glb"
    ran = scanloom("export", model, target, "--preset", "web", "--set", "export.images=ktx2")
    assert ran.exit_code == 3
    assert "npm install --global ktx2-encoder" in ran.stderr
    assert not target.exists()


def test_a_missing_file_is_reported(scanloom: Run, tmp_path: Path) -> None:
    ran = scanloom("export", tmp_path / "none.glb", tmp_path / "out.glb")
    assert (ran.exit_code, "there is no such file" in ran.stderr) == (3, True)


def test_preset_sim_writes_a_folder(scanloom: Run, tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    pytest.importorskip("pxr")
    mesh = textured_sheet(20)
    write_mesh(tmp_path / "floor.ply", mesh.with_(vertices=mesh.vertices * (1, 1, 0), texture=None))
    target = tmp_path / "new" / "floor"
    words = ("export", tmp_path / "floor.ply", target, "--preset", "sim", "--up", "+z", "--json")
    words += ("--set", "simulation.max_excess=10cm")
    ran = scanloom(*words)
    assert ran.exit_code == 0, ran.stderr
    (body,) = ran.json["bodies"]
    assert body["collision_parts"] == 1
    assert body["gap_bound_m"] == 0 < body["excess_bound_m"]
    assert "the surface is open" in ran.stderr
    assert {path.name for path in target.iterdir()} == {
        *("meshes", "model.config", "model.sdf", "model.urdf", "model.usda", "model.xml", "simulation.json"),
    }
    # The folder of a model is replaced; a folder with other files is not.
    assert scanloom(*words, "--set", "simulation.density=700").exit_code == 0
    (target / "simulation.json").unlink()
    assert scanloom(*words).exit_code == 3
