"""Evidence against surface: points through which a frame has measured a surface far behind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.frames.projection import project
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.refinement.cap_remeshing import Floats

# A measurement is clearly behind a point if the distance exceeds this many standard deviations.
_MIN_DEVIATIONS = 3.0


class FreeSpaceTest:
    """Test of points against depth maps.

    Parameters
    ----------
    points : (n, 3) world coordinates, metres.
    noise : depth noise.
    min_distance : minimum distance of a measurement behind a point, metres.

    Attributes
    ----------
    is_free : (n,) True if a frame has measured a surface clearly behind the point.
    """

    def __init__(self, points: Floats, noise: DepthNoise, min_distance: float) -> None:
        self._points = points
        self._noise = noise
        self._min_distance = min_distance
        self.is_free: NDArray[np.bool_] = np.zeros(len(points), bool)

    def observe(self, view: PosedDepth) -> None:
        """Compare the points with a depth map."""
        seen = (self._points - view.pose[:3, 3]) @ view.pose[:3, :3]
        column, row = map(np.rint, project(seen, view.camera))
        depth = view.surface.depth
        with np.errstate(invalid="ignore"):
            (inside,) = np.nonzero(
                (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
            )
        z = seen[inside, 2]
        measured = depth[row[inside].astype(int), column[inside].astype(int)]
        deviation = self._noise.constant + self._noise.quadratic * z**2
        limit = np.maximum(_MIN_DEVIATIONS * deviation, self._min_distance)
        self.is_free[inside[measured > z + limit]] = True
