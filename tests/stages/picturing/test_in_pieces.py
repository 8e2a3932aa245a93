"""A mesh in pieces looks as the whole does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.picturing import in_pieces
from scanloom.stages.picturing.in_pieces import draw_in_pieces
from scanloom.stages.picturing.render import Model, Shading
from scanloom.stages.picturing.viewpoints import looking_at, viewpoints
from scanloom.stages.scans.read import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.pieces import Pieces
from scanloom.stages.surface.piecewise import Piecewise
from scanloom.stages.surface.raycasting import Surface

SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "rgbd"

pytestmark = pytest.mark.usefixtures("few_at_a_time")


@pytest.mark.parametrize("shading", ["color", "plain"])
def test_pictures_are_those_of_the_whole(
    large: Path, shading: Shading, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, pieced = read_ply(large), Piecewise(Pieces(large))
    middle = pieced.box.mean(axis=0)
    around = (
        # From above, without what looks away; as a frame saw it; and in the midst of the pieces.
        *viewpoints(whole, 2, frames=read_scan(SAMPLE).frames, width=160),
        looking_at(middle, middle + np.array((0.3, 0.2, 1)), (0, -1, 0), 160, 120, field=100),
    )
    model = Model(Surface(whole, pieced.box))
    expected = [model.draw(one, shading).astype(int) for one in around]
    found = list(draw_in_pieces(pieced, around, pieced.box, shading=shading))
    for one, other in zip(found, expected, strict=True):
        # A ray along an edge may meet either triangle.
        assert np.count_nonzero(np.abs(one - other).max(axis=2) > 1) <= 5
        assert len(np.unique(one)) > 30
    monkeypatch.setattr(in_pieces, "_AT_ONCE", 1)
    again = draw_in_pieces(pieced, around, pieced.box, shading=shading)
    assert all((one == other).all() for one, other in zip(found, again, strict=True))
