"""The optional stage `remesh`, and what the report tells of the normal mesh it makes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stages.comparing.compare import CompareParams, compare_surfaces
from stages.comparing.distance_map import distance_map
from stages.normal_meshes.remesh import RemeshParams, remesh
from stages.params import param
from stages.picturing.render import Model, Viewpoint, write_png
from stages.progress import Progress
from stages.surface.formats.ply import read_ply
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface, bounding_box


@dataclass(frozen=True, kw_only=True)
class RemeshSection(RemeshParams):
    """Whether a run makes a normal mesh of the simplified one, and which."""

    enabled: bool = param(
        False,
        "Make a normal mesh of the simplified one: even triangles at several levels of detail, and a small "
        "file of them.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )


def make(folder: Path, mesh: Mesh, params: RemeshSection, progress: Progress) -> dict[str, Any]:
    """Write remeshed.ply, remeshed.snm and all levels in levels/, and return the figures."""
    found = remesh(mesh, params, progress=progress)
    found.write(folder / "remeshed.ply")
    found.write_levels(folder / "levels")
    found.save(folder / "remeshed.snm")
    return found.figures()


def read_levels(folder: Path) -> list[Mesh]:
    """Return the levels that `make` wrote, the base mesh first."""
    count = len(list((folder / "levels").iterdir()))
    return [read_ply(folder / "levels" / f"level_{level}.ply") for level in range(count)]


def report(
    folder: Path | None,
    original: Mesh,
    levels: Sequence[Mesh],
    viewpoint: Viewpoint,
    compared: CompareParams,
) -> tuple[dict[str, Any], list[str]]:
    """Measure each level, draw it with its triangles, and paint the original with how far off the last is.

    Parameters
    ----------
    folder : for the pictures; None to draw none.
    original : the mesh that was remeshed.
    compared : as for the whole mesh; each level gets a quarter of the samples.

    Returns
    -------
    Figures, and the names of the pictures: `remeshed-level_<k>.png` and `remeshed-distance.png`. In the
    latter, the last colour stands for `full_scale_m` of the figures, or more.
    """
    fewer = replace(compared, samples=math.ceil(compared.samples / 4))
    box = bounding_box(original, *levels)
    reference, figures, images = Surface(original, box), [], {}
    for level, mesh in enumerate(levels):
        surface = Surface(mesh, box)
        found = compare_surfaces(reference, surface, fewer)
        counts = {"level": level, "vertices": len(mesh.vertices), "triangles": len(mesh.triangles)}
        figures.append(counts | {"to_simplified": found.figures()})
        if folder is not None:
            images[f"remeshed-level_{level}.png"] = Model(surface).draw(viewpoint, "edges")
    if folder is None:
        return {"levels": figures, "full_scale_m": None}, []
    painted, full_scale = distance_map(original, surface)
    images["remeshed-distance.png"] = Model(Surface(painted, box)).draw(viewpoint)
    for name, image in images.items():
        write_png(folder / name, image)
    return {"levels": figures, "full_scale_m": full_scale}, list(images)
