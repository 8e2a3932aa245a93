"""Measurements and pictures of a normal mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from scanloom.stages.comparing.compare import CompareParams, compare_surfaces
from scanloom.stages.comparing.distance_map import distance_map
from scanloom.stages.picturing.render import Model, Viewpoint, write_png
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface, bounding_box


def report_levels(
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
