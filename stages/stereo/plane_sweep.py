"""Multi-view plane sweep, coarse to fine.

Collins, "A space-sweep approach to true multi-image matching", 1996, with semi-global aggregation of costs
(Hirschmüller, 2008). On coarse images every pixel tries all planes. On finer images it tries the planes found
around it (Rothermel et al., "SURE: Photogrammetric surface reconstruction from imagery", 2012), so that the
width of the search range hardly affects the run time.

The planes are parallel to the view's image. Their distance moves the image of the partner with the most
parallax by one pixel. Images are not rectified, so that vertical or rotated camera arrangements need no
special treatment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import Camera, DepthImage, scale_camera
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.subplane_refinement import refine_inverse_depth
from scanloom.stages.stereo.view_images import ViewImage

Grey = NDArray[np.uint8]
Map = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Maximum image side, px, and maximum number of planes at the coarsest level.
_COARSEST_PX = 256
_COARSEST_PLANES = 192
# The kernel takes a multiple of this number of planes per pixel, up to the maximum.
_PLANE_STEP = 16
_MAX_PLANES_PER_PIXEL = 96
# Additional planes on either side of the range found around a pixel.
_PLANE_MARGIN = 3
# Minimum distinctness of a reliable result (see `SweepResult`).
_MIN_DISTINCTNESS = 0.3
# Reach in px for collecting reliable planes around a pixel; the wide one if the narrow one has none.
_NEAR_RADIUS, _WIDE_RADIUS = 1, 5
# Maximum area of a warped partner image relative to the view: parallax moves its content beyond the image
# edges.
_MAX_AREA_RATIO = 3.0
# Grid of rays for measuring parallax, per side.
_GRID_SIZE = 5
# Margin between the best and the second-best cost, summed over eight paths, at which distinctness is one
# half.
HALF_MARGIN = 120.0
# State of a warped partner pixel, as in the kernel: outside of the image, scene, background of the object.
_OUTSIDE, _SCENE, _BACKGROUND = 0, 1, 2
# Additional cost of the farthest plane relative to a plane on the visual hull.
_HULL_PREFERENCE_COST = 120.0
# Margin around the object, px, so that coarse levels have context.
_WINDOW_MARGIN_PX = 32


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Result of a plane sweep.

    Attributes
    ----------
    depth : (h, w) float32 metres along the optical axis; 0 only outside of the object's window.
    distinctness : (h, w) float32 from 0 to 1, distinctness of the best plane from its competitors; one half
        at a
        cost margin of 120.
    plane_count : number of planes.
    """

    depth: DepthImage
    distinctness: Map
    plane_count: int


def sweep_view(
    main: ViewImage, partners: Sequence[ViewImage], hull_depth: DepthImage | None = None, threads: int = 1
) -> SweepResult:
    """Estimate the depth of each pixel of a view from its partners.

    Parameters
    ----------
    main : the view; planes are between its `near` and `far`. Only a window around the object is processed.
    partners : one or more other views of the same scene.
    hull_depth : (h, w) metres, minimum depth of each pixel from the visual hull, 0 where unknown. Where
        images are
        ambiguous, depth close to it is preferred.
    threads : thread count; results do not depend on it.

    Raises
    ------
    MemoryError
        If memory does not suffice.
    """
    rows, columns = _find_object_window(main)
    full_shape = main.grey.shape
    main = _crop_view(main, rows, columns)
    nearest = None if hull_depth is None else _invert_depth(hull_depth[rows, columns])
    view = main.view
    step = _compute_plane_distance(view, [one.view for one in partners])
    span = 1 / view.near - 1 / view.far
    level_count = _count_levels(view.camera, span / step)
    plane = np.zeros((0, 0), np.float32)
    distinctness = plane
    for level in range(level_count, -1, -1):
        count = math.ceil(span / (step * 2**level)) + 1
        planes = -(-count // _PLANE_STEP) * _PLANE_STEP
        inverse = 1 / view.far + np.arange(planes) * (step * 2**level)
        scaled_view = _downscale_view(main, level)
        warped = [
            _warp_partner(scaled_view.view, _downscale_view(one, level), inverse, count) for one in partners
        ]
        shape = scaled_view.grey.shape
        if plane.size:
            first, range_size = _derive_plane_ranges(plane, distinctness, shape, planes)
        else:
            first, range_size = np.zeros(shape, np.int32), np.full(shape, planes, np.uint16)
        bound = (
            None if nearest is None else _compute_nearest_planes(nearest, shape, view, step * 2**level, count)
        )
        plane, margin = _kernels.sweep_planes(
            scaled_view.grey, warped, first, range_size, bound, planes=planes, wanted_threads=threads
        )
        distinctness = (margin / (margin + np.float32(HALF_MARGIN))).astype(np.float32)
    found = np.zeros(full_shape, np.float32), np.zeros(full_shape, np.float32)
    inverse_depth = (1 / view.far + plane * step).astype(np.float32)
    found[0][rows, columns] = 1 / refine_inverse_depth(main, partners, inverse_depth, step, threads)
    found[1][rows, columns] = distinctness
    return SweepResult(*found, planes)


def _invert_depth(depth: DepthImage) -> Map:
    """Return inverse depth (h, w), 1/m, 0 where unknown."""
    return np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)


