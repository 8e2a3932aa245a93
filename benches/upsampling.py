"""Depth upsampling guided by a photo (`fuse.upsample`), compared with OpenCV's filters.

    python benches/upsampling.py DATA

"synthetic": the scene of the samples as a phone records it, noisy depth of 256 × 192 with larger photos,
against true depth. The other scans: every third pixel of a sensor's depth in DATA, upsampled by 3, against
the full depth; depth edges of these sensors do not match the photo's edges exactly.

- "smooth": mean error away from depth discontinuities. "at jumps": mean error near discontinuities.
- "wrong": ratio of pixels near discontinuities with an error above 3 %.
- "between": ratio of pixels near discontinuities whose depth is between two surfaces.

The second table fuses the synthetic scan, all frames and a single one, and measures vertices against the true
surface.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from markdown_tables import print_head, print_row

from scanloom.stages.fusion.depth_upsampling import upsample_depth
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, scale_camera
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
PHONE = Camera(256, 192, 187.0, 187.0, 127.5, 95.5)
FACTOR, FRAMES, TRUTH_FRAMES = 3, 20, 4
HELD_OUT = {
    "7-Scenes' kitchen": "rgbd/7scenes_redkitchen",
    "TUM fr3/cabinet": "real/freiburg3_cabinet_keyframes",
    "TUM fr1/rpy": "real/rgbd_dataset_freiburg1_rpy",
}

Image = np.ndarray


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    frames, truths, surface = make_phone_scan()
    print_head(["depth of", "method", "smooth mm", "at jumps mm", "wrong %", "between %", "CPU s"], words=2)
    made = [
        (read_frame_depth(frame), frame.color, truth) for frame, truth in zip(frames, truths, strict=False)
    ]
    print_rows("synthetic", made)
    for name, folder in HELD_OUT.items():
        print_rows(name, list(held_out(data / folder)))
    print()
    print_head(["mesh of", "parameters", "voxel mm", "triangles", "RMS mm", "> 5 mm %"], words=2)
    for asked in (
        {},
        {"upsample": "guided"},
        {"voxel_size": 0.004},
        {"voxel_size": 0.004, "upsample": "guided"},
    ):
        print_mesh("all frames", frames, surface, asked)
    for asked in ({"upsample": "off"}, {}):
        print_mesh("one frame", [frames[8]], surface, asked)


def make_methods() -> dict[str, Callable[[Image, Image], Image]]:
    """Return the compared methods by name.

    Each upsamples a small depth map guided by a large photo.
    """
    return {
        "nearest": upsample_nearest,
        "bilinear": upsample_bilinear,
        "OpenCV's jointBilateralFilter": make_guided_filter(
            lambda guide, image: cv2.ximgproc.jointBilateralFilter(guide.astype(np.float32), image, 9, 12, 4)
        ),
        "OpenCV's guidedFilter": make_guided_filter(
            lambda guide, image: cv2.ximgproc.guidedFilter(guide, image, 4, 20)
        ),
        "ours, without the photo": lambda depth, _: upsample_depth(depth, None, FACTOR),
        "ours": lambda depth, color: upsample_depth(depth, color, FACTOR),
    }


def make_guided_filter(smooth: Callable[[Image, Image], Image]) -> Callable[[Image, Image], Image]:
    """Return a method that smooths valid inverse depth with a guided filter."""

    def upsample_guided(depth: Image, color: Image) -> Image:
        first = upsample_bilinear(depth, color)
        there = (first > 0).astype(np.float32)
        inverse = np.divide(1, first, out=np.zeros_like(first), where=first > 0)
        return there * smooth(color, there) / np.maximum(smooth(color, inverse), 1e-9)

    return upsample_guided


def upsample_nearest(depth: Image, color: Image) -> Image:
    """Upsample by nearest neighbour."""
    return cv2.resize(depth, color.shape[1::-1], interpolation=cv2.INTER_NEAREST_EXACT)


def upsample_bilinear(depth: Image, color: Image) -> Image:
    """Interpolate inverse depth bilinearly between valid samples."""
    there = depth > 0
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=there)
    total, share = (
        cv2.resize(image, color.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        for image in (inverse, there.astype(np.float32))
    )
    return np.where(upsample_nearest(depth, color) > 0, share / np.maximum(total, 1e-9), 0).astype(np.float32)


def print_rows(name: str, sets: Sequence[tuple[Image, Image, Image]]) -> None:
    """Print the mean errors of each method over several images."""
    for way, make in make_methods().items():
        start = time.process_time()
        found = [make(depth, color) for depth, color, _ in sets]
        seconds = (time.process_time() - start) / len(sets)
        metrics = np.mean(
            [measure_errors(one, truth) for one, (*_, truth) in zip(found, sets, strict=True)], axis=0
        )
        print_row([name, way, *(f"{figure:.2f}" for figure in metrics), f"{seconds:.2f}"])


def measure_errors(found: Image, truth: Image) -> list[float]:
    """Measure errors of a depth map.

    Returns mean error away from and near discontinuities (mm), and ratios of wrong and in-between pixels (%).
    """
    window = np.ones((2 * FACTOR + 1,) * 2, np.uint8)
    farthest, nearest_there = cv2.dilate(truth, window), cv2.erode(np.where(truth > 0, truth, 99), window)
    judged, jump = (found > 0) & (truth > 0), farthest > 1.05 * nearest_there
    error, is_at_jump = np.abs(found - truth), judged & jump
    is_on_surface = np.zeros(truth.shape, bool)
    for row, column in np.ndindex(*window.shape):
        moved = np.roll(truth, (row - FACTOR, column - FACTOR), (0, 1))
        is_on_surface |= np.abs(moved - found) <= 0.02 * found
    between = (found > 1.02 * nearest_there) & (found < 0.98 * farthest) & ~is_on_surface
    return [
        1000 * float(np.mean(error[judged & ~jump])),
        1000 * float(np.mean(error[is_at_jump])),
        100 * float(np.mean(error[is_at_jump] > 0.03 * truth[is_at_jump])),
        100 * float(np.mean(between[is_at_jump])),
    ]


def held_out(folder: Path) -> Iterator[tuple[Image, Image, Image]]:
    """Yield subsampled depth, photo, and full depth of six frames."""
    frames = read_scan(folder, complete=False).frames
    for frame in frames[:: max(1, len(frames) // 6)][:6]:
        depth = read_frame_depth(frame)
        height, width = (side // FACTOR * FACTOR for side in depth.shape)
        color = read_color(frame)[:height, :width]
        whole = np.ascontiguousarray(depth[:height, :width])
        yield np.ascontiguousarray(whole[1::FACTOR, 1::FACTOR]), np.ascontiguousarray(color), whole


def read_frame_depth(frame: Frame) -> Image:
    """Read the depth of a frame."""
    depth = read_depth(frame)
    assert depth is not None
    return depth


def make_phone_scan() -> tuple[list[Frame], list[Image], Mesh]:
    """Simulate a phone scan of the samples' scene.

    Returns frames, true depth maps of some frames, and the true surface.
    """
    sys.path[:0] = [str(SAMPLES)]
    import sensors
    from make_samples import make_arc_poses
    from scene import Scene

    scene, photo = Scene(), scale_camera(PHONE, FACTOR * PHONE.width, FACTOR * PHONE.height)
    frames, truths = [], []
    for number, pose in enumerate(make_arc_poses(FRAMES, 104, 1.1)):
        random = np.random.default_rng((9, number))
        # One ray per pixel is enough, because the photos are large and well textured.
        color = sensors.photograph(scene, photo, pose, random, rays_per_pixel=1)
        raw = sensors.measure_depth(scene, PHONE, pose, random)
        depth = raw.astype(np.float32) / 1000
        frames.append(Frame(str(number), PHONE, color=color, depth=depth, world_from_camera=pose))
        if number < TRUTH_FRAMES:
            rays = sensors._compute_rays(photo, *np.meshgrid(np.arange(photo.width), np.arange(photo.height)))
            distance, _, _ = scene.cast(pose[:3, 3], rays @ pose[:3, :3].T)
            z = np.where(np.isfinite(distance), distance * rays[:, 2], 0)
            truths.append(z.reshape(photo.height, photo.width).astype(np.float32))
    return frames, truths, scene.mesh


def print_mesh(name: str, frames: Sequence[Frame], truth: Mesh, parameters: dict[str, object]) -> None:
    """Print the distance of a fused mesh's vertices from the true surface."""
    found = fuse(Scan("made", frames), **parameters)
    error = RaycastingSurface(truth).find_closest_points(found.mesh.vertices).distances
    print_row(
        [
            name,
            ", ".join(f"{key}={value}" for key, value in parameters.items()) or "default",
            f"{1000 * found.voxel_size:.1f}",
            f"{len(found.mesh.triangles):,}",
            f"{1000 * float(np.sqrt(np.mean(error**2))):.2f}",
            f"{100 * float(np.mean(error > 0.005)):.2f}",
        ]
    )


if __name__ == "__main__":
    main()
