"""USD with UsdPhysics: rigid bodies with visual mesh, convex colliders and mass.

Follows the schema UsdPhysics of OpenUSD.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.exporting.simulation.body import Body
from scanloom.stages.exporting.simulation.convex_part import ConvexPart
from scanloom.stages.exporting.simulation.mass import MassProperties
from scanloom.stages.exporting.usd import define_mesh
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.up_direction import rotate_to_z


def write_usd_physics(path: Path, bodies: Sequence[Body], image_names: Mapping[int, str]) -> None:
    """Write a .usda file with all bodies, z-up, in metres and kilograms.

    Parameters
    ----------
    image_names : file of each texture image, relative to the folder of `path`, by `id` of the image.
    """
    from pxr import Usd, UsdGeom, UsdPhysics

    with tempfile.TemporaryDirectory(prefix="scanloom-", ignore_cleanup_errors=True) as kept:
        text = Path(kept) / path.name
        stage: Any = Usd.Stage.CreateNew(str(text))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/scan").GetPrim())
        for body in bodies:
            _add_body(stage, f"/scan/{body.name}", body, image_names)
        stage.GetRootLayer().Save()
        with write_file_atomically(path) as draft:
            shutil.copyfile(text, draft)


def _add_body(stage: Any, path: str, body: Body, image_names: Mapping[int, str]) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    shape = UsdGeom.Xform.Define(stage, path)
    root = shape.GetPrim()
    if any(body.position):
        shape.AddTranslateOp().Set(Gf.Vec3d(*body.position))
    # Without the schema of a rigid body, colliders are static.
    if not body.is_static:
        UsdPhysics.RigidBodyAPI.Apply(root)
        _add_mass(UsdPhysics.MassAPI.Apply(root), body.mass)
    define_mesh(stage, f"{path}/visual", body.visual, image_names)
    group = UsdGeom.Scope.Define(stage, f"{path}/collision")
    # Renderers skip guides.
    UsdGeom.Imageable(group).CreatePurposeAttr(UsdGeom.Tokens.guide)
    if body.floor is not None:
        plane = UsdGeom.Plane.Define(stage, f"{path}/collision/floor")
        plane.CreateAxisAttr(UsdGeom.Tokens.z)
        plane.AddTransformOp().Set(_make_matrix(rotate_to_z(body.floor.normal), body.floor.point))
        UsdPhysics.CollisionAPI.Apply(plane.GetPrim())
    for number, part in enumerate(body.parts):
        if body.floor is None or not body.floor.contains(part):
            _add_collider(stage, f"{path}/collision/part{number}", part)


def _make_matrix(axes: NDArray[np.float64], origin: NDArray[np.float64]) -> Any:
    """Return the transform to axes in rows; USD multiplies row vectors from the left."""
    from pxr import Gf

    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = axes, origin
    return Gf.Matrix4d(*matrix.reshape(-1).tolist())


def _add_collider(stage: Any, path: str, part: ConvexPart) -> None:
    from pxr import UsdGeom, UsdPhysics

    if part.box is not None:
        cube = UsdGeom.Cube.Define(stage, path)
        cube.CreateSizeAttr(2.0)
        scaled = part.box.half_sizes[:, None] * part.box.axes
        cube.AddTransformOp().Set(_make_matrix(scaled, part.box.center))
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        return
    prim = define_mesh(stage, path, Mesh(part.vertices, part.triangles), {}).GetPrim()
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)


def _add_mass(schema: Any, mass: MassProperties) -> None:
    from pxr import Gf

    moments, axes = np.linalg.eigh(mass.inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    # USD multiplies row vectors from the left, so its matrix is transposed.
    rotation = Gf.Matrix3d(*axes.T.reshape(-1).tolist()).ExtractRotation().GetQuat()
    schema.CreateMassAttr(mass.mass_kg)
    schema.CreateCenterOfMassAttr(Gf.Vec3f(*mass.center_m.tolist()))
    schema.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    schema.CreatePrincipalAxesAttr(Gf.Quatf(rotation))
