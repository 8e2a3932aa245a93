"""Proven bounds of each triangle, written as properties of a PLY file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom.cli.output import Output
from scanloom.stages import Mesh
from scanloom.stages.surface.formats.ply import write_ply

SaveBounds = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="PLY file for the mesh with the proven bounds of each face: shape_bound in m, color_bound in "
        "8-bit levels. It may be the mesh file.",
        show_default=False,
    ),
]


def write_bounds(
    path: Path,
    mesh: Mesh,
    shape_bound: NDArray[np.float64] | None,
    color_bound: NDArray[np.float64] | None,
    out: Output,
) -> None:
    """Write a mesh to a PLY file with the bounds (q,) of its triangles, metres and 8-bit levels."""
    bounds = {"shape_bound": shape_bound, "color_bound": color_bound}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(path, mesh, {name: values for name, values in bounds.items() if values is not None})
    out.remark(f"{path}: bounds of {len(mesh.triangles):,} triangles")
