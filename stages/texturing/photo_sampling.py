"""Visibility of a mesh in photos, and sampling of photos at surface points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import MAX_ANGLE_DEG, MAX_ANGLE_SINGLE_FRAME_DEG
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, scale_camera, to_pinhole
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.back_projection import add_residual
from scanloom.stages.texturing.exposure import Exposure
from scanloom.stages.texturing.local_exposure import LocalExposure, apply_local_exposure
from scanloom.stages.texturing.photo_alignment import Shifts
from scanloom.stages.texturing.photos import Photo, Photos

# Camera arguments of kernels: (fx, fy, cx, cy, width, height) and camera_from_world (4, 4).
KernelCamera = tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]
_FloatMap = NDArray[np.float32]
T = TypeVar("T")

# Maximum pixels of a rendering of the mesh, whatever the photo's resolution.
_MAX_RENDER_PIXELS = 1_500_000
# Margin along occlusion boundaries where photos are not used, as a ratio of the image's width.
_MARGIN_RATIO = 1 / 210
# Near plane as a ratio of the mesh's bounding box diagonal.
_NEAR_RATIO = 1e-4
# Standard deviation of the blur that separates details from the rest, as a ratio of the photo's width.
_BLUR_RATIO = 3 / 640
# Standard deviation in pixels above which the blur is computed at half the resolution, and the blur that
# halving itself adds.
_WIDE_BLUR_PX, _HALVING_BLUR_PX = 2.0, 0.87


def to_kernel_camera(camera: Camera, camera_from_world: Pose) -> KernelCamera:
    """Convert a camera to the arguments of the kernels."""
    values = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    return values, np.ascontiguousarray(camera_from_world, np.float64)


class PhotoCorrection(NamedTuple):
    """Alignment of a photo with the texture: shifts and local exposure."""

    shifts: Shifts
    exposure: LocalExposure | None


@dataclass(frozen=True, eq=False)
class RenderMesh:
    """Mesh prepared for rendering from many cameras.

    Attributes
    ----------
    renderer : renderer.
    near_m : distance of the near plane, metres.
    parts : (m,) part of each triangle; parts with consecutive indices are close in space.
    """

    renderer: _kernels.MeshRenderer
    near_m: float
    parts: NDArray[np.uint32]


def prepare_render_mesh(mesh: Mesh) -> RenderMesh:
    """Prepare a mesh for rendering."""
    kernel = _kernels.MeshRenderer(mesh.vertices, mesh.triangles)
    return RenderMesh(kernel, compute_near_plane(mesh), kernel.triangle_clusters())


def compute_near_plane(mesh: Mesh) -> float:
    """Return the near plane distance for a mesh, metres."""
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) * _NEAR_RATIO


def sample_photos(
    points: _kernels.SurfacePoints,
    mesh: RenderMesh,
    photos: Photos,
    exposures: Sequence[Exposure],
    corrections: Sequence[PhotoCorrection] | None,
    progress: Callable[[], object],
    *,
    photo_indices: Sequence[int] | None = None,
    keeps_visibility: bool = False,
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
    photo_indices : indices of the photos to use, in this order; all by default.
    keeps_visibility : keep visibility for `resample_photos`.
    is_blended : samples will be blended; if False, the blurred photo is not computed.

    Returns
    -------
    For each used photo, the mesh parts that it may show.
    """
    photo_indices = range(len(photos)) if photo_indices is None else photo_indices
    # The same limits as in fusion, which ignores depth at more grazing angles.
    min_cosine = float(np.cos(np.radians(MAX_ANGLE_SINGLE_FRAME_DEG if len(photos) == 1 else MAX_ANGLE_DEG)))

    def prepare(number: int) -> _kernels.View:
        photo = photos.read(number)
        correction = None if corrections is None else corrections[number]
        colors = _prepare_photo(photo, exposures[number], correction, is_blended=is_blended)
        return _prepare_view(photo, colors, mesh, weight=float(photos.weights[number]), min_cosine=min_cosine)

    visible_parts = []
    for number, view in zip(photo_indices, _iterate_prepared(prepare, photo_indices, photos), strict=True):
        triangles = points.add_view(view, number, remember=keeps_visibility, wanted_threads=0)
        visible_parts.append(np.unique(mesh.parts[triangles]))
        progress()
    return visible_parts


