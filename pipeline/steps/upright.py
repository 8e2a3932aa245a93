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
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.pipeline.steps.fuse import FusedMesh
from scanloom.stages.params import check_parameters, param
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.transforms.up_direction import find_up_direction
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.up_direction import UpEstimate, estimate_up_of_scene, parse_up_direction

# Decimal places: the direction is only accurate to about one degree.
_DECIMALS = 7


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
        check_parameters(self)
        if self.up is not None:
            parse_up_direction(_translate_as_is(self.up))


@dataclass(frozen=True, kw_only=True)
class UprightInputs(PosedFrames):
    """Inputs of the stage `upright`."""

    fused_mesh: FusedMesh
    clean_mesh: CleanMesh


def _run(inputs: UprightInputs, params: UprightSection, context: Context) -> Mapping[str, Any]:
    plane = inputs.fused_mesh.load_plane_normal()
    return estimate_up(
        context.folder, inputs.clean_mesh.load_subsampled(), inputs.load_posed(), plane, params
    )


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
        given = parse_up_direction(_translate_as_is(params.up))
        return None if given is None else _round_direction(given), "given"
    found = estimate_scan_up(mesh, scan, plane)
    if found is None:
        return None, "nothing"
    return _round_direction(found.direction), found.source


def estimate_scan_up(mesh: Mesh, scan: Scan, plane: Up | None = None) -> UpEstimate | None:
    """Estimate the up direction of a mesh from its scan.

    Returns None if no frame has a pose.
    """
    poses = [frame.world_from_camera for frame in scan.frames if frame.world_from_camera is not None]
    if not poses:
        return None
    known = find_up_direction(scan)
    known_direction = None if known is None else (known.direction, known.source)
    return estimate_up_of_scene(mesh, np.array(poses), known_direction, plane)


def _translate_as_is(up: str) -> str:
    # `none` resets a parameter in a configuration, hence another word for no rotation.
    return "none" if up == "as-is" else up


def _round_direction(direction: NDArray[np.float64]) -> Up:
    rounded = direction.round(_DECIMALS)
    x, y, z = (rounded / np.linalg.norm(rounded)).tolist()
    return x, y, z


STAGE = Stage(
    name="upright",
    section=UprightSection,
    inputs=UprightInputs,
    labels=("world",),
    artifact=UpDirection,
    run=_run,
    # Increase if the direction changes for the same clean mesh and frames.
    versions=lambda known, config: {"upright": 4},  # noqa: ARG005
    cost=CostModel(seconds=0.5, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline="up direction from {up_source}",
)
