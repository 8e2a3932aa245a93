"""Bundle adjustment problem: residuals, priors and their derivatives.

Residuals are in standard deviations: pixel and depth of each observation, point-to-plane distance between
surfaces of two views, and deviation of poses and colour camera from the given ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.anchor import Anchor, anchor_rows, off_anchor
from scanloom.stages.adjusting.cameras import (
    FREE,
    STILL,
    Cameras,
    by_camera,
    carried,
    inverted_all,
    skew,
    steps_of,
)
from scanloom.stages.adjusting.lens import derivatives
from scanloom.stages.adjusting.lifting import planes_at
from scanloom.stages.adjusting.shutter import as_read, in_the_middle, turned
from scanloom.stages.adjusting.surfaces import Surfaces
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.view import View

# Standard deviation of a keypoint, pixels, and Huber thresholds of pixel and depth residuals, in standard
# deviations.
_PIXEL, _HUBER, _HUBER_DEPTH = 1.0, 2.0, 2.0
# Standard deviation of depth: a constant in metres, and a factor per squared metre (3 mm at 0.5 m, 6 mm at 2
# m). Beyond `_OTHER_THING` standard deviations the depth belongs to another surface.
_DEPTH_M, _DEPTH_PER_M = 0.0028, 0.0008
_OTHER_THING = 12.0
# Factor on the standard deviation of surface points, because their depth errors are correlated.
_MEETING = 1.5
# Standard deviation of the rotation during readout, radians. At 60°/s a camera rotates by 2° in 1/30 s.
_TURN_PRIOR = float(np.radians(1.5))
# Standard deviation of its mean over all views, radians. Cameras rotate to and fro; a rotation common to all
# images is a lens error.
_MEAN_TURN_PRIOR = float(np.radians(0.05))
# Standard deviations of the given colour camera: focal length (relative), principal point (relative to the
# image width), k1, translation (metres), rotation (radians).
_CAMERA_PRIOR = np.array([0.05, 0.005, 0.005, 0.05, *[0.015] * 3, *[np.radians(0.5)] * 3])


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns.

    Attributes
    ----------
    cameras : cameras of all views.
    points : (p, 3) metres, world.
    camera : (10,) accumulated change of the colour cameras, see `FREE`.
    """

    cameras: Cameras
    points: NDArray[np.float64]
    camera: NDArray[np.float64]

    def moved(
        self, poses: NDArray[np.float64], camera: NDArray[np.float64], points: NDArray[np.float64]
    ) -> State:
        """Return the state after a step of the unknowns.

        Parameters
        ----------
        poses, camera : (m, 6) or (m, 9), and (10,), see `Cameras.moved`.
        points : (p, 3) metres, world.
        """
        return State(self.cameras.moved(poses, camera), self.points + points, self.camera + camera)


