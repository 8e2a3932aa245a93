"""Output of the defects found by `check`: lists and a coloured mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom.cli.mesh_arguments import write_mesh_file
from scanloom.cli.output import Output
from scanloom.stages import CheckResult, Mesh
from scanloom.stages.cleaning.check import CLASSES

SavePlaces = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="JSON file for all defects by class, with a point of each.",
        show_default=False,
    ),
]
SavePly = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="PLY file for the mesh, coloured by class of defect.",
        show_default=False,
    ),
]

# Colours of classes, which differ in hue and lightness. Later classes cover earlier ones.
COLORS = {
    "border_edges": (86, 180, 233),
    "inconsistent_edges": (0, 114, 178),
    "thin_triangles": (180, 220, 255),
    "needles": (240, 228, 66),
    "caps": (230, 159, 0),
    "spikes": (204, 121, 167),
    "sharp_edges": (160, 60, 130),
    "focal_vertices": (0, 158, 115),
    "singular_border_triangles": (120, 210, 120),
    "singular_vertices": (0, 100, 60),
    "degenerate_triangles": (20, 20, 20),
    "duplicate_triangles": (90, 60, 30),
    "nonmanifold_edges": (213, 94, 0),
    "intersecting_triangles": (200, 0, 0),
}
_REGULAR = (190, 190, 190)


def list_places(found: CheckResult) -> dict[str, Any]:
    """Return the indices of all defects by class, with one point of each in metres."""
    return {
        name: {
            "kind": CLASSES[name][0],
            "treatment": CLASSES[name][1],
            "places": found.defects[name].tolist(),
            "points_m": found.defect_points[name].tolist(),
        }
        for name in CLASSES
    }


def write_colored_classes(path: Path, mesh: Mesh, found: CheckResult, out: Output) -> None:
    """Write a mesh with its triangles coloured by class of defect, and print the colours."""
    triangles = mesh.triangles
    colors = np.full((len(triangles), 3), _REGULAR, np.uint8)
    for name, color in COLORS.items():
        colors[_triangles_at(found, name)] = color
        if count := len(found.defects[name]):
            out.remark(f"{path}: {name.replace('_', ' ')} ({count:,}) are rgb{color}")
    corners = triangles.reshape(-1)
    apart = Mesh(
        mesh.vertices[corners],
        np.arange(len(corners), dtype=np.int32).reshape(-1, 3),
        colors=np.repeat(colors, 3, axis=0),
    )
    write_mesh_file(path, apart, out)


def _triangles_at(found: CheckResult, name: str) -> NDArray[np.bool_]:
    """Return a mask (m,) of the triangles that are, or touch, a defect of a class."""
    places, kind = found.defects[name], CLASSES[name][0]
    triangles = found.triangles.astype(np.int64)
    if kind == "triangle":
        return np.isin(np.arange(len(triangles)), places)
    if kind == "vertex":
        return np.asarray(np.isin(triangles, places).any(axis=1))
    count = triangles.max(initial=0) + 1
    sides = np.sort(np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2), axis=2)
    keys, chosen = sides[..., 0] * count + sides[..., 1], places[:, 0] * count + places[:, 1]
    return np.asarray(np.isin(keys, chosen).any(axis=1))
