"""A frame as registration needs it: depth to align, and what can be recognised in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import open3d
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.matching_color import read_matching_color
from scanloom.stages.frames.projection import unproject
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.registration.features import PIXELS, Features, features_of
from scanloom.stages.registration.points import deviation
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, pinhole, scaled

# Wider depth maps are taken in blocks of 2, 3, … pixels each way: alignment gains nothing beyond.
_WIDEST = 400
# Points from which the firmness of a view is measured.
_SAMPLED = 4000


@dataclass(frozen=True, eq=False)
class View:
    """A frame that was read.

    Attributes
    ----------
    name : of the frame.
    camera : of the depth, without distortion.
    image : Open3D's RGB-D image on tensors, metres.
    features : points that can be recognised in other views; none without colour.
    firmness : how well the surface alone holds a view in place, 0 to 1/3: the least eigenvalue of the mean
        of squared motions along the normals, for unit motions of the camera (lengths in median depths).
    hold : (6, 6) inverse covariance of a turn and a shift that one point of the surface tells, on average.
    depth_m : the median depth.
    pixels : of the image, that have a depth.
    mean_color : mean of the grey image, 0 to 255; NaN without colour.
    """

    name: str
    camera: Camera
    image: Any
    features: Features
    firmness: float
    hold: NDArray[np.float64]
    depth_m: float
    pixels: int
    mean_color: float


def read_view(frame: Frame, max_depth: float, known: Features | None = None) -> View:
    """Read a frame, and find its features unless they are known.

    Raises
    ------
    InputError
        If it has no depth, or cannot be read.
    """
    import cv2

    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", Where(frame=frame.name))
    depth[depth > max_depth] = 0
    valid = depth[depth > 0]
    if valid.size == 0:
        raise InputError(SCAN_DEPTH_MOSTLY_EMPTY, "no pixel has a depth.", Where(frame=frame.name))
    grey = None
    features = Features.none() if known is None else known
    if frame.color is not None and known is None:
        color, camera = _color(frame, depth)
        grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)
        features = features_of(grey, camera, depth)
    step = max(-(-frame.camera.width // _WIDEST), 1)
    small = smaller(depth, step)
    camera = scaled(pinhole(frame.camera), frame.camera.width // step, frame.camera.height // step)
    firmness, hold = _surface(small, camera)
    return View(
        name=frame.name,
        camera=camera,
        image=_image(small),
        features=features,
        firmness=firmness,
        hold=hold,
        depth_m=float(np.median(valid)),
        pixels=int(np.count_nonzero(small)),
        mean_color=float("nan") if grey is None else float(grey.mean()),
    )


def _color(frame: Frame, depth: DepthImage) -> tuple[ColorImage, Camera]:
    """Return the colour image in a size that is enough, and its camera; it stands where the depth's does."""
    import cv2

    color = read_matching_color(frame, depth) if frame.color_camera is not None else read_color(frame)
    if color is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no colour image.", Where(frame=frame.name))
    share = min((PIXELS / (color.shape[0] * color.shape[1])) ** 0.5, 1.0)
    size = (max(round(color.shape[1] * share), 1), max(round(color.shape[0] * share), 1))
    if size != (color.shape[1], color.shape[0]):
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return color, scaled(pinhole(frame.camera), *size)


def smaller(depth: DepthImage, step: int) -> DepthImage:
    """Return the median of what each block of pixels holds: no mean across an edge, no hole of a pixel."""
    height, width = (side // step for side in depth.shape)
    inside = depth[: height * step, : width * step]
    values = [inside[i::step, j::step] for i in range(step) for j in range(step)]
    values = [np.where(one > 0, one, np.float32(np.inf)) for one in values]
    count = np.sum([one < np.inf for one in values], axis=0)
    median = np.zeros((height, width), np.float32)
    # The lesser half is sorted image by image: blocks of a few pixels each are slow to sort.
    for rank in range((len(values) + 1) // 2):
        for i in range(len(values) - 1, rank, -1):
            values[i - 1], values[i] = np.minimum(*values[i - 1 : i + 1]), np.maximum(*values[i - 1 : i + 1])
        np.copyto(median, values[rank], where=(count > 0) & ((count - 1) // 2 == rank))
    return median


def _image(depth: NDArray[np.float32]) -> Any:
    o3d = open3d()
    # Colours are not used: surfaces alone align better where colour and depth are not registered exactly.
    blank = np.zeros((*depth.shape, 3), np.uint8)
    color, metres = (o3d.t.geometry.Image(o3d.core.Tensor(image)) for image in (blank, depth))
    return o3d.t.geometry.RGBDImage(color, metres)


def _surface(depth: NDArray[np.float32], camera: Camera) -> tuple[float, NDArray[np.float64]]:
    """Return the firmness of a view, and what it tells of a motion: the point-to-plane system, see `View`."""
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
    some = slice(None, None, max(len(rows) // _SAMPLED, 1))
    rows, columns = rows[some] + gap, columns[some] + gap

    def points(down: int, across: int) -> NDArray[np.float64]:
        v, u = rows + down, columns + across
        return unproject(u, v, smooth[v, u], camera)

    n = np.cross(points(0, gap) - points(0, -gap), points(gap, 0) - points(-gap, 0))
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30)
    p = points(0, 0)
    centre = p.mean(axis=0)
    unit = np.sqrt(((p - centre) ** 2).sum(axis=1).mean())
    rows6 = np.concatenate([np.cross((p - centre) / unit, n), n], axis=1)
    firmness = float(np.linalg.eigvalsh(rows6.T @ rows6 / len(rows6))[0])
    told = np.concatenate([np.cross(p, n), n], axis=1) / deviation(p[:, 2].astype(np.float64))[:, None]
    return firmness, np.asarray(told.T @ told / len(told))
