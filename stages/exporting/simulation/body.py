"""Bodies of a simulation model: visual mesh, collision parts and mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.exporting.simulation.collision_proof import CollisionProof
from scanloom.stages.exporting.simulation.convex_part import ConvexPart
from scanloom.stages.exporting.simulation.mass import MassProperties
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.formats.obj import write_obj
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Material, Texture

MESH_FOLDER = "meshes"
# MuJoCo refuses meshes with fewer vertices.
_MIN_VERTICES = 4


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, z-up, in metres.

    Attributes
    ----------
    name : name in all files.
    visual : mesh with texture or colours.
    parts : convex collision parts.
    mass : mass properties.
    is_static : the body does not move.
    proof : proven bounds of the collision parts.
    cap_ratio : area of surface that was added to close the body, relative to the scanned surface.
    """

    name: str
    visual: Mesh
    parts: tuple[ConvexPart, ...]
    mass: MassProperties
    is_static: bool
    proof: CollisionProof
    cap_ratio: float

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics of the body as JSON-compatible values."""
        return {
            "name": self.name,
            "is_static": self.is_static,
            "triangles": len(self.visual.triangles),
            "collision_parts": len(self.parts),
            "collision_corners": sum(len(part.vertices) for part in self.parts),
            **self.proof.to_dict(),
            "cap_ratio": self.cap_ratio,
            **self.mass.to_dict(),
        }


@dataclass(frozen=True, eq=False)
class VisualFile:
    """OBJ file with the triangles of one material.

    Attributes
    ----------
    file : path relative to the folder of the model.
    material : material of all triangles; None without one.
    """

    file: str
    material: Material | None


@dataclass(frozen=True, eq=False)
class BodyFiles:
    """Mesh files of a body, relative to the folder of the model.

    Attributes
    ----------
    body : the body.
    visuals : one file per material, because MJCF has one material per mesh.
    collisions : one file per convex part.
    visual_bytes, collision_bytes : sizes of the meshes without images.
    """

    body: Body
    visuals: tuple[VisualFile, ...]
    collisions: tuple[str, ...]
    visual_bytes: int
    collision_bytes: int


def write_body_meshes(folder: Path, body: Body) -> BodyFiles:
    """Write the visual and collision meshes of a body as OBJ files."""
    (folder / MESH_FOLDER).mkdir(exist_ok=True)
    visuals = []
    for number, mesh in enumerate(_divide_by_material(body.visual)):
        file = f"{MESH_FOLDER}/{body.name}_visual{number}.obj"
        write_obj(folder / file, mesh)
        material = None if mesh.texture is None else mesh.texture.materials[0]
        visuals.append(VisualFile(file, material))
    width = len(str(len(body.parts) - 1))
    collisions = []
    for number, part in enumerate(body.parts):
        file = f"{MESH_FOLDER}/{body.name}_collision{number:0{width}}.obj"
        _write_part(folder / file, part)
        collisions.append(file)

    def measure(files: Sequence[str]) -> int:
        return sum((folder / file).stat().st_size for file in files)

    return BodyFiles(
        body,
        tuple(visuals),
        tuple(collisions),
        measure([one.file for one in visuals]),
        measure(collisions),
    )


def _write_part(path: Path, part: ConvexPart) -> None:
    """Write a part; coordinates are multiples of a power of ten, so that few digits are exact."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in part.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (part.triangles + 1).tolist()]
    with write_file_atomically(path) as draft:
        draft.write_text("\n".join([*lines, ""]), encoding="ascii", newline="\n")


def _divide_by_material(mesh: Mesh) -> list[Mesh]:
    """Divide a mesh into meshes of one material each; textured ones have texture coordinates throughout."""
    texture = mesh.texture
    if texture is None:
        one = _select_triangles(mesh, np.ones(len(mesh.triangles), bool))
        return [one] if len(one.vertices) >= _MIN_VERTICES else []
    ids = np.where(texture.has_uvs(), texture.material_ids, -1)
    divided = []
    for number in np.unique(ids).tolist():
        one = _select_triangles(mesh, ids == number)
        if len(one.vertices) < _MIN_VERTICES:
            continue
        if number < 0:
            divided.append(one.with_(texture=None))
            continue
        uvs = texture.uvs[ids == number]
        own = Texture(uvs, np.zeros(len(uvs), np.int32), (texture.materials[number],))
        divided.append(one.with_(texture=own))
    return divided


def _select_triangles(mesh: Mesh, chosen: np.ndarray) -> Mesh:
    """Return the chosen triangles with the vertices in use, without corner normals and parts."""
    used, index = np.unique(mesh.triangles[chosen], return_inverse=True)
    return Mesh(
        mesh.vertices[used],
        index.reshape(-1, 3).astype(np.int32),
        colors=None if mesh.colors is None or mesh.texture is not None else mesh.colors[used],
        normals=None if mesh.normals is None else mesh.normals[used],
        up=mesh.up,
    )
