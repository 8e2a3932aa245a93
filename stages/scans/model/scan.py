"""Data model of a scan: frames, cameras and poses, in metres and OpenCV axes.

Camera axes are x right, y down, z forward. Pixel centres have integer coordinates: the top left pixel is at
(0, 0).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import format_count, format_line, render_table
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, POSE_MISSING, USAGE_FRAME_INVALID
from scanloom.stages.scans.model.array_validation import (
    check_color,
    check_depth,
    check_distortion,
    check_gray,
    check_intrinsics,
    check_pose,
)
from scanloom.stages.scans.model.depth_correction import DepthCorrection
from scanloom.stages.scans.model.thumbnail import render_thumbnail
from scanloom.stages.scans.model.world import Scale, WorldUp

Pose = NDArray[np.float64]
ColorImage = NDArray[np.uint8]
DepthImage = NDArray[np.float32]

# Relative tolerance between aspect ratios of colour and depth image, for rounded image sizes.
_ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with OpenCV's distortion, or a fisheye camera.

    Attributes
    ----------
    width, height : image size in pixels.
    fx, fy, cx, cy : intrinsics in pixels for this image size; NaN if the scan has no calibration.
    distortion : OpenCV's k1 k2 p1 p2 [k3 …], empty for none.
    fisheye : equidistant projection; `distortion` is then k1 k2 k3 k4 of OpenCV's fisheye model
        (Kannala-Brandt, Kalibr's equidistant).
    is_guess : the intrinsics are a guess from the image size.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    fisheye: bool = False
    is_guess: bool = False

    def __repr__(self) -> str:
        known = f"fx {self.fx:.6g}, fy {self.fy:.6g}, cx {self.cx:.6g}, cy {self.cy:.6g} px"
        lens = "fisheye" if self.fisheye else format_count(len(self.distortion), "distortion coefficient")
        size = f"{self.width} × {self.height} px"
        return format_line(self, (size, known if self.is_calibrated else "not calibrated", lens))

    @property
    def is_calibrated(self) -> bool:
        """True if the intrinsics are known, not only the image size."""
        return not math.isnan(self.fx)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3) float64 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)


def to_pinhole(camera: Camera) -> Camera:
    """Return the camera without lens distortion, for undistorted images."""
    return replace(camera, distortion=(), fisheye=False)


def scale_camera(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera for the same images resized.

    Pixel centres stay at integers.
    """
    sx, sy = width / camera.width, height / camera.height
    return Camera(
        width,
        height,
        camera.fx * sx,
        camera.fy * sy,
        (camera.cx + 0.5) * sx - 0.5,
        (camera.cy + 0.5) * sy - 0.5,
        camera.distortion,
        camera.fisheye,
        camera.is_guess,
    )


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras rigidly mounted to each other.

    Attributes
    ----------
    right_from_left : (4, 4) float64, metres: maps points from left to right camera coordinates.
    is_rectified : rows of both images correspond; the baseline is then -right_from_left[0, 3].
    disparity_count : maximum number of disparities if the calibration file states it, or None.
    """

    left: Camera
    right: Camera
    right_from_left: Pose
    is_rectified: bool
    disparity_count: int | None = None

    def __repr__(self) -> str:
        size = f"{self.left.width} × {self.left.height} px"
        return format_line(
            self, (size, f"baseline {self.baseline:.4g} m", "rectified" if self.is_rectified else "")
        )

    @property
    def baseline(self) -> float:
        """Distance between the camera centres, in metres."""
        return float(np.linalg.norm(self.right_from_left[:3, 3]))


@dataclass(frozen=True, eq=False)
class PackedImage:
    """Image inside a container file: a video frame or an archive entry.

    Attributes
    ----------
    file : container; the cache treats the image as changed if the container changes.
    name : name of the image in the container, unique and used in messages.
    load : reads the image: (h, w, 3) uint8 RGB for colour, (h, w) uint16 or float in the unit of
        `choose_depth_scale` for depth, (h, w) uint8 for confidence and masks. Raises InputError. Thread-safe
        and repeatable.
    """

    file: Path
    name: str
    load: Callable[[], NDArray[Any]]

    def __repr__(self) -> str:
        return format_line(self, (str(self),))

    def __str__(self) -> str:
        """Return the name of the image in messages."""
        return f"{self.file}: {self.name}"


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of a scan: a colour image and either a right image or a depth map.

    Images are paths, `PackedImage` images or arrays. Files are read on demand, see
    `scanloom.stages.scans.model.images`.

    Attributes
    ----------
    name : name of the frame in messages: the stem of its file, or its number.
    camera : camera of the depth map, or of the left image.
    color : file or (h, w, 3) uint8 RGB; the left image of a stereo pair.
    right : right image of a stereo pair, as `color`.
    depth : file, or (h, w) float32 metres along the optical axis, 0 where missing.
    depth_scale : units of the depth file per metre (1000 for millimetres).
    depth_missing : raw values that mark missing depth, in addition to 0.
    world_from_camera : (4, 4) float64 rigid pose, metres; None if the frame has no pose.
    timestamp : nanoseconds, or None.
    color_camera : camera of the colour image of an RGB-D frame, for any size of the image; None if the colour
        image is aligned to the depth map, at any resolution.
    color_from_depth : (4, 4) float64, metres: maps points from depth to colour camera coordinates; None if
        both cameras have the same position.
    confidence : confidence of each depth value, higher is better; (h, w) uint8, resized to the depth map.
    min_confidence : depth with a lower confidence is missing.
    mask : 0 where the pixel is not part of the scene (a backdrop, a border, moving objects); (h, w), resized
        to the image. Such pixels get no depth.
    depth_range : nearest and farthest depth of the frame in metres, if the folder states it; limits the depth
        search of single views.
    up : (3,) float64 unit vector, up direction in camera axes, if an accelerometer measured it.
    shutter_turn : (3,) float64 rotation vector in axes of the depth camera, radians: rotation of the camera
        from the first to the last row during readout (rolling shutter). The pose is the pose at the middle
        row. None for a global shutter, or if the rotation is not known.
    depth_correction : correction of the depth of the sensor, applied by `read_depth`; None without.
    """

    name: str
    camera: Camera
    color: Path | PackedImage | ColorImage | None = None
    right: Path | PackedImage | ColorImage | None = None
    depth: Path | PackedImage | DepthImage | None = None
    depth_scale: float = 1000.0
    depth_missing: tuple[int, ...] = ()
    world_from_camera: Pose | None = None
    timestamp: int | None = None
    color_camera: Camera | None = None
    color_from_depth: Pose | None = None
    confidence: Path | PackedImage | NDArray[np.uint8] | None = None
    min_confidence: int = 0
    mask: Path | PackedImage | NDArray[np.uint8] | None = None
    depth_range: tuple[float, float] | None = None
    up: NDArray[np.float64] | None = None
    shutter_turn: NDArray[np.float64] | None = None
    depth_correction: DepthCorrection | None = None

    def __post_init__(self) -> None:
        pose, depth = self.world_from_camera, self.depth
        if pose is not None and not (isinstance(pose, np.ndarray) and pose.shape == (4, 4)):
            raise InputError(
                USAGE_FRAME_INVALID,
                "world_from_camera must be a (4, 4) array; Frame.from_arrays takes other forms.",
                DiagnosticLocation(frame=self.name),
            )
        if isinstance(depth, np.ndarray) and not np.issubdtype(depth.dtype, np.floating):
            raise InputError(
                USAGE_FRAME_INVALID,
                (
                    "a depth array must be floats in metres, not {depth_dtype}; "
                    "Frame.from_arrays takes integers with depth_scale."
                ),
                DiagnosticLocation(frame=self.name),
                depth_dtype=depth.dtype,
            )

    @classmethod
    def from_arrays(
        cls,
        color: ArrayLike | None = None,
        depth: ArrayLike | None = None,
        intrinsics: Camera | ArrayLike | None = None,
        world_from_camera: ArrayLike | None = None,
        *,
        depth_scale: float | None = None,
        right: ArrayLike | None = None,
        color_intrinsics: Camera | ArrayLike | None = None,
        color_from_depth: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        confidence: ArrayLike | None = None,
        min_confidence: int = 0,
        timestamp: int | None = None,
        name: str = "",
    ) -> Frame:
        """Create a frame from arrays in memory.

        Parameters
        ----------
        color : (h, w, 3) uint8 RGB, or (h, w) grey. OpenCV reads BGR: reverse its channels.
        depth : (h, w) along the optical axis, floats in metres or integers; 0, NaN and infinity are missing.
        intrinsics : of the depth image, or of the colour image if there is no depth: (3, 3) camera matrix,
            fx, fy, cx, cy in pixels, or a `Camera`, which may have lens distortion.
        world_from_camera : (4, 4) or (3, 4) rigid, metres, OpenCV axes; maps points from camera to world
            coordinates. Open3D's `extrinsic` is its inverse.
        depth_scale : units of `depth` per metre; default 1000 for integers, 1 for floats.
        right : right image of a stereo pair, as `color`.
        color_intrinsics : of the colour image; default: the colour image is aligned to the depth image.
        color_from_depth : (4, 4) or (3, 4) rigid, metres; maps points from depth to colour camera
            coordinates. Default: both cameras have the same position.
        mask : (h, w) uint8 or bool, 0 where the pixel is not part of the scene.
        confidence : (h, w) uint8; depth with confidence below `min_confidence` is missing.
        timestamp : nanoseconds.
        name : name in messages; `Scan.from_frames` numbers frames without a name.

        Raises
        ------
        InputError
            For an array of another shape or dtype, and for implausible values.
        """
        where = f"frame {name}" if name else "frame"
        if color is None and depth is None:
            raise InputError(USAGE_FRAME_INVALID, "a frame needs a colour image or a depth image.", where)
        colors = None if color is None else check_color(color, where)
        depths = None if depth is None else check_depth(depth, depth_scale, where)
        reference = depths if depths is not None else colors
        assert reference is not None
        if intrinsics is None:
            raise InputError(
                USAGE_FRAME_INVALID,
                "intrinsics are missing: a (3, 3) camera matrix, a Camera, or fx, fy, cx, cy in pixels.",
                where,
            )
        camera = _create_camera(intrinsics, reference, where)
        color_camera = None
        if colors is not None and depths is not None:
            if color_intrinsics is not None:
                color_camera = _create_camera(color_intrinsics, colors, where)
            elif (
                abs(colors.shape[0] * camera.width / (colors.shape[1] * camera.height) - 1)
                > _ASPECT_TOLERANCE
            ):
                raise InputError(
                    USAGE_FRAME_INVALID,
                    (
                        "the colour image of {colors_shape} × {colors_shape_2} px and the depth image of "
                        "{camera_width} × {camera_height} px differ in aspect ratio."
                    ),
                    where,
                    remedy="Give color_intrinsics, and color_from_depth for cameras at different positions.",
                    colors_shape=colors.shape[1],
                    colors_shape_2=colors.shape[0],
                    camera_width=camera.width,
                    camera_height=camera.height,
                )
        rights = None if right is None else check_color(right, where)
        if rights is not None and (colors is None or rights.shape[:2] != colors.shape[:2]):
            raise InputError(
                USAGE_FRAME_INVALID, "the right image needs a left image (color) of the same size.", where
            )
        return cls(
            name=name,
            camera=camera,
            color=colors,
            right=rights,
            depth=depths,
            world_from_camera=check_pose(world_from_camera, "world_from_camera", where),
            timestamp=timestamp,
            color_camera=color_camera,
            color_from_depth=check_pose(color_from_depth, "color_from_depth", where),
            confidence=None if confidence is None else check_gray(confidence, "confidence", where),
            min_confidence=min_confidence,
            mask=None if mask is None else check_gray(mask, "a mask", where),
        )

    def __repr__(self) -> str:
        parts = {
            "colour": self.color,
            "right image": self.right,
            "depth": self.depth,
            "pose": self.world_from_camera,
            "confidence": self.confidence,
            "mask": self.mask,
        }
        size = f"{self.camera.width} × {self.camera.height} px"
        return format_line(
            self, (self.name, size, *(name for name, part in parts.items() if part is not None))
        )

    _repr_html_ = render_table

    def _thumbnail(self) -> bytes | None:
        return render_thumbnail([one for one in (self.color, self.right) if one is not None])

    def to_dict(self) -> dict[str, Any]:
        """Summarise the frame as a JSON object without reading images."""
        return {
            "frame": self.name,
            "size_px": [self.camera.width, self.camera.height],
            "color": self.color is not None,
            "right": self.right is not None,
            "depth": self.depth is not None,
            "pose": self.world_from_camera is not None,
            "confidence": self.confidence is not None,
            "mask": self.mask is not None,
            "position_m": None if self.world_from_camera is None else self.world_from_camera[:3, 3].tolist(),
        }


