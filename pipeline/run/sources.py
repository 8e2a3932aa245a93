"""Sources of a run: inputs that no stage writes.

These are the scan, labels of its frames, the scale of poses that are estimated, held-out frames, photos, a
network, and whether the mesh gets a texture.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.cache.digest import (
    compute_digest,
    compute_label_digests,
    compute_scan_digest,
    get_content_digest,
)
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import get_scan_input_name, is_textured
from scanloom.pipeline.run.engine import StageInput
from scanloom.pipeline.steps.structure import has_estimated_world
from scanloom.stages.diagnostics.codes import MACHINE_BUSY
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.stereo.networks.sidecar import get_sidecar_path


def load_sources(
    scan: Scan, config: Config, photos: Scan | None = None, progress: Progress = ignore_progress
) -> dict[str, StageInput]:
    """Compute the sources of a run by input name, with digests.

    Parameters
    ----------
    photos : scan of `texture.images`.
    progress : callback for digested files.
    """
    labels = {name: StageInput(one, None, {name: one}) for name, one in compute_label_digests(scan).items()}
    found = {get_scan_input_name(scan, config): _make_source(scan, progress), **labels}
    if scan.held_out:
        found["held_out"] = _make_source(replace(scan, frames=scan.held_out, held_out=()), ignore_progress)
    if photos is not None:
        found["photos"] = _make_source(photos, progress)
    if is_textured(scan, config):
        found["is_textured"] = StageInput(compute_digest({}), True, {})
    if has_estimated_world(scan) and scan.is_metric:
        found["scan_scale"] = _make_scale(config.scan)
    if config.depth.model is not None:
        found["network"] = _load_network(Path(config.depth.model))
    return found


def _make_scale(params: ScanParams) -> StageInput:
    """Make the source of the scale of cameras that `structure` estimates."""
    parts = {
        "metres per unit": compute_digest(params.resolve_scale()),
        "tags": compute_digest([params.tag_size, params.tag_family]),
    }
    return StageInput(compute_digest(parts), params, parts)


def _load_network(file: Path) -> StageInput:
    """Compute the source of a network: file, sidecar and runtime version determine its output."""
    files = {"network": file, "sidecar": get_sidecar_path(file)}
    parts = {what: get_content_digest(path) for what, path in files.items()}

    def require_unchanged() -> None:
        for what, path in files.items():
            if get_content_digest(path) != parts[what]:
                raise StageError(
                    MACHINE_BUSY,
                    "{path} changed while it was being read",
                    remedy="run again when the file is complete.",
                    path=path,
                )

    parts |= list_installed_versions("onnxruntime")
    return StageInput(compute_digest(parts), file, parts, require_unchanged)


def _make_source(scan: Scan, progress: Progress) -> StageInput:
    found = compute_scan_digest(scan, progress)
    return StageInput(found.digest, scan, found.parts, found.require_unchanged)
