"""Each layout is read from a real excerpt if the shared data has one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.stages.scans.layout_table import LAYOUTS
from scanloom.stages.scans.model.images import read_color, read_depth, read_pinhole
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# Folder, frames, focal length in pixels, baseline in metres.
EXCERPTS = [
    ("tum", "real/rgbd_dataset_freiburg1_rpy", 24, 517.3, None),
    ("tum", "rgbd/realsense_desk_tum_layout", 25, 525.0, None),
    ("redwood", "real/realsense_box_open3d_json", 10, 617.25, None),
    ("redwood", "real/phone_desk_no_calibration", 30, 187.0, None),
    ("redwood", "rgbd/open3d_testdata/RGBD", 5, 525.0, None),
    ("redwood", "rgbd/turntable_d435_data1", 6, 525.0, None),
    ("7scenes", "rgbd/7scenes_redkitchen", 100, 585.0, None),
    ("7scenes", "rgbd/tabletop_box_realsense", 25, 615.195, None),
    ("scannet", "real/scannet_views_no_depth", 4, 577.591, None),
    ("nerfstudio", "real/instant_ngp_fox", 14, 1375.52, None),
    ("nerfstudio", "real/nerf_alpha_toy", 24, 1012.574, None),
    ("colmap", "real/colmap_views_meeting_room", 14, 786.322, None),
    ("llff", "real/llff_tankard_masks", 8, 10547.244, None),
    ("photos", "real/instant_ngp_fox/images", 14, 2304.0, None),
    ("middlebury-mview", "stereo/middlebury_templeRing", 47, 1520.4, None),
    ("kitti-stereo", "real/kitti_stereo_2015", 1, 721.538, 0.5327),
    ("kitti", "stereo/kitti_sequence_1", 41, 707.091, 0.5372),
    ("euroc", "stereo/euroc_V1_01_easy_static", 10, 458.654, 0.1101),
    ("middlebury", "stereo/middlebury2014_motorcycle", 1, 994.978, 0.193),
    ("pair", "real/stereo_pair_k_txt", 1, 754.668, 0.063),
    ("plain-stereo", "stereo/opencv_chessboard_rig", 13, None, None),
]
# Tests of these layouts read single images of the data.
OF_IMAGES = {"nyu", "sun-rgbd"}
# The data has no excerpts of these layouts, so only synthetic folders are read.
MADE = {
    "arkitscenes",
    "augmented-icl",
    "bop",
    "camera-text",
    "frame-list",
    "icl-nuim",
    "karlsruhe",
    "plain-rgbd",
    "plain-views",
    "polycam",
    "predictions",
    "record3d",
    "replica",
    "ros-bag",
    "scannet-sens",
    "stray-scanner",
    "tartanair",
    "video",
}


def test_each_layout_is_read_from_something_real_or_listed_as_made():
    assert {one.name for one in LAYOUTS} == {name for name, *_ in EXCERPTS} | OF_IMAGES | MADE
    assert not {name for name, *_ in EXCERPTS} & MADE


@pytest.mark.parametrize(("layout", "folder", "count", "focal", "baseline"), EXCERPTS)
def test_a_real_excerpt(shared_data, layout, folder, count, focal, baseline):
    # One of KITTI's pairs is chosen.
    chosen = ScanParams(first=0, last=0) if layout == "kitti-stereo" else ScanParams()
    scan = read_scan(shared_data / folder, chosen, complete=False)
    assert (scan.layout, len(scan.frames), scan.skipped_frames) == (layout, count, ())
    frame = scan.frames[-1] if layout != "colmap" else scan.frames[0]
    if focal is not None:
        assert scan.frames[0].camera.fx == pytest.approx(focal, abs=1e-3)
    if baseline is not None:
        assert scan.rig.baseline == pytest.approx(baseline, abs=1e-4)
    color = read_pinhole(frame) if scan.is_views else read_color(frame)
    assert color.shape[2] == 3
    if not scan.is_views and not scan.is_stereo:
        depth = read_depth(frame)
        assert 0.05 < np.median(depth[depth > 0]) < 6


def test_points_of_a_real_model_are_where_its_images_show_them(shared_data: Path) -> None:
    # Points of the reconstruction that are inside the image and the depth range of each view.
    scan = read_scan(shared_data / "real" / "colmap_views_meeting_room", complete=False)
    assert not scan.is_metric
    places = np.array([frame.world_from_camera[:3, 3] for frame in scan.frames])
    for frame in scan.frames:
        near, far = frame.depth_range
        assert 0 < near < far < 100 * near
        # A camera with inverted convention would not face the same direction as the others.
        ahead = frame.world_from_camera[:3, 3] + frame.world_from_camera[:3, 2] * (near + far) / 2
        assert np.linalg.norm(ahead - places.mean(0)) < 2 * far


def test_the_true_disparities_of_a_real_street_fit_its_pair(shared_data: Path) -> None:
    folder = shared_data / "real" / "kitti_stereo_2015"
    scan = read_scan(folder, ScanParams(first=0, last=0))
    (frame,) = scan.frames
    truth = cv2.imread(str(folder / "disp_occ_0" / f"{frame.name}.png"), cv2.IMREAD_UNCHANGED) / 256
    left, right = (
        cv2.cvtColor(read_color(one), cv2.COLOR_RGB2GRAY).astype(float)
        for one in (frame, type(frame)(frame.name, frame.camera, color=frame.right))
    )
    # Only where the image has horizontal texture, unlike a road.
    v, u = np.nonzero((truth > 0) & (np.abs(np.gradient(left, axis=1)) > 20))
    disparity = truth[v, u]

    def off(shift: float) -> float:
        at = np.round(u - disparity - shift).astype(int)
        seen = (at >= 0) & (at < right.shape[1])
        return float(np.median(np.abs(left[v, u][seen] - right[v[seen], at[seen]])))

    assert off(0) < 0.6 * min(off(-6), off(6))
    # A road is a few metres away, a street some tens.
    depth = scan.rig.left.fx * scan.rig.baseline / disparity
    assert 3 < np.percentile(depth, 2) < np.median(depth) < 30
