"""Bodies of a model before their collision geometry is made: the complete mesh, or objects and the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.exporting.codes import EXPORT_NO_OBJECTS, EXPORT_NOT_SPLIT, EXPORT_OBJECT_CLOSED
from scanloom.stages.exporting.simulation.body import HalfSpace
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, clip_part
from scanloom.stages.exporting.simulation.decomposition import limit_corners
from scanloom.stages.exporting.simulation.object_splitting import DividedScan, ScannedObject, divide_scan
from scanloom.stages.surface.mesh import Mesh

STATIC_NAME = "static"
# Positions of bodies are multiples of this length, so that they are short in files.
_POSITION_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class BodyPlan:
    """Mesh of a body and its role.

    Attributes
    ----------
    name : name of the body.
    mesh : z-up, relative to `position`.
    position : (3,) origin of the body in the model.
    is_static : the body never moves.
    base : half-space that the collision parts must not enter, such as the table below an object.
    floor : half-space that belongs to the collision geometry.
    added_ratio : area of surface that was added to close the mesh, relative to its area.
    """

    name: str
    mesh: Mesh
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_static: bool = False
    base: HalfSpace | None = None
    floor: HalfSpace | None = None
    added_ratio: float = 0.0


def plan_bodies(mesh: Mesh) -> list[BodyPlan]:
    """Divide a z-up mesh into objects, the largest first, and a static body, which is last."""
    divided = divide_scan(mesh)
    _report_division(divided)
    plans = [_plan_object(f"object_{number}", one) for number, one in enumerate(divided.objects, 1)]
    floor = _find_floor(divided)
    return [*plans, BodyPlan(STATIC_NAME, divided.rest, is_static=True, floor=floor)]


def clip_by_base(parts: Sequence[ConvexPart], base: HalfSpace, overlap_m: float) -> list[ConvexPart]:
    """Cut off what is inside of a half-space; parts that get too many corners are split with an overlap."""
    clipped = [clip_part(part, base.offset_m - part.vertices @ base.normal) for part in parts]
    return [one for part in clipped for one in limit_corners(part, overlap_m)]


def lower_floor(floor: HalfSpace, corners: Sequence[NDArray[np.float64]]) -> HalfSpace:
    """Lower a half-space until no corners (k, 3) of other bodies are inside.

    The planes of a floor differ slightly.
    """
    lowest = min(float((one @ floor.normal).min()) for one in corners)
    return replace(floor, offset_m=min(floor.offset_m, lowest))


def _plan_object(name: str, scanned: ScannedObject) -> BodyPlan:
    plane = scanned.plane
    low, high = scanned.mesh.vertices.min(axis=0), scanned.mesh.vertices.max(axis=0)
    center = (low + high) / 2
    on_plane = center - plane.measure_heights(center[None])[0] * plane.normal
    x, y, z = on_plane.round(_POSITION_DECIMALS).tolist()
    # Between the plane and the base, so that parts contain the base and do not reach the plane.
    offset = (plane.offset_m + scanned.bottom_m) / 2 - float(plane.normal @ (x, y, z))
    return BodyPlan(
        name,
        scanned.mesh.with_(vertices=scanned.mesh.vertices - (x, y, z)),
        position=(x, y, z),
        base=HalfSpace(plane.normal, offset),
        added_ratio=scanned.added_ratio,
    )


def _find_floor(divided: DividedScan) -> HalfSpace | None:
    """Return the half-space below the lowest plane that carries an object, if no surface is below it."""
    planes = [one.plane for one in divided.objects]
    if not planes:
        return None
    plane = min(planes, key=lambda one: one.offset_m)
    if float(plane.measure_heights(divided.rest.vertices).min()) < -plane.reach_m:
        return None
    return HalfSpace(plane.normal, plane.offset_m)


def _report_division(divided: DividedScan) -> None:
    if not divided.objects:
        emit(
            EXPORT_NO_OBJECTS.warning(
                _explain_no_objects(divided), remedy="crop the scan to a table or floor."
            )
        )
    left = [
        f"{count} {text}"
        for count, text in (
            (divided.crumbs, "too small"),
            (divided.sheets, "without volume, such as walls"),
            (divided.furniture, "attached to other surfaces"),
        )
        if count
    ]
    if divided.objects and left:
        emit(
            EXPORT_NOT_SPLIT.info(
                "{objects} objects are bodies; other components on their planes stay static: {left}",
                objects=len(divided.objects),
                left=", ".join(left),
            )
        )
    if divided.torn:
        emit(
            EXPORT_NOT_SPLIT.info(
                "{count} torn components inside of objects or next to them are left out",
                count=divided.torn,
            )
        )
    for number, one in enumerate(divided.objects, 1):
        if one.stacked:
            emit(
                EXPORT_NOT_SPLIT.warning(
                    "object_{number}: {count} components stand on a level face of the object and are part of "
                    "it",
                    number=number,
                    count=one.stacked,
                )
            )
        if not one.is_sound:
            emit(
                EXPORT_OBJECT_CLOSED.warning(
                    "object_{number}: the closed surface touches itself or lacks a part of the scan, so the "
                    "mass is approximate",
                    number=number,
                )
            )
    if divided.objects:
        shares = [
            f"{one.added_ratio:.0%}" for one in sorted(divided.objects, key=lambda one: one.added_ratio)
        ]
        emit(
            EXPORT_OBJECT_CLOSED.warning(
                "objects are closed on the plane where they stood; {share} of their surface is added. The "
                "plane is flattened by up to {flattened_mm:.2g} mm",
                share=shares[0] if shares[0] == shares[-1] else f"{shares[0]} to {shares[-1]}",
                flattened_mm=1000 * divided.flattened_m,
            )
        )


def _explain_no_objects(divided: DividedScan) -> str:
    if not divided.planes:
        return "the scan has no level floor or table, so it is one static body"
    reasons = [
        (divided.furniture, "are attached to other surfaces"),
        (divided.sheets, "enclose no volume, such as walls"),
        (divided.crumbs, "are too small"),
    ]
    stated = [f"{count} {text}" for count, text in reasons if count]
    if not stated:
        return "nothing stands on the level planes of the scan, so it is one static body"
    return (
        "no object stands alone on a level plane, so the scan is one static body: of the components above "
        + ("the plane, " + ", ".join(stated))
    )
