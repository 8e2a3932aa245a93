"""Bodies of a simulation model: visual mesh, collision parts and mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
class HalfSpace:
    """Space below a floor, in the axes of a body.

    Attributes
    ----------
    normal : (3,) unit normal, out of the half-space.
    offset_m : dot product of the normal and the points of the boundary.
    """

    normal: NDArray[np.float64]
    offset_m: float

    @property
    def point(self) -> NDArray[np.float64]:
        """Point (3,) of the boundary."""
        return self.offset_m * self.normal

    def contains(self, part: ConvexPart) -> bool:
        """Return True if a part is inside, up to rounding."""
        return float((part.vertices @ self.normal).max()) <= self.offset_m + 1e3 * part.slack_m


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
    is_open : the surface encloses no volume.
    added_ratio : area of the visual mesh that was added to complete an object, relative to all of it.
    position : (3,) origin of the body in the model; all other attributes are relative to it.
    floor : half-space below a floor; formats with half-spaces have it instead of the parts inside of it.
    """

    name: str
    visual: Mesh
    parts: tuple[ConvexPart, ...]
    mass: MassProperties
    is_static: bool
    proof: CollisionProof
    cap_ratio: float
    is_open: bool = False
    added_ratio: float = 0.0
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    floor: HalfSpace | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics of the body as JSON-compatible values."""
        return {
            "name": self.name,
            "is_static": self.is_static,
            "triangles": len(self.visual.triangles),
            "position_m": list(self.position),
            "collision_parts": len(self.parts),
            "boxes": sum(part.box is not None for part in self.parts),
            "has_floor": self.floor is not None,
            "collision_corners": sum(len(part.vertices) for part in self.parts),
            **self.proof.to_dict(),
            "cap_ratio": self.cap_ratio,
            "added_ratio": self.added_ratio,
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
class CollisionShape:
    """Collision part with its file.

    Attributes
    ----------
    name : unique name.
    file : path relative to the folder of the model; None for a box.
    part : the part.
    is_floor : the part is inside of the half-space of the body.
    """

    name: str
    file: str | None
    part: ConvexPart
    is_floor: bool


@dataclass(frozen=True, eq=False)
class BodyFiles:
    """Mesh files of a body, relative to the folder of the model.

    Attributes
    ----------
    body : the body.
    visuals : one file per material, because MJCF has one material per mesh.
    collisions : one per convex part; boxes have no file.
    visual_bytes, collision_bytes : sizes of the meshes without images.
    """

    body: Body
    visuals: tuple[VisualFile, ...]
    collisions: tuple[CollisionShape, ...]
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
        name = f"{body.name}_collision{number:0{width}}"
        part_file = f"{MESH_FOLDER}/{name}.obj" if part.box is None else None
        if part_file is not None:
            _write_part(folder / part_file, part)
        is_floor = body.floor is not None and body.floor.contains(part)
        collisions.append(CollisionShape(name, part_file, part, is_floor))

    def measure(files: Sequence[str]) -> int:
        return sum((folder / file).stat().st_size for file in files)

    return BodyFiles(
        body,
        tuple(visuals),
        tuple(collisions),
        measure([one.file for one in visuals]),
        measure([one.file for one in collisions if one.file is not None]),
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
