"""Bricks of fused space as entries of the cache: a frame that is new fuses again only what it touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import ScanDigest, digest, scan_digest
from scanloom.pipeline.cache.entry import Recipe
from scanloom.pipeline.stage import Context
from scanloom.stages.fusion.bricks import Cube
from scanloom.stages.scans.model.scan import Scan


class KeptBricks:
    """The bricks of a scan; see scanloom.stages.fusion.in_bricks.

    Parameters
    ----------
    context : of the stage, whose cache holds the bricks.
    scan : in its world, as it is fused.
    versions, libraries : that decide the result of the stage.
    """

    def __init__(
        self, context: Context, scan: Scan, versions: Mapping[str, int], libraries: Mapping[str, str]
    ) -> None:
        self._context = context
        self._scan = scan
        self._versions = dict(versions)
        self._libraries = dict(libraries)
        self._known: ScanDigest | None = None
        self._frames: list[str] = []

    def get(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> Path | None:
        """Return the folder of a brick that was made of the same."""
        entry = self._context.get(self._recipe(brick, frames, decided))
        return None if entry is None else entry.folder

    def store(
        self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any], make: Callable[[Path], None]
    ) -> Path:
        """Have a brick's files written into a new entry.

        Raises
        ------
        StageError
            If a file of its frames is not any more what the name of the entry says.
        """

        def made(folder: Path) -> Mapping[str, Any]:
            make(folder)
            self._digest().require_unchanged(self._scan.frames[number] for number in frames)
            return {"figures": {}, "made": {}}

        return self._context.store(self._recipe(brick, frames, decided), made).folder

    def _recipe(self, brick: Cube, frames: Sequence[int], decided: Mapping[str, Any]) -> Recipe:
        return Recipe(
            "brick",
            self._versions,
            params={"fusion": dict(decided), "brick": {"level": brick.level, "number": str(brick.number)}},
            inputs={"frames": digest([self._digests()[number] for number in frames])},
            libraries=self._libraries,
        )

    def _digest(self) -> ScanDigest:
        """Return what the scan holds; made when first asked for."""
        if self._known is None:
            self._known = scan_digest(self._scan)
        return self._known

    def _digests(self) -> list[str]:
        """Return a digest of each frame's content."""
        if not self._frames:
            parts = self._digest().parts
            self._frames = [
                parts[f"frame {number} ({frame.name})"] for number, frame in enumerate(self._scan.frames)
            ]
        return self._frames
