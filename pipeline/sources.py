"""What the first stages of a run read: the scan, what is said of its frames, and the frames kept apart."""

from __future__ import annotations

from dataclasses import replace

from pipeline.digest import label_digests, scan_digest
from pipeline.engine import Source
from pipeline.graph import HELD_OUT, PHOTOS
from pipeline.plan import source_of
from stages.progress import Progress, silent
from stages.scans.scan import Scan


def sources_of(scan: Scan, photos: Scan | None = None, progress: Progress = silent) -> dict[str, Source]:
    """Return the sources of a run by the names under which stages read them.

    Parameters
    ----------
    photos : of `texture.images`.
    progress : told of files that are read.
    """
    labels = {name: Source(one, None, {name: one}) for name, one in label_digests(scan).items()}
    found = {source_of(scan): _source(scan, progress), **labels}
    if scan.held_out:
        found[HELD_OUT] = _source(replace(scan, frames=scan.held_out, held_out=()), silent)
    if photos is not None:
        found[PHOTOS] = _source(photos, progress)
    return found


def _source(scan: Scan, progress: Progress) -> Source:
    content = scan_digest(scan, progress)
    return Source(content.digest, scan, content.parts, content.require_unchanged)
