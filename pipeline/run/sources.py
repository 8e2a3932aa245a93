"""Sources of a run: inputs that no stage writes.

These are the scan, labels of its frames, held-out frames, photos and a network.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.cache.digest import content, digest, label_digests, scan_digest
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import source_name
from scanloom.pipeline.run.engine import Source
from scanloom.stages.diagnostics.codes import MACHINE_BUSY
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.stereo.networks.sidecar import sidecar_of


def sources_of(
    scan: Scan, config: Config, photos: Scan | None = None, progress: Progress = silent
) -> dict[str, Source]:
    """Compute the sources of a run by input name, with digests.

    Parameters
    ----------
    photos : scan of `texture.images`.
    progress : callback for digested files.
    """
    labels = {name: Source(one, None, {name: one}) for name, one in label_digests(scan).items()}
    found = {source_name(scan, config): _source(scan, progress), **labels}
    if scan.held_out:
        found["held_out"] = _source(replace(scan, frames=scan.held_out, held_out=()), silent)
    if photos is not None:
        found["photos"] = _source(photos, progress)
    if config.depth.model is not None:
        found["network"] = _network(Path(config.depth.model))
    return found


def _network(file: Path) -> Source:
    """Compute the source of a network: file, sidecar and runtime version determine its output."""
    files = {"network": file, "sidecar": sidecar_of(file)}
    parts = {what: content(path) for what, path in files.items()}

    def require_unchanged() -> None:
        for what, path in files.items():
            if content(path) != parts[what]:
                raise StageError(
                    MACHINE_BUSY,
                    "{path} changed while it was being read",
                    remedy="run again when the file is complete.",
                    path=path,
                )

    parts |= installed("onnxruntime")
    return Source(digest(parts), file, parts, require_unchanged)


def _source(scan: Scan, progress: Progress) -> Source:
    found = scan_digest(scan, progress)
    return Source(found.digest, scan, found.parts, found.require_unchanged)
