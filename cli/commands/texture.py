"""Command `texture`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from scanloom import stages
from scanloom.cli.bake_output import TEXTURED_SUFFIXES
from scanloom.cli.mesh_arguments import locate_diagnostics, read_mesh_file, write_mesh_file
from scanloom.cli.output import Output
from scanloom.cli.paths import new_folder, require_new_file
from scanloom.cli.scan_argument import ScanFolder, read_scan
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.stages import Mesh, Scan, ScanParams, TextureParams
from scanloom.stages.surface.up_direction import parse_up_direction
from scanloom.stages.texturing.provenance_maps import write_maps


def texture(
    folder: ScanFolder,
    mesh_file: Annotated[
        Path,
        typer.Argument(
            metavar="MESH", help="Mesh file in the coordinates of the scan's poses.", show_default=False
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file to write (.glb, .obj, .ply).", show_default=False),
    ],
    scan: ScanParams,
    texture: TextureParams,
    out: Output,
    up: Annotated[
        str | None,
        typer.Option(
            "--up",
            metavar="AXIS",
            help="Up axis of the scan, to rotate a .glb upright: +x, -x, +y, -y, +z, -z, three numbers, or "
            "none. Default: estimated.",
            show_default=False,
        ),
    ] = None,
    maps: Annotated[
        Path | None,
        typer.Option(
            "--maps",
            metavar="FOLDER",
            help="New folder for maps of the texels: best photo, number of photos, viewing angle and texel "
            "size.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Texture a mesh from the photos of a scan.

    Each point gets its colour from the photos that see it best; occluded photos are not used. Surface that no
    photo sees keeps the colours of the mesh. Any scan with colour and poses will do, also photos of another
    camera with poses in the coordinates of the mesh (COLMAP, nerfstudio).

    Example: scanloom texture my_scan light.ply light.glb
    """
    require_new_file(target, TEXTURED_SUFFIXES)
    given = None if up is None else parse_up_direction(up)
    mesh = read_mesh_file(mesh_file)
    source = read_scan(folder, scan)
    with out.progress("texture", "‰") as progress, locate_diagnostics(mesh_file):
        textured = stages.texture(mesh, source, texture, progress=progress)
    direction = given if up is not None else _up_in(textured.mesh, source)
    write_mesh_file(
        target, textured.mesh.with_(up=None if direction is None else tuple(direction.tolist())), out
    )
    if maps is not None:
        with new_folder(maps) as draft:
            write_maps(draft, textured)
    metrics = textured.to_dict()
    warn_skipped_frames(metrics["frames_skipped"])
    up_axis = None if direction is None else direction.tolist()
    out.result({"output": str(target), **metrics, "up": up_axis})


def _up_in(mesh: Mesh, scan: Scan) -> NDArray[np.float64] | None:
    """Return the up direction of the mesh, or of the scan; None if both are unknown."""
    if mesh.up is not None:
        return np.array(mesh.up)
    from scanloom.pipeline.steps.upright import estimate_scan_up

    found = estimate_scan_up(mesh, scan)
    return None if found is None else found.direction
