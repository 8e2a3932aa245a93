"""Accuracy of registration against true poses, compared with Open3D.

python benches/registration.py SCAN [SCAN ...] [--poses FILE] [--every N] [--again N] [--depth-only]
    [--only NAME ...] [--meshes] [--frames N ...]

Prints a Markdown table. Each SCAN has true poses, which are hidden from all tools. Errors refer to the
largest connected component; the peers have one component only.

- "ATE": RMS distance of camera centres after the best rigid alignment (Umeyama 1991). "scaled ATE" is after
  the best similarity alignment, which removes a difference in scale between depth and truth.
- "RPE": median error of the motion from each frame to the next; "RPE RMS" is its root mean square.
- "reprojection": median distance in pixels between feature matches reprojected through depth, with the
  estimated and with the true poses.
- "mesh RMS" (--meshes): RMS distance between the meshes fused with the estimated and with the true poses.

Some peers chain Open3D's odometry from frame to frame with its defaults: "hybrid" (Park, Zhou and Koltun
2017, of the legacy and the tensor pipeline) and "point to plane". For the others, which use one thread, see
open3d_reconstruction.py and open3d_slam.py. Stereo scans are matched before, which is not timed. With
--depth-only, tools that require colours get grey images.
"""

from __future__ import annotations

import argparse
import itertools
import re
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markdown_tables import print_head, print_row
from open3d_images import make_legacy_camera, make_legacy_image, read_images
from open3d_reconstruction import run_reconstruction_system
from open3d_slam import run_dense_slam

from scanloom.stages._open3d import import_open3d
from scanloom.stages.adjusting.adjust import adjust
from scanloom.stages.adjusting.agreement_check import measure_agreement
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.registration.motion import compute_rotation_angle
from scanloom.stages.registration.register import register
from scanloom.stages.registration.registration_result import Registration
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame, Pose
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_tum
from scanloom.stages.stereo.depth import DepthMap, depth_scan
from scanloom.stages.surface.mesh import Mesh

# Maximum depth in metres, as in Open3D's examples.
_MAX_DEPTH = 4.0


def register_scanloom(frames: Sequence[Frame]) -> list[dict[int, Pose]]:
    """Register as `scanloom run` does."""
    return _list_components(register(frames))


def register_without_loops(frames: Sequence[Frame]) -> list[dict[int, Pose]]:
    """Register without loop closures."""
    return _list_components(register(frames, loops=False))


def register_and_adjust(frames: Sequence[Frame]) -> list[dict[int, Pose]]:
    """Register, then adjust as `scanloom run` does."""
    found = register(frames)
    better = adjust(found.frames)
    return _list_components(replace(found, frames=better.frames))


def as_single_component(
    find: Callable[[Sequence[Frame]], dict[int, Pose]],
) -> Callable[[Sequence[Frame]], list[dict[int, Pose]]]:
    """Wrap a function whose poses form a single component."""
    return lambda frames: [find(frames)]


def chain_legacy_hybrid(frames: Sequence[Frame]) -> dict[int, Pose]:
    """Chain Open3D's legacy hybrid odometry."""
    o3d = import_open3d()
    intrinsic = make_legacy_camera(frames[0].camera)
    hybrid = o3d.pipelines.odometry.RGBDOdometryJacobianFromHybridTerm()

    def read_image(frame: Frame) -> Any:
        return make_legacy_image(*read_images(frame), _MAX_DEPTH)

    def estimate_step(source: Any, target: Any) -> Pose:
        option = o3d.pipelines.odometry.OdometryOption()
        found = o3d.pipelines.odometry.compute_rgbd_odometry(
            source, target, intrinsic, np.eye(4), hybrid, option
        )
        return np.asarray(found[1])

    return _chain_steps(frames, read_image, estimate_step)


def make_tensor_odometry(method: str) -> Callable[[Sequence[Frame]], dict[int, Pose]]:
    """Return a function that chains Open3D's tensor odometry."""

    def chain_tensor(frames: Sequence[Frame]) -> dict[int, Pose]:
        o3d = import_open3d()
        odometry = o3d.t.pipelines.odometry
        matrix = o3d.core.Tensor(frames[0].camera.matrix)

        def read_image(frame: Frame) -> Any:
            depth, color = read_images(frame)
            both = (o3d.t.geometry.Image(o3d.core.Tensor(one)) for one in (color, depth))
            return o3d.t.geometry.RGBDImage(*both)

        def estimate_step(source: Any, target: Any) -> Pose:
            found = odometry.rgbd_odometry_multi_scale(
                source,
                target,
                matrix,
                o3d.core.Tensor(np.eye(4)),
                1.0,
                _MAX_DEPTH,
                method=getattr(odometry.Method, method),
            )
            return np.asarray(found.transformation.numpy())

        return _chain_steps(frames, read_image, estimate_step)

    return chain_tensor


