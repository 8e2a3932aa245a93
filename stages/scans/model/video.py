"""Frames of a video by their number, decoded in order: the times in a container are not to be relied on."""

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

# The last frames stay in memory: threads ask for neighbours in an order of their own.
_KEPT_BYTES = 1 << 27
# A decoder keeps up to 16 pictures that others refer to, and some on their way.
_PICTURES = 20
# How MP4 and QuickTime begin. FFmpeg knows playlists, too, and would open what they name.
_STARTS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


class Video:
    """The frames of an MP4 or QuickTime file, as they are stored: never turned by what its header says.

    Going back begins again at the first frame. Any thread may ask.

    Attributes
    ----------
    path : the file.
    width, height : pixels.
    frames : how many its header promises; 0 where it says nothing.
    """

    def __init__(self, path: Path) -> None:
        """Open a video; raise InputError if it is none, or of a size that cannot be."""
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
                "the video claims to be {width}×{height}; it is damaged.",
                path,
                width=self.width,
                height=self.height,
            )
        self.frames = max(count, 0)
        self._kept: OrderedDict[int, ColorImage] = OrderedDict()
        self._most = max(2, _KEPT_BYTES // (3 * self.width * self.height))
        self._end: int | None = None

    def frame(self, number: int) -> ColorImage:
        """Return frame `number`, counted from 0: (h, w, 3) uint8 RGB.

        Raises
        ------
        InputError
            If the video ends before it, or does not decode up to there.
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
        """Return what to raise, unless it was memory that ended."""
        require_room(_PICTURES * 3 * self.width * self.height)
        return InputError(
            RECORDING_DAMAGED,
            "frame {number} is not there: the video ends or is damaged after {end} frames.",
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
                RECORDING_DAMAGED, "this is no MP4 or QuickTime video, or its start is damaged.", self.path
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
