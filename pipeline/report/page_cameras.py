"""Cameras in the output folder of a run, validated for its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.evaluation.camera_photos import CAMERAS_FILE as CAMERAS
from scanloom.pipeline.evaluation.codes import REPORT_INCOMPLETE
from scanloom.pipeline.report.page.single_file_page import PageCamera
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_json, require_inside
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.path_safety import resolve_path

_JPEG = b"\xff\xd8\xff"


@contextmanager
def convert_parse_errors(path: Path) -> Iterator[None]:
    """Convert parsing errors of a run file to InputError."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            REPORT_INCOMPLETE,
            "this file was not written by a run, or is damaged",
            path,
            remedy="run again, or move the file away.",
        ) from error


def read_cameras(folder: Path, rotation: NDArray[np.float64], skipped: Mapping[str, str]) -> list[PageCamera]:
    """Read the cameras of a scan from the output folder of a run.

    Parameters
    ----------
    folder : folder of the report's pictures.
    rotation : (3, 3) rotation to the upright frame of the page.
    skipped : reasons of skipped frames by frame name.
    """
    path = folder / CAMERAS
    if not path.is_file():
        return []
    with convert_parse_errors(path):
        document: Any = read_json(path)
        return [_parse_camera(one, path, rotation, skipped) for one in document["cameras"] if "fx" in one]


def _parse_camera(
    values: Mapping[str, Any], path: Path, rotation: NDArray[np.float64], skipped: Mapping[str, str]
) -> PageCamera:
    pose = rotation @ np.array(values["world_from_camera"], np.float64).reshape(4, 4)[:3]
    size = [int(values["size"][0]), int(values["size"][1])]
    focal, center = [float(values["fx"]), float(values["fy"])], [float(values["cx"]), float(values["cy"])]
    if not (np.isfinite(pose).all() and np.isfinite([*focal, *center]).all() and min(*size, *focal) > 0):
        raise ValueError(values)
    photo = None if values["photo"] is None else _read_photo(values["photo"], path)
    frame = str(values["frame"])
    mark = "held out" if values.get("held_out") else skipped.get(frame, "")
    return PageCamera(frame, pose.round(6).ravel().tolist(), size, focal, center, photo, mark)


def _read_photo(name: str, path: Path) -> bytes:
    """Read a photo named in cameras.json.

    Files outside the folder are rejected, because pages are shared.
    """
    photo = path.parent / require_inside(name, path, "photo")
    if not resolve_path(photo).is_relative_to(resolve_path(path.parent)):
        raise InputError(
            REPORT_INCOMPLETE, "the photo {name!r} is outside the folder.", path, name=name[:100]
        )
    if not photo.is_file():
        raise InputError(REPORT_INCOMPLETE, "this photo is missing", photo, remedy="run again.")
    content = read_input_bytes(photo)
    if not content.startswith(_JPEG):
        raise InputError(REPORT_INCOMPLETE, "this is not a JPEG file.", photo)
    return content
