"""Command `patches`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scanloom import stages
from scanloom.cli.mesh_arguments import (
    MeshFile,
    NewMesh,
    locate_diagnostics,
    read_mesh_file,
    remark_written,
    write_mesh_file,
)
from scanloom.cli.output import Output, format_table
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.stages import PatchParams
from scanloom.stages.simplification.planar.patches import color_by_patch
from scanloom.stages.surface.formats.ply import write_ply


def patches(source: MeshFile, target: NewMesh, patches: PatchParams, out: Output) -> None:
    """Segment a mesh into near-planar patches.

    OUT is the mesh, coloured by patch; faces of a PLY file have the index of their patch. Patches are sorted
    by area, largest first. `scanloom simplify --method planar` triangulates these patches.

    Example: scanloom mesh patches clean.ply patches.ply --max-shape 0.02
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_mesh_file(source)
    with locate_diagnostics(source), out.progress("patches", "triangles") as progress:
        found = stages.planar_patches(mesh, patches, progress=progress)
    colored = color_by_patch(mesh, found.triangle_patch)
    if target.suffix.lower() == ".ply":
        kept = found.triangle_patch[found.triangle_patch >= 0]
        target.parent.mkdir(parents=True, exist_ok=True)
        write_ply(target, colored, {"patch": kept.astype(np.float64)})
        remark_written(target, colored, out)
    else:
        write_mesh_file(target, colored, out)
    metrics = {"output": str(target), **found.to_dict()}
    out.result(metrics, None if out.as_json else _patches_text(metrics))


def _patches_text(metrics: Mapping[str, Any]) -> str:
    rows = [["largest patches", "area m²", "triangles", "thickness m", "normal"]]
    for number, patch in enumerate(metrics["largest_patches"]):
        normal = " ".join(f"{x:.2f}" for x in patch["normal"])
        area, thickness = f"{patch['area_m2']:.4g}", f"{patch['thickness_m']:.3g}"
        rows.append([str(number), area, f"{patch['triangles']:,}", thickness, normal])
    few = metrics["patches_of_half_the_area"]
    return (
        f"{metrics['patches']:,} patches, {metrics['area_m2']:.4g} m²; half of that in the {few:,} largest."
        f"\n\n{format_table(rows)}"
    )
