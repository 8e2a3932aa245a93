"""Folder with a simulation model: USD, MJCF, URDF and SDF with proven collision geometry."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation, Severity
from scanloom.stages.diagnostics.errors import StageError, UsageError
from scanloom.stages.exporting.codes import (
    EXPORT_BODIES_OVERLAP,
    EXPORT_COLLISION_LARGE,
    EXPORT_COLLISION_LOOSE,
    EXPORT_DECOMPOSITION_FAILED,
    EXPORT_HOLES_CLOSED,
    EXPORT_LEFT_OUT,
    EXPORT_OPEN_BODY,
    EXPORT_UP_UNKNOWN,
)
from scanloom.stages.exporting.export import rotate_mesh
from scanloom.stages.exporting.image_conversion import convert_images
from scanloom.stages.exporting.simulation.body import (
    MESH_FOLDER,
    Body,
    BodyFiles,
    write_body_meshes,
)
from scanloom.stages.exporting.simulation.body_plan import BodyPlan, clip_by_base, lower_floor, plan_bodies
from scanloom.stages.exporting.simulation.clearance import clear_obstacles
from scanloom.stages.exporting.simulation.collision_proof import (
    CollisionProof,
    measure_diagonal,
    prove_collision,
    prove_inside,
)
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, PartSet
from scanloom.stages.exporting.simulation.decomposition import (
    decompose_solid,
    decompose_surface,
    divide_solid,
)
from scanloom.stages.exporting.simulation.descriptions import (
    write_gazebo_config,
    write_mjcf,
    write_sdf,
    write_urdf,
)
from scanloom.stages.exporting.simulation.inner_parts import carve_parts
from scanloom.stages.exporting.simulation.mass import compute_mass_properties
from scanloom.stages.exporting.simulation.overlaps import Overlap, find_overlaps
from scanloom.stages.exporting.simulation.solid import SolidGeometry, build_solid
from scanloom.stages.exporting.simulation.usd_physics import write_usd_physics
from scanloom.stages.files.atomic_folders import require_replaceable_folder, write_folder_atomically
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING
from scanloom.stages.surface.mesh import Image, Material, Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.topology import require_area
from scanloom.stages.surface.up_direction import rotate_to_z

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import SimulationKeywords

REPORT_FILE = "simulation.json"
_BODY_NAME = "model"
_FOLDER_DESCRIPTION = "a simulation model"
# Default of `max_excess` for solids and open surfaces, and its minimum, per bounding-box diagonal.
# Parts of an open surface cannot extend into its inside, so many more are needed.
# The completed side of an object of a scan is uncertain by more.
_SOLID_EXCESS_RATIO, _OPEN_EXCESS_RATIO = 0.01, 0.02
_MIN_EXCESS_RATIO = 0.001
# CoACD's concavity relative to the permitted excess. CoACD samples distances, so its result can exceed it.
# Carving adds to the concavity, so that parts inside need smaller portions.
_CONCAVITY_RATIOS = {"outside": (1.0, 0.7, 0.5), "inside": (0.7, 0.4, 0.2)}
# Overlap of the halves of a split part, per permitted excess.
_OVERLAP_RATIO = 0.05
_MAX_IMAGE_SIZE = 16384
# Decompositions, each with twice the excess, until the parts are smaller than the visual mesh.
_MAX_ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class SimulationParams:
    """Parameters of a simulation model."""

    density: float = param(
        1000.0, "Density of the object; 1000 is water.", unit="kg/m³", low=0, low_open=True
    )
    split: str = param(
        "none",
        "`objects`: one body for each object on a floor or table, closed below by that plane, and a static "
        "body for the rest. Needs `scanloom[solid]`.",
        choices=("none", "objects"),
        common=True,
    )
    collision: str = param(
        "outside",
        "`outside`: collision parts contain the surface; `inside`: they are inside of the object, which must "
        "be closed, and `max_excess` limits the distance of the surface from them.",
        choices=("outside", "inside"),
    )
    max_excess: float | None = param(
        None,
        "Maximum distance by which collision geometry exceeds the object, which is proven. Default, not "
        "required: 1 % of the bounding box's diagonal, or 2 % for an open surface. Up to four times as much, "
        "if the parts would otherwise be larger than the mesh.",
        unit="m",
        low=0,
        low_open=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class SimulationResult:
    """Result of `export_simulation`.

    Attributes
    ----------
    folder : path of the written folder.
    bodies : bodies with their collision parts, proven bounds and mass.
    visual_bytes, collision_bytes : sizes of the mesh files.
    diagnostics : warnings, and an unmet requirement if a bound exceeds `max_excess`.
    """

    folder: Path
    bodies: tuple[Body, ...]
    visual_bytes: int
    collision_bytes: int
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics of the model as JSON-compatible values."""
        return {
            "output": self.folder.name,
            "visual_bytes": self.visual_bytes,
            "collision_bytes": self.collision_bytes,
            "bodies": [body.to_dict() for body in self.bodies],
        }


