"""KITTI stereo 2012 and 2015: calibrated scenes of two frames each.

2015: image_2/000000_10.png  image_3/  calib_cam_to_cam/000000.txt
2012: image_0/000000_10.png  image_1/  (or colored_0/, colored_1/)  calib/000000.txt
"""

from __future__ import annotations

import re
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import record_opened
from scanloom.stages.files.images import read_image_size
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, RECORDING_SEVERAL, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import has_all, list_images, match_by_number
from scanloom.stages.scans.layouts.kitti.projections import (
    create_projected_rig,
    read_projections,
    resolve_rectified_size,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CAMERA_FOLDERS = (
    ("image_2", "image_3", 2),
    ("colored_0", "colored_1", 2),
    ("image_0", "image_1", 0),
)
_CALIBRATION_FOLDERS = ("calib_cam_to_cam", "calib")
_IMAGE_NAME = re.compile(r"(\d{6})_\d\d")


def _matches(folder: Path) -> str | None:
    calibrations = next((name for name in _CALIBRATION_FOLDERS if (folder / name).is_dir()), None)
    left = next((left for left, right, _ in _CAMERA_FOLDERS if has_all(folder, left, right)), None)
    if calibrations is None or left is None:
        return None
    named = any(_IMAGE_NAME.fullmatch(path.stem) for path in list_images(folder / left))
    return f"{left}/ with scenes like 000000_10.png, and {calibrations}/" if named else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    found = next((names for names in _CAMERA_FOLDERS if has_all(folder, *names[:2])), None)
    if found is None:
        raise InputError(
            SCAN_FILES_MISSING,
            "two folders image_2/ and image_3/ (or image_0/, image_1/) are required.",
            folder,
        )
    left, right, at = found
    lefts, rights = (
        [path for path in list_images(folder / name) if _IMAGE_NAME.fullmatch(path.stem)]
        for name in (left, right)
    )
    pairs, skipped = match_by_number(lefts, rights, f"{left}/", f"{right}/", folder)
    end = None if options.last is None else options.last + 1
    scenes = sorted({one.stem[:6] for one, _ in pairs[options.first : end : options.every]})
    if len(scenes) != 1:
        raise InputError(
            RECORDING_SEVERAL,
            "the folder has {scenes_count} scenes of one or two pairs each",
            folder,
            remedy="select one: for {pairs_stem}, set scan.first=0 and scan.last=0.",
            scenes_count=len(scenes),
            pairs_stem=pairs[0][0].stem,
        )
    (scene,) = scenes
    calib = options.resolve_file("calibration", folder) or next(
        (path for name in _CALIBRATION_FOLDERS if (path := folder / name / f"{scene}.txt").exists()), None
    )
    if calib is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "calib_cam_to_cam/{scene}.txt is missing",
            folder,
            remedy="name a calibration with scan.calibration=FILE.",
            scene=scene,
        )
    # Mark the calibrations of the other scenes as known, so that they are not reported as unused files.
    for one, _ in pairs:
        record_opened(calib.with_name(f"{one.stem[:6]}.txt"))
    projections = read_projections(calib)
    if not {at, at + 1} <= projections.keys():
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "the projection matrices P{at} and P{at_2} are missing.",
            calib,
            at=at,
            at_2=at + 1,
        )
    size = read_image_size(next(one for one, _ in pairs if one.stem.startswith(scene)))
    stated = resolve_rectified_size(calib, size)
    rig, _ = create_projected_rig(projections[at], projections[at + 1], size, options, calib, stated)
    # Poses of the other scenes are dropped when the frame selection of the user is applied.
    given = options.resolve_file("poses", folder)
    names = [one.stem for one, _ in pairs]
    poses: list[Pose | None] = [None] * len(pairs)
    if given is not None:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    frames = [
        Frame(name=name, camera=rig.left, color=one, right=other, world_from_camera=pose)
        for name, (one, other), pose in zip(names, pairs, poses, strict=True)
    ]
    missing = (describe_missing_poses("the data set contains no poses"),) if given is None else ()
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


LAYOUT = Layout(
    name="kitti-stereo",
    description="image_2/000000_10.png, image_3/, calib_cam_to_cam/000000.txt (KITTI stereo 2012, 2015)",
    matches=_matches,
    read=_read,
)
