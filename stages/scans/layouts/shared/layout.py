"""What a layout is, and what its reader returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.model.world import Direction


@dataclass(frozen=True)
class Layout:
    """One way of packing a scan into a folder.

    Attributes
    ----------
    name : what `--set scan.layout=` takes.
    text : one line: the files that make it up.
    matches : returns why a folder is of this layout, in a few words, or None.
    read : returns every frame of the folder in order, and emits diagnostics; poses or a calibration that are
        not there go into `missing`: the caller decides whether the scan is refused.
    suffixes : of files that are a scan by themselves; `read` takes these as well as folders.
    up : what is up in the world of its poses, where it is defined so; where only some of its folders tell,
        `read` sets it.
    is_level : the device's accelerometer tells `up`, so that each pose tells what is up for its camera.
    """

    name: str
    text: str
    matches: Callable[[Path], str | None]
    read: Callable[[Path, ReadingParams], Scan]
    suffixes: tuple[str, ...] = ()
    up: Direction | None = None
    is_level: bool = False