def _compute_nearest_planes(
    nearest: Map, shape: tuple[int, ...], view: PosedView, step: float, count: int
) -> tuple[Map, float]:
    """Return the nearest allowed plane of each pixel.

    Returns
    -------
    (h, w) float32 plane, NaN where unknown, and the cost per plane behind it.
    """
    import cv2

    small = cv2.resize(nearest, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    plane = (np.asarray(small) - 1 / view.far) / np.float32(step)
    return np.where(small > 0, plane, np.float32(np.nan)).astype(np.float32), _HULL_PREFERENCE_COST / count


def _find_object_window(view: ViewImage) -> tuple[slice, slice]:
    """Return rows and columns of the object with a margin."""
    if view.object_mask is None or not view.object_mask.any():
        return slice(0, view.grey.shape[0]), slice(0, view.grey.shape[1])
    ends = []
    for axis in (1, 0):
        places = np.flatnonzero(view.object_mask.any(axis=axis))
        ends.append(
            slice(
                max(int(places[0]) - _WINDOW_MARGIN_PX, 0),
                min(int(places[-1]) + _WINDOW_MARGIN_PX + 1, view.grey.shape[1 - axis]),
            )
        )
    return ends[0], ends[1]


def _crop_view(view: ViewImage, rows: slice, columns: slice) -> ViewImage:
    camera = view.view.camera
    grey = np.ascontiguousarray(view.grey[rows, columns])
    part = replace(
        camera,
        width=grey.shape[1],
        height=grey.shape[0],
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )
    thing = None if view.object_mask is None else view.object_mask[rows, columns]
    return ViewImage(replace(view.view, camera=part), grey, thing)


def _compute_plane_distance(view: PosedView, partners: Sequence[PosedView]) -> float:
    """Return the plane distance in inverse depth, 1/m.

    It moves the image of the partner with the most parallax by one pixel.
    """
    middle = 2 / (1 / view.near + 1 / view.far)
    rays = view.compute_ray_grid(_GRID_SIZE)
    points = view.to_world(rays * middle)
    small = 1e-3 / middle
    moved = view.to_world(rays / (1 / middle + small))
    max_parallax = 0.0
    for other in partners:
        u, v, _ = other.project(points)
        moved_u, moved_v, _ = other.project(moved)
        seen = other.contains(u, v) & np.isfinite(moved_u)
        if seen.any():
            length = np.hypot(moved_u - u, moved_v - v)[seen]
            max_parallax = max(max_parallax, float(np.median(length)) / small)
    min_distance = 1e-4 * (1 / view.near - 1 / view.far)
    return max(1 / max_parallax, min_distance) if max_parallax else 64 * min_distance


def _count_levels(camera: Camera, planes: float) -> int:
    """Return the number of pyramid levels above the full image."""
    long = math.log2(max(camera.width, camera.height) / _COARSEST_PX)
    many = math.log2(max(planes, 1) / _COARSEST_PLANES)
    return max(math.ceil(max(long, many)), 0)


def _downscale_view(view: ViewImage, times: int) -> ViewImage:
    import cv2

    if times == 0:
        return view
    camera = view.view.camera
    size = max(camera.width >> times, 1), max(camera.height >> times, 1)
    grey = np.asarray(cv2.resize(view.grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    thing = None
    if view.object_mask is not None:
        thing = cv2.resize(view.object_mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
    return ViewImage(replace(view.view, camera=scale_camera(camera, *size)), grey, thing)


def _warp_partner(
    view: PosedView, partner: ViewImage, inverse: NDArray[np.float64], count: int
) -> tuple[Grey, Grey, Map]:
    """Warp a partner image to the view.

    The warp is the homography of the middle plane, of inverse depth ρ₀. The partner's centre is c in the
    view's axes. A pixel with ray r (z = 1) on the plane of inverse depth ρ has the direction r - ρ c from the
    partner. On the middle plane this direction belongs to the ray r', for which r' - ρ₀ c is parallel to r -
    ρ c: r' = s r + (ρ₀ - s ρ) c with s = (1 - ρ₀ c_z) / (1 - ρ c_z).

    Returns
    -------
    The warped image (h', w') uint8, the state of its pixels (h', w') uint8, and for each plane scale and
    offsets from pixels of the view to pixels of the warped image, (planes, 3) float32.
    """
    import cv2

    camera, other = view.camera, partner.view
    turn = view.world_from_camera[:3, :3]
    c = (other.centre - view.centre) @ turn
    middle = float(inverse[count // 2])
    ahead = 1 - inverse * c[2]
    # Planes behind the partner are invisible to it; the offset maps them outside of the image.
    behind = ahead <= 1e-3
    scale = np.where(behind, 0, (1 - middle * c[2]) / np.where(behind, 1, ahead))
    shift = middle - scale * inverse
    maps = np.stack(
        [
            scale,
            camera.cx - scale * camera.cx + camera.fx * shift * c[0],
            camera.cy - scale * camera.cy + camera.fy * shift * c[1],
        ],
        axis=1,
    )
    maps[behind] = (0, -1e6, -1e6)
    corners = np.array([(x, y) for x in (0, camera.width - 1) for y in (0, camera.height - 1)], float)
    some = maps[:count][~behind[:count]]
    if not len(some):
        some = np.array([(1.0, 0.0, 0.0)])
    places = some[:, None, :1] * corners + some[:, None, 1:]
    low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
    # The warped image is as small as possible, and limited in size. Content beyond the limit is treated as
    # invisible.
    room = (math.sqrt(_MAX_AREA_RATIO) - 1) / 2 * np.array((camera.width, camera.height))
    low = np.floor(np.maximum(low, -room)).astype(int)
    high = np.ceil(np.minimum(high, corners[-1] + room)).astype(int)
    size = tuple(int(n) for n in np.maximum(high - low + 1, 1))
    # Homography from pixels of the warped image to the partner's pixels.
    back = other.world_from_camera[:3, :3].T @ turn
    into = back @ (np.eye(3) - middle * np.outer(c, (0.0, 0.0, 1.0)))
    offset = np.array([[1.0, 0, low[0]], [0, 1.0, low[1]], [0, 0, 1]])
    homography = other.camera.matrix @ into @ np.linalg.inv(camera.matrix) @ offset
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    grey = cv2.warpPerspective(partner.grey, homography, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    inside = cv2.warpPerspective(np.full(partner.grey.shape, 255, np.uint8), homography, size, flags=flags)
    shown = np.where(np.asarray(inside) == 255, np.uint8(_SCENE), np.uint8(_OUTSIDE))
    if partner.object_mask is not None:
        thing = cv2.warpPerspective(255 * partner.object_mask.astype(np.uint8), homography, size, flags=flags)
        shown[(shown == _SCENE) & (np.asarray(thing) == 0)] = _BACKGROUND
    maps[:, 1:] -= low
    return np.asarray(grey, np.uint8), shown, maps.astype(np.float32)


def _derive_plane_ranges(
    plane: Map, distinctness: Map, shape: tuple[int, ...], plane_count: int
) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    """Derive the plane range of each pixel from a coarser level.

    Parameters
    ----------
    plane, distinctness : result at half the size.
    shape : size of the finer level.
    plane_count : number of planes at the finer level.

    Returns
    -------
    First plane, (h, w) int32, and number of planes, (h, w) uint16.
    """
    import cv2

    known = distinctness >= _MIN_DISTINCTNESS
    none = np.float32(plane_count)
    low: Map = np.full(plane.shape, np.nan, np.float32)
    high: Map = low
    for reach in (_NEAR_RADIUS, _WIDE_RADIUS):
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        lowest = cv2.erode(np.where(known, plane, none), kernel)
        highest = cv2.dilate(np.where(known, plane, -none), kernel)
        is_open = np.isnan(low) & (highest >= lowest)
        low, high = np.where(is_open, lowest, low), np.where(is_open, highest, high)
    is_isolated = np.isnan(low)
    low, high = np.where(is_isolated, plane, low), np.where(is_isolated, plane, high)
    # The range includes the pixel's own coarse result.
    low, high = np.minimum(low, plane), np.maximum(high, plane)
    size = (shape[1], shape[0])
    lowest, highest, own_plane = (
        2 * cv2.resize(one.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
        for one in (low, high, plane)
    )
    first, end = np.floor(lowest) - _PLANE_MARGIN, np.ceil(highest) + _PLANE_MARGIN + 1
    range_size = np.ceil((end - first) / _PLANE_STEP) * _PLANE_STEP
    # Ranges above the maximum are cut around the pixel's own result.
    cut = range_size > _MAX_PLANES_PER_PIXEL
    first = np.where(
        cut,
        np.clip(np.rint(own_plane) - _MAX_PLANES_PER_PIXEL / 2, first, end - _MAX_PLANES_PER_PIXEL),
        first,
    )
    range_size = np.minimum(np.minimum(range_size, _MAX_PLANES_PER_PIXEL), plane_count)
    # Rounding up to the kernel's multiple extends the range on both sides equally.
    first = np.where(cut, first, np.rint((first + end - range_size) / 2))
    first = np.clip(first, 0, plane_count - range_size)
    return first.astype(np.int32), range_size.astype(np.uint16)
