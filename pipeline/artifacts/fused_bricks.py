"""Cache of fused bricks.

After a frame is added to a scan, only the bricks that it touches are fused again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import ScanDigest, compute_digest, compute_scan_digest
from scanloom.pipeline.cache.entry import Recipe
from scanloom.pipeline.stage import Context
from scanloom.stages.fusion.bricks import BlockCube
from scanloom.stages.scans.model.scan import Scan


class CachedBrickStore:
    """Store of fused bricks in the pipeline cache; see scanloom.stages.fusion.brick_fusion.

    Parameters
    ----------
    context : context of the stage, which gives access to the cache.
    scan : scan to fuse, with final poses.
    versions, libraries : code and library versions that determine the result of the stage.
    """

    def __init__(
        self, context: Context, scan: Scan, versions: Mapping[str, int], libraries: Mapping[str, str]
    ) -> None:
        self._context = context
        self._scan = scan
        self._versions = dict(versions)
        self._libraries = dict(libraries)
        self._scan_digest: ScanDigest | None = None
        self._frame_digests: list[str] = []

    def get(self, brick: BlockCube, frames: Sequence[int], inputs: Mapping[str, Any]) -> Path | None:
        """Look up a brick fused from the same inputs, and return its folder."""
        entry = self._context.get(self._make_recipe(brick, frames, inputs))
        return None if entry is None else entry.folder

    def store(
        self, brick: BlockCube, frames: Sequence[int], inputs: Mapping[str, Any], make: Callable[[Path], None]
    ) -> Path:
        """Write a brick into a new cache entry and return its folder.

        Raises
        ------
        StageError
            If a file of the frames changed since its digest was computed.
        """

        def write_brick(folder: Path) -> Mapping[str, Any]:
            make(folder)
            self._get_scan_digest().require_unchanged(self._scan.frames[number] for number in frames)
            return {"metrics": {}, "made": {}}

        return self._context.store(self._make_recipe(brick, frames, inputs), write_brick).folder

    def _make_recipe(self, brick: BlockCube, frames: Sequence[int], inputs: Mapping[str, Any]) -> Recipe:
        return Recipe(
            "brick",
            self._versions,
            params={"fusion": dict(inputs), "brick": {"level": brick.level, "number": str(brick.index)}},
            inputs={"frames": compute_digest([self._get_frame_digests()[number] for number in frames])},
            libraries=self._libraries,
        )

    def _get_scan_digest(self) -> ScanDigest:
        """Compute the digest of the scan on first use."""
        if self._scan_digest is None:
            self._scan_digest = compute_scan_digest(self._scan)
        return self._scan_digest

    def _get_frame_digests(self) -> list[str]:
        """Return the content digest of each frame."""
        if not self._frame_digests:
            parts = self._get_scan_digest().parts
            self._frame_digests = [
                parts[f"frame {number} ({frame.name})"] for number, frame in enumerate(self._scan.frames)
            ]
        return self._frame_digests
