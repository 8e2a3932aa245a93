"""Cameras in the output folder of a run, validated for its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.evaluation.codes import REPORT_INCOMPLETE
from scanloom.pipeline.evaluation.photos import FILE as CAMERAS
from scanloom.pipeline.report.page.one_file import PageCamera
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_json, require_inside
from scanloom.stages.files.opening import content_of

_JPEG = b"\xff\xd8\xff"


@contextmanager
def as_runs_write(path: Path) -> Iterator[None]:
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


def cameras_of(folder: Path, turn: NDArray[np.float64], skipped: Mapping[str, str]) -> list[PageCamera]:
    """Read the cameras of a scan from the output folder of a run.

    Parameters
    ----------
    folder : folder of the report's pictures.
    turn : (3, 3) rotation to the upright frame of the page.
    skipped : reasons of skipped frames by frame name.
    """
    path = folder / CAMERAS
    if not path.is_file():
        return []
    with as_runs_write(path):
        told: Any = read_json(path)
        return [_camera(one, path, turn, skipped) for one in told["cameras"] if "fx" in one]


def _camera(
    one: Mapping[str, Any], path: Path, turn: NDArray[np.float64], skipped: Mapping[str, str]
) -> PageCamera:
    pose = turn @ np.array(one["world_from_camera"], np.float64).reshape(4, 4)[:3]
    size = [int(one["size"][0]), int(one["size"][1])]
    focal, center = [float(one["fx"]), float(one["fy"])], [float(one["cx"]), float(one["cy"])]
    if not (np.isfinite(pose).all() and np.isfinite([*focal, *center]).all() and min(*size, *focal) > 0):
        raise ValueError(one)
    photo = None if one["photo"] is None else _photo(one["photo"], path)
    frame = str(one["frame"])
    mark = "held out" if one.get("held_out") else skipped.get(frame, "")
    return PageCamera(frame, pose.round(6).ravel().tolist(), size, focal, center, photo, mark)


def _photo(name: str, path: Path) -> bytes:
    """Read a photo named in cameras.json.

    Files outside the folder are rejected, because pages are shared.
    """
    photo = path.parent / require_inside(name, path, "photo")
    if not photo.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(
            REPORT_INCOMPLETE, "the photo {name!r} is outside the folder.", path, name=name[:100]
        )
    if not photo.is_file():
        raise InputError(REPORT_INCOMPLETE, "this photo is missing", photo, remedy="run again.")
    content = content_of(photo)
    if not content.startswith(_JPEG):
        raise InputError(REPORT_INCOMPLETE, "this is not a JPEG file.", photo)
    return content
