"""Bundle adjustment stated: what points, poses and the colour camera are held to, and how that changes.

Residuals are in standard deviations: where a view sees a point, how deep it measures it, and how far poses
and camera are from what was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import FREE, Cameras, carried, inverted_all, skew, steps_of
from stages.adjusting.lens import derivatives
from stages.adjusting.lifting import planes_at
from stages.adjusting.tracks import Tracks
from stages.adjusting.view import View

# Pixels that a keypoint is off, and residuals from which they count by their size, not its square (Huber).
_PIXEL, _HUBER, _HUBER_DEPTH = 1.0, 2.0, 2.0
# Depth is off by 3 mm at 0.5 m and 6 mm at 2 m; farther than so many deviations it is of something else.
_DEPTH_M, _DEPTH_PER_M = 0.0028, 0.0008
_OTHER_THING = 12.0
# What the given colour camera may be off: a share of the focal length, of the width, k1, metres, radians.
_CAMERA_PRIOR = np.array([0.05, 0.005, 0.005, 0.05, *[0.015] * 3, *[np.radians(0.5)] * 3])


@dataclass(frozen=True, eq=False)
class State:
    """What is looked for.

    Attributes
    ----------
    cameras : of all views.
    points : (p, 3) metres, in the world.
    camera : (10,) what the colour cameras were moved by so far, in all.
    """

    cameras: Cameras
    points: NDArray[np.float64]
    camera: NDArray[np.float64]

    def moved(
        self, poses: NDArray[np.float64], camera: NDArray[np.float64], points: NDArray[np.float64]
    ) -> State:
        """Return it after steps of (m, 6), (10,) and (p, 3)."""
        return State(self.cameras.moved(poses, camera), self.points + points, self.camera + camera)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is measured, and what was given.

    Attributes
    ----------
    tracks : where views see points.
    normals, depths, deviations : (n, 3), (n,) and (n,) metres, of the plane that the view measures where it
        sees the point, see `planes_at`; a depth of 0 where the point is not held to it.
    given : the poses as they were, (m, 4, 4) world_from_camera.
    pose_prior : (6,) standard deviations of these, metres and radians.
    frees_camera : the colour camera is looked for, too.
    width : of the images, pixels.
    """

    tracks: Tracks
    normals: NDArray[np.float64]
    depths: NDArray[np.float64]
    deviations: NDArray[np.float64]
    given: NDArray[np.float64]
    pose_prior: NDArray[np.float64]
    frees_camera: bool
    width: int

    def looked_up(self, views: Sequence[View], state: State) -> Problem:
        """Return it with the depth that views measure where they now see the points."""
        seen = _seen(state, self.tracks)
        normals, depths, slopes = planes_at(views, self.tracks.view, seen)
        deviations = np.hypot(deviation(depths), slopes)
        off = np.abs((normals * seen).sum(axis=1) - depths) > _OTHER_THING * deviations
        return replace(self, normals=normals, depths=np.where(off, 0, depths), deviations=deviations)

    def cost(self, state: State) -> float:
        """Return half the robust sum of squares."""
        pixel, depth, poses, camera = self._residuals(state)
        return float(
            _huber(np.hypot(*pixel.T), _HUBER).sum()
            + _huber(np.abs(depth), _HUBER_DEPTH).sum()
            + 0.5 * (poses**2).sum()
            + 0.5 * (camera**2).sum()
        )

    def pixels_off(self, state: State) -> NDArray[np.float64]:
        """Return how far each observation is off, (n,) pixels."""
        return np.asarray(_PIXEL * np.hypot(*self._residuals(state)[0].T))

    def _residuals(self, state: State) -> tuple[NDArray[np.float64], ...]:
        tracks, cameras = self.tracks, state.cameras
        seen = _seen(state, tracks)
        shown = _shown(cameras, tracks, seen)
        ahead = shown[:, 2] > 1e-3
        shown = np.where(ahead[:, None], shown, (0, 0, 1))
        pixels, _, _ = derivatives(shown, cameras.lenses[tracks.view])
        pixel = np.where(ahead[:, None], (pixels - tracks.pixels) / _PIXEL, 1e3)
        behind = (self.normals * seen).sum(axis=1) - self.depths
        depth = np.where(self.depths > 0, behind, 0) / self.deviations
        moved = steps_of(inverted_all(self.given) @ cameras.poses) / self.pose_prior
        return pixel, depth, moved, state.camera / self.camera_prior

    @property
    def camera_prior(self) -> NDArray[np.float64]:
        """Return the (10,) standard deviations of the given colour camera."""
        return np.asarray(_CAMERA_PRIOR * np.array([1, self.width, self.width, *[1] * 7]))

    def linear(self, state: State) -> Linear:
        """Return the residuals and how they change with a small step, weighed as Huber's loss asks."""
        tracks, cameras = self.tracks, state.cameras
        pixel, depth, moved, camera = self._residuals(state)
        seen = _seen(state, tracks)
        shown = _shown(cameras, tracks, seen)
        shown[:, 2] = np.maximum(shown[:, 2], 1e-3)
        _, by_point, by_lens = derivatives(shown, cameras.lenses[tracks.view])
        turned = cameras.color_from_depth[tracks.view, :3, :3]
        count = len(seen)
        # Rows: two of the pixel, one of the depth. A step of the pose moves the point the other way.
        by_seen = np.empty((count, 3, 3))
        by_seen[:, :2] = by_point @ turned / _PIXEL
        by_seen[:, 2] = self.normals / self.deviations[:, None]
        weights = np.empty((count, 3))
        weights[:, :2] = _weight(np.hypot(*pixel.T), _HUBER)[:, None]
        weights[:, 2] = np.where(self.depths > 0, _weight(np.abs(depth), _HUBER_DEPTH), 0)
        root = np.sqrt(weights)
        by_seen *= root[:, :, None]
        by_pose = np.concatenate([-by_seen, by_seen @ skew(seen)], axis=2)
        back = cameras.poses[tracks.view, :3, :3].swapaxes(1, 2)
        by_camera = np.zeros((count, 3, FREE))
        if self.frees_camera:
            by_camera[:, :2, :4] = by_lens / _PIXEL
            by_camera[:, :2, 4:7] = by_point / _PIXEL
            by_camera[:, :2, 7:] = -by_point @ skew(shown) / _PIXEL
            by_camera *= root[:, :, None]
        return Linear(
            residuals=np.concatenate([pixel, depth[:, None]], axis=1) * root,
            by_pose=by_pose,
            by_camera=by_camera,
            by_point=by_seen @ back,
            poses=moved / self.pose_prior,
            pose_weights=1 / self.pose_prior**2,
            camera=camera / self.camera_prior,
            camera_weights=1 / self.camera_prior**2,
        )


