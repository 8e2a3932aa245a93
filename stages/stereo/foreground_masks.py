"""Foreground of single views, from masks or a backdrop.

If the masks of all views show one object, they are its silhouettes. Without such masks, the object is
separated from a backdrop, if all views have one. Without a backdrop, only textureless areas are
excluded.

Points that project outside of a silhouette are not part of the object (Laurentini, "The visual hull concept
for silhouette-based image understanding", 1994). Not every mask is a silhouette: masks of moving objects hide
the scene behind them, and masks of a lens border are the same in all views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_pinhole, read_valid_pixels
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, scale_camera
from scanloom.stages.stereo.background import (
    Backdrop,
    detect_backdrop,
    mask_textured_surroundings,
    segment_foreground,
)
from scanloom.stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]

# Number of evenly sampled views whose silhouettes bound the object; more add little.
_MAX_SILHOUETTES = 24
# Number of evenly sampled images for the backdrop detection.
_BACKDROP_SAMPLES = 12
# Masks are silhouettes if at most this ratio of each image border is unmasked. They are masks of a lens
# border if the intersection of all masks exceeds this ratio of their union.
_MAX_BORDER_RATIO = 0.3
_SAME_MASK_RATIO = 0.9
# Minimum number of silhouettes that must see a point to bound it; fewer leave space far in front of the
# object.
_MIN_BOUNDING_VIEWS = 4
# Views surround the object if the mean of their unit optical axes is shorter; for a half circle it is 0.64.
_MAX_MEAN_AXIS = 0.65
# Number of steps in inverse depth along a ray in search of the hull.
_RAY_STEPS = 128
# Assumed error of masks and poses, pixels.
_MARGIN_PX = 3


@dataclass(frozen=True, eq=False)
class Silhouette:
    """View with a mask (h, w) of its possible object pixels."""

    view: PosedView
    mask: Mask


@dataclass(frozen=True, eq=False)
class ObjectOutline:
    """Separation of an object from its background in all views.

    Everything is empty if nothing separates the object.

    Attributes
    ----------
    silhouettes : silhouettes from masks; nothing outside of them belongs to the object.
    backdrop : backdrop around the object, if there are no silhouettes.
    hull_silhouettes : silhouettes, from masks or from the backdrop, whose visual hull approximates the
        object, because
        the views surround it; empty otherwise. With a backdrop, parts of the object in the backdrop's colour
        may be outside.
    """

    silhouettes: Sequence[Silhouette] = ()
    backdrop: Backdrop | None = None
    hull_silhouettes: Sequence[Silhouette] = ()

    @property
    def is_known(self) -> bool:
        """Return True if silhouettes or a backdrop are known."""
        return bool(self.silhouettes) or self.backdrop is not None


def detect_outline(scan: Scan, views: Sequence[PosedView], max_contrast: float) -> ObjectOutline:
    """Detect the outline of an object: from masks, else from a backdrop.

    Parameters
    ----------
    max_contrast : texture threshold in grey levels (parameter `backdrop`); 0 disables the backdrop.
    """
    found = extract_silhouettes(scan, views)
    if found or max_contrast == 0:
        return ObjectOutline(silhouettes=found, hull_silhouettes=_select_surrounding(found))
    images, seen = [], []
    for frame in scan.frames[:: -(-len(scan.frames) // _BACKDROP_SAMPLES)]:
        try:
            image, mask = read_pinhole(frame), read_valid_pixels(frame)
        except InputError:
            continue  # reported when the view is measured
        if image is not None:
            images.append(image)
            seen.append(mask)
    backdrop = detect_backdrop(images, seen)
    if backdrop is None:
        return ObjectOutline()
    return ObjectOutline(
        backdrop=backdrop,
        hull_silhouettes=_select_surrounding(
            _extract_backdrop_silhouettes(backdrop, scan, views, max_contrast)
        ),
    )


def mask_foreground(
    frame: Frame, color: ColorImage, outline: ObjectOutline, max_contrast: float
) -> tuple[Mask, Mask]:
    """Return masks (h, w) of scene pixels and of measurable pixels."""
    import cv2

    seen = read_valid_pixels(frame)
    if outline.backdrop is not None:
        seen &= segment_foreground(color, outline.backdrop, max_contrast)
    if outline.is_known:
        return seen, seen
    return seen, seen & mask_textured_surroundings(
        np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8), max_contrast
    )


def extract_silhouettes(scan: Scan, views: Sequence[PosedView]) -> list[Silhouette]:
    """Return silhouettes of sampled views.

    Parameters
    ----------
    views : posed views of the scan's frames.

    Returns
    -------
    The silhouettes; empty if the masks do not cut one object out of all images.
    """
    if any(frame.mask is None for frame in scan.frames):
        return []
    found = []
    for at in _sample_view_indices(len(views)):
        try:
            seen = read_valid_pixels(scan.frames[at])
        except InputError:
            continue  # reported when the view is measured
        border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
        if border.mean() > _MAX_BORDER_RATIO:
            return []
        found.append(Silhouette(views[at], dilate_mask(seen)))
    return [] if _are_masks_equal(found) else found


def _extract_backdrop_silhouettes(
    backdrop: Backdrop, scan: Scan, views: Sequence[PosedView], max_contrast: float
) -> list[Silhouette]:
    """Return silhouettes in front of the backdrop, of sampled views."""
    found = []
    for at in _sample_view_indices(len(views)):
        try:
            image, seen = read_pinhole(scan.frames[at]), read_valid_pixels(scan.frames[at])
        except InputError:
            continue  # reported when the view is measured
        if image is not None:
            found.append(
                Silhouette(views[at], dilate_mask(seen & segment_foreground(image, backdrop, max_contrast)))
            )
    return found


def _select_surrounding(found: list[Silhouette]) -> list[Silhouette]:
    """Return the silhouettes if their views surround the object.

    A half circle of views is enough. The result is empty otherwise.
    """
    if not found:
        return []
    mean = np.mean([one.view.world_from_camera[:3, 2] for one in found], axis=0)
    return found if np.linalg.norm(mean) <= _MAX_MEAN_AXIS else []


def _sample_view_indices(count: int) -> list[int]:
    """Return evenly sampled view indices for silhouettes."""
    return [int(at) for at in np.unique(np.linspace(0, count - 1, min(_MAX_SILHOUETTES, count)).astype(int))]


def dilate_mask(mask: Mask) -> Mask:
    """Dilate a mask (h, w) by the error of masks and poses."""
    import cv2

    size = 2 * _MARGIN_PX + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def crop_to_hull(depth: DepthImage, view: PosedView, silhouettes: Sequence[Silhouette]) -> DepthImage:
    """Remove depth (h, w) outside of the visual hull.

    A point is inside if it projects into the silhouette of every view that sees it.
    """
    if not silhouettes:
        return depth
    inside = _kernels.is_inside_all_masks(
        depth, [(view.compute_projection_to(one.view), one.mask) for one in silhouettes], wanted_threads=1
    )
    return np.where(inside, depth, np.float32(0))


def compute_hull_entry(
    view: PosedView, mask: Mask, silhouettes: Sequence[Silhouette], stride: int = 1
) -> DepthImage:
    """Return the depth (h, w) at which rays enter the visual hull.

    Parameters
    ----------
    mask : (h, w), pixels to compute.
    silhouettes : silhouettes of the hull. Points seen by too few of them are outside.
    stride : pixel stride; results are replicated to the pixels between.

    Returns
    -------
    (h, w) float32 metres; 0 where the ray misses the hull.
    """
    import cv2

    height, width = mask.shape
    if stride > 1:
        size = -(-width // stride), -(-height // stride)
        few = replace(view, camera=scale_camera(view.camera, *size))
        front = compute_hull_entry(few, np.ascontiguousarray(mask[::stride, ::stride]), silhouettes)
        return np.asarray(cv2.resize(front, (width, height), interpolation=cv2.INTER_NEAREST), np.float32)
    return _kernels.find_hull_entry(
        mask,
        [(view.compute_projection_to(one.view), one.mask) for one in silhouettes],
        min_views=min(_MIN_BOUNDING_VIEWS, len(silhouettes)),
        depth_range=(view.near, view.far),
        steps=_RAY_STEPS,
        wanted_threads=1,
    )


def _are_masks_equal(found: Sequence[Silhouette]) -> bool:
    """Return True if all masks are almost equal (a lens border)."""
    if len({one.mask.shape for one in found}) != 1:
        return False
    stack = np.stack([one.mask for one in found])
    return bool(stack.all(axis=0).sum() >= _SAME_MASK_RATIO * stack.any(axis=0).sum())
