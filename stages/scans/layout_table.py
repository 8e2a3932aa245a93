"""Table of the supported layouts in detection order.

A new layout is one module and one row of this table.
"""

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
    plain_photos,
    plain_stereo,
    plain_views,
    polycam,
    predictions,
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
    video_file,
)
from scanloom.stages.scans.layouts import ros_recording as ros_bag
from scanloom.stages.scans.layouts.colmap import folder as colmap
from scanloom.stages.scans.layouts.kitti import sequence as kitti
from scanloom.stages.scans.layouts.kitti import stereo_pairs as kitti_stereo
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.tum import folder as tum

# Layouts with characteristic files.
DISTINCT_LAYOUTS: tuple[Layout, ...] = (
    scan_json.LAYOUT,
    frame_list.LAYOUT,
    # Before TUM: ICL-NUIM folders often contain TUM's lists, too.
    icl_nuim.LAYOUT,
    tum.LAYOUT,
    # Before 7-Scenes, which has the same image names.
    camera_text.LAYOUT,
    seven_scenes.LAYOUT,
    scannet.LAYOUT,
    scannet_sens.LAYOUT,
    euroc.LAYOUT,
    # Before KITTI sequences, which have the same folder names.
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
    # Before COLMAP: networks write their cameras in both forms, and depth only in this one.
    predictions.LAYOUT,
    colmap.LAYOUT,
    # After COLMAP: LLFF folders often contain a COLMAP model, which has more information.
    llff.LAYOUT,
    augmented_icl.LAYOUT,
    middlebury_mview.LAYOUT,
    nyu.LAYOUT,
    sun_rgbd.LAYOUT,
    ros_bag.LAYOUT,
)
# Layouts that are only known by common folder names, so they are tried last.
GENERIC_LAYOUTS: tuple[Layout, ...] = (
    plain_stereo.LAYOUT,
    single_pair.LAYOUT,
    redwood.LAYOUT,
    # It accepts any folder with images and poses.
    plain_views.LAYOUT,
    # It only accepts files.
    video_file.LAYOUT,
    # Last: it accepts any folder with images alone.
    plain_photos.LAYOUT,
)
LAYOUTS: tuple[Layout, ...] = DISTINCT_LAYOUTS + GENERIC_LAYOUTS
