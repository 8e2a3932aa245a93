"""Optional stage `lod`: builds levels of detail.

The input is the refined mesh, or the simplified mesh if the refined mesh exceeds the in-memory limit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.up_direction import UpDirection
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.codes import LEVELS_MESH_LARGE, LEVELS_NOISE_UNKNOWN
from scanloom.pipeline.steps.refine import RefinedMesh, is_refined_mesh_large
from scanloom.pipeline.steps.simplify import (
    SIMPLIFICATION_FUNCTIONS,
    Proof,
    SimplifiedMesh,
    list_method_versions,
)
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.fusion.depth_noise import estimate_depth_noise
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.lod.build import LevelsParams, LodParams, build, widen_bounds
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.slod import read_slod, write_slod
from scanloom.stages.params import param
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.mesh import Mesh

LOD_FILE = "lod.slod"
# Standard error of the mean of four observations, relative to a single observation.
_NOISE_RATIO = 0.5


@dataclass(frozen=True, kw_only=True)
class LodSection(LevelsParams):
    """Levels of detail of the refined mesh."""

    enabled: bool = param(
        False,
        "Build levels of detail of the refined mesh, each with a proven error bound.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )
    base_error: float | None = param(
        None,
        "Proven distance of the finest level from the refined mesh; 0 for that mesh itself. By default "
        "half of the depth noise: the standard deviation of a frame's depth at the median depth, estimated "
        "from neighbouring frames.",
        unit="m",
        low=0,
    )


@dataclass(frozen=True)
class Levels(Artifact):
    """Hierarchy of levels of detail."""

    NAME = "levels"

    def load(self) -> Hierarchy:
        """Load the hierarchy."""
        return read_slod(self.folder / LOD_FILE)


@dataclass(frozen=True, kw_only=True)
class LodInputs(PosedFrames):
    """Inputs of the stage `lod`.

    Attributes
    ----------
    simplified_mesh : used instead of the refined mesh if that exceeds the in-memory limit.
    """

    refined_mesh: RefinedMesh
    simplified_mesh: SimplifiedMesh | None = None
    up_direction: UpDirection


def _run(inputs: LodInputs, params: LodSection, context: Context) -> Mapping[str, Any]:
    refined, up = inputs.refined_mesh, inputs.up_direction.load()
    if not refined.is_large:
        frames = inputs.load_posed().frames
        return write_levels(context.folder, refined.load().with_(up=up), frames, params, context.progress)
    simplified = inputs.simplified_mesh
    assert simplified is not None
    return write_levels_of_simplified(
        context.folder,
        simplified.load().with_(up=up),
        simplified.load_proof(),
        refined.triangle_count,
        params,
        context.progress,
    )


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    noise = (estimate_depth_noise,) if config.get(LodSection).base_error is None else ()
    return {
        # Increase if the base error changes for the same clean mesh and frames.
        "lod": 1,
        **collect_result_versions(build, *SIMPLIFICATION_FUNCTIONS, *noise),
        # The finest level is made by a simplification method.
        **list_method_versions(),
    }


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(LodSection).enabled else "is not enabled; set lod.enabled=true"


def write_levels(
    folder: Path, mesh: Mesh, frames: Sequence[Frame], params: LodSection, progress: Progress
) -> dict[str, Any]:
    """Build levels of detail, write lod.slod and return metrics.

    Parameters
    ----------
    mesh : refined mesh.
    frames : frames with poses and depth, to estimate the depth noise.
    """
    error, noise = params.base_error, None
    if error is None:
        noise = estimate_depth_noise(frames)
        error = _NOISE_RATIO * noise
        if noise == 0:
            emit(
                LEVELS_NOISE_UNKNOWN.warning(
                    "the depth noise cannot be estimated, so the finest level is the refined mesh itself",
                    remedy="set lod.base_error to simplify it.",
                )
            )
    hierarchy = _build_hierarchy(mesh, error, params, progress)
    source = "given" if noise is None else "noise"
    return _write_hierarchy(folder, hierarchy, error, source, noise)


def write_levels_of_simplified(
    folder: Path,
    mesh: Mesh,
    proof: Proof | None,
    refined_triangles: int,
    params: LodSection,
    progress: Progress,
) -> dict[str, Any]:
    """Build levels of detail of a simplified mesh, write lod.slod and return metrics.

    Parameters
    ----------
    mesh : simplified mesh, used because the refined mesh exceeds the in-memory limit.
    proof : proven distance from the refined mesh, which is added to all bounds. None if not proven;
        bounds are then relative to the simplified mesh.
    refined_triangles : triangle count of the refined mesh.
    """
    distance = 0.0 if proof is None else proof.shape_bound_m
    error = max((params.base_error or 0.0) - distance, 0.0)
    hierarchy = _build_hierarchy(mesh, error, params, progress)
    if proof is None:
        warning = LEVELS_MESH_LARGE.warning(
            "the refined mesh is too large: levels are built from the simplified mesh, whose distance from "
            "the refined mesh is not proven",
            remedy="set simplify.max_shape for a proven distance.",
        )
    else:
        warning = LEVELS_MESH_LARGE.warning(
            "the refined mesh is too large: levels are built from the simplified mesh, which is proven to be "
            "within {distance} m of the refined mesh. The bound of each level includes this distance.",
            distance=format_upper_bound(distance),
        )
        hierarchy = widen_bounds(hierarchy, distance, proof.color_bound_levels or 0.0)
        hierarchy = replace(hierarchy, input_triangles=refined_triangles)
    emit(warning)
    # Store the warning in the file, too: viewers open it without the run.
    hierarchy = replace(hierarchy, diagnostics=(*hierarchy.diagnostics, warning))
    return _write_hierarchy(folder, hierarchy, distance + error, "simplified", None)


def _build_hierarchy(mesh: Mesh, error: float, params: LodSection, progress: Progress) -> Hierarchy:
    shared = {field.name: getattr(params, field.name) for field in fields(LevelsParams)}
    return build(mesh, LodParams(base_error=error, **shared), progress=progress)


def _write_hierarchy(
    folder: Path,
    hierarchy: Hierarchy,
    error: float,
    source: str,
    noise: float | None,
) -> dict[str, Any]:
    write_slod(folder / LOD_FILE, hierarchy)
    return hierarchy.to_dict() | {
        "base_error_m": error,
        "base_error_source": source,
        "depth_noise_m": noise,
        "file_bytes": (folder / LOD_FILE).stat().st_size,
    }


STAGE = Stage(
    name="lod",
    section=LodSection,
    inputs=LodInputs,
    artifact=Levels,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom", "opencv", "scipy"),
    result_names=(LOD_FILE,),
    input_conditions={"simplified_mesh": is_refined_mesh_large},
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=10, seconds_per_megapixel=2, bytes=500e6, bytes_per_megapixel=10e6),
    headline="{levels} levels from {base_triangles:,} triangles within {base_shape_bound_m:at_most} m; "
    "{file_bytes:,} bytes",
    progress_unit="triangles",
)
