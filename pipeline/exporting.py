"""The stage `export`: the result as glTF where there is no textured.glb, and in few bytes for the web."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stages.exporting.export import ExportParams, export
from stages.exporting.presets import preset
from stages.params import check, param
from stages.surface.mesh import Mesh
from stages.surface.vertex_normals import vertex_normals

FILE, WEB = "simplified.glb", "web.glb"


@dataclass(frozen=True, kw_only=True)
class ExportSection:
    """What a run writes for other programs, beside textured.glb."""

    web: bool = param(
        False,
        "Write web.glb: the result in few bytes, unlit, packed by meshopt, which viewers have to understand.",
    )

    def __post_init__(self) -> None:
        check(self)


def make(folder: Path, mesh: Mesh, name: str | None, params: ExportSection) -> dict[str, Any]:
    """Write what is asked for, and return the figures.

    Parameters
    ----------
    mesh : which says what is up.
    name : of a plain file; None where there is one already.
    """
    figures: dict[str, Any] = {}
    if name is not None:
        shaded = mesh.with_(normals=vertex_normals(mesh)) if len(mesh.triangles) else mesh
        figures["plain"] = export(shaded, folder / name, ExportParams()).figures()
    if params.web:
        figures["web"] = export(mesh, folder / WEB, preset("web")).figures()
    warnings = [note for of_file in figures.values() for note in of_file.pop("notes")]
    return figures | {"warnings": warnings}
