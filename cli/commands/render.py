"""The command `render`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import stages
from cli.mesh_arguments import MeshFile, read_file
from cli.output import Output
from cli.paths import require_new_file
from cli.scan_argument import read_scan
from stages import ScanParams, UsageError
from stages.params import check, param, with_former_names
from stages.picturing.render import write_png


@with_former_names
@dataclass(frozen=True, kw_only=True)
class PictureParams:
    """How a picture of a mesh is taken."""

    viewpoint: int = param(
        1, "Which of the viewpoints around the mesh, counted from 1.", low=1, high=8, was="view"
    )
    width: int = param(1200, "Width of the picture.", unit="px", low=16, high=8192)
    shading: str = param(
        "color",
        "Vertex colours, plain clay that shows the shape, or clay with the edges of the triangles.",
        choices=("color", "plain", "edges"),
    )

    def __post_init__(self) -> None:
        check(self)


def render(
    source: MeshFile,
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="Picture to write (.png).", show_default=False)
    ],
    params: PictureParams,
    reading: ScanParams,
    out: Output,
    scan: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Scan the mesh was made from: look from its cameras.", show_default=False
        ),
    ] = None,
) -> None:
    """Draw a picture of a mesh, without a window or a GPU.

    Example: scanloom render simplified.ply picture.png --shading edges --viewpoint 2
    """
    require_new_file(target, (".png",))
    if scan is None and reading != ScanParams():
        raise UsageError("how to read a scan is said, but no scan is given; name it with --scan.")
    frames = read_scan(scan, reading, out).frames if scan is not None else ()
    mesh = read_file(source, out)
    around = stages.viewpoints(mesh, max(params.viewpoint, 4), frames=frames, width=params.width)
    if params.viewpoint > len(around):
        raise UsageError(f"--viewpoint is {params.viewpoint}, but there are only {len(around)} viewpoints.")
    viewpoint = around[params.viewpoint - 1]
    target.parent.mkdir(parents=True, exist_ok=True)
    write_png(target, stages.render(mesh, viewpoint, shading=params.shading))  # type: ignore[arg-type]
    figures = {"output": str(target), "viewpoint": viewpoint.name}
    out.result(figures | {"width_px": viewpoint.camera.width, "height_px": viewpoint.camera.height})
