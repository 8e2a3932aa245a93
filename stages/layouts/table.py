"""The layouts that can be read, in the order they are tried: a new one is one module and one row here."""

from __future__ import annotations

from stages.layouts import kitti, middlebury, scan_json, seven_scenes
from stages.layouts.layout import Layout

LAYOUTS: tuple[Layout, ...] = (
    scan_json.LAYOUT,
    seven_scenes.LAYOUT,
    kitti.LAYOUT,
    middlebury.LAYOUT,
)
