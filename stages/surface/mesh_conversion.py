"""Conversion of meshes from and to Open3D and trimesh.

Only a library that is in use is imported. `open3d_meshes` converts the classes of Open3D, `trimesh_meshes`
the class of trimesh. Data that a class cannot hold is reported with the code `mesh.conversion-loss`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.library_protocols import Open3DLegacyMesh, Open3DMesh, TrimeshMesh
from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.open3d_meshes import from_open3d, from_open3d_legacy, to_open3d, to_open3d_legacy
from scanloom.stages.surface.surface_color import multiply_base_color, sample_bilinear
from scanloom.stages.surface.texture import Image, Material
from scanloom.stages.surface.trimesh_meshes import from_trimesh, to_trimesh

__all__ = [
    "MeshLike",
    "as_mesh",
    "bake_vertex_colors",
    "to_open3d",
    "to_open3d_legacy",
    "to_trimesh",
]

MeshLike: TypeAlias = Mesh | Open3DMesh | Open3DLegacyMesh | TrimeshMesh | tuple[ArrayLike, ArrayLike]

_DEFAULT_GREY = 128  # 8-bit grey level of vertices without any colour


def as_mesh(data: MeshLike, where: str = "mesh") -> Mesh:
    """Convert any supported mesh to a validated Mesh.

    Arrays of other libraries are copied.

    Parameters
    ----------
    data : Mesh, open3d.t.geometry.TriangleMesh, open3d.geometry.TriangleMesh, trimesh.Trimesh, or (vertices
        (n, 3), triangles (m, 3)). Float colours of Open3D are 0 to 1.
    where : name of the mesh in messages.

    Raises
    ------
    MeshError
        If the type is unsupported, shapes are wrong, values are not finite, or indices are out of range.
    """
    if isinstance(data, Mesh):
        return validate_mesh(data, where)
    if isinstance(data, tuple) and len(data) == 2:
        return validate_mesh(Mesh(np.asarray(data[0]), np.asarray(data[1])), where)
    # Classes are recognised by name and module, because isinstance would need an import of the library. Type
    # checkers use the protocols of `library_protocols` instead.
    other: Any = data
    for cls in type(data).__mro__:
        module = cls.__module__
        if cls.__name__ == "TriangleMesh" and module.startswith("open3d."):
            if ".t.geometry" not in module:
                return validate_mesh(from_open3d_legacy(other), where)
            with collecting() as diagnostics:
                mesh = validate_mesh(from_open3d(other, where), where)
            return mesh.with_(diagnostics=tuple(diagnostics))
        if cls.__name__ == "Trimesh" and module.startswith("trimesh."):
            with collecting() as diagnostics:
                mesh = from_trimesh(other, where)
            return mesh.with_(diagnostics=tuple(diagnostics))
    raise MeshError(
        USAGE_ARGUMENT_INVALID,
        (
            "is a {data_name}; a Mesh, an Open3D or trimesh triangle mesh, or a pair of "
            "arrays (vertices, triangles) is expected."
        ),
        where,
        data_name=type(data).__name__,
    )


def bake_vertex_colors(mesh: Mesh) -> Mesh:
    """Bake the texture into vertex colours; return the mesh unchanged without a texture.

    Each textured corner samples its image bilinearly with the material's wrap mode, times the base colour. A
    vertex gets the mean of its corners, which differ only along seams. Without an image, vertices keep their
    colour, else get the base colour of their material, else grey. If no material has a colour, the result has
    no new colours. An image that cannot be decoded is reported as a warning.
    """
    texture = mesh.texture
    if texture is None:
        return mesh
    count = len(mesh.vertices)
    sums, corner_counts = np.zeros((count, 3)), np.zeros(count)
    has_uvs = texture.has_uvs()
    for number, material in enumerate(texture.materials):
        chosen = texture.material_ids == number
        for rows, image in ((chosen & has_uvs, material.image), (chosen & ~has_uvs, None)):
            samples = _sample_corner_colors(material, image, texture.uvs[rows].reshape(-1, 2))
            if samples is None or (image is None and mesh.colors is not None):
                continue
            corners = mesh.triangles[rows].reshape(-1)
            corner_counts += np.bincount(corners, minlength=count)
            for channel in range(3):
                sums[:, channel] += np.bincount(corners, samples[:, channel], minlength=count)
    colored = corner_counts > 0
    colors = mesh.colors
    if colored.any():
        colors = np.full((count, 3), _DEFAULT_GREY, np.uint8) if colors is None else colors.copy()
        colors[colored] = np.rint(sums[colored] / corner_counts[colored, None]).astype(np.uint8)
    return mesh.with_(colors=colors, texture=None)


def _sample_corner_colors(
    material: Material, image: Image | None, uvs: NDArray[np.float64]
) -> NDArray[np.floating] | None:
    """Return colours (k, 3) in 8-bit levels at texture coordinates (k, 2); None if the material has none."""
    if image is not None and len(uvs):
        try:
            return multiply_base_color(sample_bilinear(image.pixels, uvs, material.wrap), material)
        except MeshError as error:
            emit(replace(error.diagnostic, severity=Severity.WARNING))
    if material.base_color is None:
        return None
    return np.tile(np.array(material.base_color[:3]) * 255, (len(uvs), 1))
