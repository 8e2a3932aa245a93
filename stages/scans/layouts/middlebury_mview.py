"""Middlebury multi-view: posed images of an object, without depth (templeRing, dinoRing, …)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.path_safety import is_safe_relative_path
from scanloom.stages.scans.calibration.camera_files import create_camera_from_matrix
from scanloom.stages.scans.codes import SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import find_common_size
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_NUMBER_COUNT = 21  # K and R (row-major), and t.
# Maximum skew, pixels; smaller values move no point visibly.
_MAX_SKEW_PX = 0.1
_TRIPLE_PATTERN = r"\(([^()]{5,200})\)"
_BOX_PATTERN = re.compile(
    rf"bounding box[^()]{{0,200}}{_TRIPLE_PATTERN}\s{{0,20}}{_TRIPLE_PATTERN}", re.IGNORECASE
)
_MAX_NAME_BYTES = 255
_MAX_NOTES_BYTES = 1 << 20
_MAX_COORDINATE_M = 1e6


def _matches(folder: Path) -> str | None:
    found = sorted(folder.glob("*_par.txt"))
    return found[0].name if found else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    par = _find_par_file(folder)
    rows = _read_rows(par)
    names = [Path(name).stem for name, _ in rows]
    size = find_common_size([folder / name for name, _ in rows])
    stated = options.get_camera(*size)
    path = options.resolve_file("poses", folder)
    given = (
        None
        if path is None
        else trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    )
    frames = []
    for number, (name, values) in enumerate(rows):
        camera = stated or _create_camera(values[:9].reshape(3, 3), size, par, name)
        pose = _parse_world_from_camera(values, par, name) if given is None else given[number]
        frames.append(Frame(names[number], camera, color=folder / name, world_from_camera=pose))
    return Scan(LAYOUT.name, frames, None, folder, bounding_box=_read_bounding_box(folder))


def _find_par_file(folder: Path) -> Path:
    found = sorted(folder.glob("*_par.txt"))
    if len(found) != 1:
        raise InputError(
            SCAN_FILES_MISSING,
            "exactly one camera file NAME_par.txt is required; the folder has {found_count}.",
            folder,
            found_count=len(found),
        )
    return found[0]


def _read_rows(par: Path) -> list[tuple[str, NDArray[np.float64]]]:
    """Read the image names and camera parameters (21,) of a _par.txt file.

    If the file states the number of images, it must match.
    """
    stated: int | None = None
    rows: list[tuple[str, NDArray[np.float64]]] = []
    for number, text in documents.iterate_lines(par):
        name, *words = text.split()
        if not rows and stated is None and not words and name.isdecimal():
            stated = int(name[:9])
            continue
        is_file_name = Path(name).name == name and is_safe_relative_path(name)
        if not is_file_name or len(name.encode("utf-8", "replace")) > _MAX_NAME_BYTES:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "line {number}: {name!r} is not the name of an image in the same folder.",
                par,
                number=number,
                name=name,
            )
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.empty(0)
        if values.size != _NUMBER_COUNT:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "line {number} ({name}) must be a name and {numbers} numbers (K, R and t).",
                par,
                number=number,
                name=name,
                numbers=_NUMBER_COUNT,
            )
        rows.append((name, values))
    if not rows:
        raise InputError(SCAN_TABLE_DAMAGED, "the file lists no images.", par)
    if stated is not None and stated != len(rows):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the file states {stated} images but lists {rows_count}",
            par,
            remedy="copy the file again.",
            stated=stated,
            rows_count=len(rows),
        )
    return rows


def _create_camera(matrix: NDArray[np.float64], size: tuple[int, int], par: Path, name: str) -> Camera:
    if np.isfinite(matrix).all() and abs(matrix[0, 1]) > _MAX_SKEW_PX:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the camera of {name} has skew (K[0,1] is not 0), which is not supported.",
            par,
            name=name,
        )
    return create_camera_from_matrix(matrix, (), *size, par)


def _parse_world_from_camera(values: NDArray[np.float64], par: Path, name: str) -> Pose | None:
    camera_from_world = np.column_stack([values[9:18].reshape(3, 3), values[18:]])
    pose = check_rigid_pose(camera_from_world, par, name)
    return None if pose is None else invert_pose(pose)


def _read_bounding_box(folder: Path) -> NDArray[np.float64] | None:
    """Read the bounding box (2, 3), min and max corner, from READMEs.

    Returns None if no README states one.
    """
    for notes in sorted(folder.glob("README*")):
        try:
            text = documents.read_text(notes) if notes.stat().st_size < _MAX_NOTES_BYTES else ""
            found = _BOX_PATTERN.search(text)
            triples = found.groups() if found else ()
            corners = [[float(word) for word in triple.replace(",", " ").split()] for triple in triples]
        except (InputError, OSError, ValueError):
            continue  # READMEs are free text. Without a box, the object extent is estimated from the views.
        box = np.array(corners) if [len(corner) for corner in corners] == [3, 3] else np.empty((0, 3))
        if len(box) and (np.abs(box) < _MAX_COORDINATE_M).all() and (box[0] < box[1]).all():
            return box
    return None


LAYOUT = Layout(
    name="middlebury-mview",
    description="NAME_par.txt with K, R and t of each image in the folder (Middlebury multi-view)",
    matches=_matches,
    read=_read,
)
