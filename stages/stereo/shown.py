"""Which pixels of views show the scene, where nothing but it is to be measured.

Masks tell it, where they cut one thing out of all views: these are its silhouettes. Else a backdrop tells it,
that all views have around the thing. Of other views nothing is known but what is plain.

Laurentini, "The visual hull concept for silhouette-based image understanding", 1994: what projects outside
one of the silhouettes is no part of the thing. Not every mask is a silhouette: that of what moves hides the
scene behind it, and that of a lens's rim is the same in all views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.errors import InputError
from stages.scans.images import read_pinhole, read_seen
from stages.scans.scan import ColorImage, DepthImage, Frame, Scan
from stages.stereo.background import Backdrop, before_backdrop, common_backdrop, measurable
from stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]

# Silhouettes of so many views, evenly taken, bound the thing: more add little.
_VIEWS = 24
# So many images, evenly taken, are looked at for a backdrop.
_LOOKED_AT = 12
# A mask is cut out of the image if it leaves at most this share of the image's border, and masks are those of
# a lens if all leave the same but for this share.
_ON_BORDER = 0.3
_SAME = 0.9
# Masks and poses are off by so many pixels.
_MARGIN_PX = 3


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A view, and where it shows the thing or may do: (h, w)."""

    view: PosedView
    shown: Mask


@dataclass(frozen=True, eq=False)
class Outline:
    """What tells a thing from all else in every view; neither where nothing does."""

    silhouettes: Sequence[Silhouette] = ()
    backdrop: Backdrop | None = None

    @property
    def is_known(self) -> bool:
        """Return whether anything does."""
        return bool(self.silhouettes) or self.backdrop is not None


def outline_of(scan: Scan, views: Sequence[PosedView], plain: float) -> Outline:
    """Return what tells the thing from all else: masks before a backdrop.

    Parameters
    ----------
    plain : grey levels, the parameter `backdrop`; 0 looks for none.
    """
    found = silhouettes(scan, views)
    if found or plain == 0:
        return Outline(silhouettes=found)
    images = []
    for frame in scan.frames[:: -(-len(scan.frames) // _LOOKED_AT)]:
        try:
            image = read_pinhole(frame)
        except InputError:
            continue  # Reported when its turn comes.
        if image is not None:
            images.append(image)
    return Outline(backdrop=common_backdrop(images))


def shown(frame: Frame, color: ColorImage, outline: Outline, plain: float) -> tuple[Mask, Mask]:
    """Return which pixels (h, w) of a view show the scene, and which of them can be measured."""
    import cv2

    seen = read_seen(frame)
    if outline.backdrop is not None:
        seen &= before_backdrop(color, outline.backdrop, plain)
    if outline.is_known:
        return seen, seen
    return seen, seen & measurable(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8), plain)


def silhouettes(scan: Scan, views: Sequence[PosedView]) -> list[Silhouette]:
    """Return silhouettes of some views of a scan; none if its masks do not cut a thing out of all images.

    Parameters
    ----------
    views : of the scan's frames.
    """
    if any(frame.mask is None for frame in scan.frames):
        return []
    found = []
    for at in np.unique(np.linspace(0, len(views) - 1, min(_VIEWS, len(views))).astype(int)):
        try:
            seen = read_seen(scan.frames[at])
        except InputError:
            continue  # Reported when its turn comes.
        border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
        if border.mean() > _ON_BORDER:
            return []
        found.append(Silhouette(views[at], grown(seen)))
    return [] if _alike(found) else found


def grown(shown: Mask) -> Mask:
    """Return a mask (h, w) with all that is as near to it as masks and poses are off."""
    import cv2

    size = 2 * _MARGIN_PX + 1
    return np.asarray(cv2.dilate(shown.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def in_hull(depth: DepthImage, view: PosedView, outlines: Sequence[Silhouette]) -> DepthImage:
    """Return the depth (h, w) of a view whose places lie in all silhouettes of views that look at them."""
    if not outlines:
        return depth
    inside = _kernels.inside_all(
        depth, [(view.pixels_to(one.view), one.shown) for one in outlines], wanted_threads=1
    )
    return np.where(inside, depth, np.float32(0))


def _alike(found: Sequence[Silhouette]) -> bool:
    """Return whether masks leave the same part of all images, as the rim of a lens does."""
    if len({one.shown.shape for one in found}) != 1:
        return False
    stack = np.stack([one.shown for one in found])
    return bool(stack.all(axis=0).sum() >= _SAME * stack.any(axis=0).sum())
