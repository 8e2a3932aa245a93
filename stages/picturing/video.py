"""Videos of pictures, by the encoders that OpenCV brings."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.replacing import replacing
from scanloom.stages.picturing.codes import RENDER_ENCODER_MISSING
from scanloom.stages.scans.model.scan import ColorImage

# How a file says what it is encoded by. MPEG-4 is known to players and presentations, VP9 to browsers.
CODECS = {"mpeg4": "mp4v", "vp9": "vp09"}


def write_video(path: Path, images: Iterable[ColorImage], fps: float, codec: str = "mpeg4") -> None:
    """Write pictures as a video, whole or not at all.

    Parameters
    ----------
    path : an .mp4 file.
    images : (h, w, 3) uint8 RGB, all of one size, of even width and height.
    fps : pictures a second.
    codec : of CODECS.

    Raises
    ------
    StageError
        If the encoder is missing, or the file cannot be written.
    """
    require_opencv()
    import cv2

    tag = cv2.VideoWriter.fourcc(*CODECS[codec])
    writer = cv2.VideoWriter()
    # The writer knows the kind of a file by its name, which a draft has not.
    with replacing(path) as part, tempfile.TemporaryDirectory(prefix=".scanloom-", dir=part.parent) as folder:
        draft = Path(folder) / "video.mp4"
        for image in images:
            size = (image.shape[1], image.shape[0])
            if not writer.isOpened() and not writer.open(str(draft), cv2.CAP_FFMPEG, tag, fps, size):
                raise StageError(
                    RENDER_ENCODER_MISSING,
                    "OpenCV has no encoder for {codec} here",
                    remedy="write pictures (.png).",
                    where=path,
                    codec=codec,
                )
            writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        writer.release()
        draft.replace(part)
