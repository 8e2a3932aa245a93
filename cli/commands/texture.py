"""The command `texture`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import stages
from cli.baked import TEXTURED_SUFFIXES
from cli.mesh_arguments import about_file, read_file, tell_notes, write_file
from cli.output import Output
from cli.paths import new_folder, require_new_file
from cli.scan_argument import ScanFolder, read_scan
from cli.skipped import tell_skipped
from stages import ScanParams, TextureParams
from stages.texturing.maps import write_maps


def texture(
    folder: ScanFolder,
    mesh_file: Annotated[
        Path,
        typer.Argument(
            metavar="MESH", help="Mesh file in the world of the scan's poses.", show_default=False
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file to write (.glb, .obj, .ply).", show_default=False),
    ],
    scan: ScanParams,
    params: TextureParams,
    out: Output,
    maps: Annotated[
        Path | None,
        typer.Option(
            "--maps",
            metavar="FOLDER",
            help="New folder for maps of the images: which photo counts most at a texel, how many count, how "
            "obliquely it was taken, and how wide a texel is.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Give a mesh the colours that the photos of a scan show, as a texture.

    Each place is looked up in the photos that show it best, and nothing is taken through other surfaces.
    Any scan with colour and poses will do, also photos of another camera with poses in the mesh's world
    (COLMAP, nerfstudio); name better poses with --poses. Where no photo shows the mesh, its own colours stay.

    Example: scanloom texture my_scan light.ply light.glb
    """
    require_new_file(target, TEXTURED_SUFFIXES)
    mesh = read_file(mesh_file, out)
    source = read_scan(folder, scan, out)
    with out.progress("texture", "‰") as progress, about_file(mesh_file):
        textured = stages.texture(mesh, source, params, progress=progress)
    tell_notes(target, textured.mesh.notes[len(mesh.notes) :], out)
    write_file(target, textured.mesh, out)
    if maps is not None:
        with new_folder(maps) as draft:
            write_maps(draft, textured)
    figures = textured.figures()
    tell_skipped(out, "texture", figures["frames_skipped"])
    out.result({"output": str(target), **figures})
