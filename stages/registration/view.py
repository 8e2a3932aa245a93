"""Frame prepared for registration: depth for alignment, and features."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.projection import unproject
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.registration.features import MAX_PIXELS, Features, detect_features
from scanloom.stages.registration.matched_points import predict_depth_sigma
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, scale_camera, to_pinhole

# Maximum width of depth maps, pixels. Wider ones are downscaled by an integer; alignment does not benefit
# from more.
_MAX_WIDTH_PX = 400
# Approximate number of points for the firmness of a view.
_SAMPLE_POINT_COUNT = 4000


@dataclass(frozen=True, eq=False)
class RegistrationView:
    """Depth image and features of a frame.

    Attributes
    ----------
    name : name of the frame.
    camera : camera of the depth image, without distortion.
    image : RGB-D image on Open3D tensors, metres.
    features : keypoints with depth; empty without colour.
    firmness : constraint of the pose by the surface alone, 0 to 1/3. It is the smallest eigenvalue of the
        mean point-to-plane information matrix, with lengths relative to the root-mean-square radius of the
        points.
    information_per_point : (6, 6) information matrix of rotation and translation, averaged over the points of
        the surface.
    depth_m : median depth, metres.
    valid_pixel_count : number of pixels of `image` with depth.
    mean_color : mean grey level, 0 to 255; NaN if the colour image was not read.
    """

    name: str
    camera: Camera
    image: Any
    features: Features
    firmness: float
    information_per_point: NDArray[np.float64]
    depth_m: float
    valid_pixel_count: int
    mean_color: float


def read_registration_view(
    frame: Frame, max_depth: float, known_features: Features | None = None
) -> RegistrationView:
    """Read a frame, and detect its features unless given.

    Parameters
    ----------
    frame : frame with depth.
    max_depth : farther depth is dropped, metres.
    known_features : features detected before.

    Raises
    ------
    InputError
        If the frame has no depth, or cannot be read.
    """
    import cv2

    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", DiagnosticLocation(frame=frame.name))
    depth[depth > max_depth] = 0
    valid = depth[depth > 0]
    if valid.size == 0:
        raise InputError(
            SCAN_DEPTH_MOSTLY_EMPTY, "no pixel has a depth.", DiagnosticLocation(frame=frame.name)
        )
    grey = None
    features = Features.create_empty() if known_features is None else known_features
    if frame.color is not None and known_features is None:
        color, camera = _read_color(frame, depth)
        grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)
        features = detect_features(grey, camera, depth)
    step = max(-(-frame.camera.width // _MAX_WIDTH_PX), 1)
    small = downscale_depth(depth, step)
    camera = scale_camera(to_pinhole(frame.camera), frame.camera.width // step, frame.camera.height // step)
    firmness, hold = _compute_firmness(small, camera)
    return RegistrationView(
        name=frame.name,
        camera=camera,
        image=_create_rgbd_image(small),
        features=features,
        firmness=firmness,
        information_per_point=hold,
        depth_m=float(np.median(valid)),
        valid_pixel_count=int(np.count_nonzero(small)),
        mean_color=float("nan") if grey is None else float(grey.mean()),
    )


def _read_color(frame: Frame, depth: DepthImage) -> tuple[ColorImage, Camera]:
    """Read the downscaled colour image and its camera.

    The image is reprojected to the position of the depth camera if necessary.
    """
    import cv2

    color = read_color_aligned_to_depth(frame, depth) if frame.color_camera is not None else read_color(frame)
    if color is None:
        raise InputError(
            FRAME_IMAGE_MISSING, "there is no colour image.", DiagnosticLocation(frame=frame.name)
        )
    share = min((MAX_PIXELS / (color.shape[0] * color.shape[1])) ** 0.5, 1.0)
    size = (max(round(color.shape[1] * share), 1), max(round(color.shape[0] * share), 1))
    if size != (color.shape[1], color.shape[0]):
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return color, scale_camera(to_pinhole(frame.camera), *size)


def downscale_depth(depth: DepthImage, block_px: int) -> DepthImage:
    """Downscale a depth map by the median of blocks.

    A mean would blend depths across edges; a missing pixel leaves no hole.

    Parameters
    ----------
    depth : (h, w) metres, 0 where missing.
    block_px : side of a block, pixels.
    """
    height, width = (side // block_px for side in depth.shape)
    inside = depth[: height * block_px, : width * block_px]
    values = [inside[i::block_px, j::block_px] for i in range(block_px) for j in range(block_px)]
    values = [np.where(one > 0, one, np.float32(np.inf)) for one in values]
    count = np.sum([one < np.inf for one in values], axis=0)
    median = np.zeros((height, width), np.float32)
    # Whole images are sorted up to the median, because sorting many small blocks is slow.
    for rank in range((len(values) + 1) // 2):
        for i in range(len(values) - 1, rank, -1):
            values[i - 1], values[i] = np.minimum(*values[i - 1 : i + 1]), np.maximum(*values[i - 1 : i + 1])
        np.copyto(median, values[rank], where=(count > 0) & ((count - 1) // 2 == rank))
    return median


def _create_rgbd_image(depth: NDArray[np.float32]) -> Any:
    o3d = import_open3d()
    # Colours are not used: surfaces alone align better if colour and depth are not exactly registered.
    blank = np.zeros((*depth.shape, 3), np.uint8)
    color, metres = (o3d.t.geometry.Image(o3d.core.Tensor(image)) for image in (blank, depth))
    return o3d.t.geometry.RGBDImage(color, metres)


def _compute_firmness(depth: NDArray[np.float32], camera: Camera) -> tuple[float, NDArray[np.float64]]:
    """Compute the firmness of a view and its information matrix, see `RegistrationView`."""
    import cv2

    smooth = cv2.medianBlur(depth, 5)
    gap = 4
    middle = smooth[gap:-gap, gap:-gap]
    beside = [
        smooth[gap:-gap, 2 * gap :],
        smooth[gap:-gap, : -2 * gap],
        smooth[2 * gap :, gap:-gap],
        smooth[: -2 * gap, gap:-gap],
    ]
    least, most = np.min(beside, axis=0), np.max(beside, axis=0)
    rows, columns = np.nonzero((least > 0) & (most - least < 0.1 * most) & (middle > 0))
    if len(rows) < 100:
        return 0.0, np.zeros((6, 6))
    some = slice(None, None, max(len(rows) // _SAMPLE_POINT_COUNT, 1))
    rows, columns = rows[some] + gap, columns[some] + gap

    def unproject_at(down: int, across: int) -> NDArray[np.float64]:
        v, u = rows + down, columns + across
        return unproject(u, v, smooth[v, u], camera)

    n = np.cross(unproject_at(0, gap) - unproject_at(0, -gap), unproject_at(gap, 0) - unproject_at(-gap, 0))
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30)
    p = unproject_at(0, 0)
    centre = p.mean(axis=0)
    unit = np.sqrt(((p - centre) ** 2).sum(axis=1).mean())
    rows6 = np.concatenate([np.cross((p - centre) / unit, n), n], axis=1)
    firmness = float(np.linalg.eigvalsh(rows6.T @ rows6 / len(rows6))[0])
    told = (
        np.concatenate([np.cross(p, n), n], axis=1) / predict_depth_sigma(p[:, 2].astype(np.float64))[:, None]
    )
    return firmness, np.asarray(told.T @ told / len(told))