def resample_photos(
    points: _kernels.SurfacePoints,
    photos: Photos,
    exposures: Sequence[Exposure],
    corrections: Sequence[PhotoCorrection],
    progress: Callable[[], object],
) -> None:
    """Replace the samples of points by corrected photos, with unchanged view selection.

    The points must come from `sample_photos` with `remember=True`.

    Parameters
    ----------
    points, photos, exposures, corrections, progress : as in `sample_photos`.
    """

    def prepare(number: int) -> _kernels.Photo:
        return _prepare_photo(photos.read(number), exposures[number], corrections[number])

    _replace_samples(points, photos, prepare, progress)


def render_texture(
    texture: _kernels.TexturedSurface, camera: KernelCamera, near_m: float
) -> tuple[ColorImage, NDArray[np.bool_]]:
    """Render a textured mesh from a camera.

    Returns
    -------
    Image (h, w, 3) uint8, and a mask (h, w) of pixels with a texture. Texels with level 0, which no photo
    shows, are not in the mask.
    """
    import cv2

    rendering, is_textured = texture.render(camera, near=near_m)
    return rendering, is_textured & (cv2.inRange(rendering, np.ones(3), np.full(3, 255.0)) > 0)


def resample_with_details(
    points: _kernels.SurfacePoints,
    photos: Photos,
    exposures: Sequence[Exposure],
    textures: Sequence[_kernels.TexturedSurface],
    near_m: float,
    progress: Callable[[], object],
) -> None:
    """Replace the samples of points by photos with details added by back-projection.

    Parameters
    ----------
    points, photos, exposures : as in `sample_photos`, which must have been called with `remember=True`.
    textures : the texture painted first, and the texture after each back-projection pass.
    near_m : near plane distance, metres.
    progress : called after each photo.
    """

    def prepare(number: int) -> _kernels.Photo:
        photo = photos.read(number)
        camera = to_kernel_camera(photo.camera, photo.camera_from_world)
        image = exposures[number].correct(photo.image)
        detailed = image
        for texture in textures:
            detailed = add_residual(detailed, image, *render_texture(texture, camera, near_m))
        return _kernels.Photo(camera, detailed, _blur_photo(image, photo.valid_mask), warp=None)

    _replace_samples(points, photos, prepare, progress)


def _replace_samples(
    points: _kernels.SurfacePoints,
    photos: Photos,
    prepare: Callable[[int], _kernels.Photo],
    progress: Callable[[], object],
) -> None:
    photo_indices = range(len(photos))
    for number, photo in zip(photo_indices, _iterate_prepared(prepare, photo_indices, photos), strict=True):
        points.update_view_colors(photo, number, wanted_threads=0)
        progress()


def _iterate_prepared(
    prepare: Callable[[int], T], photo_indices: Sequence[int], photos: Photos
) -> Iterator[T]:
    return map_ordered(prepare, photo_indices, threads=get_worker_count(), max_pending=photos.max_concurrent)


def _prepare_photo(
    photo: Photo, exposure: Exposure, correction: PhotoCorrection | None, *, is_blended: bool = True
) -> _kernels.Photo:
    image = exposure.correct(photo.image)
    camera = to_kernel_camera(photo.camera, photo.camera_from_world)
    warp = None
    if correction is not None:
        warp = correction.shifts.astype(np.float32)
        image = image if correction.exposure is None else apply_local_exposure(image, correction.exposure)
    blurred = _blur_photo(image, photo.valid_mask) if is_blended else image
    return _kernels.Photo(camera, image, blurred, warp=warp)


