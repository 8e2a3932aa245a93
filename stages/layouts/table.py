"""The layouts that can be read, in the order they are tried: a new one is one module and one row here."""

from __future__ import annotations

from stages.layouts import (
    euroc,
    kitti,
    middlebury,
    nerfstudio,
    plain_stereo,
    polycam,
    record3d,
    redwood,
    scan_json,
    seven_scenes,
    single_pair,
    stray_scanner,
    tum,
)
from stages.layouts.layout import Layout

# Known by files that only they have.
DISTINCT: tuple[Layout, ...] = (
    scan_json.LAYOUT,
    tum.LAYOUT,
    seven_scenes.LAYOUT,
    euroc.LAYOUT,
    kitti.LAYOUT,
    middlebury.LAYOUT,
    nerfstudio.LAYOUT,
    polycam.LAYOUT,
    record3d.LAYOUT,
    stray_scanner.LAYOUT,
)
# Known by the names of folders that other layouts use too: tried after all those.
GENERIC: tuple[Layout, ...] = (
    plain_stereo.LAYOUT,
    single_pair.LAYOUT,
    redwood.LAYOUT,
)
LAYOUTS: tuple[Layout, ...] = DISTINCT + GENERIC
