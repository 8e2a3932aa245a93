"""Random access to video frames by index.

Frames are decoded in sequence, because timestamps in containers are unreliable.
"""

from __future__ import annotations

import math
import os
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.input_files import open_input
from scanloom.stages.files.memory_check import check_memory_available
from scanloom.stages.scans.model.scan import ColorImage

# Bytes of decoded frames to keep, because threads request neighbouring frames in varying order.
_DECODED_BYTES = 1 << 27
# Images that a decoder holds: up to 16 reference pictures, and some in its pipeline.
_DECODER_IMAGES = 20
# Suffixes and first bytes of containers: box types of MP4 and QuickTime; AVI, Matroska, ASF and MPEG. Other
# files are refused, because FFmpeg also reads playlists, which could make FFmpeg open further files.
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".3gp", ".avi", ".mkv", ".webm", ".wmv", ".mpg", ".mpeg")
_FIRST_BOX_TYPES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_STARTS = (b"RIFF", b"\x1aE\xdf\xa3", b"0&\xb2u\x8ef\xcf\x11", b"\x00\x00\x01\xba")
# AV_LOG_QUIET.
_FFMPEG_QUIET = "-8"


class Video:
    """Frames of a video file.

    Thread-safe. A request for an earlier frame that is no longer in memory decodes from the start.

    Attributes
    ----------
    path : video file.
    width, height : pixels.
    frame_count : number of frames that the header states; 0 if unknown.
    frame_rate : frames per second that the header states; 0 if unknown.
    """

    def __init__(self, path: Path, *, apply_rotation: bool = False) -> None:
        """Open a video.

        Parameters
        ----------
        apply_rotation : rotate frames as the metadata states; otherwise, frames are as stored.

        Raises
        ------
        InputError
            If the file is not a video, or its image size is implausible.
        """
        self.path = path
        self._apply_rotation = apply_rotation
        self._lock = threading.Lock()
        self._open()
        import cv2

        self.width, self.height, count = (
            int(self._capture.get(key))
            for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT)
        )
        if not 0 < self.width * self.height <= MAX_PIXELS:
            raise InputError(
                RECORDING_DAMAGED,
                "its header is damaged: it states {width}×{height} pixels.",
                path,
                width=self.width,
                height=self.height,
            )
        self.frame_count = max(count, 0)
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.frame_rate = rate if 0 < rate < math.inf else 0.0
        self._decoded: OrderedDict[int, ColorImage] = OrderedDict()
        self._max_decoded = max(2, _DECODED_BYTES // (3 * self.width * self.height))
        self._end: int | None = None

    def read_frame(self, number: int) -> ColorImage:
        """Decode the frame of an index from 0: (h, w, 3) uint8 RGB.

        Raises
        ------
        InputError
            If the video ends or is damaged before the frame.
        """
        with self._lock:
            if number not in self._decoded:
                if number < self._next and (self._end is None or number < self._end):
                    self._open()
                self._decode_to(number)
            return np.array(self._decoded[number], np.uint8)

    def count_frames(self, max_count: int) -> int:
        """Count the frames by decoding, up to a maximum."""
        with self._lock:
            self._open()
            while self._next < max_count and self._capture.grab():
                self._next += 1
            return self._next

    def _decode_to(self, number: int) -> None:
        import cv2

        if self._end is not None and number >= self._end:
            raise self._create_end_error(number)
        while self._next <= number:
            if not self._capture.grab():
                self._end = self._next
                raise self._create_end_error(number)
            self._next += 1
            if self._next + self._max_decoded <= number + 1:
                continue
            found, image = self._capture.retrieve()
            if not found or image.shape != (self.height, self.width, 3):
                self._end = self._next - 1
                raise self._create_end_error(number)
            self._decoded[self._next - 1] = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
            if len(self._decoded) > self._max_decoded:
                self._decoded.popitem(last=False)

    def _create_end_error(self, number: int) -> InputError:
        """Create the error for a missing frame.

        Raise MemoryError if memory is exhausted.
        """
        check_memory_available(_DECODER_IMAGES * 3 * self.width * self.height)
        return InputError(
            RECORDING_DAMAGED,
            "frame {number} is missing: the video ends or is damaged after {end} frames.",
            self.path,
            number=number,
            end=self._end,
        )

    def _open(self) -> None:
        import cv2

        try:
            with open_input(self.path) as file:
                start = file.read(8)
        except OSError as error:
            raise InputError(
                RECORDING_DAMAGED,
                "the video cannot be opened ({strerror}).",
                self.path,
                strerror=error.strerror,
            ) from error
        if start[4:] not in _FIRST_BOX_TYPES and not start.startswith(_STARTS):
            raise InputError(
                RECORDING_DAMAGED,
                "this is not a video, or its header is damaged.",
                self.path,
            )
        # Failures are reported by the error; FFmpeg reads its log level from the environment.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _FFMPEG_QUIET)
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture: Any = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        self._next = 0
        if not self._capture.isOpened():
            check_memory_available()
            raise InputError(
                RECORDING_DAMAGED,
                "the video does not open; it is damaged or was cut short.",
                self.path,
                remedy="Copy it again.",
            )
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, int(self._apply_rotation))