TOOLS: dict[str, Callable[[Sequence[Frame]], list[dict[int, Pose]]]] = {
    "scanloom": register_scanloom,
    "scanloom, no loops": register_without_loops,
    "scanloom, adjusted": register_and_adjust,
    "Open3D legacy, hybrid": as_single_component(chain_legacy_hybrid),
    "Open3D tensor, hybrid": as_single_component(make_tensor_odometry("Hybrid")),
    "Open3D tensor, point to plane": as_single_component(make_tensor_odometry("PointToPlane")),
    "Open3D reconstruction system": as_single_component(run_reconstruction_system),
    "Open3D dense SLAM": as_single_component(run_dense_slam),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scans", nargs="+", type=Path, metavar="SCAN")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="true poses, in the order of the frames")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="use every Nth frame")
    parser.add_argument("--again", type=int, default=1, metavar="N", help="traverse the frames N times")
    parser.add_argument("--depth-only", action="store_true", help="hide the colours")
    parser.add_argument("--only", nargs="+", choices=TOOLS, default=list(TOOLS), metavar="NAME")
    parser.add_argument("--meshes", action="store_true", help="fuse and compare meshes too")
    parser.add_argument(
        "--frames", type=int, nargs="+", metavar="N", help="print speed and memory for N frames"
    )
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        _print_speed_row(options.scans[0], options.frames[0])
        return
    if min(options.every, options.again) < 1:
        parser.error("--every and --again have to be at least 1")
    if options.frames:
        _print_speed(options.scans, options.frames)
        return
    columns = ["scan", "tool", "frames", "components", "ATE mm", "ATE / path", "scaled ATE mm"]
    columns += ["RPE mm", "RPE °", "RPE RMS mm", "RPE RMS °"]
    columns += ["reprojection px", "true poses: reprojection px"]
    print_head([*columns, "frames/s", *["mesh RMS mm"] * options.meshes], words=2)
    for folder in options.scans:
        there = read_frames(folder, options.poses)[:: options.every]
        truth = [frame for i in range(options.again) for frame in there[:: 1 if i % 2 == 0 else -1]]
        hidden = [hide_pose(frame, depth_only=options.depth_only) for frame in truth]
        true_mesh = fuse(truth).mesh if options.meshes else None
        for name in options.only:
            started = time.perf_counter()
            try:
                pieces = TOOLS[name](hidden)
            except (RuntimeError, InputError) as error:
                # Open3D colours its error messages, and puts signature, file and line first.
                what = re.sub(r"\x1b\[[\d;]*m|\[Open3D Error\] .*?\.cpp:\d+: ", "", str(error)).strip()
                print_row([folder.name, name, f"failed: {what}"[:60]])
                continue
            speed = len(truth) / (time.perf_counter() - started)
            poses = pieces[0]
            cells = [
                folder.name,
                name,
                f"{len(poses)} of {len(truth)}",
                str(len(pieces)),
                *_format_errors(truth, poses),
                *_format_reprojection(truth, poses),
                f"{speed:.1f}",
            ]
            if true_mesh is not None:
                cells.append(f"{1000 * _measure_mesh_distance(truth, poses, true_mesh):.1f}")
            print_row(cells)


def _print_speed_row(folder: Path, count: int) -> None:
    """Register `count` frames of a scan; print speed and memory.

    The scan is traversed back and forth until there are enough frames.
    """
    there = read_frames(folder)
    places = itertools.cycle([*range(len(there)), *reversed(range(len(there)))])
    frames = [
        replace(hide_pose(there[place], depth_only=False), name=f"{number:05d}")
        for number, place in enumerate(itertools.islice(places, count))
    ]
    started = time.perf_counter()
    found = register(frames)
    seconds = time.perf_counter() - started
    # Peak memory of this process, KiB.
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print_row(
        [
            folder.name,
            f"{len(found.frames)} of {count}",
            str(len(found.key_frames)),
            str(len(found.edges)),
            f"{count / seconds:.1f}",
            f"{1000 * time.process_time() / count:.0f}",
            f"{peak_kib / 1024:.0f}",
        ]
    )


def _print_speed(folders: Sequence[Path], counts: Sequence[int]) -> None:
    print_head(["scan", "frames", "key frames", "edges", "frames/s", "CPU ms / frame", "peak MiB"], words=1)
    for folder, count in itertools.product(folders, counts):
        words = [sys.executable, __file__, str(folder), "--frames", str(count), "--child"]
        subprocess.run(words, check=True)


def read_frames(folder: Path, poses: Path | None = None) -> list[Frame]:
    """Read the frames of a scan with true poses and depth.

    Stereo pairs are matched.

    Parameters
    ----------
    poses : TUM trajectory with a pose for each frame, in order, if the folder has no poses.
    """
    if poses is not None:
        scan = read_scan(folder, complete=False)
        known = read_tum(poses).poses
        if len(known) != len(scan.frames):
            message = f"it has {len(known)} poses, but the scan has {len(scan.frames)} frames."
            raise InputError(MACHINE_BUG, message, poses)
        pairs = zip(scan.frames, known, strict=True)
        return [replace(frame, world_from_camera=pose) for frame, pose in pairs]
    scan = read_scan(folder)
    if not scan.is_stereo:
        return list(scan.frames)
    return [
        replace(frame, color=result.color, depth=result.depth, right=None)
        for frame, result in depth_scan(scan)
        if isinstance(result, DepthMap)
    ]


def hide_pose(frame: Frame, *, depth_only: bool) -> Frame:
    """Remove a frame's pose, and its colours if `depth_only`."""
    frame = replace(frame, world_from_camera=None)
    return replace(frame, color=None, color_camera=None, color_from_depth=None) if depth_only else frame


def align_umeyama(a: np.ndarray, b: np.ndarray, *, scale: bool) -> tuple[Pose, float]:
    """Align points `a` to `b` (n, 3) by least squares (Umeyama 1991).

    Returns the rigid motion (4, 4) and the scale, which is 1 unless `scale` is set.
    """
    centred = a - a.mean(axis=0), b - b.mean(axis=0)
    u, size, vt = np.linalg.svd(centred[0].T @ centred[1])
    mirror = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    factor = float(np.trace(np.diag(size) @ mirror) / (centred[0] ** 2).sum()) if scale else 1.0
    pose = np.eye(4)
    pose[:3, :3] = (u @ mirror @ vt).T
    pose[:3, 3] = b.mean(axis=0) - factor * pose[:3, :3] @ a.mean(axis=0)
    return pose, factor


def _format_errors(truth: Sequence[Frame], poses: dict[int, Pose]) -> list[str]:
    places = sorted(poses)
    a, b = (
        np.array([one[:3, 3] for one in of])
        for of in ([poses[p] for p in places], [require_rigid_pose(truth[p]) for p in places])
    )
    path = np.linalg.norm(np.diff(b, axis=0), axis=1).sum()
    ates = []
    for scale in (False, True):
        pose, factor = align_umeyama(a, b, scale=scale)
        off = factor * a @ pose[:3, :3].T + pose[:3, 3] - b
        ates.append(float(np.sqrt((off**2).sum(axis=1).mean())))
    true_poses = {p: require_rigid_pose(truth[p]) for p in places}
    steps = [
        invert_pose(invert_pose(true_poses[p]) @ true_poses[q]) @ invert_pose(poses[p]) @ poses[q]
        for p, q in itertools.pairwise(places)
    ]
    shift = float(np.median([np.linalg.norm(step[:3, 3]) for step in steps]))
    turn = float(np.degrees(np.median([compute_rotation_angle(step) for step in steps])))
    return [
        f"{1000 * ates[0]:.1f}",
        f"{ates[0] / path:.2%}",
        f"{1000 * ates[1]:.1f}",
        f"{1000 * shift:.1f}",
        f"{turn:.2f}",
        f"{1000 * _compute_rms([float(np.linalg.norm(step[:3, 3])) for step in steps]):.1f}",
        f"{np.degrees(_compute_rms([compute_rotation_angle(step) for step in steps])):.3f}",
    ]


def _compute_rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _format_reprojection(truth: Sequence[Frame], poses: dict[int, Pose]) -> list[str]:
    """Format median reprojection errors of estimated and true poses, pixels."""
    found = measure_agreement(
        [replace(truth[p], world_from_camera=poses[p]) for p in poses], range(len(poses))
    )
    true = measure_agreement([truth[p] for p in poses], range(len(poses)))
    return [f"{one.median_px:.2f}" if len(one.errors) else "" for one in (found, true)]


def _measure_mesh_distance(truth: Sequence[Frame], poses: dict[int, Pose], true_mesh: Mesh) -> float:
    places = sorted(poses)
    aligned, _ = align_umeyama(
        np.array([poses[p][:3, 3] for p in places]),
        np.array([require_rigid_pose(truth[p])[:3, 3] for p in places]),
        scale=False,
    )
    mesh = fuse([replace(truth[p], world_from_camera=aligned @ poses[p]) for p in places]).mesh
    return compare(true_mesh, mesh, samples=200_000).symmetric.rms


def _list_components(found: Registration) -> list[dict[int, Pose]]:
    """List the poses of each component by frame index.

    The component in use is the first. Each component has its own world.
    """
    used = dict(zip(found.frame_indices, found.frames, strict=True))
    return [
        {place: require_rigid_pose(frame) for place, frame in one.items()}
        for one in (used, *found.other_pieces.values())
    ]


def _chain_steps(
    frames: Sequence[Frame], image: Callable[[Frame], Any], step: Callable[[Any, Any], Pose]
) -> dict[int, Pose]:
    poses = {0: np.eye(4)}
    before = image(frames[0])
    for place, frame in enumerate(frames[1:], 1):
        now = image(frame)
        poses[place] = poses[place - 1] @ step(now, before)
        before = now
    return poses


if __name__ == "__main__":
    main()
