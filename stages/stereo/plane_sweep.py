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
from scanloom.stages.scans.model.scan import Camera, DepthImage, scaled
from scanloom.stages.stereo.plane_fit import refined
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.view_images import Seen

Grey = NDArray[np.uint8]
Map = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Maximum image side, px, and maximum number of planes at the coarsest level.
_COARSEST_PX = 256
_COARSEST_PLANES = 192
# The kernel takes a multiple of this number of planes per pixel, up to the maximum.
_LANES = 16
_MOST = 96
# Additional planes on either side of the range found around a pixel.
_BEYOND = 3
# Minimum distinctness of a reliable result (see `Swept`).
_DISTINCT = 0.3
# Reach in px for collecting reliable planes around a pixel; the wide one if the narrow one has none.
_NEAR, _WIDE = 1, 5
# Maximum area of a warped partner image relative to the view: parallax moves its content beyond the image
# edges.
_LARGEST_AREA = 3.0
# Grid of rays for measuring parallax, per side.
_GRID = 5
# Margin between the best and the second-best cost, summed over eight paths, at which distinctness is one
# half.
HALF_MARGIN = 120.0
# State of a warped partner pixel, as in the kernel: outside of the image, scene, background of the object.
_NOTHING, _SCENE, _EMPTY = 0, 1, 2
# Additional cost of the farthest plane relative to a plane on the visual hull.
_LEAN = 120.0
# Margin around the object, px, so that coarse levels have context.
_ROOM = 32


@dataclass(frozen=True, eq=False)
class Swept:
    """Result of a plane sweep.

    Attributes
    ----------
    depth : (h, w) float32 metres along the optical axis; 0 only outside of the object's window.
    distinct : (h, w) float32 from 0 to 1, distinctness of the best plane from its competitors; one half at a
        cost margin of 120.
    planes : number of planes.
    """

    depth: DepthImage
    distinct: Map
    planes: int


