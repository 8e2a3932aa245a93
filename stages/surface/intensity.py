"""Grey intensity of vertices: a PLY property that a mesh holds as grey colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Colors, Mesh

_MAX_LEVEL = 255
# Full scale of each range of values: fractions, 8 bits, and 16 bits as laser scanners store.
_FULL_SCALES = (1.0, 255.0, 65535.0)


def has_intensity(mesh: Mesh) -> bool:
    """Return True if the colours of a mesh are an intensity, and still grey."""
    colors = mesh.colors
    if mesh.intensity_max is None or colors is None:
        return False
    return bool((colors[:, 0] == colors[:, 1]).all() and (colors[:, 0] == colors[:, 2]).all())


def quantize_intensity(values: NDArray[Any]) -> tuple[Colors, float]:
    """Convert intensities to grey colours.

    Parameters
    ----------
    values : (n,) numbers of any type. The full scale is the maximum of unsigned integers of up to 16 bits.
        Else it is the smallest of 1, 255, 65535 and the largest value that is not exceeded; 1 for floats
        only. Negative values and values that are not finite become 0.

    Returns
    -------
    colors : (n, 3) uint8, grey.
    full_scale : value of level 255.
    """
    numbers = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0).clip(0)
    largest = float(numbers.max(initial=0.0))
    if values.dtype in (np.uint8, np.uint16):
        full_scale = float(np.iinfo(values.dtype).max)
    else:
        scales = _FULL_SCALES if values.dtype.kind == "f" else _FULL_SCALES[1:]
        full_scale = next((scale for scale in scales if largest <= scale), largest)
    levels = np.rint(numbers * (_MAX_LEVEL / full_scale)).astype(np.uint8)
    return np.repeat(levels[:, None], 3, axis=1), full_scale


def restore_intensity(mesh: Mesh) -> NDArray[Any]:
    """Return the intensities (n,) of a mesh that has them, in the unit of the file.

    uint8 if the full scale is 255, else float64.
    """
    assert mesh.colors is not None
    assert mesh.intensity_max is not None
    levels = mesh.colors[:, 0]
    return levels if mesh.intensity_max == _MAX_LEVEL else levels * (mesh.intensity_max / _MAX_LEVEL)
