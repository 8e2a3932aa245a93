"""The stages of the pipeline, declared: what each reads and writes, what decides its result, what it runs.

pairs ──depth──▶ frames ──────────fuse──▶ fused ──clean──▶ clean ──simplify──▶ simplified ──report──▶ report
                   ├─register─▶ posed ─▲                                       ├──texture──▶ textured ─▲
                   └─adjust──▶ adjusted ▲                       │              ├──remesh──▶ remeshed ──▲
                                                                └─lod─▶ levels └──bake──▶ baked
                                                                          └─tiles─▶ tileset
(upright makes `standing` of clean, and of the plane that fuse may have left out; all read it that write glTF
or tiles: texture, bake, tiles, export, coverage; export makes of simplified, or textured, what other programs
open)
(an RGB-D scan is frames from the start, and has no depth stage, unless a network fills in its depth;
single views with poses go the way of pairs; depth reads the `network` of `depth.model`, if it is set;
coverage reads clean and what fuse reads, if it is enabled; register is there where poses are missing; adjust
where frames have colour and measured depth, from what register found; texture where frames have colour; bake,
remesh and lod if they are enabled; lod reads simplified, too, where clean is large; bake reads clean, too,
tiles clean and textured; texture, lod, tiles and report what fuse reads, and report frames that were
`held_out`)

Stages that read the scan itself also read its `names` and `times`, if their results tell of them, and what is
known of its `world`: upright makes use of it, and depth hands it on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from pipeline import (
    adjusting,
    baking,
    covering,
    exporting,
    fusing,
    holding_out,
    levels,
    registering,
    remeshing,
    report,
    texturing,
    tiling,
    upright,
    versions,
)
from pipeline.bricks import KeptBricks
from pipeline.depth_maps import measure_of, write_depth_maps
from pipeline.engine import Job, Stage
from pipeline.expectation import Cost
from pipeline.large import (
    is_clean_large,
    is_large,
    pieces_of,
    read_proof,
    some_of,
    surface_of,
    whole,
    write_proof,
)
from pipeline.own_paths import from_folder
from pipeline.skipped import said_of_skipped
from pipeline.standing import Up, read_up
from stages.adjusting.adjust import adjust
from stages.cleaning.clean import clean
from stages.cleaning.clean_in_pieces import clean_in_pieces
from stages.comparing.compare import compare_surfaces
from stages.comparing.left_out import left_out as left_out_of_all
from stages.exporting.export import export
from stages.inspecting.coverage.coverage import coverage
from stages.inspecting.libraries import installed
from stages.inspecting.sanity import pose_doubts, require_poses
from stages.inspecting.view_poses import require_view_poses
from stages.lod.slod import read_slod
from stages.lod.tiles import write_tiles
from stages.normal_meshes.unmet import unmet as not_close
from stages.registration.register import register
from stages.scans.read import read_scan
from stages.scans.scan import Frame, Scan
from stages.simplification.result import Simplified
from stages.simplification.simplify import simplify
from stages.simplification.simplify_in_pieces import InPieces, simplify_in_pieces
from stages.simplification.unmet import unmet as not_simplified
from stages.surface.formats.ply import read_ply, write_ply
from stages.surface.mesh_files import read_mesh
from stages.surface.pieces import Pieces
from stages.texturing.bake import bake
from stages.texturing.texture import texture

# Under this name the report reads the frames that were kept from all other stages.
HELD_OUT = "held_out"
# And under this one the texture reads other photos than the frames'.
PHOTOS = "photos"
# And under this one depth reads a network of the user's own, and what stands beside it.
NETWORK = "network"

# What stages read beside the scan: see `pipeline.digest.label_digests`.
LABELS = ("names", "times", "world")

# The folder of what adjust found; where nothing is better there is none.
_ADJUSTED = "adjusted"


def _depth(job: Job) -> Mapping[str, Any]:
    scan: Scan = job.inputs["pairs"]
    if scan.is_views and job.config.scan.check_poses:
        require_view_poses(scan)
    measured = measure_of(scan)(scan, job.config.depth, job.progress)
    figures = _with_skipped(write_depth_maps(job.folder, measured, scan))
    return from_folder(figures, scan.folder)


def _register(job: Job) -> Mapping[str, Any]:
    scan = _scan(job)
    found = register(scan, job.config.register, progress=job.progress)
    figures = _with_skipped(registering.write(job.folder, found, scan.folder))
    return from_folder(figures, scan.folder)


def _adjust(job: Job) -> Mapping[str, Any]:
    scan = _frames(job)
    if job.config.scan.check_poses:
        # What fuse refuses, and is no matter of centimetres; what is only suspected, it tells.
        require_poses(scan)
    found = adjust(scan, job.config.adjust, progress=job.progress)
    if found.accepted:
        beside = job.folder / _ADJUSTED
        beside.mkdir()
        adjusting.write(beside, found)
    figures = found.figures()
    # Depth of a sensor alone tells: what is computed from pairs or views is off by patches of its own.
    are_given = "posed" not in job.inputs and isinstance(job.inputs["frames"], Scan)
    if job.config.scan.check_poses and are_given and not found.accepted:
        figures = {**figures, "warnings": [*figures["warnings"], *pose_doubts(scan.frames)]}
    return from_folder(figures, scan.folder)


def _fuse(job: Job) -> Mapping[str, Any]:
    unplaced = _scan(job)
    scan = _placed(unplaced, job)
    doubts = require_poses(scan) if job.config.scan.check_poses else []
    kept = KeptBricks(job, scan, versions.of_fuse({}, job.config), installed("opencv"))
    fused = fusing.make(job.folder, scan, job.config.fuse, kept, job.progress)
    figures = fused.figures()
    if "posed" in job.inputs:
        doubts += fusing.fuse_apart(job.folder, unplaced, job.inputs["posed"], job.config.fuse)
    figures = _with_skipped({**figures, "warnings": [*doubts, *figures["warnings"]]})
    return from_folder(figures, scan.folder)


def _clean(job: Job) -> Mapping[str, Any]:
    fused, result = job.inputs["fused"] / "fused.ply", job.folder / "clean.ply"
    if is_large(fused):
        return clean_in_pieces(fused, result, job.config.clean, progress=job.progress)
    cleaned = clean(read_ply(fused), job.config.clean)
    write_ply(result, cleaned.mesh)
    told = {} if cleaned.repaired is None else {"warnings": list(cleaned.repaired.mesh.notes)}
    return {**cleaned.figures(), **told}


def _upright(job: Job) -> Mapping[str, Any]:
    mesh = some_of(job.inputs["clean"] / "clean.ply")
    plane = fusing.up_from_plane(job.inputs["fused"])
    return upright.make(job.folder, mesh, _frames(job), plane, job.config.upright)


def _up(job: Job) -> Up | None:
    return read_up(job.inputs["standing"])


def _simplify(job: Job) -> Mapping[str, Any]:
    path = job.inputs["clean"] / "clean.ply"
    simplified: Simplified[Any] | InPieces
    if is_large(path):
        simplified = simplify_in_pieces(path, job.config.simplify, scratch=job.folder, progress=job.progress)
        write_proof(job.folder, simplified.figures())
    else:
        simplified = simplify(read_ply(path), job.config.simplify, progress=job.progress)
    write_ply(job.folder / "simplified.ply", simplified.mesh)
    return simplified.figures()


def _texture(job: Job) -> Mapping[str, Any]:
    scan: Scan = job.inputs[PHOTOS] if PHOTOS in job.inputs else _frames(job)
    mesh = read_ply(job.inputs["simplified"] / "simplified.ply")
    figures = texturing.make(job.folder, mesh, scan.frames, job.config.texture, _up(job), job.progress)
    return from_folder(_with_skipped(figures), scan.folder)


def _bake(job: Job) -> Mapping[str, Any]:
    light = read_ply(job.inputs["simplified"] / "simplified.ply")
    original = whole(job.inputs["clean"] / "clean.ply", "bake")
    return baking.make(job.folder, light, original, _up(job), job.config.bake, job.progress)


def _remesh(job: Job) -> Mapping[str, Any]:
    mesh = read_ply(job.inputs["simplified"] / "simplified.ply").with_(up=_up(job))
    return remeshing.make(job.folder, mesh, job.config.remesh, job.progress)


def _lod(job: Job) -> Mapping[str, Any]:
    clean, params = job.inputs["clean"] / "clean.ply", job.config.lod
    if not is_large(clean):
        mesh = read_ply(clean).with_(up=_up(job))
        return levels.make(job.folder, mesh, _frames(job).frames, params, job.progress)
    folder = job.inputs["simplified"]
    mesh = read_ply(folder / "simplified.ply").with_(up=_up(job))
    count = Pieces(clean).triangle_count
    return levels.make_of_simplified(job.folder, mesh, read_proof(folder), count, params, job.progress)


def _tiles(job: Job) -> Mapping[str, Any]:
    hierarchy = read_slod(job.inputs["levels"] / levels.FILE)
    model = read_mesh(job.inputs["textured"] / texturing.FILE) if "textured" in job.inputs else None
    return tiling.make(job.folder, hierarchy, model, job.config.tiles, _up(job), job.progress)


def _export(job: Job) -> Mapping[str, Any]:
    if "textured" in job.inputs:
        mesh, name = read_mesh(job.inputs["textured"] / texturing.FILE), None
    else:
        mesh, name = read_ply(job.inputs["simplified"] / "simplified.ply"), exporting.FILE
    return exporting.make(job.folder, mesh.with_(up=_up(job)), name, job.config.export)


def _coverage(job: Job) -> Mapping[str, Any]:
    scan = _frames(job)
    mesh = surface_of(job.inputs["clean"] / "clean.ply")
    figures = covering.make(job.folder, mesh, scan.frames, job.config.coverage, _up(job), job.progress)
    return from_folder(_with_skipped(figures), scan.folder)


def _report(job: Job) -> Mapping[str, Any]:
    # Neither of these has to have room in memory.
    origins = {name: pieces_of(job.inputs[name] / f"{name}.ply") for name in ("fused", "clean")}
    meshes = {"simplified": read_ply(job.inputs["simplified"] / "simplified.ply")}
    by_photo = None
    if "textured" in job.inputs:
        meshes["textured"] = read_mesh(job.inputs["textured"] / texturing.FILE)
        maps = job.inputs["textured"] / texturing.MAPS
        by_photo = partial(texturing.by_photo, meshes["textured"], maps)
    pictures = job.folder / "pictures"
    pictures.mkdir()
    frames, params = _frames(job).frames, job.config.report
    held_out = _held_out(job) if HELD_OUT in job.inputs else []
    shown = {**origins, **meshes}
    made = report.make(pictures, shown, frames, job.config.compare, params, job.progress, by_photo, held_out)
    drawn_in = pictures if params.pictures else None
    if "remeshed" in job.inputs:
        levels = remeshing.read_levels(job.inputs["remeshed"])
        viewpoint = report.viewpoints_of(origins["fused"], frames, params)[-1]
        made["normal_mesh"], drawn = remeshing.report(
            drawn_in, meshes["simplified"], levels, viewpoint, job.config.compare
        )
        made["pictures"] += drawn
    if HELD_OUT in job.inputs:
        result = meshes.get("textured", meshes["simplified"])
        made["held_out"], drawn = holding_out.judge(drawn_in, result, held_out, job.progress)
        made["pictures"] += drawn
    return {**made, "pictures": [f"pictures/{name}" for name in made["pictures"]]}


def _held_out(job: Job) -> list[Frame]:
    """Return the frames that no stage saw, placed like their neighbours."""
    scan, held_out = _scan(job), job.inputs[HELD_OUT].frames
    every = job.config.scan.hold_out
    return holding_out.like_neighbours(held_out, every, scan.frames, _placed(scan, job).frames)


def _with_skipped(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Add to a stage's warnings that it skipped frames, if it did."""
    warnings = list(figures.get("warnings", ()))
    skipped = figures["frames_skipped"]
    if skipped:
        warnings.append(said_of_skipped(skipped))
    return {**figures, "warnings": warnings}