def plane_sweep(
    main: Seen, partners: Sequence[Seen], front: DepthImage | None = None, threads: int = 1
) -> Swept:
    """Estimate the depth of each pixel of a view from its partners.

    Parameters
    ----------
    main : the view; planes are between its `near` and `far`. Only a window around the object is processed.
    partners : one or more other views of the same scene.
    front : (h, w) metres, minimum depth of each pixel from the visual hull, 0 where unknown. Where images are
        ambiguous, depth close to it is preferred.
    threads : thread count; results do not depend on it.

    Raises
    ------
    MemoryError
        If memory does not suffice.
    """
    rows, columns = _window(main)
    whole = main.grey.shape
    main = _cut(main, rows, columns)
    nearest = None if front is None else _inverse(front[rows, columns])
    view = main.view
    step = _step(view, [one.view for one in partners])
    span = 1 / view.near - 1 / view.far
    halvings = _halvings(view.camera, span / step)
    plane = np.zeros((0, 0), np.float32)
    distinct = plane
    for level in range(halvings, -1, -1):
        count = math.ceil(span / (step * 2**level)) + 1
        planes = -(-count // _LANES) * _LANES
        inverse = 1 / view.far + np.arange(planes) * (step * 2**level)
        fine = _halved(main, level)
        warped = [_warped(fine.view, _halved(one, level), inverse, count) for one in partners]
        shape = fine.grey.shape
        if plane.size:
            first, wide = _ranges(plane, distinct, shape, planes)
        else:
            first, wide = np.zeros(shape, np.int32), np.full(shape, planes, np.uint16)
        bound = None if nearest is None else _bound(nearest, shape, view, step * 2**level, count)
        plane, margin = _kernels.sweep_planes(
            fine.grey, warped, first, wide, bound, planes=planes, wanted_threads=threads
        )
        distinct = (margin / (margin + np.float32(HALF_MARGIN))).astype(np.float32)
    found = np.zeros(whole, np.float32), np.zeros(whole, np.float32)
    inverse_depth = (1 / view.far + plane * step).astype(np.float32)
    found[0][rows, columns] = 1 / refined(main, partners, inverse_depth, step)
    found[1][rows, columns] = distinct
    return Swept(*found, planes)


def _inverse(front: DepthImage) -> Map:
    """Return inverse depth (h, w), 1/m, 0 where unknown."""
    return np.divide(1, front, out=np.zeros_like(front), where=front > 0)


def _bound(
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
    return np.where(small > 0, plane, np.float32(np.nan)).astype(np.float32), _LEAN / count


def _window(one: Seen) -> tuple[slice, slice]:
    """Return rows and columns of the object with a margin."""
    if one.thing is None or not one.thing.any():
        return slice(0, one.grey.shape[0]), slice(0, one.grey.shape[1])
    ends = []
    for axis in (1, 0):
        places = np.flatnonzero(one.thing.any(axis=axis))
        ends.append(
            slice(max(int(places[0]) - _ROOM, 0), min(int(places[-1]) + _ROOM + 1, one.grey.shape[1 - axis]))
        )
    return ends[0], ends[1]


def _cut(one: Seen, rows: slice, columns: slice) -> Seen:
    camera = one.view.camera
    grey = np.ascontiguousarray(one.grey[rows, columns])
    part = replace(
        camera,
        width=grey.shape[1],
        height=grey.shape[0],
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )
    thing = None if one.thing is None else one.thing[rows, columns]
    return Seen(replace(one.view, camera=part), grey, thing)


def _step(view: PosedView, partners: Sequence[PosedView]) -> float:
    """Return the plane distance in inverse depth, 1/m.

    It moves the image of the partner with the most parallax by one pixel.
    """
    middle = 2 / (1 / view.near + 1 / view.far)
    rays = view.spread_rays(_GRID)
    points = view.to_world(rays * middle)
    small = 1e-3 / middle
    moved = view.to_world(rays / (1 / middle + small))
    fastest = 0.0
    for other in partners:
        u, v, _ = other.project(points)
        moved_u, moved_v, _ = other.project(moved)
        seen = other.holds(u, v) & np.isfinite(moved_u)
        if seen.any():
            length = np.hypot(moved_u - u, moved_v - v)[seen]
            fastest = max(fastest, float(np.median(length)) / small)
    least = 1e-4 * (1 / view.near - 1 / view.far)
    return max(1 / fastest, least) if fastest else 64 * least


def _halvings(camera: Camera, planes: float) -> int:
    """Return the number of pyramid levels above the full image."""
    long = math.log2(max(camera.width, camera.height) / _COARSEST_PX)
    many = math.log2(max(planes, 1) / _COARSEST_PLANES)
    return max(math.ceil(max(long, many)), 0)


def _halved(one: Seen, times: int) -> Seen:
    import cv2

    if times == 0:
        return one
    camera = one.view.camera
    size = max(camera.width >> times, 1), max(camera.height >> times, 1)
    grey = np.asarray(cv2.resize(one.grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    thing = None
    if one.thing is not None:
        thing = cv2.resize(one.thing.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
    return Seen(replace(one.view, camera=scaled(camera, *size)), grey, thing)


def _warped(
    view: PosedView, partner: Seen, inverse: NDArray[np.float64], count: int
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
    room = (math.sqrt(_LARGEST_AREA) - 1) / 2 * np.array((camera.width, camera.height))
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
    shown = np.where(np.asarray(inside) == 255, np.uint8(_SCENE), np.uint8(_NOTHING))
    if partner.thing is not None:
        thing = cv2.warpPerspective(255 * partner.thing.astype(np.uint8), homography, size, flags=flags)
        shown[(shown == _SCENE) & (np.asarray(thing) == 0)] = _EMPTY
    maps[:, 1:] -= low
    return np.asarray(grey, np.uint8), shown, maps.astype(np.float32)


def _ranges(
    plane: Map, distinct: Map, shape: tuple[int, ...], planes: int
) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    """Derive the plane range of each pixel from a coarser level.

    Parameters
    ----------
    plane, distinct : result at half the size.
    shape : size of the finer level.
    planes : number of planes at the finer level.

    Returns
    -------
    First plane, (h, w) int32, and number of planes, (h, w) uint16.
    """
    import cv2

    known = distinct >= _DISTINCT
    none = np.float32(planes)
    low: Map = np.full(plane.shape, np.nan, np.float32)
    high: Map = low
    for reach in (_NEAR, _WIDE):
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        least = cv2.erode(np.where(known, plane, none), kernel)
        most = cv2.dilate(np.where(known, plane, -none), kernel)
        open_ = np.isnan(low) & (most >= least)
        low, high = np.where(open_, least, low), np.where(open_, most, high)
    alone = np.isnan(low)
    low, high = np.where(alone, plane, low), np.where(alone, plane, high)
    # The range includes the pixel's own coarse result.
    low, high = np.minimum(low, plane), np.maximum(high, plane)
    size = (shape[1], shape[0])
    least, most, own = (
        2 * cv2.resize(one.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
        for one in (low, high, plane)
    )
    first, end = np.floor(least) - _BEYOND, np.ceil(most) + _BEYOND + 1
    wide = np.ceil((end - first) / _LANES) * _LANES
    # Ranges above the maximum are cut around the pixel's own result.
    cut = wide > _MOST
    first = np.where(cut, np.clip(np.rint(own) - _MOST / 2, first, end - _MOST), first)
    wide = np.minimum(np.minimum(wide, _MOST), planes)
    # Rounding up to the kernel's multiple extends the range on both sides equally.
    first = np.where(cut, first, np.rint((first + end - wide) / 2))
    first = np.clip(first, 0, planes - wide)
    return first.astype(np.int32), wide.astype(np.uint16)