@dataclass(frozen=True, eq=False)
class Linear:
    """A linearised problem of n observations.

    Attributes
    ----------
    residuals : (n, 3).
    by_pose, by_camera, by_point : (n, 3, 6), (n, 3, 10) and (n, 3, 3), of the residuals.
    poses, camera : (m, 6) and (10,) gradients of what holds these to what was given.
    pose_weights, camera_weights : (6,) and (10,) second derivatives of it.
    """

    residuals: NDArray[np.float64]
    by_pose: NDArray[np.float64]
    by_camera: NDArray[np.float64]
    by_point: NDArray[np.float64]
    poses: NDArray[np.float64]
    pose_weights: NDArray[np.float64]
    camera: NDArray[np.float64]
    camera_weights: NDArray[np.float64]


def deviation(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation of measured depth, metres; it grows with its square."""
    return np.asarray(_DEPTH_M + _DEPTH_PER_M * depth**2)


def _seen(state: State, tracks: Tracks) -> NDArray[np.float64]:
    """Return the points of all observations in the axes of the depth cameras."""
    return carried(inverted_all(state.cameras.poses)[tracks.view], state.points[tracks.point])


def _shown(cameras: Cameras, tracks: Tracks, seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same in the axes of the colour cameras."""
    return carried(cameras.color_from_depth[tracks.view], seen)


def _huber(size: NDArray[np.float64], bend: float) -> NDArray[np.float64]:
    return np.asarray(np.where(size <= bend, 0.5 * size**2, bend * (size - 0.5 * bend)))


def _weight(size: NDArray[np.float64], bend: float) -> NDArray[np.float64]:
    return np.asarray(bend / np.maximum(size, bend))