# Short names of missing data by diagnostic code.
_MISSING_NAMES = {POSE_MISSING.name: "poses", CAMERA_PAIR_UNCALIBRATED.name: "calibration"}


@dataclass(frozen=True)
class SkippedFrame:
    """Frame that cannot be used.

    Attributes
    ----------
    name : name of the frame.
    diagnostic : reason, without the name of the frame.
    """

    name: str
    diagnostic: Diagnostic

    @property
    def reason(self) -> str:
        """Reason in words."""
        return str(self.diagnostic)

    def to_dict(self) -> dict[str, Any]:
        """Return name, code and reason as a JSON object."""
        return {"frame": self.name, "code": self.diagnostic.code, "reason": self.reason}


@dataclass(frozen=True, eq=False)
class Scan:
    """Ordered sequence of frames whose images are read on demand.

    Attributes
    ----------
    layout : name of the detected layout.
    frames : frames in capture order.
    rig : set for stereo pairs, None for RGB-D frames and single views.
    folder : folder or file of the scan.
    skipped_frames : frames that the reader skipped (pose lost, file missing).
    diagnostics : warnings of the reader.
    missing : data that a mesh requires and the scan lacks: diagnostics of the codes pose.missing and
        camera.pair-uncalibrated.
    bounding_box : (2, 3) float64 metres, minimum and maximum corner of the scanned volume, if the folder
        states it.
    held_out : frames that no stage uses, for evaluation.
    up : up direction in world coordinates, if the layout or the folder states it.
    is_metric : lengths are metres; otherwise poses and depth have the same unknown unit.
    is_depth_predicted : a network predicted the depth, so its scale and offset differ between views.
    scale : conversion to metres that was applied to a scan without metric scale.
    source_files : all files that the scan was read from, and the image files of all frames, selected or not.
    """

    layout: str
    frames: Sequence[Frame]
    rig: StereoRig | None = None
    folder: Path | None = None
    skipped_frames: tuple[SkippedFrame, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = field(default=())
    missing: tuple[Diagnostic, ...] = ()
    bounding_box: NDArray[np.float64] | None = None
    held_out: Sequence[Frame] = ()
    up: WorldUp | None = None
    is_metric: bool = True
    is_depth_predicted: bool = False
    scale: Scale | None = None
    source_files: frozenset[Path] = frozenset()

    @classmethod
    def from_frames(
        cls,
        frames: Iterable[Frame],
        *,
        rig: StereoRig | None = None,
        up: ArrayLike | None = None,
        is_metric: bool = True,
        held_out: Iterable[Frame] = (),
    ) -> Scan:
        """Create a scan from frames in memory, such as from `Frame.from_arrays`.

        Parameters
        ----------
        frames : in capture order; all with depth, all with a right image, or all with neither.
        rig : cameras of stereo pairs.
        up : (3,) up direction in world coordinates; default: stages that need the up direction estimate it.
        is_metric : lengths are metres.
        held_out : frames that no stage uses, for evaluation.

        Raises
        ------
        InputError
            For no frames, frames of different kinds, right images without a rig, and single views without
            poses.
        """
        numbered = [
            frame if frame.name else replace(frame, name=f"{number:06d}")
            for number, frame in enumerate(frames)
        ]
        if not numbered:
            raise InputError(USAGE_FRAME_INVALID, "a scan needs at least one frame.", "scan")
        kinds = [(frame.depth is not None, frame.right is not None) for frame in numbered]
        for frame, kind in zip(numbered, kinds, strict=True):
            if kind != kinds[0]:
                raise InputError(
                    USAGE_FRAME_INVALID,
                    "it has {describe_kind}, but frame {numbered_name} has {describe_kind_2}.",
                    DiagnosticLocation(frame=frame.name),
                    describe_kind=_describe_kind(kind),
                    numbered_name=numbered[0].name,
                    describe_kind_2=_describe_kind(kinds[0]),
                )
        has_depth, has_right = kinds[0]
        if has_right and not has_depth and rig is None:
            raise InputError(USAGE_FRAME_INVALID, "stereo pairs need the argument rig, a StereoRig.", "scan")
        if not (has_depth or has_right) and not any(f.world_from_camera is not None for f in numbered):
            raise InputError(
                USAGE_FRAME_INVALID, "single images need poses: give world_from_camera to each frame.", "scan"
            )
        return cls(
            layout="arrays",
            frames=numbered,
            rig=None if has_depth else rig,
            held_out=[
                frame if frame.name else replace(frame, name=f"held-out-{number:06d}")
                for number, frame in enumerate(held_out)
            ],
            up=None if up is None else _check_up(up),
            is_metric=is_metric,
        )

    def __repr__(self) -> str:
        return format_line(
            self,
            (
                self.layout,
                format_count(len(self.frames), "frame") or "no frames",
                self._kind,
                "poses" if self.has_poses else "no poses",
                "" if self.is_metric else "not metric",
                f"{len(self.held_out):,} held out" if self.held_out else "",
                f"{len(self.skipped_frames):,} skipped" if self.skipped_frames else "",
                *(f"lacks {_MISSING_NAMES.get(one.code, one.code)}" for one in self.missing),
                format_count(len(self.diagnostics), "diagnostic"),
            ),
        )

    _repr_html_ = render_table

    def _thumbnail(self) -> bytes | None:
        return render_thumbnail([frame.color for frame in self.frames if frame.color is not None])

    def to_dict(self) -> dict[str, Any]:
        """Summarise the scan as a JSON object without reading images.

        `inspect` reports much more.
        """
        camera = self.frames[0].camera if self.frames else None
        return {
            "layout": self.layout,
            "kind": self._kind,
            "frames": len(self.frames),
            "frames_with_poses": sum(frame.world_from_camera is not None for frame in self.frames),
            "size_px": None if camera is None else [camera.width, camera.height],
            "frames_held_out": len(self.held_out),
            "frames_skipped": [one.to_dict() for one in self.skipped_frames],
            "missing": [one.to_dict() for one in self.missing],
        }

    @property
    def _kind(self) -> str:
        return "stereo pairs" if self.is_stereo else "views" if self.is_views else "colour and depth"

    @property
    def has_poses(self) -> bool:
        """True if any frame has a pose."""
        return any(frame.world_from_camera is not None for frame in self.frames)

    @property
    def is_stereo(self) -> bool:
        """True if the scan consists of stereo pairs, whose depth must be computed."""
        return self.rig is not None

    @property
    def is_views(self) -> bool:
        """True if the scan consists of single views whose depth must be computed."""
        return self.rig is None and not any(frame.depth is not None for frame in self.frames)


def _create_camera(
    intrinsics: Camera | ArrayLike, image: NDArray[np.uint8] | NDArray[np.float32], where: str
) -> Camera:
    """Create the camera of an image, or check that a given camera fits the image."""
    height, width = image.shape[:2]
    if not isinstance(intrinsics, Camera):
        return Camera(width, height, *check_intrinsics(intrinsics, (width, height), where))
    if (intrinsics.width, intrinsics.height) != (width, height):
        raise InputError(
            USAGE_FRAME_INVALID,
            (
                "the camera is for images of {intrinsics_width} × {intrinsics_height} px, "
                "but the image has {width} × {height} px."
            ),
            where,
            intrinsics_width=intrinsics.width,
            intrinsics_height=intrinsics.height,
            width=width,
            height=height,
        )
    check_intrinsics((intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy), (width, height), where)
    return replace(intrinsics, distortion=check_distortion(intrinsics.distortion, where))


def _describe_kind(kind: tuple[bool, bool]) -> str:
    """Describe the images of a frame other than colour."""
    has_depth, has_right = kind
    names = [name for name, has in (("depth", has_depth), ("a right image", has_right)) if has]
    return " and ".join(names) or "neither depth nor a right image"


def _check_up(up: ArrayLike) -> WorldUp:
    """Check an up direction and normalise it to length 1."""
    vector = np.asarray(up, np.float64).reshape(-1)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not (np.isfinite(length) and length > 0):
        raise InputError(USAGE_FRAME_INVALID, "up must be a direction of three numbers.", "scan")
    x, y, z = (vector / length).tolist()
    return WorldUp((x, y, z), "given")
