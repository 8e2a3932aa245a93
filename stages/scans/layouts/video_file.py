"""Video file, such as of a phone, without poses and depth.

Frames are named by their index in the video. Up to 10 frames per second and 600 in total are read;
`extract_frames` selects the frames for structure from motion.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.scans.advice import describe_frame_extraction
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import SCAN_VIDEO_TOO_LONG
from scanloom.stages.scans.layouts.plain_photos import guess_camera
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import scale_to_size
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, PackedImage, Scan
from scanloom.stages.scans.model.video import VIDEO_SUFFIXES, Video

# Frames that are read. Each is decoded and tracked, so their number limits the time of the selection.
_MAX_FRAMES, _MAX_RATE = 600, 10.0
# An hour at 30 frames per second. All frames before the last one that is read are decoded.
_MAX_STORED_FRAMES = 108_000


def _matches(folder: Path) -> str | None:  # noqa: ARG001
    # Folders with other files may also hold videos.
    return None


def _read(file: Path, options: ReadingParams) -> Scan:
    video = _open(file)
    count = video.frame_count or video.count_frames(_MAX_STORED_FRAMES + 1)
    if count > _MAX_STORED_FRAMES:
        raise InputError(
            SCAN_VIDEO_TOO_LONG,
            "the video has more than {maximum:,} frames.",
            file,
            remedy="Cut it, such as with `ffmpeg -ss 0 -t 600 -i {source} -c copy {target}`.",
            maximum=_MAX_STORED_FRAMES,
            source=file.name,
            target=f"{file.stem}-part{file.suffix}",
        )
    camera = get_stated_camera(options, file, video.width, video.height)
    if camera is None:
        camera = guess_camera(video.width, video.height)
    elif (camera.width, camera.height) != (video.width, video.height):
        camera = scale_to_size(camera, (video.width, video.height), "the video", file)
    step = max(1, math.ceil(count / _MAX_FRAMES), math.floor(video.frame_rate / _MAX_RATE))
    frames = [
        Frame(
            f"{number:06d}",
            camera,
            color=PackedImage(video.path, f"frame {number}", partial(video.read_frame, number)),
        )
        for number in range(0, count, step)
    ]
    missing = describe_missing_poses(
        "a video has none",
        remedy="`scanloom run` estimates them; other commands need a scan folder with poses",
    )
    return Scan(LAYOUT.name, frames, None, file, missing=(missing,), is_metric=False)


def _open(file: Path) -> Video:
    """Open a video, and decode its first frame."""
    try:
        video = Video(file, apply_rotation=True)
        video.read_frame(0)
    except InputError as error:
        if error.diagnostic.code != RECORDING_DAMAGED.name:
            raise
        remedy = f"Copy the video again. If other programs play it, {describe_frame_extraction(file)}"
        raise InputError.from_diagnostic(replace(error.diagnostic, remedy=remedy)) from error
    return video


LAYOUT = Layout(
    name="video",
    description="video file, such as of a phone: poses of its frames are estimated",
    matches=_matches,
    read=_read,
    suffixes=VIDEO_SUFFIXES,
)
