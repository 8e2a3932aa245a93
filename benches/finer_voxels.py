"""Fusion error at several voxel sizes, by distance to the nearest camera.

    python benches/finer_voxels.py [--frames 200]

Shows if smaller voxels pay off where cameras came near. A synthetic room (`benches/building.py`) and the
RGB-D sample are fused at several voxel sizes. Prints Markdown tables: RMS distance (mm) of the mesh's
vertices from the true surface in quantile ranges of the camera distance (nearest tenth, then up to each
quartile), triangles, and memory of the volume.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.raycasting import RaycastingSurface

sys.path.insert(0, str(Path(__file__).parent))
from building import build_scene, make_building

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
# Quantiles of the distance to the nearest camera that separate the columns.
QUANTILES = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)

Floats = NDArray[np.float64]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200, help="frames of the synthetic room")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        room = Path(scratch) / "room"
        make_building(room, 1, options.frames, os.cpu_count() or 1)
        scene = build_scene(1)

        def compute_room_distance(points: Floats) -> Floats:
            asked = import_open3d().core.Tensor(points.astype(np.float32))
            return np.asarray(scene.compute_distance(asked).numpy(), np.float64)

        print_table("synthetic room", read_scan(room), (0.02, 0.01, 0.005), compute_room_distance)
    truth = RaycastingSurface(read_ply(SAMPLES / "truth.ply"))
    sizes = (0.0062, 0.0031, 0.0021)
    print_table(
        "samples/rgbd",
        read_scan(SAMPLES / "rgbd"),
        sizes,
        lambda points: truth.find_closest_points(points).distances,
    )


def print_table(
    name: str, scan: Scan, sizes: Sequence[float], distance_to_truth: Callable[[Floats], Floats]
) -> None:
    """Print the table of one scan.

    Parameters
    ----------
    sizes : voxel sizes, metres.
    distance_to_truth : computes distances (n,) of points (n, 3) from the true surface, metres.
    """
    eyes = np.array([frame.world_from_camera for frame in scan.frames])[:, :3, 3]
    edges: Floats | None = None
    for size in sizes:
        fused = fuse(scan, voxel_size=size)
        points = fused.mesh.vertices
        camera_distance = np.full(len(points), np.inf)
        for eye in eyes:
            np.minimum(camera_distance, np.linalg.norm(points - eye, axis=1), out=camera_distance)
        if edges is None:
            edges = np.quantile(camera_distance, QUANTILES)
            ranges = [f"{low:.2f}–{high:.2f} m" for low, high in pairwise(edges)]
            print(f"\n| {name} | {' | '.join(ranges)} | triangles | MB |")
            print("|---" * (len(ranges) + 3) + "|")
        distances, which = distance_to_truth(points), np.digitize(camera_distance, edges[1:-1])
        rms = [1000 * np.sqrt((distances[which == part] ** 2).mean()) for part in range(len(edges) - 1)]
        cells = [f"{1000 * size:g} mm", *(f"{one:.2f}" for one in rms), f"{len(fused.mesh.triangles):,}"]
        print(f"| {' | '.join(cells)} | {fused.volume_bytes / 1e6:.0f} |", flush=True)


if __name__ == "__main__":
    main()
