"""Bring a mesh or cloud to where another one is, by a rigid motion: iterated closest points, point to plane.

Chen and Medioni, "Object modelling by registration of multiple range images", 1992; by Open3D.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import open3d
from scanloom.stages.comparing.codes import COMPARE_MESHES_APART
from scanloom.stages.comparing.measurable import box_of, comparable
from scanloom.stages.comparing.sampling import sampled
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.cloud import is_cloud, some_of
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats
from scanloom.stages.surface.topology import areas
from scanloom.stages.surface.vertex_normals import vertex_normals

# Points on each surface, or of each cloud.
_POINTS = 60_000
_SEED = 0
# How far partners may be apart, as shares of the smaller mesh's diagonal: coarse to fine.
_REACHES = (0.1, 0.03, 0.01, 0.003)
_ITERATIONS = 60
# Fewer points that find a partner than this share hold nothing in place.
_LEAST_OVERLAP = 0.2


@dataclass(frozen=True, eq=False)
class Alignment:
    """How a mesh was moved.

    Attributes
    ----------
    reference_from_mesh : (4, 4) float64, a rotation and a translation in metres.
    overlap : share of the mesh's points that have a partner in the end.
    rms : of the distances to these partners' planes, metres.
    moved_rms, angle : how far its points moved, RMS in metres, and by which angle it turned, degrees.
    """

    reference_from_mesh: NDArray[np.float64]
    overlap: float
    rms: float
    moved_rms: float
    angle: float

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return the motion and how well it fits, units in the names."""
        return {
            "reference_from_mesh": self.reference_from_mesh.tolist(),
            "overlap": self.overlap,
            "rms_m": self.rms,
            "moved_rms_m": self.moved_rms,
            "angle_degrees": self.angle,
        }


def align(mesh: MeshLike, reference: MeshLike) -> tuple[Mesh, Alignment]:
    """Return a mesh or cloud moved onto a reference, and the motion; its size stays.

    It has to lie there roughly already, within a tenth of its size: nearest points are taken for partners.

    Parameters
    ----------
    mesh, reference : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres. Without triangles it is
        a cloud, whose normals come from the points around each, if it has none.

    Raises
    ------
    MeshError
        If a mesh has no area, or a cloud is all in one place.
    InputError
        If the two do not overlap enough for it.
    """
    moving, fixed = comparable(mesh, "mesh"), comparable(reference, "reference")
    o3d = open3d()
    pipeline = o3d.pipelines.registration
    centre = box_of(fixed).mean(axis=0)
    source, target = (_points_of(one, centre, o3d) for one in (moving, fixed))
    size = min(float(np.linalg.norm(np.diff(box_of(one), axis=0))) for one in (moving, fixed))
    motion = np.eye(4)
    for share in _REACHES:
        found = pipeline.registration_icp(
            source,
            target,
            share * size,
            motion,
            pipeline.TransformationEstimationPointToPlane(),
            pipeline.ICPConvergenceCriteria(1e-9, 1e-9, _ITERATIONS),
        )
        if found.fitness < _LEAST_OVERLAP:
            break
        motion = found.transformation
    found = pipeline.evaluate_registration(source, target, _REACHES[1] * size, motion)
    if found.fitness < _LEAST_OVERLAP:
        raise InputError(
            COMPARE_MESHES_APART,
            "the two cannot be aligned: {fitness:.0%} of the points have a partner nearby",
            remedy="bring them roughly into place first.",
            fitness=found.fitness,
        )
    motion = _rigid(motion)
    rms = _rms_to_planes(source, target, np.asarray(found.correspondence_set), motion)
    # Told of the world, not of the points around the centre.
    motion[:3, 3] += centre - motion[:3, :3] @ centre
    vertices = moving.vertices @ motion[:3, :3].T + motion[:3, 3]
    moved = np.linalg.norm(vertices - moving.vertices, axis=1)
    cosine = np.clip((np.trace(motion[:3, :3]) - 1) / 2, -1, 1)
    alignment = Alignment(
        reference_from_mesh=motion,
        overlap=float(found.fitness),
        rms=rms,
        moved_rms=float(np.sqrt((moved**2).mean())),
        angle=float(np.degrees(np.arccos(cosine))),
    )
    return _moved(moving, motion), alignment


def _moved(mesh: Mesh, motion: NDArray[np.float64]) -> Mesh:
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


def _rigid(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a motion whose rotation is one to the last digit."""
    u, _, v = np.linalg.svd(motion[:3, :3])
    rigid = np.array(motion)
    rigid[:3, :3] = u @ np.diag((1, 1, np.sign(np.linalg.det(u @ v)))) @ v
    return rigid


def _rms_to_planes(source: Any, target: Any, pairs: NDArray[np.int32], motion: NDArray[np.float64]) -> float:
    """Return how far the moved points are from the planes of their partners, RMS."""
    moved = np.asarray(source.points)[pairs[:, 0]] @ motion[:3, :3].T + motion[:3, 3]
    away = moved - np.asarray(target.points)[pairs[:, 1]]
    distances = np.einsum("kx,kx->k", away, np.asarray(target.normals)[pairs[:, 1]])
    return float(np.sqrt((distances**2).mean()))


def _points_of(mesh: Mesh, centre: Floats, o3d: Any) -> Any:
    """Return points with normals: spread evenly over a mesh, or some of a cloud."""
    if is_cloud(mesh):
        chosen = some_of(mesh, _POINTS)
        assert chosen.normals is not None
        points, normals = chosen.vertices, chosen.normals
    else:
        points, normals = _spread_over(mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    found = o3d.geometry.PointCloud()
    found.points = o3d.utility.Vector3dVector(points - centre)
    found.normals = o3d.utility.Vector3dVector(normals / np.maximum(lengths, np.finfo(float).tiny))
    return found


def _spread_over(mesh: Mesh) -> tuple[Floats, Floats]:
    cumulative = np.cumsum(areas(mesh.vertices, mesh.triangles))
    at = sampled(cumulative, slice(0, _POINTS), _POINTS, np.random.default_rng(_SEED))
    rows = mesh.triangles[at.triangles]
    normals = np.einsum("kc,kcx->kx", at.weights, vertex_normals(mesh)[rows])
    return np.einsum("kc,kcx->kx", at.weights, mesh.vertices[rows]), normals
