"""The recipes of docs/ run and give the described results."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from small_sample import write_small_sample

from scanloom import UsageError, read_mesh, topology, write_mesh

ROOT = Path(__file__).resolve().parents[1]
RECIPES = ROOT / "docs" / "recipes"


@pytest.fixture(scope="module")
def deform() -> ModuleType:
    spec = importlib.util.spec_from_file_location("deform", RECIPES / "deform.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Its dataclasses look up their module in sys.modules.
    sys.modules["deform"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_deforming_refines_marked_and_then_bent_regions(deform: ModuleType, tmp_path: Path) -> None:
    mesh = deform.make_bar()
    write_mesh(tmp_path / "bar.ply", mesh)
    found = deform.main([str(tmp_path / "out"), "--mesh", str(tmp_path / "bar.ply")])
    handle = deform.Handle((0.0, 0.0, 2.0), 0.35, 1.4, (0.75, 0.0, -0.3), 70.0)

    front = found.front.vertices
    marked, held = handle.region.contains(front), handle.mark_fixed(front)
    exact = {tuple(vertex) for vertex in read_mesh(tmp_path / "bar.ply").vertices}
    assert all(tuple(vertex) in exact for vertex in front[marked])
    assert len(found.front.triangles) < len(mesh.triangles) / 2
    # Handle vertices are at their targets and held vertices stay, up to the error of the iterations.
    after = found.deformed.vertices
    np.testing.assert_allclose(after[marked], handle.move_points(front[marked]), atol=1e-6)
    np.testing.assert_allclose(after[held], front[held], atol=1e-6)

    assert found.bends[1] < found.bends[0]
    for step in (found.front, found.deformed, found.adjusted, found.repaired):
        assert topology(step).is_closed
        assert topology(step).is_manifold
    assert found.irregular[1] <= found.irregular[0]
    assert found.repair_bound_m < 0.05
    for name in ("front", "deformed", "adjusted", "repaired"):
        written = read_mesh(tmp_path / "out" / f"{name}.ply")
        assert len(written.triangles) == len(getattr(found, name).triangles)
    assert (tmp_path / "out" / "deform.png").stat().st_size > 10_000


def test_a_handle_without_vertices_is_refused(deform: ModuleType) -> None:
    away = deform.Handle((9.0, 0.0, 0.0), 0.1, 0.4, (0.0, 0.0, 1.0), 0.0)
    with pytest.raises(UsageError, match="no vertex is within the radius of the handle"):
        deform.deform_as_rigid_as_possible(deform.make_bar(12, 12), away)


def test_bends_are_relative_rotations_of_neighbours(deform: ModuleType) -> None:
    flat = deform.Mesh(
        np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], float),
        np.array([(0, 1, 2), (1, 3, 2)], np.int32),
    )
    corner = (0.5, 0.5, np.sqrt(0.5))
    folded = flat.with_(vertices=np.vstack([flat.vertices[:3], corner]))
    np.testing.assert_allclose(deform.measure_bends(flat, folded), (0, 90, 90, 0), atol=1e-9)


@pytest.mark.slow
def test_the_notebook_cells_run_and_show_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nbclient import NotebookClient
    from nbformat import v4

    cells = re.findall(r"```python\n(.*?)```", (RECIPES / "notebook.md").read_text(), flags=re.DOTALL)
    write_small_sample(tmp_path / "samples" / "rgbd")
    # The notebook kernel is a separate process, which must not leave files outside the test.
    for name in ("HOME", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    book = v4.new_notebook(cells=[v4.new_code_cell(code) for code in cells])
    NotebookClient(book, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()

    shown = [cell.outputs[-1].data["text/html"] for cell in book.cells]
    names = ("Scan", "Mesh", "Tradeoff", "SimplificationResult")
    assert [re.match(r"<div><b>(\w+)</b>", html)[1] for html in shown[:4]] == list(names)
    assert all(html.count("<img") == 1 for html in shown[:4])
    assert shown[4].startswith('<iframe title="mesh"')
    assert "stage" in shown[5]
    assert shown[6].startswith('<iframe title="out"')


def test_the_snakefile_calls_run_with_valid_options() -> None:
    from typer.main import get_command

    from scanloom.cli.app import app

    rule = (RECIPES / "Snakefile").read_text().partition("shell:")[2]
    command = "".join(re.findall(r'"([^"]*)"', rule)).partition("scanloom run ")[2].partition("2>")[0]
    words = re.sub(r"\{resources\.\w+\}", "4000", re.sub(r"\{WORDS\}", "--quality draft", command)).split()
    context = get_command(app()).commands["run"].make_context("run", list(words))  # type: ignore[attr-defined]
    assert [word.partition("=")[0] for word in context.params["set_words"]] == ["run.cache", "limits.memory"]
    assert "limits.memory=4000" in words


def test_pictures_of_recipes_are_small() -> None:
    assert all(path.stat().st_size < 150_000 for path in RECIPES.glob("*.png"))


@pytest.mark.slow
def test_frames_from_arrays_become_a_textured_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    [code] = re.findall(r"```python\n(.*?)```", (RECIPES / "arrays.md").read_text(encoding="utf-8"), re.S)
    assert len(code.splitlines()) <= 30
    monkeypatch.chdir(tmp_path)
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    exec(compile(code, "arrays.md", "exec"), {"__name__": "arrays"})
    mesh = read_mesh(tmp_path / "textured.glb")
    assert mesh.texture is not None
    assert 500 < len(mesh.triangles) < 20_000
    # Metres: the sample shows a table of about half a metre.
    assert 0.1 < np.ptp(mesh.vertices, axis=0).max() < 5