def _prepare_view(
    photo: Photo, colors: _kernels.Photo, mesh: RenderMesh, *, weight: float, min_cosine: float
) -> _kernels.View:
    render_camera = to_kernel_camera(_limit_camera(photo.camera), photo.camera_from_world)
    depth, triangles = mesh.renderer.render_zbuffer(render_camera, near=mesh.near_m)
    nearest, reach = _compute_min_depth(depth)
    if photo.valid_mask is not None:
        # Pixels near the edge of the mask are unreliable; depth 0 excludes them.
        nearest[_mask_border(photo.valid_mask, nearest.shape) > 0] = 0
    measured, measured_reach = _read_measured_depth(photo.frame)
    return _kernels.View(
        colors,
        render_camera,
        nearest,
        depth,
        triangles,
        reach=(reach, measured_reach),
        measured=measured,
        weight=weight,
        min_cosine=min_cosine,
    )


def _blur_photo(image: ColorImage, valid_mask: NDArray[np.bool_] | None) -> ColorImage:
    """Blur a photo to remove its details, ignoring masked pixels."""
    import cv2

    height, width = image.shape[:2]
    full_size = (width, height)
    spread, size = max(_BLUR_RATIO * width, 0.5), full_size
    if spread >= _WIDE_BLUR_PX:
        # Half the resolution is faster. Resampling itself blurs, which is subtracted.
        spread, size = (spread**2 - _HALVING_BLUR_PX**2) ** 0.5 / 2, (width // 2, height // 2)

    def blur(values: NDArray[Any], kind: type) -> NDArray[Any]:
        small: NDArray[Any] = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), kind)
        return np.asarray(cv2.GaussianBlur(small, (0, 0), spread))

    if valid_mask is None:
        levels = blur(image, np.uint8)
    else:
        sums = blur(cv2.bitwise_and(image, image, mask=valid_mask.astype(np.uint8)), np.float32)
        total = np.maximum(blur(valid_mask.astype(np.float32), np.float32), np.float32(1e-3))
        # `cv2.divide` rounds half to even, as NumPy does, and clips to 0–255.
        levels = np.asarray(cv2.divide(sums, cv2.merge([total] * 3), dtype=cv2.CV_8U))
    return np.asarray(cv2.resize(levels, full_size, interpolation=cv2.INTER_LINEAR), np.uint8)


def _mask_border(valid_mask: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return invalid pixels and a margin around them, uint8, resized to `shape`."""
    import cv2

    unseen = cv2.resize((~valid_mask).astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    # Undistortion mixes pixels up to two pixels apart.
    reach = max(round(shape[1] * _MARGIN_RATIO), 3)
    return np.asarray(cv2.dilate(unseen, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)), np.uint8)


def _limit_camera(camera: Camera) -> Camera:
    scale = (_MAX_RENDER_PIXELS / (camera.width * camera.height)) ** 0.5
    if scale >= 1:
        return camera
    return scale_camera(camera, max(round(camera.width * scale), 2), max(round(camera.height * scale), 2))


def _read_measured_depth(frame: Frame) -> tuple[tuple[KernelCamera, _FloatMap, _FloatMap] | None, float]:
    try:
        depth = read_depth(frame)
    except InputError:
        return None, 0.0
    if depth is None or not depth.any():
        return None, 0.0
    pose = invert_pose(np.asarray(frame.world_from_camera, np.float64))
    nearest, reach = _compute_min_depth(np.where(depth > 0, depth, np.float32(np.inf)))
    return (to_kernel_camera(to_pinhole(frame.camera), pose), nearest, depth), reach


def _compute_min_depth(depth: _FloatMap) -> tuple[_FloatMap, float]:
    """Compute the minimum depth around each pixel, and the radius in pixels."""
    import cv2

    reach = max(round(depth.shape[1] * _MARGIN_RATIO), 1)
    window: NDArray[Any] = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.erode(depth, window, borderType=cv2.BORDER_REPLICATE)), float(reach)
