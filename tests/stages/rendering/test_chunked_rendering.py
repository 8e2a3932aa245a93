"""Images of a chunked mesh equal images of the mesh in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.rendering import chunked_rendering
from scanloom.stages.rendering.chunked_rendering import draw_chunked
from scanloom.stages.rendering.render import RenderModel, Shading
from scanloom.stages.rendering.viewpoints import look_at, viewpoints
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.raycasting import RaycastingSurface

SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "rgbd"

pytestmark = pytest.mark.usefixtures("few_at_a_time")


@pytest.mark.parametrize("shading", ["color", "plain"])
def test_images_equal_those_of_the_mesh_in_memory(
    large: Path, shading: Shading, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, pieced = read_ply(large), ChunkedMesh(ChunkedPly(large))
    middle = pieced.box.mean(axis=0)
    around = (
        # From above with culling; from the pose of a frame; and from inside.
        *viewpoints(whole, 2, frames=read_scan(SAMPLE).frames, width=160),
        look_at(middle, middle + np.array((0.3, 0.2, 1)), (0, -1, 0), 160, 120, field=100),
    )
    model = RenderModel(RaycastingSurface(whole, pieced.box))
    expected = [model.draw(one, shading).astype(int) for one in around]
    found = list(draw_chunked(pieced, around, pieced.box, shading=shading))
    for one, other in zip(found, expected, strict=True):
        # A ray along an edge may hit either triangle.
        assert np.count_nonzero(np.abs(one - other).max(axis=2) > 1) <= 5
        assert len(np.unique(one)) > 30
    monkeypatch.setattr(chunked_rendering, "_BATCH_PIXELS", 1)
    again = draw_chunked(pieced, around, pieced.box, shading=shading)
    assert all((one == other).all() for one, other in zip(found, again, strict=True))
