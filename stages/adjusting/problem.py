"""Bundle adjustment problem: residuals, priors and their derivatives.

Residuals are in standard deviations: pixel and depth of each observation, point-to-plane distance between
surfaces of two views, and deviation of poses and colour camera from the given ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import (
    CAMERA_PARAMETER_COUNT,
    POSE_PARAMETER_COUNT,
    Cameras,
    compute_camera_jacobian,
    compute_cross_matrices,
    decompose_motions,
    invert_poses,
    transform_points,
)
from scanloom.stages.adjusting.color_camera_prior import (
    SilhouettePrior,
    compute_prior_jacobian,
    compute_prior_residuals,
)
from scanloom.stages.adjusting.lens import compute_projection_derivatives
from scanloom.stages.adjusting.rolling_shutter import (
    compute_readout_motions,
    transform_to_middle_row,
    transform_to_readout,
)
from scanloom.stages.adjusting.surface_points import SurfacePoints
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.unprojection import compute_depth_basis, measure_planes
from scanloom.stages.adjusting.view import AdjustmentView, correct_views
from scanloom.stages.scans.model.prefetch import run_concurrently

# Standard deviation of a keypoint, pixels, and Huber thresholds of pixel and depth residuals, in standard
# deviations.
_KEYPOINT_SIGMA_PX, _HUBER_PIXEL, _HUBER_DEPTH = 1.0, 2.0, 2.0
# Standard deviation of depth: a constant in metres, and a factor per squared metre (3 mm at 0.5 m, 6 mm at 2
# m). Beyond `_MAX_DEPTH_SIGMAS` standard deviations the depth belongs to another surface.
_DEPTH_SIGMA_M, _DEPTH_SIGMA_PER_M2 = 0.0028, 0.0008
_MAX_DEPTH_SIGMAS = 12.0
# Factor on the standard deviation of surface points, because their depth errors are correlated.
_SURFACE_SIGMA_FACTOR = 1.5
# Standard deviation of the rotation during readout, radians. At 60°/s a camera rotates by 2° in 1/30 s.
_SHUTTER_SIGMA_RAD = float(np.radians(1.5))
# Standard deviation of its mean over all views, radians. Cameras rotate to and fro; a rotation common to all
# images is a lens error.
_MEAN_SHUTTER_SIGMA_RAD = float(np.radians(0.05))
# Standard deviations of the given colour camera: focal length (relative), principal point (relative to the
# image width), k1, translation (metres), rotation (radians).
_CAMERA_SIGMAS = np.array([0.05, 0.005, 0.005, 0.05, *[0.015] * 3, *[np.radians(0.5)] * 3])


@dataclass(frozen=True, eq=False)
class AdjustmentState:
    """Values of all unknowns.

    Attributes
    ----------
    cameras : cameras of all views.
    points : (p, 3) metres, world.
    camera_change : (10,) accumulated change of the colour cameras, see `CAMERA_PARAMETER_COUNT`.
    depth_coefficients : (d,) coefficients of the depth correction; empty if it is not fitted.
    """

    cameras: Cameras
    points: NDArray[np.float64]
    camera_change: NDArray[np.float64]
    depth_coefficients: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def apply_step(
        self,
        pose_steps: NDArray[np.float64],
        shared_step: NDArray[np.float64],
        point_steps: NDArray[np.float64],
    ) -> AdjustmentState:
        """Return the state after a step of the unknowns.

        Parameters
        ----------
        pose_steps : (m, 6) or (m, 9), see `Cameras.apply_step`.
        shared_step : (10 + d,) step of the colour camera and of the depth coefficients.
        point_steps : (p, 3) metres, world.
        """
        camera_step = shared_step[:CAMERA_PARAMETER_COUNT]
        return AdjustmentState(
            self.cameras.apply_step(pose_steps, camera_step),
            self.points + point_steps,
            self.camera_change + camera_step,
            self.depth_coefficients + shared_step[CAMERA_PARAMETER_COUNT:],
        )


@dataclass(frozen=True, eq=False)
class TangentPlanes:
    """Tangent planes that views measure at n points, see `measure_planes`.

    Attributes
    ----------
    normals : (n, 3).
    depths, sigmas_m : (n,) metres; a depth of 0 disables the plane.
    by_depth : (n, d) derivatives of `depths` by the coefficients of the depth correction, metres.
    coefficients : (d,) coefficients that `depths` are corrected with.
    """

    normals: NDArray[np.float64]
    depths: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]
    by_depth: NDArray[np.float64]
    coefficients: NDArray[np.float64]

    @classmethod
    def create_disabled(cls, count: int) -> TangentPlanes:
        """Create planes that are all disabled."""
        return cls(np.zeros((count, 3)), np.zeros(count), np.ones(count), np.zeros((count, 0)), np.zeros(0))

    @classmethod
    def from_views(
        cls,
        views: Sequence[AdjustmentView],
        view_indices: NDArray[np.intp],
        points: NDArray[np.float64],
        sigma_factor: float,
        coefficients: NDArray[np.float64],
    ) -> TangentPlanes:
        """Measure the planes at points, and disable planes of other surfaces.

        Parameters
        ----------
        view_indices : (n,) index of the view of each point.
        points : (n, 3) metres, depth-camera axes of that view.
        sigma_factor : factor on the standard deviation of depth.
        coefficients : (d,) coefficients of the depth correction of the views; empty if it is not fitted.
        """
        normals, depths, slopes = measure_planes(views, view_indices, points)
        deviations = sigma_factor * np.hypot(compute_depth_sigma(depths), slopes)
        off = np.abs((normals * points).sum(axis=1) - depths) > _MAX_DEPTH_SIGMAS * deviations
        by_depth = np.zeros((len(points), 0))
        if len(coefficients):
            by_depth = compute_depth_basis(views, view_indices, points) * depths[:, None]
        return cls(normals, np.where(off, 0, depths), deviations, by_depth, coefficients)

    def compute_residuals(
        self, points: NDArray[np.float64], coefficients: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Compute the distance (n,) of points (n, 3) behind their planes, for depth coefficients (d,).

        In standard deviations; 0 for disabled planes.
        """
        far = (self.normals * points).sum(axis=1) - self.depths
        if len(coefficients):
            far -= self.by_depth @ (coefficients - self.coefficients)
        return np.asarray(np.where(self.depths > 0, far, 0) / self.sigmas_m)

    def compute_derivatives(
        self, residuals: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute derivatives and weights of the plane residuals.

        Parameters
        ----------
        residuals : (n,) residuals, see `compute_residuals`.

        Returns
        -------
        Derivatives by the points (n, 3), and square roots of the Huber weights (n,).
        """
        weights = np.where(self.depths > 0, _compute_huber_weight(np.abs(residuals), _HUBER_DEPTH), 0)
        return self.normals / self.sigmas_m[:, None], np.sqrt(weights)


class FreeParameters(NamedTuple):
    """Optional unknowns: the colour camera, rotations during readout (rolling shutter), depth correction."""

    camera: bool = False
    shutter: bool = False
    depth: bool = False


@dataclass(frozen=True, eq=False)
class AdjustmentProblem:
    """Bundle adjustment problem.

    Attributes
    ----------
    tracks : observations of points.
    planes : tangent planes at the observations.
    surfaces : surface points of frame pairs.
    surface_planes : tangent planes of the other views at these surface points.
    given_poses : (m, 4, 4) given poses, world_from_camera; the centre of the pose prior.
    pose_prior : (6,) standard deviations of the given poses, metres and radians.
    free : optional unknowns.
    width : image width, pixels.
    silhouette_prior : prior on the colour camera from silhouettes; None without.
    depth_precision : (d, d) inverse covariance of the prior on the depth coefficients; empty if they are not
        fitted.
    """

    tracks: Tracks
    planes: TangentPlanes
    surfaces: SurfacePoints
    surface_planes: TangentPlanes
    given_poses: NDArray[np.float64]
    pose_prior: NDArray[np.float64]
    free: FreeParameters
    width: int
    silhouette_prior: SilhouettePrior | None
    depth_precision: NDArray[np.float64]

    @classmethod
    def from_tracks(
        cls,
        tracks: Tracks,
        given_poses: NDArray[np.float64],
        pose_prior: NDArray[np.float64],
        *,
        surfaces: SurfacePoints | None = None,
        free: FreeParameters | None = None,
        width: int = 1,
        silhouette_prior: SilhouettePrior | None = None,
        depth_precision: NDArray[np.float64] | None = None,
    ) -> AdjustmentProblem:
        """Create a problem with all planes disabled; `update_planes` measures the planes."""
        surfaces = SurfacePoints.create_empty() if surfaces is None else surfaces
        planes, meetings = (
            TangentPlanes.create_disabled(len(tracks.view_indices)),
            TangentPlanes.create_disabled(len(surfaces.pair_of_point)),
        )
        return cls(
            tracks,
            planes,
            surfaces,
            meetings,
            given_poses,
            pose_prior,
            free or FreeParameters(),
            width,
            silhouette_prior,
            np.zeros((0, 0)) if depth_precision is None else depth_precision,
        )

    def update_planes(self, views: Sequence[AdjustmentView], state: AdjustmentState) -> AdjustmentProblem:
        """Return the problem with planes measured at the current state."""
        coefficients = state.depth_coefficients
        if len(coefficients):
            views = correct_views(views, coefficients)
        other = self.surfaces.pair_indices[self.surfaces.pair_of_point, 1]
        meetings, planes = run_concurrently(
            lambda: TangentPlanes.from_views(
                views,
                other,
                self.transform_surface_points(state).other_readout,
                _SURFACE_SIGMA_FACTOR,
                coefficients,
            ),
            lambda: TangentPlanes.from_views(
                views, self.tracks.view_indices, _to_depth_camera(state, self.tracks), 1.0, coefficients
            ),
        )
        return replace(self, planes=planes, surface_planes=meetings)

    def transform_surface_points(self, state: AdjustmentState) -> TransformedSurfacePoints:
        """Transform the surface points to the other view of their frame pair."""
        surfaces, poses, turns = self.surfaces, state.cameras.poses, state.cameras.readout_rotations
        first, other = surfaces.pair_indices.T
        moves = (invert_poses(poses[other]) @ poses[first])[surfaces.pair_of_point]
        here = transform_to_middle_row(
            surfaces.correct_points(state.depth_coefficients),
            turns[first][surfaces.pair_of_point],
            surfaces.readout_times,
        )
        middle = transform_points(moves, here)
        which = other[surfaces.pair_of_point]
        late = surfaces.compute_readout_times(which, middle)
        back = compute_readout_motions(turns[which], -late)[:, :3, :3]
        return TransformedSurfacePoints(
            here, middle, transform_to_readout(middle, turns[which], late), late, moves[:, :3, :3], back
        )

    def compute_cost(self, state: AdjustmentState) -> float:
        """Compute half the robust (Huber) sum of squared residuals."""
        meeting, (pixel, depth, poses, camera) = run_concurrently(
            lambda: self.compute_surface_residuals(state), lambda: self._compute_residuals(state)
        )
        return float(
            _compute_huber_loss(np.hypot(*pixel.T), _HUBER_PIXEL).sum()
            + _compute_huber_loss(np.abs(depth), _HUBER_DEPTH).sum()
            + _compute_huber_loss(np.abs(meeting), _HUBER_DEPTH).sum()
            + 0.5 * (poses**2).sum()
            + 0.5 * (camera**2).sum()
            + 0.5 * self._compute_depth_prior_cost(state)
            + 0.5 * (self._compute_prior_residuals(state) ** 2).sum()
            + 0.5 * self.shutter_coupling * (state.cameras.readout_rotations.sum(axis=0) ** 2).sum()
        )

    def compute_surface_residuals(self, state: AdjustmentState) -> NDArray[np.float64]:
        """Compute the distances (k,) of the surface points behind the surface of the other view.

        In standard deviations; 0 without a surface there.
        """
        points = self.transform_surface_points(state).other_readout
        return self.surface_planes.compute_residuals(points, state.depth_coefficients)

    def _compute_depth_prior_cost(self, state: AdjustmentState) -> float:
        if not self.free.depth:
            return 0.0
        return float(state.depth_coefficients @ self.depth_precision @ state.depth_coefficients)

    def _compute_prior_residuals(self, state: AdjustmentState) -> NDArray[np.float64]:
        return (
            np.zeros(4)
            if self.silhouette_prior is None
            else compute_prior_residuals(self.silhouette_prior, state.cameras)
        )

    @property
    def shutter_coupling(self) -> float:
        """Return the coupling of the readout rotations of two views.

        This second derivative of the cost comes from the prior that holds their mean rotation to 0.
        """
        together = self.free.shutter and len(self.given_poses) > 1
        return (_MEAN_SHUTTER_SIGMA_RAD * len(self.given_poses)) ** -2 if together else 0.0

    def compute_reprojection_errors(self, state: AdjustmentState) -> NDArray[np.float64]:
        """Compute the reprojection errors (n,) of the observations, pixels."""
        return np.asarray(_KEYPOINT_SIGMA_PX * np.hypot(*self._compute_residuals(state)[0].T))

    def _compute_residuals(self, state: AdjustmentState) -> tuple[NDArray[np.float64], ...]:
        tracks, cameras = self.tracks, state.cameras
        seen = _to_depth_camera(state, tracks)
        shown = _to_color_camera(cameras, tracks, seen)
        ahead = shown[:, 2] > 1e-3
        shown = np.where(ahead[:, None], shown, (0, 0, 1))
        pixels, _, _ = compute_projection_derivatives(shown, cameras.lenses[tracks.view_indices])
        pixel = np.where(ahead[:, None], (pixels - tracks.pixels) / _KEYPOINT_SIGMA_PX, 1e3)
        depth = self.planes.compute_residuals(seen, state.depth_coefficients)
        moved = decompose_motions(invert_poses(self.given_poses) @ cameras.poses)
        if self.free.shutter:
            moved = np.concatenate([moved, cameras.readout_rotations], axis=1)
        return pixel, depth, moved / self.pose_sigmas, state.camera_change / self.camera_sigmas

    @property
    def pose_sigmas(self) -> NDArray[np.float64]:
        """Return the standard deviations of the pose prior, (6,) or (9,).

        Metres and radians; with rolling shutter also the rotation during readout.
        """
        return (
            np.concatenate([self.pose_prior, [_SHUTTER_SIGMA_RAD] * 3])
            if self.free.shutter
            else self.pose_prior
        )

    @property
    def camera_sigmas(self) -> NDArray[np.float64]:
        """Return the standard deviations (10,) of the given colour camera, see `CAMERA_PARAMETER_COUNT`."""
        return np.asarray(_CAMERA_SIGMAS * np.array([1, self.width, self.width, *[1] * 7]))

    def linearise(self, state: AdjustmentState) -> LinearisedProblem:
        """Linearise the residuals at a state, weighted for the Huber loss."""
        surface_residuals, make_problem = run_concurrently(
            lambda: self._linearise_surfaces(state), lambda: self._linearise_observations(state)
        )
        return make_problem(surface_residuals)

    def _linearise_observations(self, state: AdjustmentState) -> partial[LinearisedProblem]:
        """Linearise all but the surface residuals, which the returned function takes."""
        tracks, cameras = self.tracks, state.cameras
        pixel, depth, moved, camera = self._compute_residuals(state)
        seen = _to_depth_camera(state, tracks)
        shown = _to_color_camera(cameras, tracks, seen)
        shown[:, 2] = np.maximum(shown[:, 2], 1e-3)
        _, by_point, by_lens = compute_projection_derivatives(shown, cameras.lenses[tracks.view_indices])
        apart = cameras.color_from_depth[tracks.view_indices, :3, :3]
        count = len(seen)
        # Rows: two of the pixel, one of the depth. Signs are negative because points move against the camera.
        by_seen = np.empty((count, 3, 3))
        by_seen[:, :2] = by_point @ apart / _KEYPOINT_SIGMA_PX
        root = np.empty((count, 3))
        root[:, :2] = np.sqrt(_compute_huber_weight(np.hypot(*pixel.T), _HUBER_PIXEL))[:, None]
        by_seen[:, 2], root[:, 2] = self.planes.compute_derivatives(depth)
        by_seen *= root[:, :, None]
        late, turns = tracks.readout_times, cameras.readout_rotations[tracks.view_indices]
        by_turn = late[:, None, None] * (by_seen @ compute_cross_matrices(seen))
        by_seen = by_seen @ compute_readout_motions(turns, -late)[:, :3, :3]
        middle = transform_to_middle_row(seen, turns, late)
        by_pose = [
            -by_seen,
            by_seen @ compute_cross_matrices(middle),
            *([by_turn] if self.free.shutter else []),
        ]
        back = cameras.poses[tracks.view_indices, :3, :3].swapaxes(1, 2)
        depth_count = len(state.depth_coefficients)
        by_step = np.zeros((count, 3, CAMERA_PARAMETER_COUNT + depth_count))
        anchored = np.zeros((4, CAMERA_PARAMETER_COUNT))
        if self.free.camera:
            by_step[:, :2, :CAMERA_PARAMETER_COUNT] = (
                compute_camera_jacobian(shown, by_point, by_lens) / _KEYPOINT_SIGMA_PX
            )
            by_step *= root[:, :, None]
            anchored = (
                anchored
                if self.silhouette_prior is None
                else compute_prior_jacobian(self.silhouette_prior, cameras)
            )
        camera_gradient = camera / self.camera_sigmas + anchored.T @ self._compute_prior_residuals(state)
        camera_weights = np.diag(1 / self.camera_sigmas**2) + anchored.T @ anchored
        if self.free.depth:
            scale = root[:, 2] / self.planes.sigmas_m
            by_step[:, 2, CAMERA_PARAMETER_COUNT:] = -self.planes.by_depth * scale[:, None]
            depth_gradient = self.depth_precision @ state.depth_coefficients
            camera_gradient = np.concatenate([camera_gradient, depth_gradient])
            camera_weights = _join_diagonal(camera_weights, self.depth_precision)
        return partial(
            LinearisedProblem,
            residuals=np.concatenate([pixel, depth[:, None]], axis=1) * root,
            by_pose=np.concatenate(by_pose, axis=2),
            by_camera=by_step,
            by_point=by_seen @ back,
            pose_gradient=moved / self.pose_sigmas + self._compute_mean_rotation_gradient(state),
            pose_weights=1 / self.pose_sigmas**2,
            camera_gradient=camera_gradient,
            camera_weights=camera_weights,
        )

    def _compute_mean_rotation_gradient(self, state: AdjustmentState) -> NDArray[np.float64]:
        """Compute the gradient (6,) or (9,) of the prior on the mean readout rotation.

        The gradient is the same for each view.
        """
        gradient = np.zeros(len(self.pose_sigmas))
        if self.free.shutter:
            gradient[POSE_PARAMETER_COUNT:] = self.shutter_coupling * state.cameras.readout_rotations.sum(
                axis=0
            )
        return gradient

    def _linearise_surfaces(self, state: AdjustmentState) -> SurfaceResiduals:
        across = self.transform_surface_points(state)
        planes, coefficients = self.surface_planes, state.depth_coefficients
        behind = planes.compute_residuals(across.other_readout, coefficients)
        rows, root = planes.compute_derivatives(behind)
        by_middle = np.einsum("ki,kij->kj", rows * root[:, None], across.readout_rotations)
        by_here = np.einsum("ki,kij->kj", by_middle, across.rotations)
        # n · (w × p) = w · (p × n)
        first = [by_here, np.cross(across.first_middle, by_here)]
        other = [by_middle, np.cross(across.other_middle, by_middle)]
        if self.free.shutter:
            first.append(self.surfaces.readout_times[:, None] * np.cross(across.first_middle, by_here))
            other.append(across.readout_times[:, None] * np.cross(across.other_middle, by_middle))
        return SurfaceResiduals(
            residuals=behind * root,
            by_first=np.concatenate(first, axis=1),
            by_other=-np.concatenate(other, axis=1),
            by_depth=self._differentiate_surfaces_by_depth(state, by_here, root),
        )

    def _differentiate_surfaces_by_depth(
        self, state: AdjustmentState, by_here: NDArray[np.float64], root: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Differentiate the surface residuals by the depth coefficients.

        Parameters
        ----------
        by_here : (k, 3) derivatives by the points in the axes of the first view.
        root : (k,) square roots of the Huber weights.

        Returns
        -------
        (k, d), weighted.
        """
        if not self.free.depth:
            return np.zeros((len(root), 0))
        surfaces, planes = self.surfaces, self.surface_planes
        turns = state.cameras.readout_rotations[surfaces.pair_indices[:, 0]][surfaces.pair_of_point]
        along = transform_to_middle_row(surfaces.points, turns, surfaces.readout_times)
        first = (by_here * along).sum(axis=1)[:, None] * surfaces.basis
        return np.asarray(first - planes.by_depth * (root / planes.sigmas_m)[:, None])


class TransformedSurfacePoints(NamedTuple):
    """k surface points in the axes of both views of their frame pair.

    Attributes
    ----------
    first_middle, other_middle : (k, 3) metres, axes of the first and of the other view at their middle rows.
    other_readout : (k, 3) metres, axes of the other view at the readout time of its row.
    readout_times : (k,) that readout time, see stages/adjusting/rolling_shutter.py.
    rotations, readout_rotations : (k, 3, 3) rotations from `first_middle` to `other_middle`, and from
        `other_middle` to `other_readout`.
    """

    first_middle: NDArray[np.float64]
    other_middle: NDArray[np.float64]
    other_readout: NDArray[np.float64]
    readout_times: NDArray[np.float64]
    rotations: NDArray[np.float64]
    readout_rotations: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfaceResiduals:
    """Point-to-plane residuals of k surface points, with derivatives.

    Attributes
    ----------
    residuals : (k,) weighted, in standard deviations.
    by_first, by_other : (k, 6) or (k, 9) derivatives by the pose of the first and of the other view.
    by_depth : (k, d) derivatives by the depth coefficients.
    """

    residuals: NDArray[np.float64]
    by_first: NDArray[np.float64]
    by_other: NDArray[np.float64]
    by_depth: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearisedProblem:
    """Linearised problem with n observations.

    Attributes
    ----------
    surface_residuals : linearised point-to-plane residuals.
    residuals : (n, 3) pixel x, pixel y and depth, weighted, in standard deviations.
    by_pose, by_camera, by_point : Jacobians (n, 3, 6) or (n, 3, 9), (n, 3, 10 + d) and (n, 3, 3). Unknowns of
        the colour camera are followed by the d depth coefficients.
    pose_gradient, camera_gradient : gradients of the priors on poses, (m, 6) or (m, 9), and on the colour
        camera and depth, (10 + d,).
    pose_weights, camera_weights : second derivatives of the priors: diagonal (6,) or (9,), and
        (10 + d, 10 + d).
    """

    surface_residuals: SurfaceResiduals
    residuals: NDArray[np.float64]
    by_pose: NDArray[np.float64]
    by_camera: NDArray[np.float64]
    by_point: NDArray[np.float64]
    pose_gradient: NDArray[np.float64]
    pose_weights: NDArray[np.float64]
    camera_gradient: NDArray[np.float64]
    camera_weights: NDArray[np.float64]


def compute_depth_sigma(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the standard deviation of measured depth, metres.

    It grows with the square of the depth.
    """
    return np.asarray(_DEPTH_SIGMA_M + _DEPTH_SIGMA_PER_M2 * depth**2)


def _join_diagonal(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Join two square matrices to a block-diagonal matrix."""
    size = len(first)
    joined = np.zeros((size + len(second),) * 2)
    joined[:size, :size], joined[size:, size:] = first, second
    return joined


def _to_depth_camera(state: AdjustmentState, tracks: Tracks) -> NDArray[np.float64]:
    """Transform the points of all observations to depth-camera axes.

    Axes are at the readout time of the observed row.
    """
    middle = transform_points(
        invert_poses(state.cameras.poses)[tracks.view_indices], state.points[tracks.point_indices]
    )
    return transform_to_readout(
        middle, state.cameras.readout_rotations[tracks.view_indices], tracks.readout_times
    )


def _to_color_camera(cameras: Cameras, tracks: Tracks, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform the points of all observations from depth-camera to colour-camera axes."""
    return transform_points(cameras.color_from_depth[tracks.view_indices], points)


def _compute_huber_loss(size: NDArray[np.float64], threshold: float) -> NDArray[np.float64]:
    return np.asarray(np.where(size <= threshold, 0.5 * size**2, threshold * (size - 0.5 * threshold)))


def _compute_huber_weight(size: NDArray[np.float64], threshold: float) -> NDArray[np.float64]:
    return np.asarray(threshold / np.maximum(size, threshold))
