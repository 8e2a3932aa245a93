"""Open3D's reconstruction system up to the poses: fragments are made, registered to each other, and refined.

Written after Open3D's documentation ("Reconstruction system"), with the defaults of its configuration. A
fragment is a hundred frames: odometry from each to the next, and between all pairs of key frames that
recognised points can be started from; a pose graph; the surface fused from it. Fragments are registered by
coloured ICP to the next one and by features of their surfaces (FPFH, RANSAC) to all others, in a second pose
graph; what it keeps is refined by ICP at three resolutions, in a third.

As there, a step of the odometry is taken as it comes; only a fragment in which none meets anything is an
error. Other than there, points without depth are left out of what starts a pair, images are read once, all
that is random is seeded, and the tensor volume fuses: the legacy one takes depth in metres for millimetres in
Open3D 0.20.0, and stays empty.

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
from open3d_images import legacy_camera, legacy_image, read_images

from scanloom.stages._open3d import open3d
from scanloom.stages.registration.odometry import one_thread_each
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

_FRAGMENT_FRAMES = 100
_KEY_FRAMES_EVERY = 5
# Metres.
_MAX_DEPTH, _MAX_DEPTH_DIFFERENCE = 3.0, 0.07
_FUSED_VOXEL, _FUSED_TRUNCATION = 3.0 / 512, 0.04
_VOXEL = 0.05
_REACH = 1.4 * _VOXEL
# How much a pose graph trusts a loop, within a fragment and between fragments.
_ODOMETRY_LOOPS, _REGISTRATION_LOOPS = 0.1, 5.0
_PRUNED_BELOW = 0.25
# Voxels and iterations of ICP, first and refined.
_FIRST_ICP = ((_VOXEL, 50),)
_REFINING_ICP = ((_VOXEL, 50), (_VOXEL / 2, 30), (_VOXEL / 4, 14))
# A loop between fragments must bring so much of the smaller one onto the other.
_LEAST_OVERLAP = 0.3
_RANSAC_TRIES, _RANSAC_CONFIDENCE, _LEAST_EDGE_RATIO = 1_000_000, 0.999, 0.9
# Recognised points: features an image, pixels off the epipolar line, metres off the motion.
_FEATURES, _MAX_PIXELS, _MAX_METRES = 100, 1.0, 0.05
_MOTION_TRIES, _MOTION_POINTS = 1000, 5


@dataclass(frozen=True, eq=False)
class _Edge:
    """A motion (target_from_source) between two nodes of a pose graph; a loop, if they do not follow."""

    source: int
    target: int
    motion: Pose
    information: NDArray[np.float64]

    @property
    def is_loop(self) -> bool:
        return self.target != self.source + 1


@dataclass(frozen=True, eq=False)
class _Fragment:
    """Frames with poses in the first one's camera, and the points and colours of their surface."""

    poses: list[Pose]
    cloud: Any


def reconstruction_system(
    frames: Sequence[Frame], *, fragment_frames: int = _FRAGMENT_FRAMES
) -> dict[int, Pose]:
    """Return world_from_camera of every frame by its place, the first frame's camera being the world.

    Raises
    ------
    RuntimeError
        If no frame of a fragment meets the next, or Open3D fails.
    """
    # On one thread sums, and so poses, are the same every time; the legacy odometry gains little from more.
    with one_thread_each():
        fragments = [
            _fragment(frames[start : start + fragment_frames])
            for start in range(0, len(frames), fragment_frames)
        ]
        scene = _scene(fragments)
    poses = [of @ pose for of, fragment in zip(scene, fragments, strict=True) for pose in fragment.poses]
    return dict(enumerate(poses))


# -- fragments -------------------------------------------------------------------------------------------


def _fragment(frames: Sequence[Frame]) -> _Fragment:
    images = [read_images(frame) for frame in frames]
    rgbd = [legacy_image(*one, _MAX_DEPTH) for one in images]
    camera = frames[0].camera
    keys = range(0, len(frames), _KEY_FRAMES_EVERY)
    points = {key: _features(rgbd[key], camera) for key in keys}
    edges = []
    for source, target in itertools.pairwise(range(len(frames))):
        _, motion, information = _odometry(rgbd[source], rgbd[target], camera, np.eye(4))
        edges.append(_Edge(source, target, motion, information))
    # Open3D calls it a success if no pixel of one frame meets the other.
    if edges and not any(edge.information.any() for edge in edges):
        raise RuntimeError(f"no frame meets the next within {_MAX_DEPTH:g} m")
    for source, target in itertools.combinations(keys, 2):
        start = _recognised_motion(points[source], points[target], camera)
        if start is not None:
            found, motion, information = _odometry(rgbd[source], rgbd[target], camera, start)
            if found:
                edges.append(_Edge(source, target, motion, information))
    poses, _ = _optimised(edges, _MAX_DEPTH_DIFFERENCE, _ODOMETRY_LOOPS)
    return _Fragment(poses, _surface(images, poses, camera))


