"""Stage `upright`: estimates the up direction, for all results that are rotated upright."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.up_direction import Up, UpDirection, write_up
from scanloom.pipeline.expectation import MAX_BYTES_IN_PARTS, Cost
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.pipeline.steps.fuse import FusedMesh
from scanloom.stages.params import check, param
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.transforms.up import known_up
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.upright import PlaceUp, direction_of, up_of_place

# Decimal places: the direction is only accurate to about one degree.
_DIGITS = 7


@dataclass(frozen=True, kw_only=True)
class UprightSection:
    """Up direction of the scan. glTF files and tiles are rotated upright; PLY files are not rotated."""

    up: str | None = param(
        None,
        "Up direction of the scan: an axis (+x, -x, +y, -y, +z, -z), a direction as three numbers, or "
        "`as-is` for no rotation. By default as defined by the scan layout (phones use y up) or measured by "
        "an accelerometer; otherwise the dominant surface normal within 60° of up in the frames, usually the "
        "normal of floors and table tops, even if fuse.remove_plane removes them.",
        common=True,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.up is not None:
            direction_of(_words_of(self.up))


@dataclass(frozen=True, kw_only=True)
class Inputs(PosedFrames):
    """Inputs of the stage `upright`."""

    fused_mesh: FusedMesh
    clean_mesh: CleanMesh


def _run(inputs: Inputs, params: UprightSection, context: Context) -> Mapping[str, Any]:
    plane = inputs.fused_mesh.load_plane_normal()
    return estimate_up(context.folder, inputs.clean_mesh.load_sample(), inputs.load_posed(), plane, params)


def estimate_up(
    folder: Path, mesh: Mesh, scan: Scan, plane: Up | None, params: UprightSection
) -> dict[str, Any]:
    """Estimate and write the up direction, and return metrics.

    Parameters
    ----------
    mesh : clean mesh.
    scan : scan in the world frame of the mesh; frames without a pose are ignored.
    plane : normal of the removed supporting plane, pointing up; None if no plane was removed.
    """
    up, source = _find_up(mesh, scan, plane, params)
    write_up(folder, up)
    return {"up": up, "up_source": source}


def _find_up(mesh: Mesh, scan: Scan, plane: Up | None, params: UprightSection) -> tuple[Up | None, str]:
    """Return the up direction, or None, and its source."""
    if params.up is not None:
        given = direction_of(_words_of(params.up))
        return None if given is None else _rounded(given), "given"
    found = up_in(mesh, scan, plane)
    if found is None:
        return None, "nothing"
    return _rounded(found.direction), found.source


def up_in(mesh: Mesh, scan: Scan, plane: Up | None = None) -> PlaceUp | None:
    """Estimate the up direction of a mesh from its scan.

    Returns None if no frame has a pose.
    """
    poses = [frame.world_from_camera for frame in scan.frames if frame.world_from_camera is not None]
    if not poses:
        return None
    known = known_up(scan)
    told = None if known is None else (known.direction, known.source)
    return up_of_place(mesh, np.array(poses), told, plane)


def _words_of(up: str) -> str:
    # `none` resets a parameter in a configuration, hence another word for no rotation.
    return "none" if up == "as-is" else up


def _rounded(direction: NDArray[np.float64]) -> Up:
    rounded = direction.round(_DIGITS)
    x, y, z = (rounded / np.linalg.norm(rounded)).tolist()
    return x, y, z


STAGE = Stage(
    name="upright",
    section=UprightSection,
    inputs=Inputs,
    labels=("world",),
    writes=UpDirection,
    run=_run,
    # Increase if the direction changes for the same clean mesh and frames.
    versions=lambda known, config: {"upright": 3},  # noqa: ARG005
    cost=Cost(seconds=0.5, most_bytes=MAX_BYTES_IN_PARTS),
    headline="up direction from {up_source}",
)
