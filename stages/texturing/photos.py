"""Photos of a surface: images without lens distortion, and where their cameras stood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic, Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.progress import Progress
from scanloom.stages.scans.codes import FRAME_POSE_MISSING
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, SkippedFrame
from scanloom.stages.scans.model.sharpness import sharpness
from scanloom.stages.texturing.codes import TEXTURE_PHOTOS_UNUSABLE

# Photos are kept in memory if all together have no more bytes; else they are read again when they are needed.
_KEPT_BYTES = 250_000_000
# Pixels of a photo from which photos are worked on one after the other.
_LARGE = 4_000_000
# Photos taken before and after that one is compared with, the share of their sharpness below which it is
# worth no less, and the power of that share. A photo half as sharp as they are counts a thirtieth, for worths
# are squared: what blurred photos take off others was seen to cost more than what they add.
_BESIDE = 5
_LEAST_SHARE = 0.5
_WORTH_POWER = 2.5
# Levels from which a pixel is black or white, and how many may be so in a photo of use.
_DARK, _BRIGHT = 4, 250
_MOST_CUT_OFF = 0.9


@dataclass(frozen=True, eq=False)
class Photo:
    """A colour image as a pinhole camera would have taken it.

    Attributes
    ----------
    frame : what it is of.
    image : (h, w, 3) uint8 RGB.
    camera : without distortion, of this size.
    camera_from_world : (4, 4) float64, metres.
    seen : (h, w) which pixels show the scene, None if all do.
    """

    frame: Frame
    image: ColorImage
    camera: Camera
    camera_from_world: Pose
    seen: NDArray[np.bool_] | None = None


def photo_of(frame: Frame) -> Photo:
    """Read a frame's photo.

    Raises
    ------
    InputError
        If it has none, or no pose, it cannot be read, or hardly anything but black and white is in it.
    """
    if frame.world_from_camera is None:
        raise InputError(FRAME_POSE_MISSING, "there is no camera pose.", Where(frame=frame.name))
    image, camera, seen = read_photo(frame)
    black_or_white = _black_or_white(image)
    # Of what masks leave: a thing that is cut out of its photo may fill little of it.
    shown = black_or_white if seen is None else black_or_white[seen]
    cut_off = float(shown.mean()) if shown.size else 1.0
    if cut_off > _MOST_CUT_OFF:
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "{cut_off:.0%} of the photo is black or white.",
            Where(frame=frame.name),
            cut_off=cut_off,
        )
    pose = inverted(np.asarray(frame.world_from_camera, np.float64))
    if frame.color_camera is not None and frame.color_from_depth is not None:
        pose = np.asarray(frame.color_from_depth, np.float64) @ pose
    return Photo(frame, image, camera, pose, seen)


def _black_or_white(image: ColorImage) -> NDArray[np.bool_]:
    import cv2

    black = cv2.inRange(image, np.zeros(3), np.full(3, _DARK - 1.0))
    white = cv2.inRange(image, np.full(3, _BRIGHT + 1.0), np.full(3, 255.0))
    return np.asarray(cv2.bitwise_or(black, white) > 0)


@dataclass(frozen=True, eq=False)
class Photos:
    """The photos of a scan that can be used; `read` gives them, from memory or anew.

    Attributes
    ----------
    frames : theirs.
    cameras, poses : of each, and what takes the world to it (4, 4).
    worths : (n,) of each beside those taken just before and after: blurred ones less; at most 1.
    kept : those in memory, by their number.
    skipped : frames without, and why.
    """

    frames: tuple[Frame, ...]
    cameras: tuple[Camera, ...]
    poses: tuple[Pose, ...]
    worths: NDArray[np.float64]
    kept: dict[int, Photo]
    skipped: tuple[SkippedFrame, ...]

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def ahead(self) -> int:
        """How many photos are worked on at a time: large ones take hundreds of megabytes each."""
        largest = max((camera.width * camera.height for camera in self.cameras), default=0)
        return workers() + 1 if largest <= _LARGE else 1

    def read(self, number: int) -> Photo:
        """Return a photo.

        Raises
        ------
        InputError
            If its file has gone since.
        """
        return self.kept[number] if number in self.kept else photo_of(self.frames[number])

    def without(self, wrong: Mapping[int, Diagnostic]) -> Photos:
        """Return the photos without some, by their numbers, and why."""
        rest = [i for i in range(len(self)) if i not in wrong]
        return Photos(
            frames=tuple(self.frames[i] for i in rest),
            cameras=tuple(self.cameras[i] for i in rest),
            poses=tuple(self.poses[i] for i in rest),
            worths=self.worths[rest],
            kept={new: self.kept[old] for new, old in enumerate(rest) if old in self.kept},
            skipped=(*self.skipped, *(SkippedFrame(self.frames[i].name, why) for i, why in wrong.items())),
        )


def photos_of(frames: Sequence[Frame], progress: Progress) -> Photos:
    """Look through the photos of frames.

    Parameters
    ----------
    progress : called after each frame.
    """

    def looked_at(frame: Frame) -> tuple[Photo, float] | SkippedFrame:
        try:
            photo = photo_of(frame)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.within(frame=None))
        return photo, sharpness(photo.image)

    used: list[Frame] = []
    stands: list[tuple[Camera, Pose]] = []
    skipped: list[SkippedFrame] = []
    kept: dict[int, Photo] = {}
    sharpnesses: list[float] = []
    room = _KEPT_BYTES
    found = read_ahead(looked_at, frames, threads=workers(), ahead=workers() + 2)
    for done, (frame, one) in enumerate(zip(frames, found, strict=True), 1):
        if isinstance(one, SkippedFrame):
            skipped.append(one)
        else:
            photo, its_sharpness = one
            room -= photo.image.nbytes
            if room >= 0:
                kept[len(used)] = photo
            else:
                kept.clear()
            used.append(frame)
            stands.append((photo.camera, photo.camera_from_world))
            sharpnesses.append(its_sharpness)
        progress(done, len(frames))
    return Photos(
        frames=tuple(used),
        cameras=tuple(camera for camera, _ in stands),
        poses=tuple(pose for _, pose in stands),
        worths=_worths(np.array(sharpnesses)),
        kept=kept,
        skipped=tuple(skipped),
    )


def _worths(sharpnesses: NDArray[np.float64]) -> NDArray[np.float64]:
    around = [sharpnesses[max(i - _BESIDE, 0) : i + _BESIDE + 1] for i in range(len(sharpnesses))]
    medians = np.array([np.median(some) for some in around])
    share = np.divide(sharpnesses, medians, out=np.ones_like(sharpnesses), where=medians > 0)
    return np.asarray(share.clip(_LEAST_SHARE, 1.0) ** _WORTH_POWER)
