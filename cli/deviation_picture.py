"""A picture of a mesh or cloud in the colours of its deviations, with the scale beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import Deviations
from scanloom.stages._opencv import require_opencv
from scanloom.stages.comparing.palette import colors_of
from scanloom.stages.picturing.render import Model, write_png
from scanloom.stages.picturing.spots import spots
from scanloom.stages.picturing.viewpoints import viewpoints
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.raycasting import Surface

# Of a cloud, so many points are drawn.
_MOST_SPOTS = 400_000
_WIDTH, _BAR, _MARGIN = 1000, 28, 200
_INK, _PAPER = (40, 44, 52), 250
_STEPS = 9


def write_deviation_picture(path: Path, found: Deviations, palette: str) -> None:
    """Write the mesh from two sides in the colours of its deviations, and what these stand for."""
    painted = spots(found.painted, _MOST_SPOTS) if is_cloud(found.painted) else found.painted
    views = viewpoints(painted, 4, width=_WIDTH)
    model = Model(Surface(painted))
    drawn = [model.draw(view, "color") for view in (views[0], views[2])]
    height = drawn[0].shape[0]
    write_png(path, np.ascontiguousarray(np.hstack([*drawn, _scale(found, palette, height)])))


def _scale(found: Deviations, palette: str, height: int) -> NDArray[np.uint8]:
    require_opencv()
    import cv2

    panel = np.full((height, _MARGIN, 3), _PAPER, np.uint8)
    top, bottom = 50, height - 30
    most, lowest = found.color_range, -found.color_range if found.is_signed else 0.0
    values = np.linspace(most, lowest, bottom - top)
    panel[top:bottom, 20 : 20 + _BAR] = colors_of(values, found.within, most, palette)[:, None]
    cv2.putText(panel, "mm", (20, 32), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _INK, 1, cv2.LINE_AA)
    for value in np.linspace(most, lowest, _STEPS):
        row = round(top + (most - value) / (most - lowest) * (bottom - top - 1))
        text = f"{1000 * value:+.3g}" if found.is_signed else f"{1000 * value:.3g}"
        at = (20 + _BAR + 10, row + 6)
        cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
    return panel
