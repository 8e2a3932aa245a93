"""Scale of a scan from tags of known size in its photos.

The corners of each tag are triangulated with the poses of the photos. The scale is the ratio of true to
triangulated edge length.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCALE_TAGS_UNRELIABLE
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, scale_camera
from scanloom.stages.scans.model.tags import TAG_FAMILIES, find_tags
from scanloom.stages.scans.model.world import Scale

Floats = NDArray[np.float64]

# Maximum number of photos, evenly spaced, and maximum length of their longer side in pixels.
_MAX_PHOTOS = 60
_MAX_SIDE_PX = 2400
# Number of photos in which tags of other families are searched, for the error message.
_MAX_SEARCHED_PHOTOS = 12
# Maximum number of views whose pairs are tried as RANSAC hypotheses.
_MAX_HYPOTHESIS_VIEWS = 12
# Inlier threshold of the reprojection error: the larger of a ratio of the edge length and a number of pixels.
_INLIER_EDGE_RATIO, _INLIER_PX = 0.08, 2.0
# Reweighting iterations: weights depend on depths, and depths on the corners; three iterations converge.
_ITERATIONS = 3
# Minimum triangulation angle, degrees.
_MIN_ANGLE_DEG = 2.0
# Relative differences of tag sizes: above the first, tags are not of one size; above the second, a warning.
_MAX_SIZE_DIFFERENCE, _DOUBTFUL_SIZE_DIFFERENCE = 0.05, 0.02


@dataclass(frozen=True, eq=False)
class _TagView:
    """Photo with tags: pinhole camera, pose, and tag corners.

    Corners are (4, 2) pixels by tag id.
    """

    camera: Camera
    camera_from_world: Pose
    tags: Mapping[int, Floats]


@dataclass(frozen=True, eq=False)
class _TriangulatedTag:
    """Triangulated tag.

    Edge lengths (4,) are in world units; `views` are the indices of the inlier views.
    """

    number: int
    edges: Floats
    views: tuple[int, ...]


def estimate_scale_from_tags(frames: Sequence[Frame], edge: float, family: str, folder: Path) -> Scale:
    """Estimate the scale of the frames' poses from tags of known size.

    Parameters
    ----------
    edge : edge length of the tags' black squares, metres.
    family : one of `scanloom.stages.scans.model.tags.TAG_FAMILIES`.
    folder : scan folder for messages.

    Raises
    ------
    InputError
        If no tag is visible from two positions, or the tags contradict each other.
    """
    posed = [frame for frame in frames if frame.color is not None and frame.world_from_camera is not None]
    if not posed:
        raise InputError(SCALE_TAGS_UNRELIABLE, "tags require photos with poses, and there are none.", folder)
    chosen = _sample_evenly(posed, _MAX_PHOTOS)
    views = [view for view in _detect_in_frames(chosen, family) if view is not None]
    seen = sorted({number for view in views for number in view.tags})
    if not seen:
        raise InputError(SCALE_TAGS_UNRELIABLE, _describe_missing_tags(chosen, family), folder)
    tags = [tag for number in seen if (tag := _triangulate_tag(number, views)) is not None]
    if not tags:
        named = ", ".join(map(str, seen[:8])) + (" …" if len(seen) > 8 else "")
        raise InputError(
            SCALE_TAGS_UNRELIABLE,
            (
                "tags were detected ({named}), but none in two photos from different positions with "
                "consistent poses."
            ),
            folder,
            named=named,
        )
    tags = _select_consistent_tags(tags, edge, folder)
    factors = np.array([edge / tag.edges.mean() for tag in tags])
    factor = float(np.median(factors))
    compared = factors if len(tags) > 1 else edge / tags[0].edges
    spread = float(np.abs(compared / factor - 1).max())
    if spread > _DOUBTFUL_SIZE_DIFFERENCE:
        emit(
            SCALE_TAGS_UNRELIABLE.warning(
                "the scale from tags is only accurate to {spread:.1%}, because their measured sizes differ",
                spread=spread,
            )
        )
    which = f"tag {tags[0].number}" if len(tags) == 1 else f"{len(tags)} tags"
    count = len({view for tag in tags for view in tag.views})
    return Scale(factor, f"{which} of {edge:g} m in {count} photos", spread)


def _sample_evenly(frames: Sequence[Frame], max_count: int) -> list[Frame]:
    places = np.unique(np.linspace(0, len(frames) - 1, max_count).round().astype(int))
    return [frames[at] for at in places]


def _detect_in_frames(frames: Sequence[Frame], family: str) -> list[_TagView | None]:
    threads = get_worker_count()
    return list(
        map_ordered(partial(_detect_in_frame, family), frames, threads=threads, max_pending=threads + 1)
    )


def _detect_in_frame(family: str, frame: Frame) -> _TagView | None:
    """Detect tags in a photo; None if it cannot be read.

    Read errors are reported by the stage that uses the photo.
    """
    photo = _read_small_photo(frame)
    if photo is None:
        return None
    image, camera = photo
    pose = frame.world_from_camera
    assert pose is not None
    color_from_depth = np.eye(4) if frame.color_from_depth is None else frame.color_from_depth
    return _TagView(camera, color_from_depth @ invert_pose(pose), find_tags(image, family))


def _read_small_photo(frame: Frame) -> tuple[ColorImage, Camera] | None:
    import cv2

    try:
        image, camera, _ = read_photo(frame)
    except InputError:
        return None
    share = _MAX_SIDE_PX / max(camera.width, camera.height)
    if share >= 1:
        return image, camera
    camera = scale_camera(camera, round(share * camera.width), round(share * camera.height))
    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), camera


def _describe_missing_tags(frames: Sequence[Frame], family: str) -> str:
    """Describe that no tags were found.

    Suggests families that have a tag in two photos.
    """
    threads = get_worker_count()
    looked_at = map_ordered(
        _detect_all_families,
        _sample_evenly(frames, _MAX_SEARCHED_PHOTOS),
        threads=threads,
        max_pending=threads + 1,
    )
    counts = Counter(tag for found in looked_at for tag in found)
    others = [
        other for other in TAG_FAMILIES if any(one == other and n > 1 for (one, _), n in counts.items())
    ]
    advice = (
        f"there are tags of {' and '.join(others)}: set scan.tag_family={others[0]}"
        if others
        else "set scan.tag_family=NAME if they are of another family"
    )
    return f"no tag of {family} was found in {len(frames)} photos; {advice}."


def _detect_all_families(frame: Frame) -> list[tuple[str, int]]:
    photo = _read_small_photo(frame)
    if photo is None:
        return []
    return [(family, number) for family in TAG_FAMILIES for number in find_tags(photo[0], family)]


def _triangulate_tag(number: int, views: Sequence[_TagView]) -> _TriangulatedTag | None:
    """Triangulate a tag from the largest consistent set of views.

    Pairs of views give hypotheses; the one with the most inliers is refined with all its inliers. None if
    fewer than two views agree, or their triangulation angle is too small.
    """
    view_indices = [at for at, view in enumerate(views) if number in view.tags]
    tag_views = [views[at] for at in view_indices]
    hypothesis_views = (
        np.unique(np.linspace(0, len(tag_views) - 1, _MAX_HYPOTHESIS_VIEWS).round().astype(int)).tolist()
        if tag_views
        else []
    )
    best: list[int] = []
    for pair in itertools.combinations(hypothesis_views, 2):
        if _compute_max_angle_deg([tag_views[at] for at in pair], number) < _MIN_ANGLE_DEG:
            continue
        agreeing = _find_inlier_views(
            _triangulate_corners([tag_views[at] for at in pair], number), tag_views, number
        )
        if len(agreeing) > len(best):
            best = agreeing
    if len(best) > 1:
        best = _find_inlier_views(
            _triangulate_corners([tag_views[at] for at in best], number), tag_views, number
        )
    if len(best) < 2 or _compute_max_angle_deg([tag_views[at] for at in best], number) < _MIN_ANGLE_DEG:
        return None
    corners = _triangulate_corners([tag_views[at] for at in best], number)
    edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return _TriangulatedTag(number, edges, tuple(view_indices[at] for at in best))


def _unproject_corners(view: _TagView, number: int) -> Floats:
    """Unproject the corners of a tag to rays (4, 3) with z = 1, in camera axes."""
    camera, pixels = view.camera, view.tags[number]
    x = (pixels[:, 0] - camera.cx) / camera.fx
    y = (pixels[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(4)], axis=1)


def _compute_max_angle_deg(views: Sequence[_TagView], number: int) -> float:
    """Compute the maximum triangulation angle at the centre of a tag, degrees."""
    rays = np.array(
        [_unproject_corners(view, number).mean(axis=0) @ view.camera_from_world[:3, :3] for view in views]
    )
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return math.degrees(math.acos(float(np.clip((rays @ rays.T).min(), -1, 1))))


def _triangulate_corners(views: Sequence[_TagView], number: int) -> Floats:
    """Triangulate the corners (4, 3) of a tag in world coordinates.

    Minimises the reprojection error by iteratively reweighted linear least squares.
    """
    turns = np.array([view.camera_from_world[:3, :3] for view in views])
    shifts = np.array([view.camera_from_world[:3, 3] for view in views])
    rays = np.array([_unproject_corners(view, number) for view in views])
    focal = np.array([view.camera.fx for view in views])
    # x − X / Z = 0 and y − Y / Z = 0, multiplied by Z: linear in the point. The residual is Z times the
    # reprojection error; the weights 1 / Z undo this.
    rows = rays[:, :, :2, None] * turns[:, None, 2:3] - turns[:, None, :2]
    right = shifts[:, None, :2] - rays[:, :, :2] * shifts[:, None, 2:3]
    corners = np.zeros((4, 3))
    weights = np.broadcast_to(focal[:, None], rays.shape[:2])
    for _ in range(_ITERATIONS):
        for at in range(4):
            weight = np.repeat(weights[:, at], 2)
            corners[at] = np.linalg.lstsq(
                weight[:, None] * rows[:, at].reshape(-1, 3), weight * right[:, at].reshape(-1), rcond=None
            )[0]
        depth = np.einsum("nj,kj->nk", turns[:, 2], corners) + shifts[:, 2:3]
        weights = focal[:, None] / np.maximum(np.abs(depth), np.finfo(np.float64).tiny)
    return corners


def _find_inlier_views(corners: Floats, views: Sequence[_TagView], number: int) -> list[int]:
    """Return the indices of the views in which all corners of a tag are inliers."""
    inliers = []
    for at, view in enumerate(views):
        points = corners @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
        if (points[:, 2] <= 0).any():
            continue
        focal = np.array((view.camera.fx, view.camera.fy))
        projected = points[:, :2] / points[:, 2:] * focal + (view.camera.cx, view.camera.cy)
        pixels = view.tags[number]
        edge = float(np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1).mean())
        if np.linalg.norm(projected - pixels, axis=1).max() < max(_INLIER_EDGE_RATIO * edge, _INLIER_PX):
            inliers.append(at)
    return inliers


def _select_consistent_tags(
    tags: Sequence[_TriangulatedTag], edge: float, folder: Path
) -> list[_TriangulatedTag]:
    """Return the tags of the most common size, with a warning about the rejected ones.

    Raises
    ------
    InputError
        If no tag is square, or at most half of the tags have the same size.
    """
    square = [tag for tag in tags if np.ptp(tag.edges) < 2 * _MAX_SIZE_DIFFERENCE * tag.edges.mean()]
    if not square:
        edges = tags[0].edges
        raise InputError(
            SCALE_TAGS_UNRELIABLE,
            (
                "tag {number} is not square, its edges are {min:.4g} to {max:.4g} units long: the "
                "poses are too inaccurate to estimate the scale."
            ),
            folder,
            number=tags[0].number,
            min=edges.min(),
            max=edges.max(),
        )
    sizes = np.array([tag.edges.mean() for tag in square])
    same = np.abs(sizes / np.median(sizes) - 1) <= _MAX_SIZE_DIFFERENCE
    if len(square) > 1 and np.count_nonzero(same) <= len(square) / 2:
        scales = ", ".join(f"tag {tag.number} {edge / tag.edges.mean():.4g}" for tag in square[:8])
        raise InputError(
            SCALE_TAGS_UNRELIABLE,
            "the tags give different scales in metres per unit: {scales}. Do they all have the same size?",
            folder,
            scales=scales,
        )
    kept = [tag for tag, is_same in zip(square, same, strict=True) if is_same]
    others = [tag.number for tag in tags if tag not in kept]
    if others:
        emit(
            SCALE_TAGS_UNRELIABLE.warning(
                "tags ignored for the scale, because they differ in size from most tags or are not "
                "square: {numbers}",
                numbers=", ".join(map(str, others)),
            )
        )
    return kept
