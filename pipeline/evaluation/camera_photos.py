"""Camera poses and small photos of a scan, for the report page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame, to_pinhole
from scanloom.stages.scans.model.threads import get_thread_count

CAMERAS_FILE, PHOTOS_FOLDER = "cameras.json", "photos"

_PHOTO_WIDTH = 480
# Maximum number of cameras: recordings have tens of thousands of frames, and the camera path needs fewer.
_MAX_CAMERAS = 2_000
_JPEG_QUALITY = 75


def write_photos(folder: Path, frames: Sequence[Frame], count: int, held_out: Sequence[Frame] = ()) -> int:
    """Write cameras.json and photos spread evenly over the scan.

    Up to `count` photos are written; the number of written photos is returned.

    cameras.json has the number of frames with a pose, `posed`, and a list `cameras` of up to 2,000 of them,
    spread evenly, held-out frames last. A camera has `frame` (name), `world_from_camera` (pose of the colour
    camera: 16 numbers, row-major, metres, OpenCV axes), `size`, `fx`, `fy`, `cx`, `cy` of the pinhole camera
    in pixels, `held_out`, and `photo` (name of a JPEG file or null).
    """
    require_opencv()
    import cv2

    posed = [frame for frame in (*frames, *held_out) if frame.world_from_camera is not None]
    last = len(posed) - sum(frame.world_from_camera is not None for frame in held_out)
    listed_indices = sample_evenly(len(posed), _MAX_CAMERAS).tolist()
    listed = [posed[number] for number in listed_indices]
    chosen = [
        number for number in sample_evenly(len(listed), count).tolist() if listed[number].color is not None
    ]
    (folder / PHOTOS_FOLDER).mkdir()

    def write_photo(number: int) -> tuple[int, str | None]:
        try:
            image, _, _ = read_photo(listed[number])
        except InputError:
            return number, None
        height = max(1, round(image.shape[0] * _PHOTO_WIDTH / image.shape[1]))
        small = cv2.resize(image, (_PHOTO_WIDTH, height), interpolation=cv2.INTER_AREA)
        name = f"{PHOTOS_FOLDER}/{number:06d}.jpg"
        (folder / name).write_bytes(encode_image(np.asarray(small, np.uint8), "jpeg", _JPEG_QUALITY))
        return number, name

    threads = get_thread_count()
    photos = dict(map_ordered(write_photo, chosen, threads=threads, max_pending=threads))
    cameras = [
        {**_describe_camera(frame, photos.get(number)), "held_out": listed_indices[number] >= last}
        for number, frame in enumerate(listed)
    ]
    (folder / CAMERAS_FILE).write_text(
        json.dumps({"posed": len(posed), "cameras": cameras}) + "\n", encoding="utf-8", newline="\n"
    )
    return sum(name is not None for name in photos.values())


def _describe_camera(frame: Frame, photo: str | None) -> dict[str, Any]:
    assert frame.world_from_camera is not None
    camera = to_pinhole(frame.color_camera or frame.camera)
    pose = np.asarray(frame.world_from_camera, np.float64)
    if frame.color_from_depth is not None:
        pose = pose @ invert_pose(np.asarray(frame.color_from_depth, np.float64))
    known = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")} if camera.is_calibrated else {}
    return {
        "frame": frame.name,
        "world_from_camera": pose.round(7).ravel().tolist(),
        "size": [camera.width, camera.height],
        **known,
        "photo": photo,
    }