@dataclass(frozen=True, eq=False)
class Planes:
    """Tangent planes that views measure at n points, see `planes_at`.

    Attributes
    ----------
    normals : (n, 3).
    depths, deviations : (n,) metres; a depth of 0 disables the plane.
    """

    normals: NDArray[np.float64]
    depths: NDArray[np.float64]
    deviations: NDArray[np.float64]

    @classmethod
    def none(cls, count: int) -> Planes:
        """Create planes that are all disabled."""
        return cls(np.zeros((count, 3)), np.zeros(count), np.ones(count))

    @classmethod
    def met(
        cls, views: Sequence[View], view: NDArray[np.intp], points: NDArray[np.float64], share: float
    ) -> Planes:
        """Measure the planes at points, and disable planes of other surfaces.

        Parameters
        ----------
        view : (n,) index of the view of each point.
        points : (n, 3) metres, depth-camera axes of that view.
        share : factor on the standard deviation of depth.
        """
        normals, depths, slopes = planes_at(views, view, points)
        deviations = share * np.hypot(deviation(depths), slopes)
        off = np.abs((normals * points).sum(axis=1) - depths) > _OTHER_THING * deviations
        return cls(normals, np.where(off, 0, depths), deviations)

    def behind(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the distance (n,) of points (n, 3) behind their planes.

        In standard deviations; 0 for disabled planes.
        """
        far = (self.normals * points).sum(axis=1) - self.depths
        return np.asarray(np.where(self.depths > 0, far, 0) / self.deviations)

    def rows(self, behind: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute derivatives and weights of the plane residuals.

        Parameters
        ----------
        behind : (n,) residuals, see `behind`.

        Returns
        -------
        Derivatives by the points (n, 3), and square roots of the Huber weights (n,).
        """
        weights = np.where(self.depths > 0, _weight(np.abs(behind), _HUBER_DEPTH), 0)
        return self.normals / self.deviations[:, None], np.sqrt(weights)


class Frees(NamedTuple):
    """Optional unknowns: the colour camera, and rotations during readout (rolling shutter)."""

    camera: bool = False
    turns: bool = False


@dataclass(frozen=True, eq=False)
class Problem:
    """Bundle adjustment problem.

    Attributes
    ----------
    tracks : observations of points.
    planes : tangent planes at the observations.
    surfaces : surface points of frame pairs.
    meetings : tangent planes of the other views at these surface points.
    given : (m, 4, 4) given poses, world_from_camera; the centre of the pose prior.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    frees : optional unknowns.
    width : image width, pixels.
    anchor : prior on the colour camera from silhouettes; None without.
    """

    tracks: Tracks
    planes: Planes
    surfaces: Surfaces
    meetings: Planes
    given: NDArray[np.float64]
    pose_prior: NDArray[np.float64]
    frees: Frees
    width: int
    anchor: Anchor | None

    @classmethod
    def of(
        cls,
        tracks: Tracks,
        given: NDArray[np.float64],
        pose_prior: NDArray[np.float64],
        *,
        surfaces: Surfaces | None = None,
        frees: Frees | None = None,
        width: int = 1,
        anchor: Anchor | None = None,
    ) -> Problem:
        """Create a problem with all planes disabled; `looked_up` measures the planes."""
        surfaces = Surfaces.none() if surfaces is None else surfaces
        planes, meetings = Planes.none(len(tracks.view)), Planes.none(len(surfaces.couple))
        return cls(tracks, planes, surfaces, meetings, given, pose_prior, frees or Frees(), width, anchor)

    def looked_up(self, views: Sequence[View], state: State) -> Problem:
        """Return the problem with planes measured at the current state."""
        planes = Planes.met(views, self.tracks.view, _seen(state, self.tracks), 1.0)
        other = self.surfaces.couples[self.surfaces.couple, 1]
        meetings = Planes.met(views, other, self.across(state).there, _MEETING)
        return replace(self, planes=planes, meetings=meetings)

    def across(self, state: State) -> Across:
        """Transform the surface points to the other view of their frame pair."""
        surfaces, poses, turns = self.surfaces, state.cameras.poses, state.cameras.turns
        first, other = surfaces.couples.T
        moves = (inverted_all(poses[other]) @ poses[first])[surfaces.couple]
        here = in_the_middle(surfaces.points, turns[first][surfaces.couple], surfaces.late)
        middle = carried(moves, here)
        which = other[surfaces.couple]
        late = surfaces.late_where(which, middle)
        back = turned(turns[which], -late)[:, :3, :3]
        return Across(here, middle, as_read(middle, turns[which], late), late, moves[:, :3, :3], back)

    def cost(self, state: State) -> float:
        """Compute half the robust (Huber) sum of squared residuals."""
        pixel, depth, poses, camera = self._residuals(state)
        meeting = self.meetings.behind(self.across(state).there)
        return float(
            _huber(np.hypot(*pixel.T), _HUBER).sum()
            + _huber(np.abs(depth), _HUBER_DEPTH).sum()
            + _huber(np.abs(meeting), _HUBER_DEPTH).sum()
            + 0.5 * (poses**2).sum()
            + 0.5 * (camera**2).sum()
            + 0.5 * (self._off_anchor(state) ** 2).sum()
            + 0.5 * self.turn_coupling * (state.cameras.turns.sum(axis=0) ** 2).sum()
        )

    def _off_anchor(self, state: State) -> NDArray[np.float64]:
        return np.zeros(4) if self.anchor is None else off_anchor(self.anchor, state.cameras)

    @property
    def turn_coupling(self) -> float:
        """Return the coupling of the readout rotations of two views.

        This second derivative of the cost comes from the prior that holds their mean rotation to 0.
        """
        together = self.frees.turns and len(self.given) > 1
        return (_MEAN_TURN_PRIOR * len(self.given)) ** -2 if together else 0.0

    def pixels_off(self, state: State) -> NDArray[np.float64]:
        """Compute the reprojection errors (n,) of the observations, pixels."""
        return np.asarray(_PIXEL * np.hypot(*self._residuals(state)[0].T))

    def _residuals(self, state: State) -> tuple[NDArray[np.float64], ...]:
        tracks, cameras = self.tracks, state.cameras
        seen = _seen(state, tracks)
        shown = _shown(cameras, tracks, seen)
        ahead = shown[:, 2] > 1e-3
        shown = np.where(ahead[:, None], shown, (0, 0, 1))
        pixels, _, _ = derivatives(shown, cameras.lenses[tracks.view])
        pixel = np.where(ahead[:, None], (pixels - tracks.pixels) / _PIXEL, 1e3)
        depth = self.planes.behind(seen)
        moved = steps_of(inverted_all(self.given) @ cameras.poses)
        if self.frees.turns:
            moved = np.concatenate([moved, cameras.turns], axis=1)
        return pixel, depth, moved / self.step_prior, state.camera / self.camera_prior

    @property
    def step_prior(self) -> NDArray[np.float64]:
        """Return the standard deviations of the pose prior, (6,) or (9,).

        Metres and radians; with rolling shutter also the rotation during readout.
        """
        return np.concatenate([self.pose_prior, [_TURN_PRIOR] * 3]) if self.frees.turns else self.pose_prior

    @property
    def camera_prior(self) -> NDArray[np.float64]:
        """Return the standard deviations (10,) of the given colour camera, see `FREE`."""
        return np.asarray(_CAMERA_PRIOR * np.array([1, self.width, self.width, *[1] * 7]))

    def linear(self, state: State) -> Linear:
        """Linearise the residuals at a state, weighted for the Huber loss."""
        tracks, cameras = self.tracks, state.cameras
        pixel, depth, moved, camera = self._residuals(state)
        seen = _seen(state, tracks)
        shown = _shown(cameras, tracks, seen)
        shown[:, 2] = np.maximum(shown[:, 2], 1e-3)
        _, by_point, by_lens = derivatives(shown, cameras.lenses[tracks.view])
        apart = cameras.color_from_depth[tracks.view, :3, :3]
        count = len(seen)
        # Rows: two of the pixel, one of the depth. Signs are negative because points move against the camera.
        by_seen = np.empty((count, 3, 3))
        by_seen[:, :2] = by_point @ apart / _PIXEL
        root = np.empty((count, 3))
        root[:, :2] = np.sqrt(_weight(np.hypot(*pixel.T), _HUBER))[:, None]
        by_seen[:, 2], root[:, 2] = self.planes.rows(depth)
        by_seen *= root[:, :, None]
        late, turns = tracks.late, cameras.turns[tracks.view]
        by_turn = late[:, None, None] * (by_seen @ skew(seen))
        by_seen = by_seen @ turned(turns, -late)[:, :3, :3]
        middle = in_the_middle(seen, turns, late)
        by_pose = [-by_seen, by_seen @ skew(middle), *([by_turn] if self.frees.turns else [])]
        back = cameras.poses[tracks.view, :3, :3].swapaxes(1, 2)
        by_step = np.zeros((count, 3, FREE))
        anchored = np.zeros((4, FREE))
        if self.frees.camera:
            by_step[:, :2] = by_camera(shown, by_point, by_lens) / _PIXEL
            by_step *= root[:, :, None]
            anchored = anchored if self.anchor is None else anchor_rows(self.anchor, cameras)
        return Linear(
            meetings=self._met(state),
            residuals=np.concatenate([pixel, depth[:, None]], axis=1) * root,
            by_pose=np.concatenate(by_pose, axis=2),
            by_camera=by_step,
            by_point=by_seen @ back,
            poses=moved / self.step_prior + self._towards_no_mean(state),
            pose_weights=1 / self.step_prior**2,
            camera=camera / self.camera_prior + anchored.T @ self._off_anchor(state),
            camera_weights=np.diag(1 / self.camera_prior**2) + anchored.T @ anchored,
        )

    def _towards_no_mean(self, state: State) -> NDArray[np.float64]:
        """Compute the gradient (6,) or (9,) of the prior on the mean readout rotation.

        The gradient is the same for each view.
        """
        gradient = np.zeros(len(self.step_prior))
        if self.frees.turns:
            gradient[STILL:] = self.turn_coupling * state.cameras.turns.sum(axis=0)
        return gradient

    def _met(self, state: State) -> Met:
        across = self.across(state)
        behind = self.meetings.behind(across.there)
        rows, root = self.meetings.rows(behind)
        by_middle = np.einsum("ki,kij->kj", rows * root[:, None], across.back)
        by_here = np.einsum("ki,kij->kj", by_middle, across.turns)
        # n · (w × p) = w · (p × n)
        first = [by_here, np.cross(across.here, by_here)]
        other = [by_middle, np.cross(across.middle, by_middle)]
        if self.frees.turns:
            first.append(self.surfaces.late[:, None] * np.cross(across.here, by_here))
            other.append(across.late[:, None] * np.cross(across.middle, by_middle))
        return Met(
            residuals=behind * root,
            by_first=np.concatenate(first, axis=1),
            by_other=-np.concatenate(other, axis=1),
        )


class Across(NamedTuple):
    """k surface points in the axes of both views of their frame pair.

    Attributes
    ----------
    here, middle : (k, 3) metres, axes of the first and of the other view at their middle rows.
    there : (k, 3) metres, axes of the other view at the readout time of its row.
    late : (k,) that readout time, see stages/adjusting/shutter.py.
    turns, back : (k, 3, 3) rotations from `here` to `middle`, and from `middle` to `there`.
    """

    here: NDArray[np.float64]
    middle: NDArray[np.float64]
    there: NDArray[np.float64]
    late: NDArray[np.float64]
    turns: NDArray[np.float64]
    back: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Met:
    """Point-to-plane residuals of k surface points, with derivatives.

    Attributes
    ----------
    residuals : (k,) weighted, in standard deviations.
    by_first, by_other : (k, 6) or (k, 9) derivatives by the pose of the first and of the other view.
    """

    residuals: NDArray[np.float64]
    by_first: NDArray[np.float64]
    by_other: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linear:
    """Linearised problem with n observations.

    Attributes
    ----------
    meetings : linearised point-to-plane residuals.
    residuals : (n, 3) pixel x, pixel y and depth, weighted, in standard deviations.
    by_pose, by_camera, by_point : Jacobians (n, 3, 6) or (n, 3, 9), (n, 3, 10) and (n, 3, 3).
    poses, camera : gradients of the priors on poses, (m, 6) or (m, 9), and on the colour camera, (10,).
    pose_weights, camera_weights : second derivatives of the priors: diagonal (6,) or (9,), and (10, 10).
    """

    meetings: Met
    residuals: NDArray[np.float64]
    by_pose: NDArray[np.float64]
    by_camera: NDArray[np.float64]
    by_point: NDArray[np.float64]
    poses: NDArray[np.float64]
    pose_weights: NDArray[np.float64]
    camera: NDArray[np.float64]
    camera_weights: NDArray[np.float64]


def deviation(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the standard deviation of measured depth, metres.

    It grows with the square of the depth.
    """
    return np.asarray(_DEPTH_M + _DEPTH_PER_M * depth**2)


def _seen(state: State, tracks: Tracks) -> NDArray[np.float64]:
    """Transform the points of all observations to depth-camera axes.

    Axes are at the readout time of the observed row.
    """
    middle = carried(inverted_all(state.cameras.poses)[tracks.view], state.points[tracks.point])
    return as_read(middle, state.cameras.turns[tracks.view], tracks.late)


def _shown(cameras: Cameras, tracks: Tracks, seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform the points of all observations from depth-camera to colour-camera axes."""
    return carried(cameras.color_from_depth[tracks.view], seen)


def _huber(size: NDArray[np.float64], bend: float) -> NDArray[np.float64]:
    return np.asarray(np.where(size <= bend, 0.5 * size**2, bend * (size - 0.5 * bend)))


def _weight(size: NDArray[np.float64], bend: float) -> NDArray[np.float64]:
    return np.asarray(bend / np.maximum(size, bend))
