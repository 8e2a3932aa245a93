"""How far away the scene is: the poses of two views tell where each point stands that both recognise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import Keypoints, match_descriptors
from scanloom.stages.stereo.epipolar import off_lines
from scanloom.stages.stereo.posed_views import PosedView

# Of the views that look the same way, each is compared with the nearest, the second, the fourth … : frames of
# a video stand so close that the nearest tell nothing, and the farther see something else.
_RANKS = (1, 2, 4, 8, 16)
# Degrees between the optical axes of views that may see the same.
_WIDEST = 45.0
# Share of the image's diagonal that a match may be off its epipolar line, 8 px of 640×480: poses of phones
# are off by several pixels.
_TOLERANCE = 0.01
# Views see the same where so many matches are on their lines, and this share of all of them.
_ENOUGH, _SHARE = 12, 0.3
# A match tells how far away it is where the rays differ by so many degrees, and by so many times what the
# matches of the pair are off.
_SMALLEST, _SURE = 1.0, 5.0


@dataclass(frozen=True, eq=False)
class Recognised:
    """What two views recognise in each other.

    Attributes
    ----------
    off : pixels, how far the median match lies off its epipolar line; more than one says that poses or
        calibration do not fit the images.
    depths : of the matches that tell, (n,) metres along the axis of the first view, and of the second.
    pixels : of the matches near their lines, (n, 2) in the first view, and in the second.
    """

    off: float
    depths: tuple[NDArray[np.float64], NDArray[np.float64]]
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]]


def neighbours(views: Sequence[PosedView]) -> list[tuple[int, int]]:
    """Return the places of pairs of views that may see the same as far as their poses tell, in order."""
    centres = np.stack([view.centre for view in views])
    axes = np.stack([view.world_from_camera[:3, 2] for view in views])
    pairs: set[tuple[int, int]] = set()
    for at in range(len(views)):
        apart = np.linalg.norm(centres - centres[at], axis=1)
        alike = np.flatnonzero((apart > 0) & (axes @ axes[at] > math.cos(math.radians(_WIDEST))))
        order = alike[np.argsort(apart[alike], kind="stable")]
        pairs |= {(min(at, int(order[n - 1])), max(at, int(order[n - 1]))) for n in _RANKS if n <= len(order)}
    return sorted(pairs)


def recognised(first: PosedView, second: PosedView, here: Keypoints, there: Keypoints) -> Recognised | None:
    """Return what two views recognise in each other; None where they do not see the same.

    Parameters
    ----------
    here, there : the points of both images, without distortion.
    """
    same = match_descriptors(here.descriptors, there.descriptors)
    one, other = (
        points.pixels[same[:, side]].astype(np.float64) for side, points in enumerate((here, there))
    )
    off = off_lines(first, second, one, other)
    fits = off <= _TOLERANCE * math.hypot(first.camera.width, first.camera.height)
    if np.count_nonzero(fits) < max(_ENOUGH, _SHARE * len(same)):
        return None
    rays = [
        view.rays(*points[fits].T) @ view.world_from_camera[:3, :3].T
        for view, points in ((first, one), (second, other))
    ]
    usual = float(np.median(off[fits]))
    angle = max(math.radians(_SMALLEST), _SURE * usual / first.camera.fx)
    depths = _where_rays_meet(rays[0], rays[1], second.centre - first.centre, angle)
    return Recognised(usual, depths, (one[fits], other[fits]))


def _where_rays_meet(
    first: NDArray[np.float64], second: NDArray[np.float64], across: NDArray[np.float64], least: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far along rays (n, 3) of z = 1, `across` apart, they come nearest to each other.

    Only of those that differ by the `least` angle (radians), and meet before both views.
    """
    aa, bb, ab = ((u * v).sum(axis=1) for u, v in ((first, first), (second, second), (first, second)))
    wide = ab < math.cos(least) * np.sqrt(aa * bb)
    aa, bb, ab, to_a, to_b = aa[wide], bb[wide], ab[wide], first[wide] @ across, second[wide] @ across
    determinant = aa * bb - ab**2
    here, there = (bb * to_a - ab * to_b) / determinant, (ab * to_a - aa * to_b) / determinant
    before = (here > 0) & (there > 0)
    return here[before], there[before]
