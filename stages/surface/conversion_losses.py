"""Warning about data that the mesh class of another library cannot hold."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

from stages.surface.mesh import Mesh


class ConversionWarning(UserWarning):
    """Data of a mesh that the target class of a conversion cannot hold."""


def warn_of_losses(class_name: str, losses: Iterable[str]) -> None:
    """Emit one ConversionWarning that names all data left out; none if there is no loss."""
    found = list(losses)
    if found:
        warnings.warn(
            f"{class_name} cannot hold {' and '.join(found)} of this mesh: left out. "
            "Pass the Mesh itself, or write it with write_mesh as GLB, OBJ or PLY.",
            ConversionWarning,
            stacklevel=3,
        )


def find_material_losses(mesh: Mesh) -> list[str]:
    """List what materials say beside image and base colour; empty if they say nothing else."""
    materials = () if mesh.texture is None else mesh.texture.materials
    losses = (
        ("names of materials", any(material.name for material in materials)),
        ("wrap modes of images", any(set(material.wrap) != {"repeat"} for material in materials)),
        ("shading properties of materials", any(material.kept is not None for material in materials)),
    )
    return [name for name, is_lost in losses if is_lost]