def _odometry(
    source: Any, target: Any, camera: Camera, start: Pose
) -> tuple[bool, Pose, NDArray[np.float64]]:
    odometry = open3d().pipelines.odometry
    option = odometry.OdometryOption(depth_diff_max=_MAX_DEPTH_DIFFERENCE)
    hybrid = odometry.RGBDOdometryJacobianFromHybridTerm()
    return odometry.compute_rgbd_odometry(source, target, legacy_camera(camera), start, hybrid, option)


def _surface(images: Iterable[tuple[Any, Any]], poses: Iterable[Pose], camera: Camera) -> Any:
    o3d = open3d()
    f32, u16 = o3d.core.float32, o3d.core.uint16
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (f32, u16, u16), (1, 1, 3), _FUSED_VOXEL, 16, 4000
    )
    matrix = o3d.core.Tensor(camera.matrix)
    cut = 1.0, _MAX_DEPTH, _FUSED_TRUNCATION / _FUSED_VOXEL
    for (depth, color), pose in zip(images, poses, strict=True):
        if not ((depth > 0) & (depth < _MAX_DEPTH)).any():
            continue
        metres = o3d.t.geometry.Image(o3d.core.Tensor(depth))
        share = o3d.t.geometry.Image(o3d.core.Tensor(color / np.float32(255)))
        extrinsic = o3d.core.Tensor(inverted(pose))
        blocks = grid.compute_unique_block_coordinates(metres, matrix, extrinsic, *cut)
        grid.integrate(blocks, metres, share, matrix, extrinsic, *cut)
    return grid.extract_point_cloud(weight_threshold=0).to_legacy()


# -- where a pair of key frames starts --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Features:
    """Recognisable pixels (n, 2) of an image, their descriptors, and points (n, 3), NaN without depth."""

    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    points: NDArray[np.float64]


def _features(rgbd: Any, camera: Camera) -> _Features:
    grey = np.uint8(np.clip(np.asarray(rgbd.color) * 255, 0, 255))
    found, descriptors = cv2.ORB_create(nfeatures=_FEATURES).detectAndCompute(grey, None)
    pixels = np.array([point.pt for point in found], np.float32).reshape(-1, 2)
    if descriptors is None:
        descriptors = np.zeros((0, 32), np.uint8)
    return _Features(pixels, descriptors, _points(pixels, np.asarray(rgbd.depth), camera))


def _points(pixels: NDArray[np.float32], depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float64]:
    holes = np.where(depth > 0, depth, np.nan)
    x, y = pixels.astype(np.float64).T
    left = np.clip(np.floor(x).astype(int), 0, depth.shape[1] - 2)
    top = np.clip(np.floor(y).astype(int), 0, depth.shape[0] - 2)
    right, down = x - left, y - top
    z = (1 - down) * ((1 - right) * holes[top, left] + right * holes[top, left + 1])
    z += down * ((1 - right) * holes[top + 1, left] + right * holes[top + 1, left + 1])
    return np.stack([(x - camera.cx) / camera.fx * z, (y - camera.cy) / camera.fy * z, z], axis=1)


def _recognised_motion(source: _Features, target: _Features, camera: Camera) -> Pose | None:
    """Return target_from_source from points that both show, None if too few agree."""
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
    return rigid_motion(a[good], b[good])


def rigid_motion(a: NDArray[np.float64], b: NDArray[np.float64]) -> Pose | None:
    """Return the motion of a few drawn points (n, 3) that brings most onto `b`; None if it is not enough."""
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
    # Images that show the same are not turned by more than a right angle.
    agreeing[(turns[:, range(3), range(3)] <= 0).any(axis=1)] = 0
    best = int(agreeing.argmax())
    if agreeing[best] <= _MOTION_POINTS:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turns[best], shifts[best, 0]
    return pose


# -- the scene -------------------------------------------------------------------------------------------


