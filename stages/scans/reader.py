"""Detection of the layout of a scan folder, and reading of the scan."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.collector import collecting, emit, merge_repeated
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.blas_memory import reserve_blas_buffers
from scanloom.stages.files.codes import FILE_PATH_INVALID, FILE_UNREADABLE
from scanloom.stages.files.file_access_log import record_opened_files
from scanloom.stages.scans.advice import (
    describe_file,
    describe_photos,
    describe_streams,
    describe_unreadable_photos,
)
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    POSE_ASSUMED,
    POSE_MISSING,
    SCAN_ASSUMED,
    SCAN_IMAGES_UNPAIRED,
    SCAN_LAYOUT_UNKNOWN,
    SCAN_OPTION_UNUSED,
    SCAN_SELECTION_EMPTY,
    SCAN_TIMES_IRREGULAR,
    SCAN_TOO_MANY_FRAMES_SKIPPED,
)
from scanloom.stages.scans.image_folders.image_files import find_common_size
from scanloom.stages.scans.image_folders.rotated_bits import decode_rotated_scan
from scanloom.stages.scans.layout_table import DISTINCT_LAYOUTS, GENERIC_LAYOUTS, LAYOUTS
from scanloom.stages.scans.layouts import plain_photos, plain_views
from scanloom.stages.scans.layouts.plain_views import find_photo_folder
from scanloom.stages.scans.layouts.shared.axis_alignment import apply_axis_alignment
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.unsupported import UnsupportedLayout, find_unsupported_layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.poses import AS_WRITTEN, to_camera_to_world
from scanloom.stages.scans.model.scan import Frame, PackedImage, Scan, SkippedFrame
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.transforms.adjusted_cameras import apply_adjusted_cameras
from scanloom.stages.scans.transforms.depth_agreement import align_predicted_depth
from scanloom.stages.scans.transforms.depth_calibration import apply_depth_calibration
from scanloom.stages.scans.transforms.masks import apply_masks
from scanloom.stages.scans.transforms.scale import apply_scale
from scanloom.stages.scans.transforms.unposed_photos import add_unlisted_photos
from scanloom.stages.scans.transforms.up_direction import set_layout_up

# Maximum number of subfolders that a message names as scans.
_MAX_NAMED_FOLDERS = 6
# Maximum depth of folders that hold nothing but another folder.
_MAX_NESTED_FOLDERS = 3


def read_scan(folder: Path | str, options: ScanParams | None = None, *, complete: bool = True) -> Scan:
    """Read a scan folder.

    Frames are in capture order, lengths in metres (if the scan is metric) and poses in OpenCV axes. Images
    stay on disk until they are needed.

    Parameters
    ----------
    folder : folder of the scan, or a recording file.
    options : parameters that replace or complete what the folder states.
    complete : reject a scan without poses or calibration. If False, `Scan.missing` lists what is missing.

    Raises
    ------
    InputError
        If the layout is unknown, or required data is missing or invalid.
    """
    reserve_blas_buffers(1)
    require_opencv()
    folder = Path(folder)
    options = options or ScanParams()
    with collecting() as diagnostics:
        scan = _read_frames(folder, options, keep_unposed=options.keep_unposed and not complete)
        if complete:
            require_complete(scan, scan.folder or folder)
        _require_equal_sides(scan.frames, scan.folder or folder)
    return replace(scan, diagnostics=tuple(diagnostics))


def _read_frames(folder: Path, options: ScanParams, *, keep_unposed: bool) -> Scan:
    """Read all frames, apply poses, masks and scale, and return the selected frames.

    Parameters
    ----------
    keep_unposed : keep photos without a pose in a scan with poses.
    """
    folder, layout = _select_layout(folder, options)
    with record_opened_files() as opened_files, collecting(forward=False) as diagnostics:
        read = layout.read(folder, options)
    _require_options_used(options, folder, layout, read, opened_files)
    emit(*merge_repeated(diagnostics))
    read = _apply_pose_convention(read, options.pose_convention)
    scan = set_layout_up(
        _drop_constant_poses(replace(read, source_files=_collect_files(read, opened_files))), layout, options
    )
    if layout.name != "sun-rgbd":  # its reader detects rotated bits itself
        scan = decode_rotated_scan(scan, options.depth_scale, is_own_layout=layout.name == "plain-rgbd")
    if scan.is_depth_predicted:
        scan = replace(scan, frames=align_predicted_depth(scan.frames))
    keep_unposed = keep_unposed and scan.is_views and scan.has_poses
    if keep_unposed:
        scan = add_unlisted_photos(scan)
    masks = options.resolve_file("masks", folder)
    if masks is not None:
        scan = apply_masks(scan, masks)
    # Scale before the adjusted cameras, which are in metres already. The scale is estimated from all frames,
    # so that it does not depend on the selection.
    scan = apply_scale(scan, options, folder)
    # The correction of adjusted cameras, which is specific to the scan, replaces the sensor's.
    depth_calibration = options.resolve_file("depth_calibration", folder)
    if depth_calibration is not None:
        scan = apply_depth_calibration(scan, depth_calibration)
    adjusted = options.resolve_file("adjusted_cameras", folder)
    if adjusted is not None:
        scan = apply_adjusted_cameras(scan, adjusted)
    scan = _drop_missing_files(scan)
    if not keep_unposed:
        scan = _drop_untracked(scan, folder)
    if options.align_axes:
        scan = apply_axis_alignment(scan, folder)
    _warn_irregular_times(scan.frames)
    scan = _hold_out_frames(replace(scan, frames=_select_frames(scan, options)), options.hold_out)
    return _place_at_origin(scan) if len(scan.frames) == 1 else scan


def _select_layout(folder: Path, options: ScanParams) -> tuple[Path, Layout]:
    """Return the folder of the scan, and its layout.

    The folder differs from the given one if that holds exactly one scan.
    """
    named = next((one for one in LAYOUTS if one.name == options.layout), None)
    if named is not None:
        _require_readable(folder, named.suffixes)
        return folder, named
    found = find_layout(folder)
    is_without_poses = found is None or found[0] is plain_photos.LAYOUT
    if is_without_poses and options.poses is not None and find_photo_folder(folder) is not None:
        return folder, plain_views.LAYOUT
    if found is not None:
        return folder, found[0]
    inside = _find_scans_inside(folder)
    if len(inside) == 1:
        child, layout = inside[0]
        emit(
            SCAN_ASSUMED.info(
                "the only scan in this folder is {child}/ ({layout}), which is read",
                folder,
                child=child,
                layout=layout.name,
            )
        )
        return folder / child, layout
    raise InputError(SCAN_LAYOUT_UNKNOWN, _describe_unknown_folder(folder), folder)


def _apply_pose_convention(scan: Scan, convention: str) -> Scan:
    """Convert the poses from the convention that the user states to camera-to-world."""
    if convention == AS_WRITTEN:
        return scan
    frames = [
        frame
        if frame.world_from_camera is None
        else replace(frame, world_from_camera=to_camera_to_world(frame.world_from_camera, convention))
        for frame in scan.frames
    ]
    return replace(scan, frames=frames)


def _require_options_used(
    options: ScanParams, folder: Path, layout: Layout, read: Scan, opened_files: Collection[Path]
) -> None:
    """Check that the layout used all options that the user gave.

    Raises
    ------
    UsageError
        If an option has no effect or conflicts with another.
    """
    opened = {os.path.realpath(path) for path in opened_files}
    for name in ("poses", "calibration"):
        path = options.resolve_file(name, folder if folder.is_dir() else folder.parent)
        if path is None or os.path.realpath(path) in opened:
            continue
        if name == "calibration" and options.intrinsics is not None:
            raise UsageError(
                SCAN_OPTION_UNUSED,
                "scan.intrinsics and scan.calibration={path_name} both state the camera",
                remedy="remove one of them.",
                path_name=path.name,
            )
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.{name}={path_name} has no effect: the layout {layout_name} does not use it.",
            remedy="Remove the option.",
            name=name,
            path_name=path.name,
            layout_name=layout.name,
        )
    if options.baseline is not None and not read.is_stereo:
        raise UsageError(
            SCAN_OPTION_UNUSED,
            ("scan.baseline applies to stereo pairs, and these frames are not stereo pairs"),
            remedy="remove the option.",
        )
    if options.depth_scale is not None and read.is_stereo:
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.depth_scale applies to depth maps, and stereo pairs have none",
            remedy="remove the option.",
        )
    if options.depth_calibration is not None and all(frame.depth is None for frame in read.frames):
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.depth_calibration applies to depth maps, and these frames have none",
            remedy="remove the option.",
        )
    if options.min_confidence is not None and all(frame.confidence is None for frame in read.frames):
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.min_confidence requires confidence maps, and these frames have none",
            remedy="remove the option.",
        )
    if options.hold_out is not None and read.is_views and not read.has_poses:
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.hold_out requires poses, and these photos have none",
            remedy="remove the option, or run again with the poses in sparse/ of a first run.",
        )
    if options.poses_by_order and options.poses is None and not read.has_poses:
        raise UsageError(
            SCAN_OPTION_UNUSED,
            "scan.poses_by_order requires a trajectory, and the scan has none",
            remedy="give one with scan.poses=FILE.",
        )


def _collect_files(scan: Scan, opened_files: Collection[Path]) -> frozenset[Path]:
    """Return the files that were read, and the image files of all frames."""
    images = [
        image
        for frame in scan.frames
        for image in (frame.color, frame.right, frame.depth, frame.confidence, frame.mask)
    ]
    held = [image.file if isinstance(image, PackedImage) else image for image in images]
    if any(isinstance(path, Path) and "\0" in str(path) for path in held):
        raise InputError(FILE_PATH_INVALID, "the name of an image contains a null character.", scan.folder)
    return frozenset({*opened_files, *(path for path in held if isinstance(path, Path))})


def require_complete(scan: Scan, folder: Path, *, posed: bool = True) -> None:
    """Check that a scan has calibration and, with `posed`, poses.

    Raises
    ------
    InputError
        If something is missing.
    """
    lacking = [one for one in scan.missing if posed or one.code != POSE_MISSING.name]
    if len(lacking) == 1:
        raise InputError.from_diagnostic(
            replace(lacking[0], severity=Severity.ERROR).replace_location(folder)
        )
    if lacking:
        message = "; and ".join(map(str, lacking))
        raise InputError.from_diagnostic(
            Diagnostic(lacking[0].code, Severity.ERROR, message).replace_location(folder)
        )


def detect_layout(folder: Path) -> tuple[Layout, str]:
    """Detect the layout of a scan folder or recording file.

    Returns
    -------
    The layout, and the reason for the match in words.

    Raises
    ------
    InputError
        If the path does not exist, is an empty folder, or has no supported layout.
    """
    found = find_layout(folder)
    if found is None:
        raise InputError(SCAN_LAYOUT_UNKNOWN, _describe_unknown_folder(folder), folder)
    return found


def find_layout(folder: Path) -> tuple[Layout, str] | None:
    """Detect the layout as `detect_layout` does; None if no layout matches.

    Raises
    ------
    InputError
        If the path does not exist, cannot be listed, or has a known but unsupported layout.
    """
    _require_readable(folder, [suffix for one in LAYOUTS for suffix in one.suffixes])
    if folder.is_file():
        return next((one, folder.name) for one in LAYOUTS if folder.suffix.lower() in one.suffixes)
    found = _find_first_match(DISTINCT_LAYOUTS, folder)
    if found is None and (known := find_unsupported_layout(folder)) is not None:
        raise InputError(
            SCAN_LAYOUT_UNKNOWN,
            "{refusal} If it has another layout, set scan.layout=NAME.",
            folder,
            refusal=_describe_unsupported(known),
        )
    return found or _find_first_match(GENERIC_LAYOUTS, folder)


def _require_readable(folder: Path, suffixes: Collection[str]) -> None:
    """Check that a path is a readable folder or a file with one of the suffixes.

    Raises
    ------
    InputError
        If it is neither.
    """
    if folder.is_file() and (known := find_unsupported_layout(folder)) is not None:
        raise InputError(SCAN_LAYOUT_UNKNOWN, _describe_unsupported(known), folder)
    if folder.is_file() and folder.suffix.lower() in suffixes:
        return
    if not folder.is_dir():
        if not folder.exists():
            raise InputError(FILE_PATH_INVALID, "there is no such folder.", folder)
        problem = describe_file(folder, is_scan_folder=_is_scan_folder(folder.absolute().parent))
        raise InputError(FILE_PATH_INVALID, problem, folder)
    try:
        next(folder.iterdir(), None)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the folder cannot be listed ({strerror}).", folder, strerror=error.strerror
        ) from error


def _is_scan_folder(folder: Path) -> bool:
    try:
        return _find_first_match(LAYOUTS, folder) is not None
    except InputError:
        return False


def _describe_unsupported(known: UnsupportedLayout) -> str:
    return f"this looks like {known.name}, which is not supported. {known.advice}"


def _find_first_match(layouts: Sequence[Layout], folder: Path) -> tuple[Layout, str] | None:
    # Diagnostics are discarded here; reading the scan emits them again.
    with collecting(forward=False):
        return next(((one, reason) for one in layouts if (reason := one.matches(folder)) is not None), None)


def _describe_unknown_folder(folder: Path) -> str:
    """Describe a folder of unknown layout: its content, and the supported layouts."""
    content = sorted(path.name + "/" * path.is_dir() for path in folder.iterdir())
    if not content:
        return "the folder is empty."
    if inside := _find_scans_inside(folder):
        child, layout = inside[0][0], inside[0][1].name
        others = ", ".join(f"{name}/" for name, _ in inside[1:])
        also = f", and so do {others}" if others else ""
        return f"this is no scan, but its folder {child}/ looks like one ({layout}){also}; give that folder."
    if (unreadable := describe_unreadable_photos(folder)) is not None:
        return unreadable
    if (streams := describe_streams(folder)) is not None:
        return streams
    if (photos := find_photo_folder(folder)) is not None:
        return describe_photos(folder, photos)
    shown = ", ".join(content[:6]) + (f" and {len(content) - 6} more" if len(content) > 6 else "")
    known = ", ".join(one.name for one in LAYOUTS)
    return f"unknown layout. The folder holds {shown}. Supported layouts are {known}; see the README."


def _find_scans_inside(folder: Path, max_depth: int = _MAX_NESTED_FOLDERS) -> list[tuple[str, Layout]]:
    """Return (name, layout) of up to six subfolders that are scans.

    Unpacked archives often hold one folder in another, so a single subfolder is searched, too.
    """
    try:
        content = sorted(filter(_is_content, folder.iterdir()))
        children = [path for path in content if path.is_dir()]
        # Photos alone are not searched for: they may belong to a scan whose other files are unknown.
        known = [layout for layout in LAYOUTS if layout is not plain_photos.LAYOUT]
        matches = ((child.name, _find_first_match(known, child)) for child in children)
        found = [(name, match[0]) for name, match in matches if match is not None]
    except OSError:
        # A subfolder that cannot be listed.
        return []
    if found or len(content) != 1 or not children or max_depth <= 1:
        return found[:_MAX_NAMED_FOLDERS]
    inside = _find_scans_inside(children[0], max_depth - 1)
    return [(f"{children[0].name}/{name}", layout) for name, layout in inside]


def _is_content(path: Path) -> bool:
    """Return False for hidden files, and for what macOS adds to archives."""
    return not path.name.startswith((".", "__MACOSX"))


def _select_frames(scan: Scan, options: ScanParams) -> Sequence[Frame]:
    end = None if options.last is None else options.last + 1
    chosen = scan.frames[options.first : end : options.every]
    if not chosen:
        raise UsageError(
            SCAN_SELECTION_EMPTY,
            "scan.first={first}, scan.last={last} selects none of the scan's {frames_count} frames.",
            first=options.first,
            last=options.last,
            frames_count=len(scan.frames),
        )
    max_frames = options.max_frames
    if max_frames is None or len(chosen) <= max_frames or scan.is_views or not scan.has_poses:
        return chosen
    return [chosen[k * (len(chosen) - 1) // (max_frames - 1)] for k in range(max_frames)]


def _hold_out_frames(scan: Scan, every: int | None) -> Scan:
    """Hold out every n-th frame, starting in the middle of the first n."""
    if every is None:
        return scan
    kept = [frame for number, frame in enumerate(scan.frames) if number % every != every // 2]
    held_out = tuple(scan.frames[every // 2 :: every])
    if not held_out:
        raise UsageError(
            SCAN_SELECTION_EMPTY,
            "scan.hold_out={every} holds out none of the scan's {frames_count} frames.",
            every=every,
            frames_count=len(scan.frames),
        )
    return replace(scan, frames=kept, held_out=held_out)


def _drop_constant_poses(scan: Scan) -> Scan:
    """Discard the poses if all are identical.

    Recorders without tracking write the same pose for every frame.
    """
    poses = [frame.world_from_camera for frame in scan.frames if frame.world_from_camera is not None]
    if len(poses) < 2 or any(not np.array_equal(poses[0], pose) for pose in poses[1:]):
        return scan
    return replace(
        scan,
        frames=[replace(frame, world_from_camera=None) for frame in scan.frames],
        missing=(
            *scan.missing,
            describe_missing_poses(
                "all {count} frames have the same pose",
                remedy="give a trajectory with scan.poses=FILE",
                count=len(poses),
            ),
        ),
    )


def _place_at_origin(scan: Scan) -> Scan:
    """Place the camera of a single frame without a pose at the origin."""
    (frame,) = scan.frames
    if frame.world_from_camera is not None:
        return scan
    emit(POSE_ASSUMED.warning("the only frame has no pose; its camera becomes the origin of the mesh"))
    return replace(
        scan,
        frames=[replace(frame, world_from_camera=np.eye(4))],
        missing=tuple(one for one in scan.missing if one.code != POSE_MISSING.name),
    )


def _drop_missing_files(scan: Scan) -> Scan:
    """Skip frames with a missing image file.

    Excerpts of data sets often keep the lists of the complete data set.
    """
    frames, skipped = [], []
    for frame in scan.frames:
        images = (frame.color, frame.right, frame.depth, frame.confidence, frame.mask)
        files = [path for path in images if isinstance(path, Path)]
        missing = next((path for path in files if not path.exists()), None)
        if missing is None:
            frames.append(frame)
        else:
            reason = FRAME_IMAGE_MISSING.warning("{file} is missing", file=missing.name)
            skipped.append(SkippedFrame(frame.name, reason))
    return replace(scan, frames=frames, skipped_frames=(*scan.skipped_frames, *skipped))


def _drop_untracked(scan: Scan, folder: Path) -> Scan:
    """Skip frames without a pose.

    A scan without any poses is returned unchanged if its `missing` states that.

    Raises
    ------
    InputError
        If no frame is left.
    """
    frames = [frame for frame in scan.frames if frame.world_from_camera is not None]
    if not frames and scan.missing and scan.frames:
        return scan
    lost = [
        SkippedFrame(frame.name, FRAME_POSE_MISSING.warning("tracking was lost: it has no pose"))
        for frame in scan.frames
        if frame.world_from_camera is None
    ]
    skipped = (*scan.skipped_frames, *lost)
    if not frames:
        reason = f" (frame {skipped[0].name}: {skipped[0].reason})" if skipped else ""
        inside = _find_scans_inside(folder) if folder.is_dir() else []
        other = f" Its folder {inside[0][0]}/ looks like a scan." if inside else ""
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            "none of its {skipped_count} frames can be used{reason}.{other}",
            folder,
            skipped_count=len(skipped),
            reason=reason,
            other=other,
        )
    return replace(scan, frames=frames, skipped_frames=skipped)


def _require_equal_sides(frames: Sequence[Frame], folder: Path) -> None:
    lefts = [frame.color for frame in frames if isinstance(frame.color, Path)]
    rights = [frame.right for frame in frames if isinstance(frame.right, Path)]
    if not rights:
        return
    left, right = find_common_size(lefts), find_common_size(rights)
    if left != right:
        raise InputError(
            SCAN_IMAGES_UNPAIRED,
            (
                "left images are {left}×{left_2} px and right images {right}×{right_2} px; both "
                "images of a stereo pair must have the same size."
            ),
            folder,
            left=left[0],
            left_2=left[1],
            right=right[0],
            right_2=right[1],
        )


def _warn_irregular_times(frames: Sequence[Frame]) -> None:
    """Warn about repeated timestamps, decreasing timestamps and gaps."""
    times = [frame.timestamp for frame in frames if frame.timestamp is not None]
    steps = np.diff(np.array(times, np.float64))
    if repeated := int(np.count_nonzero(steps == 0)):
        emit(SCAN_TIMES_IRREGULAR.warning("{count} timestamps are repeated", count=repeated))
    if earlier := int(np.count_nonzero(steps < 0)):
        emit(
            SCAN_TIMES_IRREGULAR.warning(
                "{count} timestamps are earlier than the previous one; frames stay in the order of "
                "their files",
                count=earlier,
            )
        )
    if gaps := int(np.count_nonzero(steps > 5 * max(float(np.median(steps)), 1.0))) if len(steps) else 0:
        emit(
            SCAN_TIMES_IRREGULAR.warning(
                "{count} gaps between timestamps are longer than five frames", count=gaps
            )
        )
