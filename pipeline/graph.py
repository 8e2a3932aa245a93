"""The stages of the pipeline, declared: what each reads and writes, what decides its result, what it runs.

pairs ──depth──▶ frames ──────────fuse──▶ fused ──clean──▶ clean ──simplify──▶ simplified ──report──▶ report
                   ├─register─▶ posed ─▲                                       ├──texture──▶ textured ─▲
                   └─adjust──▶ adjusted ▲                       │              ├──remesh──▶ remeshed ──▲
                                                                └─lod─▶ levels └──bake──▶ baked
                                                                          └─tiles─▶ tileset
(upright makes `standing` of clean, which all read that write glTF or tiles: texture, bake, tiles, export;
export makes of simplified, or textured, what other programs open)
(an RGB-D scan is frames from the start, and has no depth stage; single views with poses go the way of pairs;
register is there where poses are missing; adjust where frames have colour and measured depth, from what
register found; texture where frames have colour; bake, remesh and lod if they are enabled; bake reads clean,
too, tiles clean and textured; texture, lod, tiles and report what fuse reads, and report frames that were
`held_out`)

Stages that read the scan itself also read its `names` and `times`, if their results tell of them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any, cast

from pipeline import (
    adjusting,
    baking,
    exporting,
    holding_out,
    levels,
    registering,
    remeshing,
    report,
    texturing,
    tiling,
    upright,
)
from pipeline.config import Config
from pipeline.depth_maps import write_depth_maps
from pipeline.engine import Job, Stage
from pipeline.expectation import Cost
from pipeline.own_paths import from_folder
from pipeline.skipped import said_of_skipped
from pipeline.standing import Up, read_up
from stages.adjusting.adjust import adjust
from stages.cleaning.clean import clean
from stages.comparing.certify import certify
from stages.comparing.compare import compare_surfaces
from stages.comparing.left_out import left_out as left_out_of_all
from stages.errors import InputError, UsageError
from stages.exporting.export import export
from stages.fusion.fuse import fuse
from stages.fusion.noise import depth_noise
from stages.inspecting.sanity import require_poses
from stages.lod.build import build
from stages.lod.slod import read_slod
from stages.lod.tiles import write_tiles
from stages.normal_meshes.remesh import remesh
from stages.normal_meshes.unmet import unmet as not_close
from stages.registration.register import register
from stages.registration.unmet import unmet as not_joined
from stages.scans.read import read_scan
from stages.scans.scan import Scan
from stages.simplification.auto import chosen
from stages.simplification.methods import METHODS
from stages.simplification.simplify import simplify
from stages.simplification.unmet import unmet as not_simplified
from stages.stereo.depth import depth_scan
from stages.stereo.views_depth import views_depth
from stages.surface.formats.ply import read_ply, write_ply
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import read_mesh
from stages.texturing.bake import bake
from stages.texturing.texture import texture

# The folder of what adjust found; where nothing is better there is none.
_ADJUSTED = "adjusted"


def _depth(job: Job) -> Mapping[str, Any]:
    scan: Scan = job.inputs["pairs"]
    measured = _measure(scan)(scan, job.config.depth, job.progress)
    figures = _with_skipped(write_depth_maps(job.folder, measured, len(scan.frames)))
    return from_folder(figures, scan.folder)


def _measure(scan: Scan) -> Callable[..., Any]:
    return views_depth if scan.is_views else depth_scan


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
    return from_folder(found.figures(), scan.folder)


def _fuse(job: Job) -> Mapping[str, Any]:
    unplaced = _scan(job)
    scan = _placed(unplaced, job)
    doubts = require_poses(scan) if job.config.scan.check_poses else []
    fused = fuse(scan, job.config.fuse, progress=job.progress)
    write_ply(job.folder / "fused.ply", fused.mesh)
    figures = fused.figures()
    doubts += _fuse_apart(unplaced, job)
    figures = _with_skipped({**figures, "warnings": [*doubts, *figures.get("warnings", ())]})
    return from_folder(figures, scan.folder)


def _fuse_apart(scan: Scan, job: Job) -> list[str]:
    """Fuse the pieces that poses could not join to the one that is used, each into a mesh of its own."""
    if "posed" not in job.inputs:
        return []
    said = []
    folder = job.folder / "pieces"
    for number, piece in registering.apart(scan, job.inputs["posed"]).items():
        try:
            mesh = fuse(piece, job.config.fuse).mesh
        except InputError as error:
            said.append(f"piece {number} is not fused: {error}")
            continue
        folder.mkdir(exist_ok=True)
        write_ply(folder / f"fused-{number}.ply", mesh)
        said.append(
            f"piece {number}, of {len(piece.frames)} frames, is fused apart: pieces/fused-{number}.ply"
        )
    return said


def _clean(job: Job) -> Mapping[str, Any]:
    cleaned = clean(read_ply(job.inputs["fused"] / "fused.ply"), job.config.clean)
    write_ply(job.folder / "clean.ply", cleaned.mesh)
    told = {} if cleaned.repaired is None else {"warnings": list(cleaned.repaired.mesh.notes)}
    return {**cleaned.figures(), **told}


def _upright(job: Job) -> Mapping[str, Any]:
    mesh = read_ply(job.inputs["clean"] / "clean.ply")
    return upright.make(job.folder, mesh, _frames(job).frames, job.config.upright)


def _up(job: Job) -> Up | None:
    return read_up(job.inputs["standing"])


def _simplify(job: Job) -> Mapping[str, Any]:
    mesh = read_ply(job.inputs["clean"] / "clean.ply")
    simplified = simplify(mesh, job.config.simplify, progress=job.progress)
    write_ply(job.folder / "simplified.ply", simplified.mesh)
    return simplified.figures()


def _texture(job: Job) -> Mapping[str, Any]:
    scan: Scan = job.inputs[PHOTOS] if PHOTOS in job.inputs else _frames(job)
    mesh = read_ply(job.inputs["simplified"] / "simplified.ply")
    figures = texturing.make(job.folder, mesh, scan.frames, job.config.texture, _up(job), job.progress)
    return from_folder(_with_skipped(figures), scan.folder)


def _bake(job: Job) -> Mapping[str, Any]:
    light, original = (read_ply(job.inputs[name] / f"{name}.ply") for name in ("simplified", "clean"))
    return baking.make(job.folder, light, original, _up(job), job.config.bake, job.progress)


def _remesh(job: Job) -> Mapping[str, Any]:
    mesh = read_ply(job.inputs["simplified"] / "simplified.ply")
    return remeshing.make(job.folder, mesh, job.config.remesh, job.progress)


def _lod(job: Job) -> Mapping[str, Any]:
    mesh = read_ply(job.inputs["clean"] / "clean.ply")
    return levels.make(job.folder, mesh, _frames(job).frames, job.config.lod, job.progress)


def _export(job: Job) -> Mapping[str, Any]:
    if "textured" in job.inputs:
        mesh, name = read_mesh(job.inputs["textured"] / texturing.FILE), None
    else:
        mesh, name = read_ply(job.inputs["simplified"] / "simplified.ply"), exporting.FILE
    return exporting.make(job.folder, mesh.with_(up=_up(job)), name, job.config.export)


def _report(job: Job) -> Mapping[str, Any]:
    names = ("fused", "clean", "simplified")
    meshes = {name: read_ply(job.inputs[name] / f"{name}.ply") for name in names}
    pictures = job.folder / "pictures"
    pictures.mkdir()
    frames, params = _frames(job).frames, job.config.report
    made = report.make(pictures, meshes, frames, job.config.compare, params, job.progress)
    if "remeshed" in job.inputs:
        levels = remeshing.read_levels(job.inputs["remeshed"])
        viewpoint = report.viewpoints_of(meshes["fused"], frames, params)[-1]
        made["normal_mesh"], drawn = remeshing.report(
            pictures, meshes["simplified"], levels, viewpoint, job.config.compare
        )
        made["pictures"] += drawn
    if "textured" in job.inputs and params.pictures:
        viewpoints = report.viewpoints_of(meshes["fused"], frames, params)
        made["pictures"] += texturing.report(pictures, job.inputs["textured"], viewpoints)
    if HELD_OUT in job.inputs:
        made["held_out"], drawn = _held_out(job, pictures, meshes["simplified"])
        made["pictures"] += drawn
    return {**made, "pictures": [f"pictures/{name}" for name in made["pictures"]]}


def _held_out(job: Job, pictures: Path, light: Mesh) -> tuple[dict[str, Any], list[str]]:
    """Compare the frames that no stage saw with the textured mesh, or with the simplified one."""
    mesh = read_mesh(job.inputs["textured"] / texturing.FILE) if "textured" in job.inputs else light
    scan, held_out = _scan(job), job.inputs[HELD_OUT].frames
    every = job.config.scan.hold_out
    frames = holding_out.like_neighbours(held_out, every, scan.frames, _placed(scan, job).frames)
    return holding_out.judge(pictures, mesh, frames, job.progress)


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


def _version(*distributions: str) -> str:
    """Return the installed version of a library, by the names of its distributions; nothing is imported."""
    found = (one.version for name in distributions for one in metadata.distributions(name=name))
    return next(found, "unknown")


_OPENCV = {
    "opencv": _version(
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
        "opencv-python-headless",
        "opencv-python",
    )
}
_OPEN3D = {"open3d": _version("open3d", "open3d-cpu")}
_KERNELS = {"kernels": _version("scanloom")}

Versions = Callable[[Mapping[str, Any], Config], Mapping[str, int]]


def _stated(*functions: Callable[..., Any]) -> dict[str, int]:
    """Return the RESULT_VERSION that stands beside each function, by the name of its file."""
    modules = [sys.modules[function.__module__] for function in functions]
    return {module.__name__.rpartition(".")[2]: module.RESULT_VERSION for module in modules}


def _of(*functions: Callable[..., Any]) -> Versions:
    """Return what tells the versions of a stage that runs these functions, whatever is asked of it."""
    return lambda inputs, config: _stated(*functions)  # noqa: ARG005


def _of_depth(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    # Views are matched in pairs, each as depth_scan does it.
    return _stated(depth_scan, _measure(inputs["pairs"]))


def _of_adjust(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    return _stated(adjust, require_poses) if config.scan.check_poses else _stated(adjust)


def _of_fuse(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    # Poses that are not looked at are not refused, and nothing is said of them.
    return _stated(fuse, require_poses) if config.scan.check_poses else _stated(fuse)


def _of_clean(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    # What is not proven is not repaired.
    return _stated(clean, certify) if config.clean.repair else _stated(clean)


def _of_simplify(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    try:
        method = chosen(config.simplify)  # What clean leaves has neither texture nor parts.
    except UsageError:
        return _stated(simplify)  # No method runs: the stage says what is wrong.
    proof = _stated(certify) if method.proves else {}
    return {**_stated(simplify), method.name: method.result_version, **proof}


def _of_remesh(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    # A base that is never refined is a simplified mesh.
    return {**_stated(remesh, simplify), **{method.name: method.result_version for method in METHODS}}


def _tiles(job: Job) -> Mapping[str, Any]:
    hierarchy = read_slod(job.inputs["levels"] / levels.FILE)
    model = read_mesh(job.inputs["textured"] / texturing.FILE) if "textured" in job.inputs else None
    return tiling.make(job.folder, hierarchy, model, job.config.tiles, _up(job), job.progress)


def _of_lod(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    noise = _stated(depth_noise) if config.lod.base_error is None else {}
    # A base is simplified by `certified`, whose version goes with those of all methods as for remesh.
    methods = {method.name: method.result_version for method in METHODS}
    return {**_stated(levels.make, build, simplify), **methods, **noise}


# Under this name the report reads the frames that were kept from all other stages.
HELD_OUT = "held_out"
# And under this one the texture reads other photos than the frames'.
PHOTOS = "photos"

# What stages read beside the scan: see `pipeline.digest.label_digests`.
LABELS = ("names", "times")

# Costs are what samples and the README's scans took on two cores, roundly.
STAGES: tuple[Stage, ...] = (
    Stage(
        name="depth",
        reads=("pairs", "names"),
        writes="frames",
        sections=("depth",),
        make=_depth,
        versions=_of_depth,
        libraries=_OPENCV,
        results=("points.ply",),
        cost=Cost(seconds_per_megapixel=0.5, bytes=500e6, bytes_per_megapixel=1e6),
    ),
    Stage(
        name="register",
        reads=("frames", "names", "times"),
        writes="posed",
        sections=("register",),
        make=_register,
        versions=_of(register),
        libraries=_OPENCV | _OPEN3D,
        results=("trajectory.tum", "path.ply", "pieces/"),
        unmet=lambda config, figures: not_joined(figures),  # noqa: ARG005
        cost=Cost(seconds_per_megapixel=0.5, bytes_per_megapixel=10e6),
    ),
    Stage(
        name="adjust",
        reads=("frames", "posed", "names", "times"),
        writes="adjusted",
        sections=("adjust",),
        make=_adjust,
        versions=_of_adjust,
        libraries=_OPENCV | {"scipy": _version("scipy")},
        results=(f"{_ADJUSTED}/",),
        cost=Cost(seconds=2, seconds_per_megapixel=1, bytes=200e6, bytes_per_megapixel=6e6),
    ),
    Stage(
        name="fuse",
        reads=("frames", "posed", "adjusted", "names"),
        writes="fused",
        sections=("fuse",),
        make=_fuse,
        versions=_of_fuse,
        libraries=_OPENCV | _OPEN3D,
        results=("fused.ply", "pieces/"),
        cost=Cost(seconds_per_megapixel=0.4),
    ),
    Stage(
        name="clean",
        reads=("fused",),
        writes="clean",
        sections=("clean",),
        make=_clean,
        versions=_of_clean,
        results=("clean.ply",),
        cost=Cost(seconds_per_megapixel=0.08),
    ),
    Stage(
        name="upright",
        reads=("frames", "posed", "adjusted", "clean"),
        writes="standing",
        sections=("upright",),
        make=_upright,
        versions=_of(upright.make),
        cost=Cost(seconds=0.5),
    ),
    Stage(
        name="simplify",
        reads=("clean",),
        writes="simplified",
        sections=("simplify",),
        make=_simplify,
        versions=_of_simplify,
        libraries=_KERNELS,
        results=("simplified.ply",),
        unmet=lambda config, figures: not_simplified(config.simplify, figures),
        cost=Cost(seconds_per_megapixel=0.15),
    ),
    Stage(
        name="texture",
        reads=("frames", "posed", "adjusted", "simplified", "standing", "names", PHOTOS),
        writes="textured",
        sections=("texture",),
        make=_texture,
        versions=_of(texture),
        libraries=_KERNELS | _OPENCV,
        results=(texturing.FILE, f"{texturing.MAPS}/"),
        cost=Cost(seconds=2, seconds_per_megapixel=0.5, bytes=1e9, bytes_per_megapixel=3e6),
    ),
    Stage(
        name="bake",
        reads=("clean", "simplified", "standing"),
        writes="baked",
        sections=("bake",),
        make=_bake,
        versions=_of(bake, compare_surfaces),
        libraries=_KERNELS | _OPEN3D | _OPENCV,
        results=("baked.glb",),
        cost=Cost(seconds=10, seconds_per_megapixel=1, bytes=300e6),
    ),
    Stage(
        name="remesh",
        reads=("simplified",),
        writes="remeshed",
        sections=("remesh",),
        make=_remesh,
        versions=_of_remesh,
        libraries=_KERNELS,
        results=("remeshed.ply", "remeshed.snm", "levels/"),
        unmet=lambda config, figures: not_close(config.remesh.max_error, figures),
        cost=Cost(seconds=2, seconds_per_megapixel=0.5, bytes=300e6),
    ),
    Stage(
        name="lod",
        reads=("frames", "posed", "adjusted", "clean"),
        writes="levels",
        sections=("lod",),
        make=_lod,
        versions=_of_lod,
        libraries=_KERNELS | _OPENCV | {"scipy": _version("scipy")},
        results=(levels.FILE,),
        cost=Cost(seconds=10, seconds_per_megapixel=2, bytes=500e6, bytes_per_megapixel=10e6),
    ),
    Stage(
        name="tiles",
        reads=("standing", "levels", "textured"),
        writes="tileset",
        sections=("tiles",),
        make=_tiles,
        versions=_of(tiling.make, write_tiles),
        libraries=_KERNELS | _OPENCV | _OPEN3D | {"scipy": _version("scipy")},
        results=(f"{tiling.FOLDER}/",),
        cost=Cost(seconds=10, seconds_per_megapixel=1, bytes=700e6, bytes_per_megapixel=10e6),
    ),
    Stage(
        name="export",
        reads=("simplified", "standing", "textured"),
        writes="exported",
        sections=("export",),
        make=_export,
        versions=_of(export),
        libraries=_KERNELS | _OPENCV,
        results=(exporting.FILE, exporting.WEB),
        cost=Cost(seconds=1, bytes=300e6),
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
        versions=_of(report.make, compare_surfaces, left_out_of_all),
        libraries=_OPEN3D | _OPENCV | {"scikit-image": _version("scikit-image")},
        results=("pictures/",),
        cost=Cost(seconds=6, seconds_per_megapixel=0.2, bytes=300e6),
    ),
)


def plan_for(scan: Scan, config: Config) -> Sequence[Stage]:
    """Return the stages a scan goes through: not those of `left_out`, and what they write is not read."""
    stages = [stage for stage in STAGES if stage.name not in left_out(scan, config)]
    there = {source_of(scan), *(stage.writes for stage in stages)}
    if scan.held_out:
        there.add(HELD_OUT)
    has_photos = config.texture.images is not None
    plan = []
    for stage in stages:
        if stage.name == "texture" and has_photos:
            plan.append(replace(stage, reads=("simplified", "standing", PHOTOS)))
            continue
        if stage.name == "tiles" and not config.tiles.images:
            stage = replace(stage, reads=tuple(name for name in stage.reads if name != "textured"))
        # Frames that the depth stage left are numbered, and have no times.
        labels = LABELS if source_of(scan) in stage.reads else ()
        plan.append(
            replace(stage, reads=tuple(name for name in stage.reads if name in there or name in labels))
        )
    return plan


def left_out(scan: Scan, config: Config) -> Mapping[str, str]:
    """Return the stages a scan does not go through, and why."""
    reasons = {}
    if source_of(scan) == "frames":
        reasons["depth"] = "is not a stage of this scan: it is RGB-D, its depth is measured already"
    if not is_registered(scan, config):
        why = (
            "is switched off"
            if config.register.enabled is False
            else "its frames have poses; adjust makes them better, and register.enabled=true finds others"
        )
        reasons["register"] = f"is not a stage of this scan: {why}"
    if not is_adjusted(scan, config):
        if config.adjust.enabled is False:
            why = "is switched off"
        elif scan.is_views:
            why = "is not a stage of this scan: its depth is found with the poses that it has"
        else:
            why = "is not a stage of this scan: its frames have no colour"
        reasons["adjust"] = why
    if not config.texture.enabled:
        reasons["texture"] = "is switched off; set texture.enabled=true"
    elif config.texture.images is None and not any(frame.color is not None for frame in scan.frames):
        reasons["texture"] = (
            "is not a stage of this scan: its frames have no colour; texture.images=FOLDER takes other photos"
        )
    if not config.bake.enabled:
        reasons["bake"] = "is not enabled; set bake.enabled=true"
    if not config.remesh.enabled:
        reasons["remesh"] = "is not enabled; set remesh.enabled=true"
    if not config.lod.enabled:
        reasons["lod"] = "is not enabled; set lod.enabled=true"
    if not config.tiles.enabled:
        reasons["tiles"] = "is switched off; set tiles.enabled=true"
    elif not config.lod.enabled:
        reasons["tiles"] = "is made of levels of detail, which are not enabled; set lod.enabled=true"
    if not config.report.enabled:
        reasons["report"] = "is switched off; set report.enabled=true"
    if "texture" not in reasons and not config.export.web:
        reasons["export"] = "has nothing to write: textured.glb is there; export.web=true makes a small one"
    return reasons


def is_registered(scan: Scan, config: Config) -> bool:
    """Return whether the poses of a scan are found: those it lacks, or all, if asked for."""
    if config.register.enabled is None:
        return not scan.has_poses or (config.register.refine and not is_adjusted(scan, config))
    return config.register.enabled


def is_adjusted(scan: Scan, config: Config) -> bool:
    """Return whether poses and colour camera are adjusted: where frames have colour and measured depth."""
    if config.adjust.enabled is False or scan.is_views:
        return False
    return any(frame.color is not None for frame in scan.frames)


def source_of(scan: Scan) -> str:
    """Return the name under which stages read this scan."""
    return "pairs" if scan.is_stereo or scan.is_views else "frames"
