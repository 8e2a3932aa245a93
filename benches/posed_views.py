"""Depth of posed views by plane sweep and pairs, against sensor depth.

    python benches/posed_views.py DATA

Compares the values of `depth.views`. Poses and colour cameras of RGB-D scans are adjusted first. The colour
images alone then serve as views, and the sensor's depth is the ground truth away from depth discontinuities.

- "coverage": ratio of ground-truth pixels with depth.
- "wrong": ratio of pixels with depth whose error exceeds 5 %.
- "correct": pixels with depth that are not wrong, over all ground-truth pixels.
- "coverage, 3 views": coverage of pixels that at least two other views see, too, according to their sensor
  depth.
- "CPU s / MP": CPU seconds per megapixel of a view.

A second table covers folders of views: wall and CPU seconds for the depth of all views, and the ratio of
pixels with depth. If the views have masks, it also gives the mean intersection over union (IoU) of the masks
with the silhouettes of the cleaned mesh.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from markdown_tables import print_head, print_row
from numpy.typing import NDArray

from scanloom.stages.adjusting.adjust import adjust
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.scans.model.images import read_color, read_depth, read_valid_pixels
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Scan, to_pinhole
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.posed_views import create_posed_views
from scanloom.stages.stereo.view_consistency import count_supporting_views
from scanloom.stages.stereo.views_depth import views_depth
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

SCANS = {
    "7-Scenes' kitchen, every third": ("rgbd/7scenes_redkitchen", 3),
    "box on a table": ("rgbd/tabletop_box_realsense", 1),
}
FOLDERS = (
    "real/colmap_views_meeting_room",
    "real/instant_ngp_fox",
    "real/nerf_alpha_toy",
    "stereo/middlebury_templeRing",
)
METHODS = {
    "pairs": {"views": "pairs", "partners": 4},
    "sweep, without planes": {"fill_from_planes": False},
    "sweep": {"views": "sweep"},
}
MAX_RELATIVE_ERROR, MIN_RELATIVE_JUMP, AGREEMENT_TOLERANCE = 0.05, 0.1, 0.03


def make_view_and_truth(frame: Frame) -> tuple[Frame, NDArray[np.float32]]:
    """Convert an RGB-D frame to a view and its true depth.

    The view has only the photo. The sensor's depth is reprojected into the colour camera, (h, w) float32
    metres; it is 0 where unknown and near discontinuities.
    """
    lens, pose = frame.color_camera or frame.camera, np.asarray(frame.world_from_camera)
    shift = np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth)
    color, depth, own, camera = (
        read_color(frame),
        read_depth(frame),
        to_pinhole(frame.camera),
        to_pinhole(lens),
    )
    assert color is not None
    assert depth is not None
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns].astype(np.float64)
    points = np.stack([(columns - own.cx) / own.fx * z, (rows - own.cy) / own.fy * z, z], axis=1)
    points = points @ shift[:3, :3].T + shift[:3, 3]
    u = np.rint(points[:, 0] / points[:, 2] * camera.fx + camera.cx).astype(int)
    v = np.rint(points[:, 1] / points[:, 2] * camera.fy + camera.cy).astype(int)
    inside = np.flatnonzero((u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
    inside = inside[np.argsort(-points[inside, 2], kind="stable")]
    truth = np.zeros((camera.height, camera.width), np.float32)
    truth[v[inside], u[inside]] = points[inside, 2]
    window = np.ones((5, 5), np.uint8)
    nearest = cv2.erode(np.where(truth > 0, truth, np.float32(1e9)), window)
    truth[cv2.dilate(truth, window) > (1 + MIN_RELATIVE_JUMP) * nearest] = 0
    view = Frame(frame.name, lens, color=color, world_from_camera=pose @ invert_pose(shift))
    return view, truth


def mark_covisible(scan: Scan, truths: Sequence[NDArray[np.float32]]) -> list[NDArray[np.bool_]]:
    """Mark the pixels that at least two other views see.

    Holes of one pixel in the ground truth are closed first.
    """
    views = create_posed_views(scan)
    closed = [np.asarray(cv2.dilate(truth, np.ones((3, 3), np.uint8)), np.float32) for truth in truths]
    result = []
    for at, truth in enumerate(truths):
        others = [(views[other], closed[other]) for other in range(len(views)) if other != at]
        result.append(
            count_supporting_views(
                views[at], truth, others, AGREEMENT_TOLERANCE, AGREEMENT_TOLERANCE, threads=2
            ).consistent
            >= 2
        )
    return result


def print_methods(name: str, scan: Scan, truths: Sequence[NDArray[np.float32]]) -> None:
    """Print a row for each method."""
    some = np.concatenate([truth[truth > 0][::97] for truth in truths])
    near, far = (float(f * np.quantile(some, q)) for f, q in ((0.9, 0.002), (1.1, 0.998)))
    known = sum(int(np.count_nonzero(truth)) for truth in truths)
    three = mark_covisible(scan, truths)
    known_to_three = sum(int(np.count_nonzero(seen)) for seen in three)
    for way, changes in METHODS.items():
        began, found, wrong, of_three = time.process_time(), 0, 0, 0
        results = views_depth(scan, min_depth=near, max_depth=far, **changes)  # type: ignore[arg-type]
        for (_, result), truth, seen in zip(results, truths, three, strict=True):
            if isinstance(result, DepthMap):
                of_three += int(np.count_nonzero(seen & (result.depth > 0)))
                both = (truth > 0) & (result.depth > 0)
                found += int(np.count_nonzero(both))
                off = np.abs(result.depth[both] / truth[both] - 1)
                wrong += int(np.count_nonzero(off > MAX_RELATIVE_ERROR))
        seconds = (time.process_time() - began) / sum(truth.size for truth in truths) * 1e6
        shares = (found / known, wrong / max(found, 1), (found - wrong) / known, of_three / known_to_three)
        print_row([name, way, *(f"{share:.1%}" for share in shares), f"{seconds:.1f}"])


def compute_mask_iou(mesh: Mesh, scan: Scan) -> float:
    """Compute the mean IoU of silhouettes and masks, at every fourth pixel."""
    surface, shares = RaycastingSurface(mesh), []
    for frame in scan.frames:
        camera, pose, seen = (
            to_pinhole(frame.camera),
            np.asarray(frame.world_from_camera),
            read_valid_pixels(frame),
        )
        rows, columns = np.mgrid[0 : camera.height : 4, 0 : camera.width : 4]
        x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T
        hit = np.zeros(len(rays), bool)
        hit[surface.cast_rays(pose[:3, 3], rays).rays] = True
        shown = seen[::4, ::4].ravel()
        shares.append(np.count_nonzero(hit & shown) / np.count_nonzero(hit | shown))
    return float(np.mean(shares))


def print_folder(name: str, scan: Scan) -> None:
    """Print a row for a folder of views."""
    began, work = time.perf_counter(), time.process_time()
    results = list(views_depth(scan))
    wall, work = time.perf_counter() - began, time.process_time() - work
    kept = [(frame, result) for frame, result in results if isinstance(result, DepthMap)]
    share = np.mean([np.mean(result.depth > 0) for _, result in kept])
    shared = ""
    if all(frame.mask is not None for frame in scan.frames):
        fused = fuse(replace(scan, frames=[frame for frame, _ in kept]))
        shared = f"{compute_mask_iou(clean(fused.mesh).mesh, scan):.2f}"
    print_row([name, f"{len(kept)} of {len(results)}", f"{wall:.0f}", f"{work:.0f}", f"{share:.0%}", shared])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    print_head(["scan", "method", "coverage", "wrong", "correct", "coverage, 3 views", "CPU s / MP"], words=2)
    for name, (path, step) in SCANS.items():
        frames = adjust(read_scan(data / path)).frames[::step]
        views, truths = zip(*(make_view_and_truth(frame) for frame in frames), strict=True)
        print_methods(name, Scan("views", list(views)), truths)
    print()
    print_head(["folder", "views", "s", "CPU s", "coverage", "mask IoU"], words=1)
    for name in FOLDERS:
        print_folder(name, read_scan(data / name))


if __name__ == "__main__":
    main()