def _frames(job: Job) -> Scan:
    return _placed(_scan(job), job)


def _placed(scan: Scan, job: Job) -> Scan:
    """Return the scan with the poses that were found, and made better, if they were."""
    if "posed" in job.inputs:
        scan = registering.placed(scan, job.inputs["posed"])
    return adjusting.placed(scan, job.inputs["adjusted"] / _ADJUSTED) if "adjusted" in job.inputs else scan


def _scan(job: Job) -> Scan:
    """Return the RGB-D scan, or the one the depth stage left."""
    frames = job.inputs["frames"]
    # No message should name the cache's folder, which is that of the depth stage's scan.
    if isinstance(frames, Path):
        return replace(read_scan(frames, complete=False), folder=None)
    return cast(Scan, frames)


# The most that stages take which go piece by piece: by a building of a hundred million triangles.
_PIECES = 1.7e9

# Costs are what samples and the README's scans took on two cores, roundly.
STAGES: tuple[Stage, ...] = (
    Stage(
        name="depth",
        reads=("pairs", "names", "world", NETWORK),
        writes="frames",
        sections=("depth",),
        make=_depth,
        versions=versions.of_depth,
        libraries=installed("opencv"),
        results=("points.ply",),
        cost=Cost(seconds_per_megapixel=0.5, bytes=500e6, bytes_per_megapixel=1e6, by_voxels=False),
    ),
    Stage(
        name="register",
        reads=("frames", "names", "times"),
        writes="posed",
        sections=("register",),
        make=_register,
        versions=versions.of(register),
        libraries=installed("opencv", "open3d"),
        results=("trajectory.tum", "path.ply", "pieces/", "masks/"),
        cost=Cost(seconds_per_megapixel=0.5, bytes=200e6, bytes_per_megapixel=1e6, by_voxels=False),
    ),
    Stage(
        name="adjust",
        reads=("frames", "posed", "names", "times"),
        writes="adjusted",
        sections=("adjust",),
        make=_adjust,
        versions=versions.of_adjust,
        libraries=installed("opencv", "scipy"),
        results=(f"{_ADJUSTED}/",),
        cost=Cost(
            seconds=2,
            seconds_per_megapixel=1,
            bytes=200e6,
            bytes_per_megapixel=6e6,
            by_voxels=False,
            # Of key frames, of which there are 200 at most.
            most_bytes=900e6,
        ),
    ),
    Stage(
        name="fuse",
        reads=("frames", "posed", "adjusted", "names"),
        writes="fused",
        sections=("fuse",),
        make=_fuse,
        versions=versions.of_fuse,
        libraries=installed("scanloom", "opencv", "open3d"),
        results=("fused.ply", "pieces/"),
        cost=Cost(seconds_per_megapixel=0.4),
    ),
    Stage(
        name="clean",
        reads=("fused",),
        writes="clean",
        sections=("clean",),
        make=_clean,
        versions=versions.of_clean,
        results=("clean.ply",),
        cost=Cost(seconds_per_megapixel=0.08, most_bytes=_PIECES),
    ),
    Stage(
        name="upright",
        reads=("frames", "posed", "adjusted", "fused", "clean", "world"),
        writes="standing",
        sections=("upright",),
        make=_upright,
        versions=versions.of(upright.make),
        cost=Cost(seconds=0.5, most_bytes=_PIECES),
    ),
    Stage(
        name="simplify",
        reads=("clean",),
        writes="simplified",
        sections=("simplify",),
        make=_simplify,
        versions=versions.of_simplify,
        libraries=installed("scanloom"),
        results=("simplified.ply",),
        unmet=lambda config, figures: not_simplified(config.simplify, figures),
        cost=Cost(seconds_per_megapixel=0.15, most_bytes=_PIECES),
    ),
    Stage(
        name="texture",
        reads=("frames", "posed", "adjusted", "simplified", "standing", "names", PHOTOS),
        writes="textured",
        sections=("texture",),
        make=_texture,
        versions=versions.of(texture),
        libraries=installed("scanloom", "opencv"),
        results=(texturing.FILE, f"{texturing.MAPS}/"),
        cost=Cost(
            seconds=2,
            seconds_per_megapixel=0.5,
            bytes=8e8,
            bytes_per_megapixel=3e6,
            by_voxels=False,
            most_bytes=_PIECES,
        ),
    ),
    Stage(
        name="bake",
        reads=("clean", "simplified", "standing"),
        writes="baked",
        sections=("bake",),
        make=_bake,
        versions=versions.of(bake, compare_surfaces),
        libraries=installed("scanloom", "open3d", "opencv"),
        results=("baked.glb",),
        cost=Cost(seconds=10, seconds_per_megapixel=1, bytes=300e6),
    ),
    Stage(
        name="remesh",
        reads=("simplified", "standing"),
        writes="remeshed",
        sections=("remesh",),
        make=_remesh,
        versions=versions.of_remesh,
        libraries=installed("scanloom"),
        results=("remeshed.ply", "remeshed.snm", "levels/"),
        unmet=lambda config, figures: not_close(config.remesh.max_error, figures),
        cost=Cost(seconds=2, seconds_per_megapixel=0.5, bytes=300e6),
    ),
    Stage(
        name="lod",
        reads=("frames", "posed", "adjusted", "clean", "simplified", "standing"),
        writes="levels",
        sections=("lod",),
        make=_lod,
        when={"simplified": is_clean_large},
        versions=versions.of_lod,
        libraries=installed("scanloom", "opencv", "scipy"),
        results=(levels.FILE,),
        cost=Cost(seconds=10, seconds_per_megapixel=2, bytes=500e6, bytes_per_megapixel=10e6),
    ),
    Stage(
        name="tiles",
        reads=("standing", "levels", "textured"),
        writes="tileset",
        sections=("tiles",),
        make=_tiles,
        versions=versions.of(tiling.make, write_tiles),
        libraries=installed("scanloom", "opencv", "open3d", "scipy"),
        results=(f"{tiling.FOLDER}/",),
        cost=Cost(seconds=10, seconds_per_megapixel=1, bytes=700e6, bytes_per_megapixel=10e6),
    ),
    Stage(
        name="export",
        reads=("simplified", "standing", "textured"),
        writes="exported",
        sections=("export",),
        make=_export,
        versions=versions.of(export),
        libraries=installed("scanloom", "opencv"),
        results=(exporting.FILE, exporting.WEB),
        cost=Cost(seconds=1, bytes=300e6),
    ),
    Stage(
        name="coverage",
        reads=("frames", "posed", "adjusted", "clean", "standing", "names"),
        writes="covered",
        sections=("coverage",),
        make=_coverage,
        versions=versions.of(coverage),
        libraries=installed("open3d", "opencv", "scipy"),
        results=(covering.MESH, covering.MODEL, covering.FILE),
        cost=Cost(seconds=2, seconds_per_megapixel=0.15, bytes=300e6, most_bytes=_PIECES),
    ),
    Stage(
        name="report",
        reads=(
            "frames",
            "posed",
            "adjusted",
            "fused",
            "clean",
            "simplified",
            "textured",
            "remeshed",
            "names",
            HELD_OUT,
        ),
        writes="report",
        sections=("compare", "report"),
        make=_report,
        versions=versions.of(report.make, compare_surfaces, left_out_of_all),
        libraries=installed("open3d", "opencv", "scikit-image"),
        results=("pictures/",),
        cost=Cost(seconds=6, seconds_per_megapixel=0.2, bytes=300e6, most_bytes=_PIECES),
    ),
)