def _scene(fragments: Sequence[_Fragment]) -> list[Pose]:
    """Return where the fragments are, in the first one's world."""
    surfaces = [_described(fragment.cloud) for fragment in fragments]

    edges = list(_registered(fragments, surfaces))
    _, kept = _optimised(edges, _REACH, _REGISTRATION_LOOPS)
    edges = [
        _Edge(
            edge.source,
            edge.target,
            *_icp(fragments[edge.source].cloud, fragments[edge.target].cloud, edge.motion, _REFINING_ICP),
        )
        for edge in kept
    ]
    poses, _ = _optimised(edges, _REACH, _REGISTRATION_LOOPS)
    return poses


def _registered(fragments: Sequence[_Fragment], surfaces: Sequence[tuple[Any, Any]]) -> Iterator[_Edge]:
    for source, target in itertools.combinations(range(len(fragments)), 2):
        if target == source + 1:
            # The next fragment starts about where this one ends.
            start = inverted(fragments[source].poses[-1])
            pair = surfaces[source][0], surfaces[target][0]
            yield _Edge(source, target, *_icp(*pair, start, _FIRST_ICP))
        elif (found := _recognised_surface(surfaces[source], surfaces[target])) is not None:
            yield _Edge(source, target, *found)


def _described(cloud: Any) -> tuple[Any, Any]:
    """Return a cloud's points thinned out, and their features."""
    o3d = open3d()
    thin = cloud.voxel_down_sample(_VOXEL)
    thin.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * _VOXEL, max_nn=30))
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * _VOXEL, max_nn=100)
    return thin, o3d.pipelines.registration.compute_fpfh_feature(thin, near)


def _recognised_surface(
    source: tuple[Any, Any], target: tuple[Any, Any]
) -> tuple[Pose, NDArray[np.float64]] | None:
    o3d = open3d()
    registration = o3d.pipelines.registration
    (a, features_a), (b, features_b) = source, target
    o3d.utility.random.seed(0)
    pose = registration.registration_ransac_based_on_feature_matching(
        a,
        b,
        features_a,
        features_b,
        True,
        _REACH,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(_LEAST_EDGE_RATIO),
            registration.CorrespondenceCheckerBasedOnDistance(_REACH),
        ],
        registration.RANSACConvergenceCriteria(_RANSAC_TRIES, _RANSAC_CONFIDENCE),
    ).transformation
    # Open3D's answer where it found none is no motion.
    if np.array_equal(pose, np.eye(4)):
        return None
    information = registration.get_information_matrix_from_point_clouds(a, b, _REACH, pose)
    # Each pair of points adds an identity to the block of the shift.
    overlap = information[5, 5] / min(len(a.points), len(b.points))
    return (pose, information) if overlap >= _LEAST_OVERLAP else None


def _icp(
    source: Any, target: Any, start: Pose, scales: Sequence[tuple[float, int]]
) -> tuple[Pose, NDArray[np.float64]]:
    """Return target_from_source by coloured ICP from coarse to fine, and its information."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    pose = start
    for voxel, iterations in scales:
        pair = [cloud.voxel_down_sample(voxel) for cloud in (source, target)]
        for cloud in pair:
            cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
        pose = registration.registration_colored_icp(
            *pair,
            _REACH,
            pose,
            registration.TransformationEstimationForColoredICP(),
            registration.ICPConvergenceCriteria(1e-6, 1e-6, iterations),
        ).transformation
    return pose, registration.get_information_matrix_from_point_clouds(*pair, 1.4 * voxel, pose)


# -- pose graphs -----------------------------------------------------------------------------------------


def _optimised(edges: Sequence[_Edge], reach: float, loops: float) -> tuple[list[Pose], list[_Edge]]:
    """Return the poses that agree best, from the chain of the edges that are no loops, and the edges kept."""
    registration = open3d().pipelines.registration
    graph = registration.PoseGraph()
    pose = np.eye(4)
    graph.nodes.append(registration.PoseGraphNode(pose))
    for edge in edges:
        if not edge.is_loop:
            pose = pose @ inverted(edge.motion)
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
        registration.GlobalOptimizationOption(reach, _PRUNED_BELOW, loops, 0),
    )
    kept = {(edge.source_node_id, edge.target_node_id) for edge in graph.edges}
    return (
        [np.asarray(node.pose) for node in graph.nodes],
        [edge for edge in edges if (edge.source, edge.target) in kept],
    )
