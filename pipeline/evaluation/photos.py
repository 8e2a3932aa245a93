"""Camera poses and small photos of a scan, for the report page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import encoded_image
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import Frame, pinhole
from scanloom.stages.scans.model.threads import threads_to_use

FILE, PHOTOS = "cameras.json", "photos"

_WIDTH = 480
# Maximum number of cameras: recordings have tens of thousands of frames, and the camera path needs fewer.
_MOST_CAMERAS = 2_000
_QUALITY = 75


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
    shown = sample_evenly(len(posed), _MOST_CAMERAS).tolist()
    told = [posed[number] for number in shown]
    chosen = [number for number in sample_evenly(len(told), count).tolist() if told[number].color is not None]
    (folder / PHOTOS).mkdir()

    def written(number: int) -> tuple[int, str | None]:
        try:
            image, _, _ = read_photo(told[number])
        except InputError:
            return number, None
        height = max(1, round(image.shape[0] * _WIDTH / image.shape[1]))
        small = cv2.resize(image, (_WIDTH, height), interpolation=cv2.INTER_AREA)
        name = f"{PHOTOS}/{number:06d}.jpg"
        (folder / name).write_bytes(encoded_image(np.asarray(small, np.uint8), "jpeg", _QUALITY))
        return number, name

    threads = threads_to_use()
    photos = dict(read_ahead(written, chosen, threads=threads, ahead=threads))
    cameras = [
        {**_told(frame, photos.get(number)), "held_out": shown[number] >= last}
        for number, frame in enumerate(told)
    ]
    (folder / FILE).write_text(
        json.dumps({"posed": len(posed), "cameras": cameras}) + "\n", encoding="utf-8", newline="\n"
    )
    return sum(name is not None for name in photos.values())


def _told(frame: Frame, photo: str | None) -> dict[str, Any]:
    assert frame.world_from_camera is not None
    camera = pinhole(frame.color_camera or frame.camera)
    pose = np.asarray(frame.world_from_camera, np.float64)
    if frame.color_from_depth is not None:
        pose = pose @ inverted(np.asarray(frame.color_from_depth, np.float64))
    known = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")} if camera.is_calibrated else {}
    return {
        "frame": frame.name,
        "world_from_camera": pose.round(7).ravel().tolist(),
        "size": [camera.width, camera.height],
        **known,
        "photo": photo,
    }
