"""Report of data that the mesh class of another library cannot hold."""

from __future__ import annotations

from collections.abc import Iterable

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.surface.codes import MESH_CONVERSION_LOSS
from scanloom.stages.surface.mesh import Mesh


def report_losses(class_name: str, losses: Iterable[str]) -> None:
    """Emit one warning that names all data left out; none if there is no loss."""
    found = list(losses)
    if found:
        emit(
            MESH_CONVERSION_LOSS.warning(
                "{class_name} cannot hold {losses} of this mesh: left out.",
                remedy="Pass the Mesh itself, or write it with write_mesh as GLB, OBJ or PLY.",
                class_name=class_name,
                losses=" and ".join(found),
            )
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