def export_simulation(
    mesh: MeshLike,
    folder: Path | str,
    params: SimulationParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[SimulationKeywords],
) -> SimulationResult:
    """Write a folder with a model for physics simulators.

    The folder has `model.usda` (UsdPhysics), `model.xml` (MJCF), `model.sdf`, a URDF file for each body,
    meshes, images and `simulation.json`. All paths are relative, all files z-up, in metres and kilograms.

    The collision geometry is a union of convex parts. It contains the surface, and its excess is proven: no
    point of a part is farther from the object than the stated bound. The object is the solid that the mesh
    encloses after small holes are closed, or the surface itself if the mesh is open.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    folder : folder to write; the folder of an earlier model is replaced.
    params : SimulationParams; single fields can be given by name instead.
    progress : called after each body; an exception from it stops the work.

    Raises
    ------
    UsageError
        If a parameter is out of range, or `coacd` or `usd-core` is not installed.
    InputError
        If the folder has other files.
    MeshError
        If the mesh is invalid or has no area.
    StageError
        If the decomposition fails, or a file cannot be written.
    """
    params = resolve(SimulationParams, params, changes)
    require_simulation_target(Path(folder))
    with collecting() as diagnostics:
        result = _write_model(as_mesh(mesh), Path(folder), params, progress)
    return replace(result, diagnostics=tuple(diagnostics))


def require_simulation_target(folder: Path) -> None:
    """Check that `export_simulation` can run and may write to a folder.

    Raises
    ------
    UsageError
        If `coacd` or `usd-core` is missing; the message names the package to install.
    InputError
        If `folder` is a file, or has files that are no simulation model.
    """
    _require_libraries()
    require_replaceable_folder(folder, _may_replace, _FOLDER_DESCRIPTION)


def _require_libraries() -> None:
    missing = [
        name for module, name in (("coacd", "coacd"), ("pxr", "usd-core")) if find_spec(module) is None
    ]
    if missing:
        raise UsageError(
            MACHINE_EXTRA_MISSING,
            "a simulation model requires {libraries}",
            remedy="install scanloom[sim].",
            libraries=" and ".join(missing),
        )


def _may_replace(folder: Path) -> bool:
    """Return True if a folder has a model of `export_simulation`."""
    return (folder / REPORT_FILE).is_file()


