"""Interface of a scan layout and its reader."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.model.world import Direction


@dataclass(frozen=True)
class Layout:
    """Scan layout: a way to store a scan in a folder.

    Attributes
    ----------
    name : value of `scan.layout`.
    description : one-line list of the files that make up the layout.
    matches : return a short reason why a folder has this layout, or None.
    read : return all frames of the folder in order, and emit diagnostics. Missing poses or a missing
        calibration are added to `missing`; the caller decides whether to reject the scan.
    suffixes : suffixes of files that are a complete scan; `read` accepts these files as well as folders.
    up : up direction of the world, if the layout defines it. If only some folders define it, `read` sets
        `Scan.up` instead.
    is_gravity_aligned : `up` comes from the device's accelerometer, so that each pose implies the up
        direction of its
        camera.
    """

    name: str
    description: str
    matches: Callable[[Path], str | None]
    read: Callable[[Path, ReadingParams], Scan]
    suffixes: tuple[str, ...] = ()
    up: Direction | None = None
    is_gravity_aligned: bool = False
