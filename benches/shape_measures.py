"""Measures of the shape of a scanned surface, with and without known truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose
from scanloom.stages.surface.edges import build_edges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import to_trimesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_triangle_normals
from scanloom.stages.surface.topology import compute_areas

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAMPLES = 300_000
_SEED = 0
# A sharp edge of the truth: minimum angle between its triangles, and the radius around the edge.
_SHARP_DEG, _SHARP_RADIUS = 30.0, 0.01
_EDGE_SPACING = 0.001
_COMPLETE_DISTANCE = 0.005
# A point of the truth is seen up to this distance, and up to this angle between ray and normal.
MAX_SEEN_DISTANCE, _MAX_SEEN_DEG = 4.0, 75.0
_SEEN_TOLERANCE = 0.002
# Similarity fit: samples, iterations, and the factor on the median residual beyond which a sample is ignored.
_FIT_SAMPLES, _FIT_ITERATIONS, _FIT_CUT = 50_000, 40, 3.0
# Planar places: number of candidates and density of samples per square metre; radii of both planes; the
# surface is planar if this share of the samples is within the distance of the plane.
_PLACES, _DENSITY = 4000, 60_000.0
_NEAR_RADIUS, _FAR_RADIUS = 0.06, 0.20
_PLANAR_RATIO, _PLANAR_DISTANCE = 0.9, 0.02
# Minimum covered ratio of the disc of 20 cm, and minimum number of samples within 6 cm.
_MIN_COVERED, _MIN_SAMPLES = 0.6, 20
_PLANE_ITERATIONS = 5
# Cosine between the normals of two triangles that are folded over each other.
_FOLDED_COSINE = -0.9


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on a mesh, uniform over its area.

    Attributes
    ----------
    points, normals : (n, 3), metres and unit vectors.
    """

    points: Floats
    normals: Floats


@dataclass(frozen=True)
class TruthErrors:
    """Errors of a surface relative to the true surface.

    Attributes
    ----------
    mean_m, rms_m, p95_m : distance from the surface to the truth, metres.
    normal_median_deg, normal_p90_deg : unsigned angle to the normal of the closest point of the truth.
    sharp_rms_m : RMS distance within 1 cm of sharp edges and borders of the truth; NaN without such edges.
    """

    mean_m: float
    rms_m: float
    p95_m: float
    normal_median_deg: float
    normal_p90_deg: float
    sharp_rms_m: float


@dataclass(frozen=True, eq=False)
class PlanarPlaces:
    """Places where a surface is planar within 20 cm.

    Attributes
    ----------
    centers, normals : (n, 3) of the planes.
    """

    centers: Floats
    normals: Floats


@dataclass(frozen=True)
class PlanarErrors:
    """Errors of a surface on planar places.

    Attributes
    ----------
    normal_median_deg, normal_p90_deg : angle between triangles and the plane within 20 cm, without sign.
    near_median_m, near_p90_m : RMS distance from a plane fitted within 6 cm, over the places.
    far_median_m, far_p90_m : RMS distance from a plane fitted within 20 cm, over the places.
    """

    normal_median_deg: float
    normal_p90_deg: float
    near_median_m: float
    near_p90_m: float
    far_median_m: float
    far_p90_m: float


