"""The table of textured models: materials in results of other tools, and the summary."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHES = Path(__file__).parents[2] / "benches"
sys.path.insert(0, str(BENCHES))

from seamed_meshes import wrapped_ball  # noqa: E402
from textured import (  # noqa: E402
    OURS,
    TexturedResult,
    is_better_in_both,
    is_comparable,
    measure,
    print_summary,
    read_models,
    run_keep_uv,
    run_pymeshlab,
)

from scanloom.stages.surface.mesh import Image, Material, Mesh  # noqa: E402
from scanloom.stages.surface.mesh_files import write_mesh  # noqa: E402
from scanloom.stages.surface.surface_color import compute_surface_colors  # noqa: E402

pytestmark = pytest.mark.slow


def make_row(tool: str, rms: float, psnr: float | None, triangles: int = 100) -> TexturedResult:
    return TexturedResult(tool, triangles, 0.1, rms, 10 * rms, psnr, 0.0, "", 1.0)


def make_two_coloured_ball() -> Mesh:
    """Make a sphere whose halves have single-colour images."""
    mesh = wrapped_ball()
    is_upper = mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0
    images = [Image(given=np.full((4, 4, 3), color, np.uint8)) for color in ((200, 0, 0), (0, 0, 200))]
    materials = tuple(Material(image=image) for image in images)
    texture = replace(mesh.texture, material_ids=is_upper.astype(np.int32), materials=materials)
    return mesh.with_(texture=texture)


def test_the_summary_counts_results_that_are_as_good(capsys):
    rows = [make_row(OURS, 20.0, 30.0), make_row("peer A", 25.0, 31.0), make_row("peer B", 19.0, 29.0)]
    print_summary(
        [("ball", 0.1, 100, rows), ("cube", 0.1, 100, [make_row(OURS, 5, 40), make_row("peer A", 6, 39)])]
    )
    printed = capsys.readouterr().out
    assert "Of 2 cases" in printed
    assert "in RMS in 1, in PSNR in 1, in both in 1. In 2, no single peer is better in both." in printed


def test_a_result_with_too_many_triangles_does_not_win(capsys):
    print_summary(
        [("ball", 0.1, 100, [make_row(OURS, 5.0, 40.0, triangles=300), make_row("peer A", 6.0, 39.0)])]
    )
    printed = capsys.readouterr().out
    assert "no: the target is 100 triangles" in printed
    assert "in RMS in 0, in PSNR in 0, in both in 0. In 0, no single peer is better in both." in printed


def test_a_peer_is_better_only_in_both_errors():
    ours = make_row(OURS, 20.0, 30.0)
    assert is_better_in_both(make_row("peer", 19.0, 31.0), ours)
    assert not is_better_in_both(make_row("peer", 19.0, 30.0), ours)
    assert not is_better_in_both(make_row("peer", 20.04, 31.0), ours)


def test_peers_that_stop_early_or_drop_the_texture_are_not_compared():
    assert is_comparable(make_row("peer", 1, 30, triangles=105), 100)
    assert not is_comparable(make_row("peer", 1, 30, triangles=110), 100)
    assert not is_comparable(make_row("peer", 1, None), 100)


@pytest.mark.parametrize("prepare", [run_keep_uv, run_pymeshlab])
def test_triangles_keep_their_material(prepare):
    if prepare is run_pymeshlab:
        pytest.importorskip("pymeshlab")
    mesh = make_two_coloured_ball()
    work, unpack = prepare(mesh, 300)
    simplified = unpack(work())
    middles = simplified.vertices[simplified.triangles].mean(axis=1)
    is_clear = np.abs(middles[:, 2]) > 0.2
    triangles = np.flatnonzero(is_clear)
    colors = compute_surface_colors(simplified, triangles, np.full((len(triangles), 3), 1 / 3))
    np.testing.assert_array_equal(colors[:, 0] > 100, middles[is_clear, 2] < 0)


def test_a_peer_that_fails_gets_a_reason():
    def prepare(_mesh, _triangles):
        raise ValueError("no such filter\nsecond line")

    assert measure("peer", wrapped_ball(), 100, prepare, 1000) == "skipped: no such filter"


def test_models_without_an_image_are_skipped_with_a_message(tmp_path, capsys):
    write_mesh(tmp_path / "ball.glb", make_two_coloured_ball())
    write_mesh(tmp_path / "bare.ply", make_two_coloured_ball().with_(texture=None))
    (tmp_path / "inner").mkdir()
    write_mesh(tmp_path / "inner" / "bare.glb", make_two_coloured_ball().with_(texture=None))
    (tmp_path / "damaged.obj").write_text("f 1 2 3\n")
    found = dict(read_models(tmp_path, [], tmp_path))
    assert list(found) == ["ball"]
    assert len(found["ball"].texture.images) == 2
    printed = capsys.readouterr().out
    assert "skipped inner/bare: it has no texture image" in printed
    assert "skipped damaged: " in printed
