"""Tiny scan folders of two frames in the layouts of several makers, and recordings."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tiny_recordings import recording, ros_bag

from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame

_SAMPLES = Path(__file__).resolve().parents[2] / "samples"
_CAMERA = Camera(32, 24, 100.0, 100.0, 16.0, 12.0)
_TURNED = np.array([[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1.0]])
_POSES = (np.eye(4), _TURNED)
_INTRINSICS = "100 0 16\n0 100 12\n0 0 1\n"


def _write_images(folder: Path, color: str, depth: str | None, names: Sequence[str]) -> None:
    """Write colour, and depth in millimetres, for each name into path templates."""
    for name in names:
        for form in (color, depth):
            if form is not None:
                path = folder / form.format(name)
                path.parent.mkdir(parents=True, exist_ok=True)
                pixels = np.full((24, 32, 3), 120, np.uint8)
                pixels[:, 10:20] = (10, 40, 230)
                assert cv2.imwrite(str(path), pixels if form is color else np.full((24, 32), 2000, np.uint16))


def _format_rows(matrix: NDArray[np.float64]) -> str:
    out = io.StringIO()
    np.savetxt(out, matrix, "%.6f")
    return out.getvalue()


def _write_scan_json(folder: Path) -> None:
    _write_images(folder, "color/{}.png", "depth/{}.png", ("0", "1"))
    frames = [
        Frame(
            str(i),
            _CAMERA,
            folder / f"color/{i}.png",
            depth=folder / f"depth/{i}.png",
            world_from_camera=pose,
        )
        for i, pose in enumerate(_POSES)
    ]
    write_scan_json(folder, frames)


def _write_tum(folder: Path) -> None:
    names = ("10.000000", "10.500000")
    _write_images(folder, "rgb/{}.png", "depth/{}.png", names)
    for kind in ("rgb", "depth"):
        (folder / f"{kind}.txt").write_text("# list\n" + "".join(f"{n} {kind}/{n}.png\n" for n in names))
    (folder / "groundtruth.txt").write_text("# t\n10.0 0 0 0 0 0 0 1\n10.5 1 2 3 0 0.6 0 0.8\n")


def _write_seven_scenes(folder: Path) -> None:
    names = ("frame-000002", "frame-000010")
    _write_images(folder, "{}.color.png", "{}.depth.png", names)
    for name, pose in zip(names, _POSES, strict=True):
        (folder / f"{name}.pose.txt").write_text(_format_rows(pose))
    (folder / "camera-intrinsics.txt").write_text(_INTRINSICS)


def _write_redwood(folder: Path) -> None:
    _write_images(folder, "color/{}.jpg", "depth/{}.png", ("2", "10"))
    log = [f"{i} {i} {i + 1}\n{_format_rows(pose)}" for i, pose in enumerate(_POSES)]
    (folder / "trajectory.log").write_text("".join(log))
    camera = {"width": 32, "height": 24, "intrinsic_matrix": [100, 0, 0, 0, 100, 0, 16, 12, 1]}
    (folder / "intrinsic.json").write_text(json.dumps(camera))


def _write_nerfstudio(folder: Path) -> None:
    _write_images(folder, "images/{}.png", "depth/{}.png", ("2", "10"))
    frames = [
        {
            "file_path": f"images/{n}.png",
            "depth_file_path": f"depth/{n}.png",
            "transform_matrix": pose.tolist(),
        }
        for n, pose in zip((2, 10), _POSES, strict=True)
    ]
    lens = {"camera_model": "OPENCV", "w": 32, "h": 24, "fl_x": 100.0, "fl_y": 100.0, "cx": 16.5, "cy": 12.5}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))


def _write_colmap(folder: Path) -> None:
    _write_images(folder, "images/{}.png", None, ("2", "10"))
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("# cameras\n7 PINHOLE 32 24 100 100 16.5 12.5\n")
    (model / "images.txt").write_text(
        "# images\n1 1 0 0 0 0 0 0 7 2.png\n1.5 2.5 1\n2 0.8 0 -0.6 0 3 -2 -1 7 10.png\n3.5 2.5 1\n"
    )
    (model / "points3D.txt").write_text("1 0.1 0.2 2 10 20 30 0.5 1 0 2 0\n")


def _write_stereo(folder: Path) -> None:
    for side in ("left", "right"):
        _write_images(folder, f"{side}/{{}}.png", None, ("0", "1"))
    lens = "width = 32\nheight = 24\nfx = 100.0\nfy = 100.0\ncx = 16.0\ncy = 12.0\n"
    (folder / "calibration.toml").write_text(f"baseline = 0.1\n[left]\n{lens}[right]\n{lens}")
    (folder / "poses.txt").write_text(
        "".join(" ".join(_format_rows(pose[:3]).split()) + "\n" for pose in _POSES)
    )


def _write_middlebury(folder: Path) -> None:
    _write_images(folder, "im{}.png", None, ("0", "1"))
    (folder / "calib.txt").write_text(
        "cam0=[100 0 16; 0 100 12; 0 0 1]\ncam1=[100 0 20; 0 100 12; 0 0 1]\ndoffs=4\nbaseline=250\n"
        "width=32\nheight=24\nndisp=30\nisint=0\n"
    )


def _write_karlsruhe(folder: Path) -> None:
    _write_images(folder, "I{}.png", None, ("1_000000", "1_000001", "2_000000", "2_000001"))
    (folder / "calib.txt").write_text(
        "P1_roi: 100 0 16 0 0 100 12 0 0 0 1 0\nP2_roi = 100 0 16 -50 0 100 12 0 0 0 1 0\n"
    )
    (folder / "poses.txt").write_text(
        "".join(" ".join(_format_rows(pose[:3]).split()) + "\n" for pose in _POSES)
    )


def _write_kitti(folder: Path) -> None:
    _write_images(folder, "{}.png", None, [f"image_{side}/00000{n}" for side in (2, 3) for n in (0, 1)])
    rows = {0: 0, 1: -50, 2: 0, 3: -50}
    (folder / "calib.txt").write_text(
        "".join(f"P{k}: 100 0 16 {b} 0 100 12 0 0 0 1 0\n" for k, b in rows.items())
    )
    (folder / "poses.txt").write_text(
        "".join(" ".join(_format_rows(pose[:3]).split()) + "\n" for pose in _POSES)
    )


def _write_bundle_fusion(folder: Path) -> None:
    names = ("frame-000002", "frame-000010")
    _write_images(folder, "{}.color.png", "{}.depth.png", names)
    for name, pose in zip(names, _POSES, strict=True):
        (folder / f"{name}.pose.txt").write_text(_format_rows(pose))
    camera = "100 0 16 0 0 100 12 0 0 0 1 0 0 0 0 1"
    (folder / "info.txt").write_text(
        "m_versionNumber = 4\nm_colorWidth = 32\nm_colorHeight = 24\nm_depthShift = 1000\n"
        f"m_calibrationColorIntrinsic = {camera}\nm_calibrationDepthIntrinsic = {camera}\n"
    )


def _write_camera_text(folder: Path) -> None:
    names = ("frame-000002", "frame-000010")
    _write_images(folder, "{}.color.png", "{}.depth.png", names)
    blocks = {
        f"Camera-to-world extrinsic matrix for {n}": _format_rows(p)
        for n, p in zip(names, _POSES, strict=True)
    }
    blocks["Color camera intrinsic matrix"] = blocks["Depth camera intrinsic matrix"] = _INTRINSICS
    blocks["Depth-to-color camera extrinsic matrix"] = _format_rows(np.eye(4))
    (folder / "cam.info.txt").write_text("".join(f"# {head}\n{rows}\n" for head, rows in blocks.items()))


def _write_view_circle(folder: Path) -> None:
    _write_images(folder, "x{}.png", None, ("0001", "0002"))
    rows = []
    for k, pose in enumerate(_POSES, 1):
        moved = np.linalg.inv(pose)
        values = [100, 0, 16, 0, 100, 12, 0, 0, 1, *moved[:3, :3].ravel(), *moved[:3, 3]]
        rows.append(f"x000{k}.png {' '.join(map(str, values))}\n")
    (folder / "x_par.txt").write_text(f"{len(rows)}\n{''.join(rows)}")
    (folder / "README.txt").write_text("bounding box is (-0.1 -0.2 -0.3) (0.1 0.2 0.3)\n")


def _write_bag(folder: Path) -> None:
    ros_bag().write(folder / "take.bag")


def _write_realsense(folder: Path) -> None:
    recording().write(folder / "take.bag")


def _write_mcap(folder: Path) -> None:
    ros_bag().write_ros2(folder / "take", "mcap")


def _copy_sample_rgbd(folder: Path) -> None:
    """Copy the first frames of the sample."""
    listed = json.loads((_SAMPLES / "rgbd" / "scan.json").read_text(encoding="utf-8"))
    listed["frames"] = listed["frames"][:2]
    (folder / "scan.json").write_text(json.dumps(listed))
    _copy_files(_SAMPLES / "rgbd", folder, ("color", "depth"))


def _copy_sample_stereo(folder: Path) -> None:
    """Copy the first pairs of the sample."""
    _copy_files(_SAMPLES / "stereo", folder, ("left", "right"))
    shutil.copy(_SAMPLES / "stereo" / "calibration.toml", folder)
    poses = (_SAMPLES / "stereo" / "poses.txt").read_text(encoding="utf-8").splitlines()
    (folder / "poses.txt").write_text("\n".join(poses[:2]))


def _copy_files(sample: Path, folder: Path, kinds: Sequence[str]) -> None:
    for kind in kinds:
        (folder / kind).mkdir()
        for path in sorted((sample / kind).iterdir())[:2]:
            shutil.copy(path, folder / kind)


# The path that read_scan gets, relative to the folder, and the function that writes the scan.
SCANS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "scan.json": (".", _write_scan_json),
    "TUM": (".", _write_tum),
    "7-Scenes": (".", _write_seven_scenes),
    "Redwood": (".", _write_redwood),
    "nerfstudio": (".", _write_nerfstudio),
    "COLMAP": (".", _write_colmap),
    "stereo pairs": (".", _write_stereo),
    "Middlebury": (".", _write_middlebury),
    "Middlebury views": (".", _write_view_circle),
    "Karlsruhe": (".", _write_karlsruhe),
    "KITTI": (".", _write_kitti),
    "BundleFusion": (".", _write_bundle_fusion),
    "camera text": (".", _write_camera_text),
    "sample of RGB-D": (".", _copy_sample_rgbd),
    "sample of stereo": (".", _copy_sample_stereo),
    "ROS bag": ("take.bag", _write_bag),
    "RealSense bag": ("take.bag", _write_realsense),
    "ROS 2 folder": ("take", _write_mcap),
}