class TruthSurface:
    """True surface prepared for closest-point queries.

    Attributes
    ----------
    surface : raycasting surface of the mesh.
    sharp_points : (n, 3) points along sharp edges and borders.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.surface = RaycastingSurface(mesh)
        self.sharp_points = sample_sharp_edges(mesh)


def sample_surface(mesh: Mesh, count: int = _SAMPLES) -> SurfaceSamples:
    """Sample points and normals of a mesh, stratified by area."""
    areas = np.cumsum(compute_areas(mesh.vertices, mesh.triangles))
    found = sample_stratified(areas, slice(0, count), count, np.random.default_rng(_SEED))
    corners = mesh.vertices[mesh.triangles[found.triangles]]
    points = np.einsum("kc,kcx->kx", found.weights, corners)
    return SurfaceSamples(points, compute_triangle_normals(mesh)[found.triangles])


def sample_sharp_edges(mesh: Mesh, min_angle_deg: float = _SHARP_DEG) -> Floats:
    """Sample points (n, 3) along sharp edges and borders, 1 mm apart.

    Vertices at equal positions count as one, because a made scene repeats vertices along sharp edges. Borders
    count because objects rest on others there.
    """
    _, first, number = np.unique(np.round(mesh.vertices, 6), axis=0, return_index=True, return_inverse=True)
    welded = number.reshape(-1)[mesh.triangles]
    distinct = (welded != np.roll(welded, 1, axis=1)).all(axis=1)
    welded, normals = welded[distinct], compute_triangle_normals(mesh)[distinct]
    edges = build_edges(welded.astype(np.int32), len(first))
    sharp = edges.triangle_count != 2
    pairs = edges.start[~sharp]
    a, b = (normals[edges.halfedges[pairs + k] // 3] for k in range(2))
    sharp[~sharp] = np.einsum("kx,kx->k", a, b) < np.cos(np.radians(min_angle_deg))
    ends = mesh.vertices[first][edges.ends[sharp]]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    counts = np.ceil(lengths / _EDGE_SPACING).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(ends)), counts)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (step / np.maximum(counts[edge] - 1, 1))[:, None]
    return np.asarray((1 - share) * ends[edge, 0] + share * ends[edge, 1])


def measure_truth_errors(mesh: Mesh, truth: TruthSurface, count: int = _SAMPLES) -> TruthErrors:
    """Measure distances and angles from a mesh to the true surface."""
    import scipy.spatial

    samples = sample_surface(mesh, count)
    closest = truth.surface.find_closest_points(samples.points)
    angles = _compute_angles(samples.normals, truth.surface.normals[closest.triangles])
    near = np.zeros(len(samples.points), bool)
    if len(truth.sharp_points):
        tree = scipy.spatial.cKDTree(truth.sharp_points)
        near = np.isfinite(tree.query(samples.points, distance_upper_bound=_SHARP_RADIUS)[0])
    return TruthErrors(
        float(closest.distances.mean()),
        _compute_rms(closest.distances),
        float(np.quantile(closest.distances, 0.95)),
        float(np.median(angles)),
        float(np.quantile(angles, 0.9)),
        _compute_rms(closest.distances[near]) if near.any() else float("nan"),
    )


def find_seen_points(
    samples: SurfaceSamples,
    truth: TruthSurface,
    frames: Iterable[Frame],
    max_distance: float = MAX_SEEN_DISTANCE,
) -> Mask:
    """Find the points (n,) of the truth that at least one frame sees.

    A frame sees a point inside its image, not occluded, within a maximum distance and 75° of the normal.
    """
    seen = np.zeros(len(samples.points), bool)
    for frame in frames:
        if frame.world_from_camera is None:
            continue
        todo = np.flatnonzero(~seen)
        candidates = SurfaceSamples(samples.points[todo], samples.normals[todo])
        seen[todo] = _is_seen(candidates, truth.surface, frame, max_distance)
    return seen


def _is_seen(samples: SurfaceSamples, surface: RaycastingSurface, frame: Frame, max_distance: float) -> Mask:
    pose, camera = frame.world_from_camera, frame.camera
    points, normals = samples.points, samples.normals
    assert pose is not None
    local = points @ invert_pose(pose)[:3, :3].T + invert_pose(pose)[:3, 3]
    z = np.maximum(local[:, 2], 1e-6)
    u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
    inside = (local[:, 2] > 0.1) & (u > 0) & (v > 0) & (u < camera.width - 1) & (v < camera.height - 1)
    rays = points - pose[:3, 3]
    distances = np.linalg.norm(rays, axis=1)
    facing = -np.einsum("kx,kx->k", rays, normals) > np.cos(np.radians(_MAX_SEEN_DEG)) * distances
    chosen = np.flatnonzero(inside & facing & (distances < max_distance))
    visible = np.zeros(len(points), bool)
    hits = surface.cast_rays(pose[:3, 3], rays[chosen])
    # Rays are as long as the distance to their points, so that a ray which reaches its point has length 1.
    gap = (1 - hits.distances) * distances[chosen[hits.rays]]
    visible[chosen[hits.rays[np.abs(gap) < _SEEN_TOLERANCE]]] = True
    return visible


def measure_completeness(points: Floats, mesh: Mesh, distance: float = _COMPLETE_DISTANCE) -> float:
    """Measure the ratio of points (n, 3) that have the mesh within a distance."""
    found = RaycastingSurface(mesh).find_closest_points(points)
    return float((found.distances <= distance).mean())


def count_folded_edges(mesh: Mesh) -> int:
    """Count the edges whose two triangles face in nearly opposite directions."""
    whole = to_trimesh(Mesh(mesh.vertices, mesh.triangles))
    first, second = whole.face_normals[whole.face_adjacency].transpose(1, 0, 2)
    return int(np.count_nonzero(np.einsum("ki,ki->k", first, second) < _FOLDED_COSINE))


def estimate_similarity(mesh: Mesh, truth: TruthSurface) -> Pose:
    """Estimate the similarity (4, 4) from a mesh to the truth by point-to-plane ICP with scale.

    Samples farther from the truth than three times the median are ignored.
    """
    points = sample_surface(mesh, _FIT_SAMPLES).points
    center = points.mean(axis=0)
    motion = np.eye(4)
    for _ in range(_FIT_ITERATIONS):
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        closest = truth.surface.find_closest_points(moved)
        corners = truth.surface.mesh.vertices[truth.surface.mesh.triangles[closest.triangles]]
        targets = np.einsum("kc,kcx->kx", closest.weights, corners)
        kept = closest.distances <= _FIT_CUT * np.median(closest.distances)
        p, n = moved[kept] - center, truth.surface.normals[closest.triangles[kept]]
        jacobian = np.column_stack([np.cross(p, n), n, np.einsum("kx,kx->k", p, n)])
        residuals = np.einsum("kx,kx->k", targets[kept] - moved[kept], n)
        turn_x, turn_y, turn_z, *shift, growth = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        skew = np.array(((0, -turn_z, turn_y), (turn_z, 0, -turn_x), (-turn_y, turn_x, 0)))
        u, _, v = np.linalg.svd(np.eye(3) + skew)
        step = np.eye(4)
        step[:3, :3] = np.exp(growth) * (u @ v)
        step[:3, 3] = center + shift - step[:3, :3] @ center
        motion = step @ motion
    return motion


def transform_mesh(mesh: Mesh, motion: Pose) -> Mesh:
    """Apply a similarity (4, 4) to the vertices of a mesh."""
    return mesh.with_(vertices=mesh.vertices @ motion[:3, :3].T + motion[:3, 3], normals=None)


def find_planar_places(mesh: Mesh, count: int = _PLACES) -> PlanarPlaces:
    """Find places where 90 % of a mesh within 20 cm is less than 2 cm from a plane.

    Places near borders are ignored, because a plane is poorly determined there.

    Parameters
    ----------
    count : number of candidates, uniform over the surface.
    """
    field = _SampledSurface(mesh)
    min_samples = _MIN_COVERED * np.pi * _FAR_RADIUS**2 * _DENSITY
    centers, normals = [], []
    for candidate in sample_surface(mesh, count).points:
        points = field.samples.points[field.find_near(candidate, _FAR_RADIUS)]
        if len(points) < min_samples:
            continue
        plane = _Plane.from_points(points)
        ratio = (np.abs(plane.compute_heights(points)) < _PLANAR_DISTANCE).mean()
        height = plane.compute_heights(candidate)
        if ratio >= _PLANAR_RATIO and abs(height) < _PLANAR_DISTANCE:
            centers.append(candidate - height * plane.normal)
            normals.append(plane.normal)
    return PlanarPlaces(np.reshape(centers, (-1, 3)), np.reshape(normals, (-1, 3)))


def measure_planar_errors(mesh: Mesh, places: PlanarPlaces) -> PlanarErrors:
    """Measure how far a mesh deviates from planes at given places.

    Planes are fitted to this mesh, so that a shift of a surface is no error.
    """
    field = _SampledSurface(mesh)
    angles, near_rms, far_rms = [], [], []
    for center, normal in zip(places.centers, places.normals, strict=True):
        found = field.find_near(center, _FAR_RADIUS)
        heights = _Plane(center, normal).compute_heights(field.samples.points[found])
        found = found[np.abs(heights) < 2 * _PLANAR_DISTANCE]
        points = field.samples.points[found]
        near = np.linalg.norm(points - center, axis=1) < _NEAR_RADIUS
        if near.sum() < _MIN_SAMPLES:
            continue
        plane = _Plane.from_points(points)
        far_rms.append(_compute_rms(plane.compute_heights(points)))
        near_rms.append(_compute_rms(_Plane.from_points(points[near]).compute_heights(points[near])))
        angles.append(_compute_angles(field.samples.normals[found[near]], plane.normal))
    if not angles:
        return PlanarErrors(*[float("nan")] * 6)
    limits = [np.quantile(values, (0.5, 0.9)) for values in (np.concatenate(angles), near_rms, far_rms)]
    return PlanarErrors(*(float(value) for value in np.concatenate(limits)))


class _SampledSurface:
    """Dense samples of a mesh with a search tree."""

    def __init__(self, mesh: Mesh) -> None:
        import scipy.spatial

        area = float(compute_areas(mesh.vertices, mesh.triangles).sum())
        self.samples = sample_surface(mesh, max(int(area * _DENSITY), 1))
        self._tree = scipy.spatial.cKDTree(self.samples.points)

    def find_near(self, center: Floats, radius: float) -> NDArray[np.int64]:
        """Find the samples (n,) within a radius, ascending."""
        return np.sort(np.asarray(self._tree.query_ball_point(center, radius), np.int64))


@dataclass(frozen=True, eq=False)
class _Plane:
    center: Floats
    normal: Floats

    @classmethod
    def from_points(cls, points: Floats) -> _Plane:
        """Fit a plane to points (n, 3) robustly, with Cauchy weights."""
        weights = np.ones(len(points))
        for _ in range(_PLANE_ITERATIONS):
            center = weights @ points / weights.sum()
            offsets = points - center
            plane = cls(center, np.linalg.eigh((offsets * weights[:, None]).T @ offsets)[1][:, 0])
            heights = np.abs(plane.compute_heights(points))
            weights = 1 / (1 + (heights / max(2.5 * float(np.median(heights)), 1e-9)) ** 2)
        return plane

    def compute_heights(self, points: Floats) -> Floats:
        return np.asarray((points - self.center) @ self.normal)


def _compute_angles(normals: Floats, others: Floats) -> Floats:
    """Compute angles (n,) between directions, degrees 0..90."""
    cosines = np.abs((normals * others).sum(axis=1))
    return np.asarray(np.degrees(np.arccos(cosines.clip(0, 1))))


def _compute_rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