def _write_model(mesh: Mesh, folder: Path, params: SimulationParams, progress: Progress) -> SimulationResult:
    require_area(mesh, "mesh")
    mesh = convert_images(_turn_upright(mesh), "png", 100, _MAX_IMAGE_SIZE)
    plans = [BodyPlan(_BODY_NAME, mesh)] if params.split == "none" else plan_bodies(mesh)
    plans = _name_images(plans)
    with write_folder_atomically(folder, _may_replace, _FOLDER_DESCRIPTION) as draft:
        written: list[BodyFiles] = []
        limits: dict[str, float] = {}
        for number, plan in enumerate(plans):
            progress(number, len(plans))
            files, limits[plan.name] = _write_body(draft, plan, params, [one.body for one in written])
            written.append(files)
        progress(len(plans), len(plans))
        # The static body was made last, to keep it clear of the others.
        written = written[-1:] + written[:-1]
        bodies = [files.body for files in written]
        overlaps = find_overlaps(bodies)
        _report_overlaps(overlaps)
        images = {id(one): one.name for plan in plans for one in _list_images(plan.mesh)}
        write_usd_physics(
            draft / f"{_BODY_NAME}.usda",
            bodies,
            {key: f"./{MESH_FOLDER}/{name}" for key, name in images.items()},
        )
        write_mjcf(draft / f"{_BODY_NAME}.xml", _BODY_NAME, written)
        for files in written:
            write_urdf(draft / f"{files.body.name}.urdf", files)
        write_sdf(draft / f"{_BODY_NAME}.sdf", _BODY_NAME, written)
        if len(written) == 1:
            write_gazebo_config(draft / "model.config", folder.name, f"{_BODY_NAME}.sdf")
        result = SimulationResult(
            folder,
            tuple(bodies),
            sum(files.visual_bytes for files in written),
            sum(files.collision_bytes for files in written),
        )
        _report_sizes(written)
        report = {
            **result.to_dict(),
            "density_kg_m3": params.density,
            "max_excess_m": limits if len(limits) > 1 else limits[bodies[0].name],
            # Number k belongs to part k of the body.
            "part_excess_bound_m": {one.name: one.proof.part_excess_m.tolist() for one in bodies},
            "overlaps": [one.to_dict() for one in overlaps],
        }
        (draft / REPORT_FILE).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return result


def _write_body(
    draft: Path, plan: BodyPlan, params: SimulationParams, others: list[Body]
) -> tuple[BodyFiles, float]:
    """Make a body that does not overlap the others, if possible, and write its meshes.

    Returns
    -------
    The files, and the limit of the excess in metres.
    """
    geometry = build_solid(plan.mesh)
    limit = _choose_limit(plan, geometry, params)
    obstacles = PartSet(
        [
            part.translate(np.subtract(other.position, plan.position))
            for other in others
            for part in other.parts
        ]
    )
    if plan.floor is not None:
        corners = [part.vertices + other.position for other in others for part in other.parts]
        plan = replace(plan, floor=lower_floor(plan.floor, corners))
    body = _build_body(plan, geometry, limit, params, obstacles)
    files = write_body_meshes(draft, body)
    may_grow = params.max_excess is None and plan.base is None
    for _ in range(_MAX_ATTEMPTS - 1):
        if files.collision_bytes <= files.visual_bytes or not may_grow:
            break
        for shape in files.collisions:
            if shape.file is not None:
                (draft / shape.file).unlink()
        limit *= 2
        body = _build_body(plan, geometry, limit, params, obstacles)
        files = write_body_meshes(draft, body)
    _report_body(body, limit, params, has_obstacles=bool(others))
    return files, limit


def _turn_upright(mesh: Mesh) -> Mesh:
    if mesh.up is None:
        emit(
            EXPORT_UP_UNKNOWN.warning(
                "the up direction is unknown: the mesh is written as if it were {axes} already",
                remedy="set `up`",
                axes="z-up",
            )
        )
        return mesh
    return rotate_mesh(mesh, rotate_to_z(np.array(mesh.up)))


def _list_images(mesh: Mesh) -> tuple[Image, ...]:
    return () if mesh.texture is None else mesh.texture.images


def _name_images(plans: list[BodyPlan]) -> list[BodyPlan]:
    """Name images by number.

    Properties that only the original file format knows are dropped, because they may refer to other files.
    """
    if any(plan.mesh.colors is not None and not _list_images(plan.mesh) for plan in plans):
        emit(
            EXPORT_LEFT_OUT.warning(
                "the MJCF file has no vertex colours, and few programs show those of URDF and SDF "
                "models; the USD file has them",
                remedy="use a mesh with a texture.",
            )
        )
    images = {id(image): image for plan in plans for image in _list_images(plan.mesh)}
    named = {
        key: Image(f"texture{number}.png", image.file_bytes)
        for number, (key, image) in enumerate(images.items())
    }
    return [replace(plan, mesh=_rename_images(plan.mesh, named)) for plan in plans]


