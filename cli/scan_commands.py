"""Commands on scan folders: inspect, depth, fuse."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import stages
from cli.options import as_typed, with_options
from cli.output import Output
from cli.paths import MESH_SUFFIXES, new_folder, require_new_file, require_scan
from stages import DepthParams, FuseParams, InputError, RegisterParams, ScanParams
from stages.inspecting.picture import inspection_picture
from stages.inspecting.sanity import require_poses
from stages.picturing.render import write_png
from stages.scans.read import require_complete

ScanFolder = Annotated[
    Path,
    typer.Argument(
        metavar="SCAN",
        help="Folder of the scan, or a recording (.bag, .db3, .sens, .r3d).",
        show_default=False,
    ),
]


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("inspect", rich_help_panel="From scan to mesh")(with_options(inspect))
    app.command("depth", rich_help_panel="One stage at a time")(with_options(depth))
    app.command("register", rich_help_panel="One stage at a time")(with_options(register))
    app.command("fuse", rich_help_panel="One stage at a time")(with_options(fuse))


def inspect(
    folder: ScanFolder,
    params: ScanParams,
    out: Output,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture (.png) of where the cameras stand, from above and from the side, and of the middle "
            "frame's depth over its colour.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Say what a scan folder holds: layout, frames, sizes, calibration, poses, depth, and what is odd.

    Example: scanloom inspect my_scan --picture my_scan.png
    """
    if picture is not None:
        require_new_file(picture, (".png",))
    scan = stages.read_scan(require_scan(folder), params, complete=False)
    inspection = stages.inspect(scan)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_png(picture, inspection_picture(scan))
    out.result(inspection.figures(), as_typed("\n".join(inspection.lines())))


def depth(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder for the depth maps.", show_default=False)
    ],
    scan: ScanParams,
    params: DepthParams,
    out: Output,
) -> None:
    """Match the pairs or single views of a scan: depth maps, confidence and a coloured point cloud.

    OUTDIR is then a scan folder itself, which `scanloom fuse` reads.

    Example: scanloom depth my_pairs my_depth --max-depth 30
    """
    from pipeline.depth_maps import write_depth_maps

    source = stages.read_scan(require_scan(folder), scan)
    measure = stages.views_depth if source.is_views else stages.depth_scan
    with new_folder(target) as draft, out.progress("depth", "pairs") as progress:
        figures = write_depth_maps(draft, measure(source, params, progress), len(source.frames))
    out.result({"output": str(target), **figures})


def register(
    folder: ScanFolder,
    target: Annotated[
        Path, typer.Argument(metavar="OUTDIR", help="Folder for poses and cloud.", show_default=False)
    ],
    scan: ScanParams,
    params: RegisterParams,
    out: Output,
) -> None:
    """Find the camera poses of a scan with depth from what its frames show.

    Poses it has are not used, except with --refine, which makes them better. OUTDIR gets trajectory.tum
    (camera-to-world), registration.json (matrices, edges, pieces, where the chain broke), path.ply (a
    coloured cloud, the camera's path in red), and pieces/ with the poses of what could not be joined.

    Example: scanloom register my_scan poses; scanloom fuse my_scan fused.ply --poses poses/trajectory.tum
    """
    from pipeline.registering import write

    source = stages.read_scan(require_scan(folder), scan, complete=False)
    if source.is_stereo:
        raise InputError(
            f"these are stereo pairs without depth; run `scanloom depth {folder} OUTDIR`, register OUTDIR, "
            "or `scanloom run` for the whole way.",
            folder,
        )
    require_complete(source, folder, posed=False)
    with new_folder(target) as draft, out.progress("register", "frames") as progress:
        figures = write(draft, stages.register(source, params, progress=progress))
    out.result({"output": str(target), **figures})


def fuse(
    folder: ScanFolder,
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Mesh file to write (.ply, .obj, .off, .stl, .glb).", show_default=False
        ),
    ],
    scan: ScanParams,
    params: FuseParams,
    out: Output,
) -> None:
    """Fuse the depth maps of a scan into one coloured mesh (TSDF).

    Stereo pairs have no depth yet: run `scanloom depth` on them first and fuse what it leaves.

    Example: scanloom fuse my_scan fused.ply --voxel-size 0.01
    """
    require_new_file(target, MESH_SUFFIXES)
    source = stages.read_scan(require_scan(folder), scan)
    if source.is_stereo or source.is_views:
        what = "stereo pairs" if source.is_stereo else "single views"
        raise InputError(
            f"these are {what} without depth; run `scanloom depth {folder} OUTDIR` and fuse OUTDIR, "
            "or `scanloom run` for the whole way.",
            folder,
        )
    if scan.check_poses:
        for doubt in require_poses(source):
            out.remark(doubt)
    with out.progress("fuse", "frames") as progress:
        fused = stages.fuse(source, params, progress=progress)
    target.parent.mkdir(parents=True, exist_ok=True)
    stages.write_mesh(target, fused.mesh)
    out.result({"output": str(target), **fused.figures()})
