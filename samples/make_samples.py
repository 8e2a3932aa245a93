"""Generator of the sample scans.

`python samples/make_samples.py` rewrites stereo/, rgbd/ and truth.ply in the folder of this file. In both
scans, noisy cameras (sensors.py) move along an arc around the corner of a room (scene.py). All random numbers
have fixed seeds.

- stereo/: 14 pairs of 480×360 from a rig with a baseline of 12 cm, not rectified: the right camera is rotated
  by about one degree, and both lenses distort. `format_calibration.toml`, `poses.txt` (left camera to world).
- rgbd/: 24 frames of 320×240 with registered depth in millimetres; `scan.json` with camera and poses.
- truth.ply: the true surface, with the scene's colours at its vertices.

--tags adds AprilTags to floor and walls. --visitor adds a person in a red coat to every tenth frame of rgbd/,
at a different position each time. Pass a folder with these options, because the sample scans have neither.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from scene import Scene
from sensors import measure_depth, photograph

from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, StereoRig
from scanloom.stages.surface.formats.ply import write_ply

SEED = 7
LEFT = Camera(480, 360, 432.4, 431.8, 243.1, 176.2, (-0.112, 0.041, 0.0006, -0.0004))
RIGHT = Camera(480, 360, 430.9, 430.6, 236.7, 182.5, (-0.107, 0.036, -0.0003, 0.0005))
RIGHT_TURN = np.deg2rad((0.5, -1.2, 0.4))  # rotation vector of the right camera in the axes of the left one
BASELINE = 0.12
DEPTH_CAMERA = Camera(320, 240, 291.0, 291.0, 159.2, 119.6)
PAIRS, DEPTH_FRAMES = 14, 24
VISITOR_FRAME = 4  # index within every ten frames
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 92]


def make_rig() -> StereoRig:
    """Make the calibrated stereo rig."""
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = cv2.Rodrigues(RIGHT_TURN)[0]
    # As in a real rig, the right camera's centre is slightly off the x axis of the left camera.
    right_from_left[:3, 3] = -right_from_left[:3, :3] @ np.array((BASELINE, 0.0012, -0.0008))
    return StereoRig(LEFT, RIGHT, right_from_left, is_rectified=False)


def make_arc_poses(count: int, sweep: float, phase: float) -> Iterator[Pose]:
    """Yield world-from-camera poses along an arc in front of the corner.

    Parameters
    ----------
    sweep : angle of the arc, degrees.
    phase : of the variation in elevation and distance, radians.
    """
    for t in np.linspace(0, 1, count):
        azimuth = np.deg2rad(-45 + sweep * (t - 0.5))
        elevation = np.deg2rad(34 + 11 * np.sin(2 * np.pi * 1.5 * t + phase))
        distance = 0.86 + 0.08 * np.cos(2 * np.pi * 2 * t + phase)
        target = np.array((-0.06, 0.06, 0.11)) + 0.05 * np.array(
            (np.sin(9 * t), np.cos(7 * t), np.sin(5 * t))
        )
        level = np.array((np.cos(azimuth), np.sin(azimuth), 0.0))
        eye = target + distance * (np.cos(elevation) * level + np.sin(elevation) * np.array((0, 0, 1)))
        forward = (target - eye) / distance
        right = np.cross(forward, (0, 0, 1))
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
        yield pose


def make_stereo(scene: Scene, folder: Path) -> None:
    """Write the stereo scan."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    pair, lines = make_rig(), []
    for i, pose in enumerate(make_arc_poses(PAIRS, 104, 0.4)):
        rng = np.random.default_rng((SEED, 0, i))
        right_pose = pose @ np.linalg.inv(pair.right_from_left)
        write_image(folder / "left" / f"{i:04d}.jpg", photograph(scene, pair.left, pose, rng))
        write_image(folder / "right" / f"{i:04d}.jpg", photograph(scene, pair.right, right_pose, rng))
        lines.append(" ".join(f"{value:.9f}" for value in pose[:3].ravel()))
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    (folder / "calibration.toml").write_text(format_calibration(pair))


def format_calibration(pair: StereoRig) -> str:
    """Format the rig as TOML."""
    rotation, translation = pair.right_from_left[:3, :3], pair.right_from_left[:3, 3]
    lines = [
        "# x_right = R x_left + T, metres; distortion is OpenCV's k1 k2 p1 p2.",
        "rectified = false",
        'unit = "m"',
        f"R = {np.round(rotation, 9).tolist()}",
        f"T = {np.round(translation, 9).tolist()}",
    ]
    for name, camera in (("left", pair.left), ("right", pair.right)):
        lines += ["", f"[{name}]"]
        lines += [f"{key} = {getattr(camera, key)}" for key in ("width", "height", "fx", "fy", "cx", "cy")]
        lines.append(f"distortion = {list(camera.distortion)}")
    return "\n".join(lines) + "\n"


def make_rgbd(scene: Scene, folder: Path, visited_scene: Callable[[int], Scene] | None = None) -> None:
    """Write the RGB-D scan.

    Parameters
    ----------
    visited_scene : returns the scene for a frame index; replaces `scene` in every tenth frame.
    """
    frames = []
    for kind in ("color", "depth"):
        (folder / kind).mkdir(parents=True)
    for i, pose in enumerate(make_arc_poses(DEPTH_FRAMES, 116, 2.0)):
        rng = np.random.default_rng((SEED, 1, i))
        color, depth = folder / "color" / f"{i:04d}.jpg", folder / "depth" / f"{i:04d}.png"
        shown = visited_scene(i) if visited_scene is not None and i % 10 == VISITOR_FRAME else scene
        write_image(color, photograph(shown, DEPTH_CAMERA, pose, rng))
        write_image(depth, measure_depth(shown, DEPTH_CAMERA, pose, rng))
        frames.append(
            Frame(f"{i:04d}", DEPTH_CAMERA, color=color, depth=depth, world_from_camera=np.round(pose, 9))
        )
    write_scan_json(folder, frames)


def write_image(path: Path, image: np.ndarray, *, compression: int = 9) -> None:
    """Write an RGB image or depth map in its suffix's format.

    Parameters
    ----------
    compression : level of PNG, 0 to 9.
    """
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    options = JPEG if path.suffix == ".jpg" else [cv2.IMWRITE_PNG_COMPRESSION, compression]
    path.write_bytes(cv2.imencode(path.suffix, image, options)[1].tobytes())


def main() -> None:
    """Write all scans into a folder, by default this script's folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).resolve().parent)
    parser.add_argument("--tags", action="store_true", help="paint AprilTags on floor and walls")
    parser.add_argument("--visitor", action="store_true", help="add a person to every tenth RGB-D frame")
    parser.add_argument("--only", choices=("stereo", "rgbd"), help="make this scan alone")
    options = parser.parse_args()
    folder: Path = options.folder
    scene = Scene(tags=options.tags)

    def make_visited_scene(number: int) -> Scene:
        return Scene(tags=options.tags, visitor=(0.05 * np.cos(number), -0.02 + 0.1 * np.sin(number)))

    if options.only != "rgbd":
        shutil.rmtree(folder / "stereo", ignore_errors=True)
        make_stereo(scene, folder / "stereo")
    if options.only != "stereo":
        shutil.rmtree(folder / "rgbd", ignore_errors=True)
        make_rgbd(scene, folder / "rgbd", make_visited_scene if options.visitor else None)
    write_ply(folder / "truth.ply", scene.mesh)


if __name__ == "__main__":
    main()
