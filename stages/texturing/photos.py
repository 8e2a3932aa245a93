"""Undistorted photos of a surface with their cameras and poses."""

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

# Maximum bytes of photos kept in memory together. Larger sets are read again from their files when needed.
_KEPT_BYTES = 250_000_000
# Photos with more pixels than this are processed one at a time, to bound memory.
_LARGE = 4_000_000
# Weights by sharpness: number of neighbours on each side in time, minimum sharpness ratio, and exponent of
# the ratio. A photo with half the sharpness of its neighbours gets 1/30 of the influence, because weights are
# squared. Measured: blurred photos cost more quality than they add coverage.
_BESIDE = 5
_LEAST_SHARE = 0.5
_WORTH_POWER = 2.5
# Levels below and above which a pixel is black or white, and maximum ratio of such pixels in a usable photo.
_DARK, _BRIGHT = 4, 250
_MOST_CUT_OFF = 0.9


@dataclass(frozen=True, eq=False)
class Photo:
    """Undistorted photo with its pinhole camera and pose.

    Attributes
    ----------
    frame : frame that the photo belongs to.
    image : (h, w, 3) uint8 RGB.
    camera : intrinsics without distortion, for this image size.
    camera_from_world : (4, 4) float64, metres.
    seen : (h, w) bool, valid pixels; None if all are.
    """

    frame: Frame
    image: ColorImage
    camera: Camera
    camera_from_world: Pose
    seen: NDArray[np.bool_] | None = None


def photo_of(frame: Frame) -> Photo:
    """Read and undistort the photo of a frame.

    Raises
    ------
    InputError
        If the frame has no photo or no pose, the file cannot be read, or almost all pixels are black or
        white.
    """
    if frame.world_from_camera is None:
        raise InputError(FRAME_POSE_MISSING, "there is no camera pose.", Where(frame=frame.name))
    image, camera, seen = read_photo(frame)
    black_or_white = _black_or_white(image)
    # Only pixels inside the mask count: an object may fill a small part of its photo.
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
    """Usable photos of a scan, in memory or read from their files.

    Attributes
    ----------
    frames : frame of each photo.
    cameras, poses : intrinsics and camera_from_world (4, 4) of each photo.
    worths : (n,) weight of each photo by its sharpness relative to its neighbours in time, at most 1.
    kept : photos in memory, by index.
    skipped : frames without a usable photo, and the reason.
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
        """Number of photos processed at a time: large ones take hundreds of megabytes each."""
        largest = max((camera.width * camera.height for camera in self.cameras), default=0)
        return workers() + 1 if largest <= _LARGE else 1

    def read(self, number: int) -> Photo:
        """Return the photo with the given index.

        Raises
        ------
        InputError
            If its file has disappeared.
        """
        return self.kept[number] if number in self.kept else photo_of(self.frames[number])

    def without(self, wrong: Mapping[int, Diagnostic]) -> Photos:
        """Return the photos without the given indices, which are recorded as skipped."""
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
    """Collect the usable photos of frames, with weights by sharpness.

    Parameters
    ----------
    frames : with colour images.
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
