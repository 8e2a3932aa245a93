"""Rigid alignment of a mesh or cloud by point-to-plane ICP.

Chen and Medioni, "Object modelling by registration of multiple range images", 1992; Open3D implementation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.comparing.codes import COMPARE_MESHES_APART
from scanloom.stages.comparing.comparison_inputs import compute_joint_box, to_mesh_or_cloud
from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.point_cloud import is_cloud, subsample_cloud
from scanloom.stages.surface.raycasting import Floats
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.surface.vertex_normals import compute_vertex_normals

# Number of points sampled on each mesh or drawn from each cloud.
_SAMPLE_COUNT = 60_000
_SEED = 0
# Maximum correspondence distances, coarse to fine, as ratios of the smaller bounding-box diagonal.
_CORRESPONDENCE_RATIOS = (0.1, 0.03, 0.01, 0.003)
_MAX_ITERATIONS = 60
# Minimum ratio of points with a correspondence. With fewer, ICP does not constrain the motion.
_MIN_OVERLAP_RATIO = 0.2


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of a rigid alignment.

    Attributes
    ----------
    reference_from_mesh : (4, 4) float64, rotation and translation (metres) from mesh to reference
        coordinates.
    overlap_ratio : ratio of the mesh's sample points with a correspondence after alignment.
    rms_m : RMS point-to-plane distance of these correspondences, metres.
    displacement_rms_m, angle_deg : RMS displacement of the mesh's vertices in metres, and rotation angle in
        degrees.
    """

    reference_from_mesh: NDArray[np.float64]
    overlap_ratio: float
    rms_m: float
    displacement_rms_m: float
    angle_deg: float

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for JSON, with units in the key names."""
        return {
            "reference_from_mesh": self.reference_from_mesh.tolist(),
            "overlap": self.overlap_ratio,
            "rms_m": self.rms_m,
            "moved_rms_m": self.displacement_rms_m,
            "angle_degrees": self.angle_deg,
        }


def align(mesh: MeshLike, reference: MeshLike) -> tuple[Mesh, Alignment]:
    """Align a mesh or cloud rigidly to a reference by ICP.

    The scale stays unchanged. The initial offset must be below about a tenth of the object's size, because
    correspondences are nearest points.

    Parameters
    ----------
    mesh, reference : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres. Input without triangles
        is a cloud. Missing normals of a cloud are estimated from neighbouring points.

    Returns
    -------
    The moved mesh, and its alignment.

    Raises
    ------
    MeshError
        If a mesh has no area, or all points of a cloud coincide.
    InputError
        If the overlap of mesh and reference is too small.
    """
    moving, fixed = to_mesh_or_cloud(mesh, "mesh"), to_mesh_or_cloud(reference, "reference")
    o3d = import_open3d()
    pipeline = o3d.pipelines.registration
    centre = compute_joint_box(fixed).mean(axis=0)
    source, target = (_to_open3d_points(one, centre, o3d) for one in (moving, fixed))
    size = min(float(np.linalg.norm(np.diff(compute_joint_box(one), axis=0))) for one in (moving, fixed))
    motion = np.eye(4)
    for share in _CORRESPONDENCE_RATIOS:
        registration = pipeline.registration_icp(
            source,
            target,
            share * size,
            motion,
            pipeline.TransformationEstimationPointToPlane(),
            pipeline.ICPConvergenceCriteria(1e-9, 1e-9, _MAX_ITERATIONS),
        )
        if registration.fitness < _MIN_OVERLAP_RATIO:
            break
        motion = registration.transformation
    registration = pipeline.evaluate_registration(source, target, _CORRESPONDENCE_RATIOS[1] * size, motion)
    if registration.fitness < _MIN_OVERLAP_RATIO:
        raise InputError(
            COMPARE_MESHES_APART,
            "mesh and reference cannot be aligned: only {fitness:.0%} of the points have a correspondence "
            "nearby ({minimum:.0%} required)",
            remedy="align them roughly first.",
            fitness=registration.fitness,
            minimum=_MIN_OVERLAP_RATIO,
        )
    motion = _orthonormalize_rotation(motion)
    rms = _compute_plane_rms(source, target, np.asarray(registration.correspondence_set), motion)
    # ICP ran on centred points; convert the translation to world coordinates.
    motion[:3, 3] += centre - motion[:3, :3] @ centre
    vertices = moving.vertices @ motion[:3, :3].T + motion[:3, 3]
    moved = np.linalg.norm(vertices - moving.vertices, axis=1)
    cosine = np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1)
    alignment = Alignment(
        reference_from_mesh=motion,
        overlap_ratio=float(registration.fitness),
        rms_m=rms,
        displacement_rms_m=float(np.sqrt((moved**2).mean())),
        angle_deg=float(np.degrees(np.arccos(cosine))),
    )
    return _transform_mesh(moving, motion), alignment


def _transform_mesh(mesh: Mesh, motion: NDArray[np.float64]) -> Mesh:
    turn = motion[:3, :3]
    up = None
    if mesh.up is not None:
        x, y, z = (turn @ np.array(mesh.up)).tolist()
        up = (x, y, z)
    return mesh.with_(
        vertices=mesh.vertices @ turn.T + motion[:3, 3],
        normals=None if mesh.normals is None else mesh.normals @ turn.T,
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals @ turn.T,
        up=up,
    )


def _orthonormalize_rotation(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project the rotation part of a motion (4, 4) onto the exact rotations."""
    u, _, v = np.linalg.svd(motion[:3, :3])
    rigid = np.array(motion)
    rigid[:3, :3] = u @ np.diag((1, 1, np.sign(np.linalg.det(u @ v)))) @ v
    return rigid


def _compute_plane_rms(
    source: Any, target: Any, correspondences: NDArray[np.int32], motion: NDArray[np.float64]
) -> float:
    """Compute the RMS point-to-plane distance of the correspondences, metres."""
    moved = np.asarray(source.points)[correspondences[:, 0]] @ motion[:3, :3].T + motion[:3, 3]
    away = moved - np.asarray(target.points)[correspondences[:, 1]]
    distances = np.einsum("kx,kx->k", away, np.asarray(target.normals)[correspondences[:, 1]])
    return float(np.sqrt((distances**2).mean()))


def _to_open3d_points(mesh: Mesh, centre: Floats, o3d: Any) -> Any:
    """Convert a mesh or cloud to Open3D points with unit normals.

    A mesh is sampled; a large cloud is subsampled. Coordinates are relative to `centre`.
    """
    if is_cloud(mesh):
        chosen = subsample_cloud(mesh, _SAMPLE_COUNT)
        assert chosen.normals is not None
        points, normals = chosen.vertices, chosen.normals
    else:
        points, normals = _sample_mesh(mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    found = o3d.geometry.PointCloud()
    found.points = o3d.utility.Vector3dVector(points - centre)
    found.normals = o3d.utility.Vector3dVector(normals / np.maximum(lengths, np.finfo(float).tiny))
    return found


def _sample_mesh(mesh: Mesh) -> tuple[Floats, Floats]:
    cumulative = np.cumsum(compute_areas(mesh.vertices, mesh.triangles))
    at = sample_stratified(cumulative, slice(0, _SAMPLE_COUNT), _SAMPLE_COUNT, np.random.default_rng(_SEED))
    rows = mesh.triangles[at.triangles]
    normals = np.einsum("kc,kcx->kx", at.weights, compute_vertex_normals(mesh)[rows])
    return np.einsum("kc,kcx->kx", at.weights, mesh.vertices[rows]), normals
