"""Open3D's reconstruction system up to the poses: fragments, registration, refinement.

Follows Open3D's documentation ("Reconstruction system") with the defaults of its configuration. A fragment
has a hundred frames. Odometry runs between consecutive frames, and between all pairs of key frames for which
feature matches give an initial pose. A pose graph is optimised, and a surface is fused. Each fragment is
registered to the next one by coloured ICP and to all others by surface features (FPFH, RANSAC), in a second
pose graph. The edges that remain are refined by ICP at three resolutions, in a third pose graph.

As in the original, every odometry step is accepted. Only a fragment in which no frame overlaps the next is an
error. Differences from the original: points without depth do not count for initial poses, images are read
once, and all random numbers have a seed. The tensor volume is used for fusion, because the legacy volume of
Open3D 0.20.0 takes depth in metres for millimetres and stays empty.

References
----------
Choi, Zhou and Koltun, "Robust reconstruction of indoor scenes", 2015; Park, Zhou and Koltun, "Colored point
cloud registration revisited", 2017.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from open3d_images import make_legacy_camera, make_legacy_image, read_images

from scanloom.stages._open3d import import_open3d
from scanloom.stages.registration.surface_alignment import limit_threads
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

_FRAGMENT_FRAMES = 100
_KEY_FRAME_INTERVAL = 5
# Metres, Open3D's defaults: limits of odometry, voxel and truncation of fusion, voxel and maximum
# correspondence distance of registration.
_MAX_DEPTH, _MAX_DEPTH_DIFFERENCE = 3.0, 0.07
_FUSION_VOXEL, _FUSION_TRUNCATION = 3.0 / 512, 0.04
_VOXEL = 0.05
_MAX_CORRESPONDENCE_DISTANCE = 1.4 * _VOXEL
# Preference for loop closures in pose graph optimisation: within a fragment, and between fragments.
_ODOMETRY_LOOP_PREFERENCE, _REGISTRATION_LOOP_PREFERENCE = 0.1, 5.0
_PRUNE_THRESHOLD = 0.25
# Voxel size (m) and iterations of each ICP scale: for neighbouring fragments, and for refinement.
_INITIAL_ICP_SCALES = ((_VOXEL, 50),)
_REFINEMENT_ICP_SCALES = ((_VOXEL, 50), (_VOXEL / 2, 30), (_VOXEL / 4, 14))
# Minimum overlap of a loop closure between fragments, relative to the smaller one.
_MIN_OVERLAP = 0.3
_RANSAC_TRIES, _RANSAC_CONFIDENCE, _MIN_EDGE_RATIO = 1_000_000, 0.999, 0.9
# Feature matching: features per image, inlier thresholds in pixels (epipolar line) and metres (rigid motion).
_FEATURE_COUNT, _MAX_PIXELS, _MAX_METRES = 100, 1.0, 0.05
_MOTION_TRIES, _MOTION_POINTS = 1000, 5


@dataclass(frozen=True, eq=False)
class _Edge:
    """Pose graph edge with its motion (target_from_source).

    Edges between nodes that are not consecutive are loop closures.
    """

    source: int
    target: int
    motion: Pose
    information: NDArray[np.float64]

    @property
    def is_loop(self) -> bool:
        return self.target != self.source + 1


@dataclass(frozen=True, eq=False)
class _Fragment:
    """Poses of frames relative to the first, and their fused point cloud."""

    poses: list[Pose]
    cloud: Any


def run_reconstruction_system(
    frames: Sequence[Frame], *, fragment_frames: int = _FRAGMENT_FRAMES
) -> dict[int, Pose]:
    """Estimate world_from_camera of every frame, by index.

    The world is the camera of the first frame.

    Raises
    ------
    RuntimeError
        If no frame of a fragment overlaps the next, or Open3D fails.
    """
    # A single thread makes sums, and so poses, reproducible; the legacy odometry gains little from more
    # threads.
    with limit_threads():
        fragments = [
            _make_fragment(frames[start : start + fragment_frames])
            for start in range(0, len(frames), fragment_frames)
        ]
        scene = _estimate_fragment_poses(fragments)
    poses = [of @ pose for of, fragment in zip(scene, fragments, strict=True) for pose in fragment.poses]
    return dict(enumerate(poses))


# -- fragments -------------------------------------------------------------------------------------------


def _make_fragment(frames: Sequence[Frame]) -> _Fragment:
    images = [read_images(frame) for frame in frames]
    rgbd = [make_legacy_image(*one, _MAX_DEPTH) for one in images]
    camera = frames[0].camera
    keys = range(0, len(frames), _KEY_FRAME_INTERVAL)
    points = {key: _extract_features(rgbd[key], camera) for key in keys}
    edges = []
    for source, target in itertools.pairwise(range(len(frames))):
        _, motion, information = _run_odometry(rgbd[source], rgbd[target], camera, np.eye(4))
        edges.append(_Edge(source, target, motion, information))
    # Open3D reports success even if no pixel of one frame overlaps the other.
    if edges and not any(edge.information.any() for edge in edges):
        raise RuntimeError(f"no frame overlaps the next within {_MAX_DEPTH:g} m")
    for source, target in itertools.combinations(keys, 2):
        start = _estimate_feature_motion(points[source], points[target], camera)
        if start is not None:
            found, motion, information = _run_odometry(rgbd[source], rgbd[target], camera, start)
            if found:
                edges.append(_Edge(source, target, motion, information))
    poses, _ = _optimise_poses(edges, _MAX_DEPTH_DIFFERENCE, _ODOMETRY_LOOP_PREFERENCE)
    return _Fragment(poses, _fuse_surface(images, poses, camera))


def _run_odometry(
    source: Any, target: Any, camera: Camera, start: Pose
) -> tuple[bool, Pose, NDArray[np.float64]]:
    odometry = import_open3d().pipelines.odometry
    option = odometry.OdometryOption(depth_diff_max=_MAX_DEPTH_DIFFERENCE)
    hybrid = odometry.RGBDOdometryJacobianFromHybridTerm()
    return odometry.compute_rgbd_odometry(source, target, make_legacy_camera(camera), start, hybrid, option)


def _fuse_surface(images: Iterable[tuple[Any, Any]], poses: Iterable[Pose], camera: Camera) -> Any:
    o3d = import_open3d()
    f32, u16 = o3d.core.float32, o3d.core.uint16
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (f32, u16, u16), (1, 1, 3), _FUSION_VOXEL, 16, 4000
    )
    matrix = o3d.core.Tensor(camera.matrix)
    cut = 1.0, _MAX_DEPTH, _FUSION_TRUNCATION / _FUSION_VOXEL
    for (depth, color), pose in zip(images, poses, strict=True):
        if not ((depth > 0) & (depth < _MAX_DEPTH)).any():
            continue
        metres = o3d.t.geometry.Image(o3d.core.Tensor(depth))
        share = o3d.t.geometry.Image(o3d.core.Tensor(color / np.float32(255)))
        extrinsic = o3d.core.Tensor(invert_pose(pose))
        blocks = grid.compute_unique_block_coordinates(metres, matrix, extrinsic, *cut)
        grid.integrate(blocks, metres, share, matrix, extrinsic, *cut)
    return grid.extract_point_cloud(weight_threshold=0).to_legacy()


# -- initial poses of key frame pairs ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Features:
    """ORB features of an image.

    Attributes
    ----------
    pixels : (n, 2).
    descriptors : (n, 32).
    points : (n, 3), camera frame, metres; NaN without depth.
    """

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float64]


def _extract_features(rgbd: Any, camera: Camera) -> _Features:
    grey = np.uint8(np.clip(np.asarray(rgbd.color) * 255, 0, 255))
    found, descriptors = cv2.ORB_create(nfeatures=_FEATURE_COUNT).detectAndCompute(grey, None)
    pixels = np.array([point.pt for point in found], np.float32).reshape(-1, 2)
    if descriptors is None:
        descriptors = np.zeros((0, 32), np.uint8)
    return _Features(pixels, descriptors, _unproject_pixels(pixels, np.asarray(rgbd.depth), camera))


def _unproject_pixels(
    pixels: NDArray[np.float32], depth: NDArray[np.float32], camera: Camera
) -> NDArray[np.float64]:
    holes = np.where(depth > 0, depth, np.nan)
    x, y = pixels.astype(np.float64).T
    left = np.clip(np.floor(x).astype(int), 0, depth.shape[1] - 2)
    top = np.clip(np.floor(y).astype(int), 0, depth.shape[0] - 2)
    right, down = x - left, y - top
    z = (1 - down) * ((1 - right) * holes[top, left] + right * holes[top, left + 1])
    z += down * ((1 - right) * holes[top + 1, left] + right * holes[top + 1, left + 1])
    return np.stack([(x - camera.cx) / camera.fx * z, (y - camera.cy) / camera.fy * z, z], axis=1)


def _estimate_feature_motion(source: _Features, target: _Features, camera: Camera) -> Pose | None:
    """Estimate target_from_source from feature matches; None if too few agree."""
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(source.descriptors, target.descriptors)
    if len(matches) < _MOTION_POINTS:
        return None
    of_source = np.array([match.queryIdx for match in matches])
    of_target = np.array([match.trainIdx for match in matches])
    _, agrees = cv2.findEssentialMat(
        source.pixels[of_source],
        target.pixels[of_target],
        camera.matrix,
        method=cv2.RANSAC,
        prob=_RANSAC_CONFIDENCE,
        threshold=_MAX_PIXELS,
    )
    if agrees is None:
        return None
    a, b = source.points[of_source], target.points[of_target]
    good = agrees.ravel().astype(bool) & np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    return estimate_rigid_motion(a[good], b[good])


def estimate_rigid_motion(a: NDArray[np.float64], b: NDArray[np.float64]) -> Pose | None:
    """Estimate the rigid motion from `a` to `b` (n, 3) by RANSAC.

    Returns None if too few points are inliers.
    """
    if len(a) < _MOTION_POINTS:
        return None
    drawn = np.random.default_rng(0).integers(len(a), size=(_MOTION_TRIES, _MOTION_POINTS))
    centre_a, centre_b = (points[drawn].mean(axis=1, keepdims=True) for points in (a, b))
    u, _, vt = np.linalg.svd((a[drawn] - centre_a).swapaxes(1, 2) @ (b[drawn] - centre_b))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    turns = (u @ vt).swapaxes(1, 2)
    shifts = centre_b - centre_a @ turns.swapaxes(1, 2)
    off = np.linalg.norm(a @ turns.swapaxes(1, 2) + shifts - b, axis=2)
    agreeing = (off < _MAX_METRES).sum(axis=1)
    # Overlapping images are not rotated by more than 90° about any axis.
    agreeing[(turns[:, range(3), range(3)] <= 0).any(axis=1)] = 0
    best = int(agreeing.argmax())
    if agreeing[best] <= _MOTION_POINTS:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turns[best], shifts[best, 0]
    return pose


# -- the scene -------------------------------------------------------------------------------------------


def _estimate_fragment_poses(fragments: Sequence[_Fragment]) -> list[Pose]:
    """Estimate world_from_fragment poses, relative to the first fragment."""
    surfaces = [_compute_surface_features(fragment.cloud) for fragment in fragments]

    edges = list(_register_fragments(fragments, surfaces))
    _, kept = _optimise_poses(edges, _MAX_CORRESPONDENCE_DISTANCE, _REGISTRATION_LOOP_PREFERENCE)
    edges = [
        _Edge(
            edge.source,
            edge.target,
            *_refine_icp(
                fragments[edge.source].cloud,
                fragments[edge.target].cloud,
                edge.motion,
                _REFINEMENT_ICP_SCALES,
            ),
        )
        for edge in kept
    ]
    poses, _ = _optimise_poses(edges, _MAX_CORRESPONDENCE_DISTANCE, _REGISTRATION_LOOP_PREFERENCE)
    return poses


def _register_fragments(
    fragments: Sequence[_Fragment], surfaces: Sequence[tuple[Any, Any]]
) -> Iterator[_Edge]:
    for source, target in itertools.combinations(range(len(fragments)), 2):
        if target == source + 1:
            # The next fragment starts close to the last frame of this one.
            start = invert_pose(fragments[source].poses[-1])
            pair = surfaces[source][0], surfaces[target][0]
            yield _Edge(source, target, *_refine_icp(*pair, start, _INITIAL_ICP_SCALES))
        elif (found := _match_surfaces(surfaces[source], surfaces[target])) is not None:
            yield _Edge(source, target, *found)


def _compute_surface_features(cloud: Any) -> tuple[Any, Any]:
    """Downsample a cloud and compute its FPFH features."""
    o3d = import_open3d()
    thin = cloud.voxel_down_sample(_VOXEL)
    thin.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * _VOXEL, max_nn=30))
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * _VOXEL, max_nn=100)
    return thin, o3d.pipelines.registration.compute_fpfh_feature(thin, near)


def _match_surfaces(
    source: tuple[Any, Any], target: tuple[Any, Any]
) -> tuple[Pose, NDArray[np.float64]] | None:
    o3d = import_open3d()
    registration = o3d.pipelines.registration
    (a, features_a), (b, features_b) = source, target
    o3d.utility.random.seed(0)
    pose = registration.registration_ransac_based_on_feature_matching(
        a,
        b,
        features_a,
        features_b,
        True,
        _MAX_CORRESPONDENCE_DISTANCE,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(_MIN_EDGE_RATIO),
            registration.CorrespondenceCheckerBasedOnDistance(_MAX_CORRESPONDENCE_DISTANCE),
        ],
        registration.RANSACConvergenceCriteria(_RANSAC_TRIES, _RANSAC_CONFIDENCE),
    ).transformation
    # Open3D returns the identity if RANSAC finds no transformation.
    if np.array_equal(pose, np.eye(4)):
        return None
    information = registration.get_information_matrix_from_point_clouds(
        a, b, _MAX_CORRESPONDENCE_DISTANCE, pose
    )
    # Each correspondence adds an identity to the translation block, so its last entry counts correspondences.
    overlap = information[5, 5] / min(len(a.points), len(b.points))
    return (pose, information) if overlap >= _MIN_OVERLAP else None


def _refine_icp(
    source: Any, target: Any, start: Pose, scales: Sequence[tuple[float, int]]
) -> tuple[Pose, NDArray[np.float64]]:
    """Refine target_from_source by multi-scale coloured ICP; return it and its information."""
    o3d = import_open3d()
    registration = o3d.pipelines.registration
    pose = start
    for voxel, iterations in scales:
        pair = [cloud.voxel_down_sample(voxel) for cloud in (source, target)]
        for cloud in pair:
            cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
        pose = registration.registration_colored_icp(
            *pair,
            _MAX_CORRESPONDENCE_DISTANCE,
            pose,
            registration.TransformationEstimationForColoredICP(),
            registration.ICPConvergenceCriteria(1e-6, 1e-6, iterations),
        ).transformation
    return pose, registration.get_information_matrix_from_point_clouds(*pair, 1.4 * voxel, pose)


# -- pose graphs -----------------------------------------------------------------------------------------


def _optimise_poses(
    edges: Sequence[_Edge], max_distance: float, loop_preference: float
) -> tuple[list[Pose], list[_Edge]]:
    """Optimise a pose graph; return its poses and remaining edges.

    Initial poses follow from the chain of edges that are not loop closures.
    """
    registration = import_open3d().pipelines.registration
    graph = registration.PoseGraph()
    pose = np.eye(4)
    graph.nodes.append(registration.PoseGraphNode(pose))
    for edge in edges:
        if not edge.is_loop:
            pose = pose @ invert_pose(edge.motion)
            graph.nodes.append(registration.PoseGraphNode(pose))
        graph.edges.append(
            registration.PoseGraphEdge(
                edge.source, edge.target, edge.motion, edge.information, uncertain=edge.is_loop
            )
        )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(max_distance, _PRUNE_THRESHOLD, loop_preference, 0),
    )
    kept = {(edge.source_node_id, edge.target_node_id) for edge in graph.edges}
    return (
        [np.asarray(node.pose) for node in graph.nodes],
        [edge for edge in edges if (edge.source, edge.target) in kept],
    )
