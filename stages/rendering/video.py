"""Video files of rendered images, encoded by OpenCV."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.rendering.codes import RENDER_ENCODER_MISSING
from scanloom.stages.scans.model.scan import ColorImage

# FourCC of each codec. Media players and presentations support MPEG-4, browsers support VP9.
CODECS = {"mpeg4": "mp4v", "vp9": "vp09"}


def write_video(path: Path, images: Iterable[ColorImage], fps: float, codec: str = "mpeg4") -> None:
    """Write images as a video, atomically.

    Parameters
    ----------
    path : an .mp4 file.
    images : (h, w, 3) uint8 RGB, all of the same size, with even width and height.
    fps : frames per second.
    codec : key of CODECS.

    Raises
    ------
    StageError
        If the encoder is missing, or the file cannot be written.
    """
    require_opencv()
    import cv2

    tag = cv2.VideoWriter.fourcc(*CODECS[codec])
    writer = cv2.VideoWriter()
    # OpenCV derives the container from the file name, so the draft needs the suffix .mp4.
    with (
        write_file_atomically(path) as part,
        tempfile.TemporaryDirectory(prefix=".scanloom-", dir=part.parent) as folder,
    ):
        draft = Path(folder) / "video.mp4"
        for image in images:
            size = (image.shape[1], image.shape[0])
            if not writer.isOpened() and not writer.open(str(draft), cv2.CAP_FFMPEG, tag, fps, size):
                raise StageError(
                    RENDER_ENCODER_MISSING,
                    "this build of OpenCV has no encoder for {codec}",
                    remedy="choose another codec, or write images (.png).",
                    where=path,
                    codec=codec,
                )
            writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        writer.release()
        draft.replace(part)