def _rename_images(mesh: Mesh, named: Mapping[int, Image]) -> Mesh:
    if not _list_images(mesh):
        return mesh
    assert mesh.texture is not None
    materials = tuple(
        Material(
            one.name,
            None if one.image is None else named[id(one.image)],
            one.base_color,
            one.wrap,
        )
        for one in mesh.texture.materials
    )
    return mesh.with_(texture=replace(mesh.texture, materials=materials))


def _build_body(
    plan: BodyPlan,
    geometry: SolidGeometry,
    limit_m: float,
    params: SimulationParams,
    obstacles: PartSet,
) -> Body:
    parts, proof = _decompose(plan, geometry, limit_m, params, obstacles)
    if geometry.is_solid:
        surfaces = [(geometry.surface.vertices, geometry.surface.triangles)]
    else:
        surfaces = [(part.vertices, part.triangles) for part in parts]
    return Body(
        name=plan.name,
        visual=plan.mesh,
        parts=tuple(parts),
        mass=compute_mass_properties(surfaces, params.density),
        is_static=plan.is_static or not geometry.is_solid,
        is_open=not geometry.is_solid,
        proof=proof,
        cap_ratio=geometry.cap_ratio,
        added_ratio=plan.added_ratio,
        position=plan.position,
        floor=plan.floor,
    )


def _report_body(body: Body, limit_m: float, params: SimulationParams, *, has_obstacles: bool) -> None:
    is_required = params.max_excess is not None
    max_gap_m = limit_m if params.collision == "inside" or has_obstacles else 0.0
    _report_collision(body.name, body.proof, limit_m, max_gap_m, is_required=is_required)
    if has_obstacles and params.collision == "outside" and 0 < body.proof.gap_m <= limit_m:
        emit(
            EXPORT_COLLISION_LOOSE.info(
                "{name}: the surface reaches up to {gap_mm:.3g} mm out of the collision geometry, which ends "
                "at other bodies",
                name=body.name,
                gap_mm=1000 * body.proof.gap_m,
            )
        )
    if body.is_open and params.collision == "inside":
        emit(
            EXPORT_OPEN_BODY.warning(
                "{name}: the surface is open and has no inside, so its collision parts contain the surface",
                name=body.name,
            )
        )
    if body.is_open:
        emit(
            EXPORT_OPEN_BODY.warning(
                "{name}: the surface is open, so the body is static, and its mass is that of its collision "
                "parts",
                name=body.name,
            )
        )
    if body.cap_ratio > 0:
        emit(
            EXPORT_HOLES_CLOSED.warning(
                "{name}: holes are closed with {percent:.2g} % of additional surface for mass and collision",
                name=body.name,
                percent=100 * body.cap_ratio,
            )
        )


def _choose_limit(plan: BodyPlan, geometry: SolidGeometry, params: SimulationParams) -> float:
    """Return the permitted excess in metres.

    Raises
    ------
    UsageError
        If it is so small that the number of parts would exceed that of the triangles.
    """
    diagonal = measure_diagonal(geometry.surface.vertices)
    if params.max_excess is None:
        is_complete = geometry.is_solid and plan.base is None
        return diagonal * (_SOLID_EXCESS_RATIO if is_complete else _OPEN_EXCESS_RATIO)
    if params.max_excess < _MIN_EXCESS_RATIO * diagonal:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {value:g} m; at least 0.1 % of the bounding box's diagonal, {min:.3g} m, is required.",
            DiagnosticLocation(parameter="max_excess"),
            value=params.max_excess,
            min=_MIN_EXCESS_RATIO * diagonal,
        )
    return params.max_excess


