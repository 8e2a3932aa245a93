"""Random access to video frames by index.

Frames are decoded in sequence, because timestamps in containers are unreliable.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.opening import opened
from scanloom.stages.files.room import require_room
from scanloom.stages.scans.model.scan import ColorImage

# Bytes of decoded frames to keep, because threads request neighbouring frames in varying order.
_KEPT_BYTES = 1 << 27
# Images that a decoder holds: up to 16 reference pictures, and some in its pipeline.
_PICTURES = 20
# First box types of MP4 and QuickTime. FFmpeg also reads playlists, which could make it open other files.
_STARTS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


class Video:
    """Frames of an MP4 or QuickTime file, as stored: rotation metadata is ignored.

    Thread-safe. A request for an earlier frame that is no longer in memory decodes from the start.

    Attributes
    ----------
    path : video file.
    width, height : pixels.
    frames : number of frames that the header states; 0 if unknown.
    """

    def __init__(self, path: Path) -> None:
        """Open a video.

        Raises
        ------
        InputError
            If the file is not a video, or its image size is implausible.
        """
        self.path = path
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
        self.frames = max(count, 0)
        self._kept: OrderedDict[int, ColorImage] = OrderedDict()
        self._most = max(2, _KEPT_BYTES // (3 * self.width * self.height))
        self._end: int | None = None

    def frame(self, number: int) -> ColorImage:
        """Decode the frame of an index from 0: (h, w, 3) uint8 RGB.

        Raises
        ------
        InputError
            If the video ends or is damaged before the frame.
        """
        with self._lock:
            if number not in self._kept:
                if number < self._next and (self._end is None or number < self._end):
                    self._open()
                self._decode_to(number)
            return np.array(self._kept[number], np.uint8)

    def _decode_to(self, number: int) -> None:
        import cv2

        if self._end is not None and number >= self._end:
            raise self._ended(number)
        while self._next <= number:
            if not self._capture.grab():
                self._end = self._next
                raise self._ended(number)
            self._next += 1
            if self._next + self._most <= number + 1:
                continue
            found, image = self._capture.retrieve()
            if not found or image.shape != (self.height, self.width, 3):
                self._end = self._next - 1
                raise self._ended(number)
            self._kept[self._next - 1] = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)

    def _ended(self, number: int) -> InputError:
        """Create the error for a missing frame.

        Raise MemoryError if memory is exhausted.
        """
        require_room(_PICTURES * 3 * self.width * self.height)
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
            with opened(self.path) as file:
                start = file.read(8)
        except OSError as error:
            raise InputError(
                RECORDING_DAMAGED,
                "the video cannot be opened ({strerror}).",
                self.path,
                strerror=error.strerror,
            ) from error
        if start[4:] not in _STARTS:
            raise InputError(
                RECORDING_DAMAGED,
                "this is not an MP4 or QuickTime video, or its header is damaged.",
                self.path,
            )
        self._capture: Any = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        self._next = 0
        if not self._capture.isOpened():
            require_room()
            raise InputError(
                RECORDING_DAMAGED,
                "the video does not open; it is damaged or was cut short.",
                self.path,
                remedy="Copy it again.",
            )
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
