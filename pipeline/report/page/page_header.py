"""Header of a page: picture and facts of a result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh

# Metres; objects with longer sides are measured in metres, smaller objects in millimetres.
_MIN_METRES = 0.1
# Digits of the longest side.
_DIGITS = 3


@dataclass(frozen=True)
class PageFact:
    """Fact in the header of a page.

    Attributes
    ----------
    name, value : label and formatted value.
    note : meaning of the value in a few words.
    link : identifier of the section with details; a fact with a link is highlighted.
    """

    name: str
    value: str
    note: str = ""
    link: str = ""


def make_page_header(
    facts: Sequence[PageFact], subtitle: str = "", picture: str | None = None
) -> dict[str, Any]:
    """Make the JSON-ready header of a page.

    Parameters
    ----------
    subtitle : line below the title.
    picture : data URL of a picture.
    """
    return {"subtitle": subtitle, "facts": [asdict(fact) for fact in facts], "picture": picture}


def describe_mesh(mesh: Mesh, rotation: NDArray[np.float64], *, is_metric: bool = True) -> list[PageFact]:
    """Describe size and triangle count of a mesh.

    Parameters
    ----------
    rotation : (3, 3) rotation to z up.
    is_metric : True if lengths are in metres; False if in units of the scan.
    """
    facts = [PageFact("Triangles", f"{len(mesh.triangles):,}")]
    if not len(mesh.triangles):
        return facts
    sides = _measure_upright_box(mesh.vertices[np.unique(mesh.triangles)] @ rotation.T)
    unit, factor = ("mm", 1000) if is_metric and max(sides) < _MIN_METRES else ("m", 1)
    decimals = max(_DIGITS - 1 - math.floor(math.log10(factor * max(sides))), 0) if max(sides) else 0
    text = " × ".join(f"{factor * side:,.{decimals}f}" for side in sides)
    return [PageFact("Size", f"{text} {unit if is_metric else 'units'}", "length × width × height"), *facts]


def _measure_upright_box(points: NDArray[np.float64]) -> tuple[float, float, float]:
    """Measure length, width and height of the smallest upright box of points (n, 3), z up."""
    import cv2

    # The rectangle is computed in single precision, which is too coarse for map coordinates.
    ground = (points[:, :2] - points[:, :2].mean(axis=0)).astype(np.float32)
    width, length = sorted(cv2.minAreaRect(ground)[1])
    return float(length), float(width), float(np.ptp(points[:, 2]))


def format_file_size(byte_count: int) -> str:
    """Format a file size in kB or MB with three digits."""
    unit, factor = ("kB", 1e3) if byte_count < 1e6 else ("MB", 1e6)
    return f"{byte_count / factor:,.3g} {unit}" if byte_count < 1e9 else f"{byte_count / 1e9:,.3g} GB"
