"""Which pixels of views show the scene, where nothing but it is to be measured.

Masks tell it, where they cut one thing out of all views: these are its silhouettes. Else a backdrop tells it,
that all views have around the thing. Of other views nothing is known but what is plain.

Laurentini, "The visual hull concept for silhouette-based image understanding", 1994: what projects outside
one of the silhouettes is no part of the thing. Not every mask is a silhouette: that of what moves hides the
scene behind it, and that of a lens's rim is the same in all views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_pinhole, read_seen
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, scaled
from scanloom.stages.stereo.background import Backdrop, before_backdrop, common_backdrop, measurable
from scanloom.stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]

# Silhouettes of so many views, evenly taken, bound the thing: more add little.
_VIEWS = 24
# So many images, evenly taken, are looked at for a backdrop.
_LOOKED_AT = 12
# A mask is cut out of the image if it leaves at most this share of the image's border, and masks are those of
# a lens if all leave the same but for this share.
_ON_BORDER = 0.3
_SAME = 0.9
# So many silhouettes must see a place to bound it, or it may be far before the thing.
_LEAST_VIEWS = 4
# Views stand all around if the mean of their unit axes is shorter: that of half a circle is 0.64.
_ONE_SIDED = 0.65
# The hull is looked for in so many steps of inverse depth, over the view's whole range.
_STEPS = 128
# Masks and poses are off by so many pixels.
_MARGIN_PX = 3


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A view, and where it shows the thing or may do: (h, w)."""

    view: PosedView
    shown: Mask


@dataclass(frozen=True, eq=False)
class Outline:
    """What tells a thing from all else in every view; neither where nothing does.

    Attributes
    ----------
    silhouettes : of masks; nothing of the thing is outside.
    hull : silhouettes, of masks or of what stands before the backdrop, whose hull is near to the thing, since
        the views stand all around; none if they do not. Of a thing before a backdrop, what looks like it may
        yet be outside.
    """

    silhouettes: Sequence[Silhouette] = ()
    backdrop: Backdrop | None = None
    hull: Sequence[Silhouette] = ()

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
        return Outline(silhouettes=found, hull=_around(found))
    images, seen = [], []
    for frame in scan.frames[:: -(-len(scan.frames) // _LOOKED_AT)]:
        try:
            image, mask = read_pinhole(frame), read_seen(frame)
        except InputError:
            continue  # Reported when its turn comes.
        if image is not None:
            images.append(image)
            seen.append(mask)
    backdrop = common_backdrop(images, seen)
    if backdrop is None:
        return Outline()
    return Outline(backdrop=backdrop, hull=_around(_before(backdrop, scan, views, plain)))


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
    for at in _evenly(len(views)):
        try:
            seen = read_seen(scan.frames[at])
        except InputError:
            continue  # Reported when its turn comes.
        border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
        if border.mean() > _ON_BORDER:
            return []
        found.append(Silhouette(views[at], grown(seen)))
    return [] if _alike(found) else found


def _before(backdrop: Backdrop, scan: Scan, views: Sequence[PosedView], plain: float) -> list[Silhouette]:
    """Return what stands before the backdrop in some of the views."""
    found = []
    for at in _evenly(len(views)):
        try:
            image, seen = read_pinhole(scan.frames[at]), read_seen(scan.frames[at])
        except InputError:
            continue  # Reported when its turn comes.
        if image is not None:
            found.append(Silhouette(views[at], grown(seen & before_backdrop(image, backdrop, plain))))
    return found


def _around(found: list[Silhouette]) -> list[Silhouette]:
    """Return silhouettes if their views stand all around, as far as half a circle does, else none."""
    if not found:
        return []
    mean = np.mean([one.view.world_from_camera[:3, 2] for one in found], axis=0)
    return found if np.linalg.norm(mean) <= _ONE_SIDED else []


def _evenly(count: int) -> list[int]:
    """Return the places of the views whose silhouettes are taken."""
    return [int(at) for at in np.unique(np.linspace(0, count - 1, min(_VIEWS, count)).astype(int))]


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


def hull_front(view: PosedView, wanted: Mask, outlines: Sequence[Silhouette], every: int = 1) -> DepthImage:
    """Return the depth (h, w) at which the rays of wanted pixels enter the hull of silhouettes; 0 if never.

    What few silhouettes see is not taken for bounded. With `every`, only one in so many pixels each way is
    looked at, and those around it are given the same.
    """
    import cv2

    height, width = wanted.shape
    if every > 1:
        size = -(-width // every), -(-height // every)
        few = replace(view, camera=scaled(view.camera, *size))
        front = hull_front(few, np.ascontiguousarray(wanted[::every, ::every]), outlines)
        return np.asarray(cv2.resize(front, (width, height), interpolation=cv2.INTER_NEAREST), np.float32)
    return _kernels.first_inside(
        wanted,
        [(view.pixels_to(one.view), one.shown) for one in outlines],
        least=min(_LEAST_VIEWS, len(outlines)),
        span=(view.near, view.far),
        steps=_STEPS,
        wanted_threads=1,
    )


def _alike(found: Sequence[Silhouette]) -> bool:
    """Return whether masks leave the same part of all images, as the rim of a lens does."""
    if len({one.shown.shape for one in found}) != 1:
        return False
    stack = np.stack([one.shown for one in found])
    return bool(stack.all(axis=0).sum() >= _SAME * stack.any(axis=0).sum())
