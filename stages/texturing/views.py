"""Visibility of a mesh in photos, and sampling of photos at surface points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import MAX_ANGLE, MAX_ANGLE_ALONE
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, pinhole, scaled
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.alignment import Shifts
from scanloom.stages.texturing.back_projection import with_lacking
from scanloom.stages.texturing.exposure import Exposure
from scanloom.stages.texturing.local_exposure import LocalExposure, made_even
from scanloom.stages.texturing.photos import Photo, Photos

# Camera arguments of kernels: (fx, fy, cx, cy, width, height) and camera_from_world (4, 4).
KernelCamera = tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]
_Map = NDArray[np.float32]
T = TypeVar("T")

# Maximum pixels of a rendering of the mesh, whatever the photo's resolution.
_MOST_DRAWN = 1_500_000
# Margin along occlusion boundaries where photos are not used, as a ratio of the image's width.
_MARGIN = 1 / 210
# Near plane as a ratio of the mesh's bounding box diagonal.
_NEAR = 1e-4
# Standard deviation of the blur that separates details from the rest, as a ratio of the photo's width.
_BLUR = 3 / 640
# Standard deviation in pixels above which the blur is computed at half the resolution, and the blur that
# halving itself adds.
_WIDE_BLUR, _BLUR_OF_HALVING = 2.0, 0.87


def kernel_camera(camera: Camera, camera_from_world: Pose) -> KernelCamera:
    """Convert a camera to the arguments of the kernels."""
    values = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    return values, np.ascontiguousarray(camera_from_world, np.float64)


class Correction(NamedTuple):
    """Alignment of a photo with the texture: shifts and local exposure."""

    shifts: Shifts
    exposure: LocalExposure | None


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """Mesh prepared for rendering from many cameras.

    Attributes
    ----------
    kernel : renderer.
    near : distance of the near plane, metres.
    parts : (m,) part of each triangle; parts with consecutive indices are close in space.
    """

    kernel: _kernels.DrawnMesh
    near: float
    parts: NDArray[np.uint32]


def drawn_mesh(mesh: Mesh) -> DrawnMesh:
    """Prepare a mesh for rendering."""
    kernel = _kernels.DrawnMesh(mesh.vertices, mesh.triangles)
    return DrawnMesh(kernel, near_of(mesh), kernel.parts())


def near_of(mesh: Mesh) -> float:
    """Return the near plane distance for a mesh, metres."""
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) * _NEAR


def see(
    points: _kernels.SurfacePoints,
    mesh: DrawnMesh,
    photos: Photos,
    exposures: Sequence[Exposure],
    corrections: Sequence[Correction] | None,
    progress: Callable[[], object],
    *,
    numbers: Sequence[int] | None = None,
    remember: bool = False,
    is_blended: bool = True,
) -> list[NDArray[np.uint32]]:
    """Sample surface points in photos, one photo after another.

    Parameters
    ----------
    points : receive the samples of the photos that show them best.
    mesh : the same surface, for occlusion tests.
    photos : photos to sample.
    exposures, corrections : of each photo; see `scanloom.stages.texturing.exposure`, `alignment` and
        `local_exposure`. Corrections may be None.
    progress : called after each photo.
    numbers : indices of the photos to use, in this order; all by default.
    remember : keep visibility for `see_again`.
    is_blended : samples will be blended; if False, the blurred photo is not computed.

    Returns
    -------
    For each used photo, the mesh parts that it may show.
    """
    numbers = range(len(photos)) if numbers is None else numbers
    # The same limits as in fusion, which ignores depth at more grazing angles.
    flattest = float(np.cos(np.radians(MAX_ANGLE_ALONE if len(photos) == 1 else MAX_ANGLE)))

    def prepared(number: int) -> _kernels.View:
        photo = photos.read(number)
        correction = None if corrections is None else corrections[number]
        colors = _colors(photo, exposures[number], correction, is_blended=is_blended)
        return _view(photo, colors, mesh, worth=float(photos.worths[number]), flattest=flattest)

    shown = []
    for number, view in zip(numbers, _each(prepared, numbers, photos), strict=True):
        triangles = points.see(view, number, remember=remember, wanted_threads=0)
        shown.append(np.unique(mesh.parts[triangles]))
        progress()
    return shown


def see_again(
    points: _kernels.SurfacePoints,
    photos: Photos,
    exposures: Sequence[Exposure],
    corrections: Sequence[Correction],
    progress: Callable[[], object],
) -> None:
    """Replace the samples of points by corrected photos, with unchanged view selection.

    The points must come from `see` with `remember=True`.

    Parameters
    ----------
    points, photos, exposures, corrections, progress : as in `see`.
    """

    def prepared(number: int) -> _kernels.Photo:
        return _colors(photos.read(number), exposures[number], corrections[number])

    _take_anew(points, photos, prepared, progress)


def painted_from(
    texture: _kernels.TexturedSurface, camera: KernelCamera, near: float
) -> tuple[ColorImage, NDArray[np.bool_]]:
    """Render a textured mesh from a camera.

    Returns
    -------
    Image (h, w, 3) uint8, and a mask (h, w) of pixels with a texture. Texels with level 0, which no photo
    shows, are not in the mask.
    """
    import cv2

    drawn, shown = texture.seen_by(camera, near=near)
    return drawn, shown & (cv2.inRange(drawn, np.ones(3), np.full(3, 255.0)) > 0)


def see_details(
    points: _kernels.SurfacePoints,
    photos: Photos,
    exposures: Sequence[Exposure],
    textures: Sequence[_kernels.TexturedSurface],
    near: float,
    progress: Callable[[], object],
) -> None:
    """Replace the samples of points by photos with details added by back-projection.

    Parameters
    ----------
    points, photos, exposures : as in `see`, which must have been called with `remember=True`.
    textures : the texture painted first, and the texture after each back-projection pass.
    near : near plane distance, metres.
    progress : called after each photo.
    """

    def prepared(number: int) -> _kernels.Photo:
        photo = photos.read(number)
        camera = kernel_camera(photo.camera, photo.camera_from_world)
        image = exposures[number].corrected(photo.image)
        detailed = image
        for texture in textures:
            detailed = with_lacking(detailed, image, *painted_from(texture, camera, near))
        return _kernels.Photo(camera, detailed, _blurred(image, photo.seen), warp=None)

    _take_anew(points, photos, prepared, progress)


def _take_anew(
    points: _kernels.SurfacePoints,
    photos: Photos,
    prepared: Callable[[int], _kernels.Photo],
    progress: Callable[[], object],
) -> None:
    numbers = range(len(photos))
    for number, photo in zip(numbers, _each(prepared, numbers, photos), strict=True):
        points.see_again(photo, number, wanted_threads=0)
        progress()


def _each(prepared: Callable[[int], T], numbers: Sequence[int], photos: Photos) -> Iterator[T]:
    return read_ahead(prepared, numbers, threads=workers(), ahead=photos.ahead)


def _colors(
    photo: Photo, exposure: Exposure, correction: Correction | None, *, is_blended: bool = True
) -> _kernels.Photo:
    image = exposure.corrected(photo.image)
    camera = kernel_camera(photo.camera, photo.camera_from_world)
    warp = None
    if correction is not None:
        warp = correction.shifts.astype(np.float32)
        image = image if correction.exposure is None else made_even(image, correction.exposure)
    blurred = _blurred(image, photo.seen) if is_blended else image
    return _kernels.Photo(camera, image, blurred, warp=warp)


def _view(
    photo: Photo, colors: _kernels.Photo, mesh: DrawnMesh, *, worth: float, flattest: float
) -> _kernels.View:
    drawn = kernel_camera(_drawing_camera(photo.camera), photo.camera_from_world)
    depth, triangles = mesh.kernel.zbuffer(drawn, near=mesh.near)
    nearest, reach = _nearest(depth)
    if photo.seen is not None:
        # Pixels near the edge of the mask are unreliable; depth 0 excludes them.
        nearest[_border(photo.seen, nearest.shape) > 0] = 0
    measured, measured_reach = _measured(photo.frame)
    return _kernels.View(
        colors,
        drawn,
        nearest,
        depth,
        triangles,
        reach=(reach, measured_reach),
        measured=measured,
        worth=worth,
        flattest=flattest,
    )


def _blurred(image: ColorImage, seen: NDArray[np.bool_] | None) -> ColorImage:
    """Blur a photo to remove its details, ignoring masked pixels."""
    import cv2

    height, width = image.shape[:2]
    whole = (width, height)
    spread, size = max(_BLUR * width, 0.5), whole
    if spread >= _WIDE_BLUR:
        # Half the resolution is faster. Resampling itself blurs, which is subtracted.
        spread, size = (spread**2 - _BLUR_OF_HALVING**2) ** 0.5 / 2, (width // 2, height // 2)

    def blurred(values: NDArray[Any], kind: type) -> NDArray[Any]:
        small: NDArray[Any] = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), kind)
        return np.asarray(cv2.GaussianBlur(small, (0, 0), spread))

    if seen is None:
        levels = blurred(image, np.uint8)
    else:
        sums = blurred(cv2.bitwise_and(image, image, mask=seen.astype(np.uint8)), np.float32)
        total = np.maximum(blurred(seen.astype(np.float32), np.float32), np.float32(1e-3))
        # `cv2.divide` rounds half to even, as NumPy does, and clips to 0–255.
        levels = np.asarray(cv2.divide(sums, cv2.merge([total] * 3), dtype=cv2.CV_8U))
    return np.asarray(cv2.resize(levels, whole, interpolation=cv2.INTER_LINEAR), np.uint8)


def _border(seen: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return invalid pixels and a margin around them, uint8, resized to `shape`."""
    import cv2

    unseen = cv2.resize((~seen).astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    # Undistortion mixes pixels up to two pixels apart.
    reach = max(round(shape[1] * _MARGIN), 3)
    return np.asarray(cv2.dilate(unseen, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)), np.uint8)


def _drawing_camera(camera: Camera) -> Camera:
    share = (_MOST_DRAWN / (camera.width * camera.height)) ** 0.5
    if share >= 1:
        return camera
    return scaled(camera, max(round(camera.width * share), 2), max(round(camera.height * share), 2))


def _measured(frame: Frame) -> tuple[tuple[KernelCamera, _Map, _Map] | None, float]:
    try:
        depth = read_depth(frame)
    except InputError:
        return None, 0.0
    if depth is None or not depth.any():
        return None, 0.0
    pose = inverted(np.asarray(frame.world_from_camera, np.float64))
    nearest, reach = _nearest(np.where(depth > 0, depth, np.float32(np.inf)))
    return (kernel_camera(pinhole(frame.camera), pose), nearest, depth), reach


def _nearest(depth: _Map) -> tuple[_Map, float]:
    """Compute the minimum depth around each pixel, and the radius in pixels."""
    import cv2

    reach = max(round(depth.shape[1] * _MARGIN), 1)
    window: NDArray[Any] = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.erode(depth, window, borderType=cv2.BORDER_REPLICATE)), float(reach)
