"""The layouts that can be read, in the order they are tried: a new one is one module and one row here."""

from __future__ import annotations

from scanloom.stages.scans.layouts import (
    arkit_scenes,
    augmented_icl,
    bop,
    camera_text,
    euroc,
    frame_list,
    icl_nuim,
    karlsruhe,
    llff,
    middlebury,
    middlebury_mview,
    nerfstudio,
    nyu,
    plain_stereo,
    plain_views,
    polycam,
    record3d,
    redwood,
    replica,
    scan_json,
    scannet,
    scannet_sens,
    seven_scenes,
    single_pair,
    stray_scanner,
    sun_rgbd,
    tartan_air,
)
from scanloom.stages.scans.layouts import recording as ros_bag
from scanloom.stages.scans.layouts.colmap import folder as colmap
from scanloom.stages.scans.layouts.kitti import sequence as kitti
from scanloom.stages.scans.layouts.kitti import stereo_pairs as kitti_stereo
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.tum import folder as tum

# Known by files that only they have.
DISTINCT: tuple[Layout, ...] = (
    scan_json.LAYOUT,
    frame_list.LAYOUT,
    # Its folders often hold TUM's lists too.
    icl_nuim.LAYOUT,
    tum.LAYOUT,
    # Its images are named as those of 7-Scenes.
    camera_text.LAYOUT,
    seven_scenes.LAYOUT,
    scannet.LAYOUT,
    scannet_sens.LAYOUT,
    euroc.LAYOUT,
    # Its folders have the names of the sequences'.
    kitti_stereo.LAYOUT,
    kitti.LAYOUT,
    middlebury.LAYOUT,
    nerfstudio.LAYOUT,
    karlsruhe.LAYOUT,
    polycam.LAYOUT,
    record3d.LAYOUT,
    stray_scanner.LAYOUT,
    arkit_scenes.LAYOUT,
    bop.LAYOUT,
    replica.LAYOUT,
    tartan_air.LAYOUT,
    colmap.LAYOUT,
    # Its folders often hold the model of COLMAP too, which tells more.
    llff.LAYOUT,
    augmented_icl.LAYOUT,
    middlebury_mview.LAYOUT,
    nyu.LAYOUT,
    sun_rgbd.LAYOUT,
    ros_bag.LAYOUT,
)
# Known by the names of folders that other layouts use too: tried after all those.
GENERIC: tuple[Layout, ...] = (
    plain_stereo.LAYOUT,
    single_pair.LAYOUT,
    redwood.LAYOUT,
    # Wants the least: after all that know more of their folders.
    plain_views.LAYOUT,
)
LAYOUTS: tuple[Layout, ...] = DISTINCT + GENERIC
