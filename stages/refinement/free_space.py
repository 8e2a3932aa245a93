"""Evidence against surface: caps through which a frame has measured a surface far behind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.frames.projection import project
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.surface.cap_remeshing import Floats

# A measurement is clearly behind a point if the distance exceeds this many standard deviations.
_MIN_DEVIATIONS = 3.0
# Minimum number of pixels of 3 × 3 with depth for a frame to be believed on its own: the nearest of them is
# behind the point. Fewer may be a single wrong measurement, which a second frame must confirm.
_MIN_PIXELS = 5
# Minimum distance along the normal, as part of the minimum distance. At grazing angles, errors of a pixel or
# of the pose change the depth by more than the minimum distance.
_MIN_NORMAL_RATIO = 0.5


class FreeSpaceTest:
    """Test of points against depth maps.

    Parameters
    ----------
    points, normals : (n, 3) world coordinates in metres, and unit normals of the supposed surface.
    noise : depth noise.
    min_distance : minimum distance of a measurement behind a point, metres.

    Attributes
    ----------
    is_free : (n,) True if a frame has measured a surface clearly behind the point. A single pixel counts only
        if two frames agree.
    """

    def __init__(self, points: Floats, normals: Floats, noise: DepthNoise, min_distance: float) -> None:
        self._points = points
        self._normals = normals
        self._noise = noise
        self._min_distance = min_distance
        self.is_free: NDArray[np.bool_] = np.zeros(len(points), bool)
        self._was_behind: NDArray[np.bool_] = np.zeros(len(points), bool)

    def observe(self, view: PosedDepth) -> None:
        """Compare the points with a depth map."""
        rays = self._points - view.pose[:3, 3]
        seen = rays @ view.pose[:3, :3]
        column, row = map(np.rint, project(seen, view.camera))
        depth = view.surface.depth
        with np.errstate(invalid="ignore"):
            (inside,) = np.nonzero(
                (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
            )
        if not len(inside):
            return
        z = seen[inside, 2]
        nearest, pixel_counts = _find_nearest_depth(depth)
        pixels = row[inside].astype(int), column[inside].astype(int)
        measured = nearest[pixels]
        deviation = self._noise.constant + self._noise.quadratic * z**2
        limit = np.maximum(_MIN_DEVIATIONS * deviation, self._min_distance)
        normal_limit = np.maximum(_MIN_DEVIATIONS * deviation, _MIN_NORMAL_RATIO * self._min_distance)
        along = np.abs((rays[inside] * self._normals[inside]).sum(axis=1))
        is_behind = (measured > z + limit) & ((measured / z - 1) * along > normal_limit)
        points = inside[is_behind]
        is_certain = pixel_counts[pixels][is_behind] >= _MIN_PIXELS
        self.is_free[points[is_certain | self._was_behind[points]]] = True
        self._was_behind[points] = True


def _find_nearest_depth(depth: DepthImage) -> tuple[DepthImage, NDArray[np.uint8]]:
    """Return the minimum depth of 3 × 3 pixels, and the number of pixels with depth among them.

    The minimum is 0 if the central pixel has no depth.

    Poses and depth maps are hardly more accurate than a pixel: next to an occlusion boundary, a ray may miss
    the surface in front.
    """
    import cv2

    known = depth > 0
    nearest = cv2.erode(np.where(known, depth, np.float32(np.inf)), np.ones((3, 3), np.uint8))
    counts = cv2.boxFilter(
        known.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(np.where(known, nearest, 0), np.float32), np.asarray(counts, np.uint8)
