"""Single views with poses, and the range of depth in which each of them sees the scene.

Nothing is known of the scene yet. Where its bounding box is stated, the range follows from that. Else views
are taken to look at one thing: it stands where their optical axes come nearest to each other, and reaches as
far around as the usual view shows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.scan import Camera, Frame, Pose, Scan

# A stated box is tight, and poses are off by a little: it is widened by this share of its diagonal.
_BOX_MARGIN = 0.02
# Optical axes that differ by less than about 3 degrees from one another meet nowhere in particular.
_LEAST_SPREAD = math.sin(math.radians(3)) ** 2
# What is nearer than this share of the distance to the scene's middle is not looked for.
_NEAREST = 0.1
# No scan is that far from its origin.
_FARTHEST_M = 1e9


@dataclass(frozen=True, eq=False)
class PosedView:
    """A view without distortion, and where to look for depth in it.

    Attributes
    ----------
    camera : of the undistorted image.
    world_from_camera : (4, 4) float64, metres.
    near, far : metres along the optical axis.
    """

    camera: Camera
    world_from_camera: Pose
    near: float
    far: float

    @property
    def centre(self) -> NDArray[np.float64]:
        """Return where the camera stands, (3,) metres."""
        return np.asarray(self.world_from_camera[:3, 3])

    @property
    def middle(self) -> float:
        """Return the geometric mean of the range of depth, metres."""
        return math.sqrt(self.near * self.far)

    def rays(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rays (…, 3) through pixels, in camera axes, of z = 1."""
        x = (columns - self.camera.cx) / self.camera.fx
        y = (rows - self.camera.cy) / self.camera.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def spread_rays(self, count: int) -> NDArray[np.float64]:
        """Return rays (count², 3) evenly spread over the image, the corners' among them."""
        columns, rows = np.meshgrid(
            np.linspace(-0.5, self.camera.width - 0.5, count),
            np.linspace(-0.5, self.camera.height - 0.5, count),
        )
        return self.rays(columns.ravel(), rows.ravel())

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (…, 3) of camera axes in the world."""
        return np.asarray(points @ self.world_from_camera[:3, :3].T + self.world_from_camera[:3, 3])

    def project(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return columns, rows (pixels) and depths (metres) of world points (…, 3); NaN for those behind."""
        seen = (points - self.centre) @ self.world_from_camera[:3, :3]
        z = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        camera = self.camera
        return seen[..., 0] / z * camera.fx + camera.cx, seen[..., 1] / z * camera.fy + camera.cy, z

    def holds(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which positions lie between the centres of the image's outermost pixels; NaN does not."""
        inside = (columns >= 0) & (columns <= self.camera.width - 1)
        return np.asarray(inside & (rows >= 0) & (rows <= self.camera.height - 1))


def posed_views(scan: Scan, min_depth: float | None, max_depth: float | None) -> list[PosedView]:
    """Return the views of a scan, each with its range of depth.

    Parameters
    ----------
    scan : whose frames have calibrated cameras and poses.
    min_depth, max_depth : metres; what is given holds for every view, in place of what the scene says.

    Raises
    ------
    InputError
        If a frame has no pose, or nothing tells where the scene is.
    """
    views = [_view(frame, scan.folder) for frame in scan.frames]
    if min_depth is not None and max_depth is not None:
        return [replace(view, near=min_depth, far=max_depth) for view in views]
    box = scene_box(scan)
    if box is None:
        box = estimated_box(views)
    if box is None:
        raise InputError(
            "the views look past each other, so that nothing tells where the scene is; give the range of its "
            "depth with depth.min_depth and depth.max_depth (metres).",
            scan.folder,
        )
    ranged = []
    for view in views:
        near, far = _depth_range(view, box)
        near, far = min_depth or near, max_depth or far
        if near >= far:
            raise InputError(
                f"depth from {near:.3g} m to {far:.3g} m is no range; correct min_depth or max_depth.",
                scan.folder,
            )
        ranged.append(replace(view, near=near, far=far))
    return ranged


def scene_box(scan: Scan) -> NDArray[np.float64] | None:
    """Return the box the scan states, (2, 3) metres, a little widened, or None."""
    if scan.box is None:
        return None
    margin = _BOX_MARGIN * float(np.linalg.norm(scan.box[1] - scan.box[0]))
    return np.stack([scan.box[0] - margin, scan.box[1] + margin])


def estimated_box(views: Sequence[PosedView]) -> NDArray[np.float64] | None:
    """Return the cube, (2, 3) metres, around what all views look at; None where their axes do not meet.

    Its middle is the point of the least sum of squared distances to the optical axes; half of its edge is
    what half the longer side of an image shows at that distance, in the median.
    """
    centres = np.stack([view.centre for view in views])
    axes = np.stack([view.world_from_camera[:3, 2] for view in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _LEAST_SPREAD * len(views):
        return None
    middle = np.linalg.solve(total, np.einsum("nij,nj->i", across, centres))
    depth = np.einsum("ni,ni->n", middle - centres, axes)
    if np.median(depth) <= 0:
        return None
    shown = [max(v.camera.width / v.camera.fx, v.camera.height / v.camera.fy) / 2 for v in views]
    reach = float(np.median(np.array(shown)[depth > 0] * depth[depth > 0]))
    return np.stack([middle - reach, middle + reach])


def _view(frame: Frame, folder: Path | None) -> PosedView:
    pose, camera = frame.world_from_camera, frame.camera
    if pose is None or not np.isfinite(pose).all() or not camera.is_calibrated:
        lacking = "camera" if not camera.is_calibrated else "pose"
        raise InputError(f"frame {frame.name} has no {lacking}; views need both.", folder)
    if np.abs(pose).max() > _FARTHEST_M:
        raise InputError(
            f"frame {frame.name} stands {np.abs(pose).max():g} m off; its pose is wrong.", folder
        )
    pinhole = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return PosedView(pinhole, np.asarray(pose, np.float64), 0.0, math.inf)


def _depth_range(view: PosedView, box: NDArray[np.float64]) -> tuple[float, float]:
    """Return the depths between which the corners of a box lie; of the whole way where it is behind."""
    corners = np.array(list(itertools.product(*box.T)))
    depth = (corners - view.centre) @ view.world_from_camera[:3, 2]
    far = float(depth.max())
    if far <= 0:
        far = float(np.linalg.norm(corners - view.centre, axis=1).max())
    return max(float(depth.min()), _NEAREST * far), far
