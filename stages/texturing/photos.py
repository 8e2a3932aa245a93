"""Undistorted photos of a surface with their cameras and poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.progress import Progress
from scanloom.stages.scans.codes import FRAME_POSE_MISSING
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, SkippedFrame
from scanloom.stages.scans.model.sharpness import measure_sharpness
from scanloom.stages.texturing.codes import TEXTURE_PHOTOS_UNUSABLE

# Maximum bytes of photos kept in memory together. Larger sets are read again from their files when needed.
_MAX_CACHE_BYTES = 250_000_000
# Photos with more pixels than this are processed one at a time, to bound memory.
_LARGE_PHOTO_PIXELS = 4_000_000
# Weights by sharpness: number of neighbours on each side in time, minimum sharpness ratio, and exponent of
# the ratio. A photo with half the sharpness of its neighbours gets 1/30 of the influence, because weights are
# squared. Measured: blurred photos cost more quality than they add coverage.
_NEIGHBOUR_COUNT = 5
_MIN_SHARPNESS_RATIO = 0.5
_WEIGHT_EXPONENT = 2.5
# Levels below and above which a pixel is black or white, and maximum ratio of such pixels in a usable photo.
_MIN_LEVEL, _MAX_LEVEL = 4, 250
_MAX_CLIPPED_RATIO = 0.9


@dataclass(frozen=True, eq=False)
class Photo:
    """Undistorted photo with its pinhole camera and pose.

    Attributes
    ----------
    frame : frame that the photo belongs to.
    image : (h, w, 3) uint8 RGB.
    camera : intrinsics without distortion, for this image size.
    camera_from_world : (4, 4) float64, metres.
    valid_mask : (h, w) bool, valid pixels; None if all are.
    """

    frame: Frame
    image: ColorImage
    camera: Camera
    camera_from_world: Pose
    valid_mask: NDArray[np.bool_] | None = None


def load_photo(frame: Frame) -> Photo:
    """Read and undistort the photo of a frame.

    Raises
    ------
    InputError
        If the frame has no photo or no pose, the file cannot be read, or almost all pixels are black or
        white.
    """
    if frame.world_from_camera is None:
        raise InputError(FRAME_POSE_MISSING, "there is no camera pose.", DiagnosticLocation(frame=frame.name))
    image, camera, valid_mask = read_photo(frame)
    is_clipped = _mask_clipped_pixels(image)
    # Only pixels inside the mask count: an object may fill a small part of its photo.
    clipped_in_mask = is_clipped if valid_mask is None else is_clipped[valid_mask]
    clipped_ratio = float(clipped_in_mask.mean()) if clipped_in_mask.size else 1.0
    if clipped_ratio > _MAX_CLIPPED_RATIO:
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "{cut_off:.0%} of the photo is black or white.",
            DiagnosticLocation(frame=frame.name),
            cut_off=clipped_ratio,
        )
    return Photo(frame, image, camera, compute_photo_pose(frame), valid_mask)


def compute_photo_pose(frame: Frame) -> Pose:
    """Compute the pose (4, 4), camera_from_world, of the photo of a frame with a pose; metres."""
    pose = invert_pose(np.asarray(frame.world_from_camera, np.float64))
    if frame.color_camera is not None and frame.color_from_depth is not None:
        pose = np.asarray(frame.color_from_depth, np.float64) @ pose
    return pose


def _mask_clipped_pixels(image: ColorImage) -> NDArray[np.bool_]:
    import cv2

    black = cv2.inRange(image, np.zeros(3), np.full(3, _MIN_LEVEL - 1.0))
    white = cv2.inRange(image, np.full(3, _MAX_LEVEL + 1.0), np.full(3, 255.0))
    return np.asarray(cv2.bitwise_or(black, white) > 0)


@dataclass(frozen=True, eq=False)
class Photos:
    """Usable photos of a scan, in memory or read from their files.

    Attributes
    ----------
    frames : frame of each photo.
    cameras, poses : intrinsics and camera_from_world (4, 4) of each photo.
    weights : (n,) weight of each photo by its sharpness relative to its neighbours in time, at most 1.
    cached : photos in memory, by index.
    skipped : frames without a usable photo, and the reason.
    """

    frames: tuple[Frame, ...]
    cameras: tuple[Camera, ...]
    poses: tuple[Pose, ...]
    weights: NDArray[np.float64]
    cached: dict[int, Photo]
    skipped: tuple[SkippedFrame, ...]

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def max_concurrent(self) -> int:
        """Number of photos processed at a time: large ones take hundreds of megabytes each."""
        largest = max((camera.width * camera.height for camera in self.cameras), default=0)
        return get_worker_count() + 1 if largest <= _LARGE_PHOTO_PIXELS else 1

    def read(self, number: int) -> Photo:
        """Return the photo with the given index.

        Raises
        ------
        InputError
            If its file has disappeared.
        """
        return self.cached[number] if number in self.cached else load_photo(self.frames[number])

    def drop_photos(self, rejected: Mapping[int, Diagnostic]) -> Photos:
        """Return the photos without the given indices, which are recorded as skipped."""
        rest = [i for i in range(len(self)) if i not in rejected]
        return Photos(
            frames=tuple(self.frames[i] for i in rest),
            cameras=tuple(self.cameras[i] for i in rest),
            poses=tuple(self.poses[i] for i in rest),
            weights=self.weights[rest],
            cached={new: self.cached[old] for new, old in enumerate(rest) if old in self.cached},
            skipped=(*self.skipped, *(SkippedFrame(self.frames[i].name, why) for i, why in rejected.items())),
        )


def load_photos(frames: Sequence[Frame], progress: Progress) -> Photos:
    """Collect the usable photos of frames, with weights by sharpness.

    Parameters
    ----------
    frames : with colour images.
    progress : called after each frame.
    """

    def inspect_frame(frame: Frame) -> tuple[Photo, float] | SkippedFrame:
        try:
            photo = load_photo(frame)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
        return photo, measure_sharpness(photo.image)

    used_frames: list[Frame] = []
    cameras_and_poses: list[tuple[Camera, Pose]] = []
    skipped: list[SkippedFrame] = []
    cached: dict[int, Photo] = {}
    sharpnesses: list[float] = []
    remaining_bytes = _MAX_CACHE_BYTES
    found = map_ordered(inspect_frame, frames, threads=get_worker_count(), max_pending=get_worker_count() + 2)
    for done, (frame, one) in enumerate(zip(frames, found, strict=True), 1):
        if isinstance(one, SkippedFrame):
            skipped.append(one)
        else:
            photo, its_sharpness = one
            remaining_bytes -= photo.image.nbytes
            if remaining_bytes >= 0:
                cached[len(used_frames)] = photo
            else:
                cached.clear()
            used_frames.append(frame)
            cameras_and_poses.append((photo.camera, photo.camera_from_world))
            sharpnesses.append(its_sharpness)
        progress(done, len(frames))
    return Photos(
        frames=tuple(used_frames),
        cameras=tuple(camera for camera, _ in cameras_and_poses),
        poses=tuple(pose for _, pose in cameras_and_poses),
        weights=_compute_weights(np.array(sharpnesses)),
        cached=cached,
        skipped=tuple(skipped),
    )


def _compute_weights(sharpnesses: NDArray[np.float64]) -> NDArray[np.float64]:
    neighbourhoods = [
        sharpnesses[max(i - _NEIGHBOUR_COUNT, 0) : i + _NEIGHBOUR_COUNT + 1] for i in range(len(sharpnesses))
    ]
    medians = np.array([np.median(some) for some in neighbourhoods])
    ratio = np.divide(sharpnesses, medians, out=np.ones_like(sharpnesses), where=medians > 0)
    return np.asarray(ratio.clip(_MIN_SHARPNESS_RATIO, 1.0) ** _WEIGHT_EXPONENT)
