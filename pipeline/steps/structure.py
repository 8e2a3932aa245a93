"""Stage `structure`: estimates camera poses and intrinsics from photos alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.sparse_model import (
    FRAMES_FOLDER,
    MODEL_FOLDER,
    SparseModel,
    write_sparse_model,
)
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.registration.structure.frame_selection import extract_frames
from scanloom.stages.registration.structure.params import StructureParams
from scanloom.stages.registration.structure.reconstruct import reconstruct_cameras
from scanloom.stages.scans.layouts import video_file
from scanloom.stages.scans.model.scan import Scan


@dataclass(frozen=True, kw_only=True)
class StructureInputs:
    """Inputs of the stage `structure`."""

    scan: Scan


def needs_structure(scan: Scan) -> bool:
    """Return True if the poses of photos are estimated: if photos without depth have none."""
    return scan.is_views and any(frame.world_from_camera is None for frame in scan.frames)


def has_estimated_world(scan: Scan) -> bool:
    """Return True if no photo has a pose, so that `structure` chooses world and unit."""
    return needs_structure(scan) and not scan.has_poses


def _run(inputs: StructureInputs, params: StructureParams, context: Context) -> Mapping[str, Any]:
    scan, progress = inputs.scan, context.progress
    if scan.layout == video_file.LAYOUT.name:
        scan = extract_frames(
            scan,
            context.folder / FRAMES_FOLDER,
            params,
            progress=lambda done, total: context.progress(done, 2 * total),
        )

        def progress(done: int, total: int) -> object:
            return context.progress(total + done, 2 * total)

    found = reconstruct_cameras(scan, params, progress=progress)
    metrics = write_sparse_model(context.folder, found, inputs.scan.folder)
    warn_skipped_frames(metrics["photos_skipped"])
    return metrics


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    if needs_structure(scan):
        return None
    if scan.has_poses:
        return "does not apply to this scan: its frames have poses"
    return "does not apply to this scan: it has depth, so register estimates the poses"


STAGE = Stage(
    name="structure",
    section=StructureParams,
    inputs=StructureInputs,
    labels=("names",),
    artifact=SparseModel,
    run=_run,
    versions=make_fixed_versions(extract_frames, reconstruct_cameras),
    libraries=list_installed_versions("opencv", "pycolmap"),
    result_names=(f"{MODEL_FOLDER}/", f"{FRAMES_FOLDER}/"),
    skip_reason=_get_skip_reason,
    cost=CostModel(
        seconds=2,
        seconds_per_megapixel=2.5,
        bytes=300e6,
        bytes_per_megapixel=2e6,
        depends_on_voxel_size=False,
    ),
    headline="poses of {photos} photos from {points} points in {pairs_verified} pairs; reprojection error "
    "{reprojection_error_px:.2g} px",
)
