"""All mesh operations keep the up direction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from coloured_sheet import UP, ball, sheet, textured_sheet

from scanloom import Mesh, stages


def replay_record(mesh: Mesh, tmp_path) -> Mesh:
    record = stages.simplify(mesh, ratio=0.5, record=True).record
    record.save(tmp_path / "record.npz")
    return stages.load_record(tmp_path / "record.npz").replay(ratio=0.7).mesh


WAYS: dict[str, Callable[..., Mesh]] = {
    "quadric": lambda mesh, _: stages.simplify(mesh, method="quadric", ratio=0.5).mesh,
    "certified": lambda mesh, _: stages.simplify(mesh, method="certified", max_shape=0.1).mesh,
    "jia01": lambda mesh, _: stages.simplify(mesh, method="jia01", ratio=0.7).mesh,
    "planar": lambda mesh, _: stages.simplify(mesh, method="planar", max_shape=0.1).mesh,
    "seams": lambda mesh, _: stages.simplify(mesh, method="seams", ratio=0.5).mesh,
    "replay": replay_record,
    "clean": lambda mesh, _: stages.clean(mesh).mesh,
    "repair": lambda mesh, _: stages.repair(mesh).mesh,
    "bake": lambda mesh, _: stages.bake(mesh, mesh).mesh,
    "remesh": lambda mesh, _: stages.remesh(mesh, levels=1).levels[-1],
    "vertex colours": lambda mesh, _: stages.surface.mesh_conversion.bake_vertex_colors(mesh),
}


@pytest.mark.slow
@pytest.mark.parametrize("made", [sheet, textured_sheet])
@pytest.mark.parametrize("way", WAYS)
def test_up_is_kept(tmp_path, way, made):
    mesh = made(16).with_(up=UP)
    result = WAYS[way](mesh, tmp_path)
    assert result.up == UP
    assert np.isfinite(result.vertices).all()


def test_up_is_kept_when_remeshing_a_sphere(tmp_path):
    assert WAYS["remesh"](ball(), tmp_path).up == UP