def _decompose(
    plan: BodyPlan,
    geometry: SolidGeometry,
    limit_m: float,
    params: SimulationParams,
    obstacles: PartSet,
) -> tuple[list[ConvexPart], CollisionProof]:
    """Decompose a surface; repeat with smaller parts until the proven bounds are within the limit."""
    surface = geometry.surface
    if not geometry.is_solid:
        parts = decompose_surface(surface, limit_m, obstacles)
        parts = clear_obstacles(parts, obstacles, surface, _OVERLAP_RATIO * limit_m)
        return parts, prove_collision(surface, parts, is_solid=False, resolution_m=limit_m / 2)
    best = None
    for ratio in _CONCAVITY_RATIOS[params.collision]:
        if params.collision == "inside":
            parts = carve_parts(divide_solid(surface, ratio * limit_m), surface, limit_m)
            parts = clear_obstacles(parts, obstacles, surface, _OVERLAP_RATIO * limit_m)
            if not parts:
                continue
            proof = prove_inside(surface, parts)
        else:
            parts = decompose_solid(surface, limit_m, ratio * limit_m)
            if plan.base is not None:
                parts = clip_by_base(parts, plan.base, _OVERLAP_RATIO * limit_m)
            parts = clear_obstacles(parts, obstacles, surface, _OVERLAP_RATIO * limit_m)
            proof = prove_collision(surface, parts, is_solid=True, resolution_m=limit_m / 2)
        if best is None or max(proof.excess_m, proof.gap_m) < max(best[1].excess_m, best[1].gap_m):
            best = parts, proof
        if max(proof.excess_m, proof.gap_m) <= limit_m:
            break
    if best is None:
        raise StageError(
            EXPORT_DECOMPOSITION_FAILED,
            "{name}: no convex part of the permitted size is inside of the object",
            remedy="set `max_excess` lower, or simulation.collision=outside.",
            name=plan.name,
        )
    return best


def _report_collision(
    name: str, proof: CollisionProof, limit_m: float, max_gap_m: float, *, is_required: bool
) -> None:
    severity = Severity.UNMET if is_required else Severity.WARNING
    if proof.excess_m > limit_m:
        emit(
            EXPORT_COLLISION_LOOSE.create(
                severity,
                "{name}: the collision geometry reaches up to {excess_mm:.3g} mm outside the surface (limit "
                "{limit_mm:.3g} mm) in {count} of {parts} parts",
                None,
                "set `max_excess` higher.",
                {
                    "name": name,
                    "excess_mm": 1000 * proof.excess_m,
                    "limit_mm": 1000 * limit_m,
                    "count": int((proof.part_excess_m > limit_m).sum()),
                    "parts": len(proof.part_excess_m),
                },
            )
        )
    if proof.gap_m > max_gap_m:
        emit(
            EXPORT_COLLISION_LOOSE.create(
                severity,
                "{name}: the surface reaches up to {gap_mm:.3g} mm out of the collision geometry (limit "
                "{limit_mm:.3g} mm)",
                None,
                "set `max_excess` higher." if max_gap_m > 0 else "report the mesh as a bug.",
                {"name": name, "gap_mm": 1000 * proof.gap_m, "limit_mm": 1000 * max_gap_m},
            )
        )


def _report_overlaps(overlaps: list[Overlap]) -> None:
    for one in overlaps:
        emit(
            EXPORT_BODIES_OVERLAP.warning(
                "{first} and {second} overlap at the start, by at most {depth_mm:.3g} mm, in {count} pairs "
                "of collision parts",
                remedy="set `max_excess` lower.",
                first=one.first,
                second=one.second,
                depth_mm=1000 * one.depth_m,
                count=one.pairs,
            )
        )


def _report_sizes(written: list[BodyFiles]) -> None:
    for files in written:
        if files.collision_bytes > files.visual_bytes:
            emit(
                EXPORT_COLLISION_LARGE.warning(
                    "{name}: the collision geometry ({collision:,} bytes) is larger than the visual mesh "
                    "({visual:,} bytes)",
                    remedy="set `max_excess` higher.",
                    name=files.body.name,
                    collision=files.collision_bytes,
                    visual=files.visual_bytes,
                )
            )
