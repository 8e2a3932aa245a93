"""What the colours of a deviation stand for, as a page shows it."""

from __future__ import annotations

import numpy as np

from stages.comparing.deviations import Deviations
from stages.comparing.palette import colors_of
from stages.picturing.page.one_file import PageScale

_STEPS = 40
# What is over, what is under, and what is well, by the palette.
_COLORS = {"metrology": ("red", "blue", "green"), "safe": ("orange", "blue", "white")}


def range_in_words(is_signed: bool, palette: str = "metrology") -> str:
    """Return which colour is where."""
    over, under, near = _COLORS[palette]
    return f"{over} outside, {under} inside; {near} is near" if is_signed else f"{over} far, {near} near"


def scale_of(found: Deviations, palette: str = "metrology") -> PageScale:
    """Return the scale of deviations, in millimetres, and how much of the surface has each colour."""
    most = found.color_range
    low = -most if found.is_signed else 0.0
    edges = np.linspace(low, most, _STEPS + 1)
    colors = colors_of((edges[1:] + edges[:-1]) / 2, found.within, most, palette)
    # What lies beyond the scale has its last colours.
    shares = np.histogram(found.samples.clip(low, most), edges)[0] / len(found.samples)
    css = [f"rgb({r}, {g}, {b})" for r, g, b in colors.tolist()]
    return PageScale("mm", 1000 * low, 1000 * most, 1000 * found.within, css, shares.round(5).tolist())
