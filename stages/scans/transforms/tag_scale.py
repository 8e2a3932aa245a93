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
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, scaled
from scanloom.stages.scans.model.tags import FAMILIES, find_tags
from scanloom.stages.scans.model.world import Scale

Floats = NDArray[np.float64]

# Maximum number of photos, evenly spaced, and maximum length of their longer side in pixels.
_MOST_PHOTOS = 60
_LONGEST_SIDE = 2400
# Number of photos in which tags of other families are searched, for the error message.
_LOOKED_AT = 12
# Maximum number of views whose pairs are tried as RANSAC hypotheses.
_TRIED = 12
# Inlier threshold of the reprojection error: the larger of a ratio of the edge length and a number of pixels.
_OFF_SHARE, _OFF_PX = 0.08, 2.0
# Reweighting iterations: weights depend on depths, and depths on the corners; three iterations converge.
_ROUNDS = 3
# Minimum triangulation angle, degrees.
_LEAST_ANGLE_DEG = 2.0
# Relative differences of tag sizes: above the first, tags are not of one size; above the second, a warning.
_DISAGREE, _DOUBTFUL = 0.05, 0.02


@dataclass(frozen=True, eq=False)
class _View:
    """Photo with tags: pinhole camera, pose, and tag corners.

    Corners are (4, 2) pixels by tag id.
    """

    camera: Camera
    camera_from_world: Pose
    tags: Mapping[int, Floats]


@dataclass(frozen=True, eq=False)
class _Tag:
    """Triangulated tag.

    Edge lengths (4,) are in world units; `views` are the indices of the inlier views.
    """

    number: int
    edges: Floats
    views: tuple[int, ...]


def scale_by_tags(frames: Sequence[Frame], edge: float, family: str, folder: Path) -> Scale:
    """Estimate the scale of the frames' poses from tags of known size.

    Parameters
    ----------
    edge : edge length of the tags' black squares, metres.
    family : one of `scanloom.stages.scans.model.tags.FAMILIES`.
    folder : scan folder for messages.

    Raises
    ------
    InputError
        If no tag is visible from two positions, or the tags contradict each other.
    """
    posed = [frame for frame in frames if frame.color is not None and frame.world_from_camera is not None]
    if not posed:
        raise InputError(SCALE_TAGS_UNRELIABLE, "tags require photos with poses, and there are none.", folder)
    chosen = _spread(posed, _MOST_PHOTOS)
    views = [view for view in _looked_at(chosen, family) if view is not None]
    seen = sorted({number for view in views for number in view.tags})
    if not seen:
        raise InputError(SCALE_TAGS_UNRELIABLE, _none_found(chosen, family), folder)
    tags = [tag for number in seen if (tag := _placed(number, views)) is not None]
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
    tags = _agreeing(tags, edge, folder)
    factors = np.array([edge / tag.edges.mean() for tag in tags])
    factor = float(np.median(factors))
    compared = factors if len(tags) > 1 else edge / tags[0].edges
    spread = float(np.abs(compared / factor - 1).max())
    if spread > _DOUBTFUL:
        emit(
            SCALE_TAGS_UNRELIABLE.warning(
                "the scale from tags is only accurate to {spread:.1%}, because their measured sizes differ",
                spread=spread,
            )
        )
    which = f"tag {tags[0].number}" if len(tags) == 1 else f"{len(tags)} tags"
    count = len({view for tag in tags for view in tag.views})
    return Scale(factor, f"{which} of {edge:g} m in {count} photos", spread)


def _spread(frames: Sequence[Frame], most: int) -> list[Frame]:
    places = np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int))
    return [frames[at] for at in places]


def _looked_at(frames: Sequence[Frame], family: str) -> list[_View | None]:
    threads = workers()
    return list(read_ahead(partial(_look, family), frames, threads=threads, ahead=threads + 1))


def _look(family: str, frame: Frame) -> _View | None:
    """Detect tags in a photo; None if it cannot be read.

    Read errors are reported by the stage that uses the photo.
    """
    photo = _photo(frame)
    if photo is None:
        return None
    image, camera = photo
    pose = frame.world_from_camera
    assert pose is not None
    apart = np.eye(4) if frame.color_from_depth is None else frame.color_from_depth
    return _View(camera, apart @ inverted(pose), find_tags(image, family))


def _photo(frame: Frame) -> tuple[ColorImage, Camera] | None:
    import cv2

    try:
        image, camera, _ = read_photo(frame)
    except InputError:
        return None
    share = _LONGEST_SIDE / max(camera.width, camera.height)
    if share >= 1:
        return image, camera
    camera = scaled(camera, round(share * camera.width), round(share * camera.height))
    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), camera


def _none_found(frames: Sequence[Frame], family: str) -> str:
    """Describe that no tags were found.

    Suggests families that have a tag in two photos.
    """
    threads = workers()
    looked_at = read_ahead(_of_any_family, _spread(frames, _LOOKED_AT), threads=threads, ahead=threads + 1)
    counts = Counter(tag for found in looked_at for tag in found)
    others = [other for other in FAMILIES if any(one == other and n > 1 for (one, _), n in counts.items())]
    advice = (
        f"there are tags of {' and '.join(others)}: set scan.tag_family={others[0]}"
        if others
        else "set scan.tag_family=NAME if they are of another family"
    )
    return f"no tag of {family} was found in {len(frames)} photos; {advice}."


def _of_any_family(frame: Frame) -> list[tuple[str, int]]:
    photo = _photo(frame)
    if photo is None:
        return []
    return [(family, number) for family in FAMILIES for number in find_tags(photo[0], family)]


def _placed(number: int, views: Sequence[_View]) -> _Tag | None:
    """Triangulate a tag from the largest consistent set of views.

    Pairs of views give hypotheses; the one with the most inliers is refined with all its inliers. None if
    fewer than two views agree, or their triangulation angle is too small.
    """
    places = [at for at, view in enumerate(views) if number in view.tags]
    own = [views[at] for at in places]
    tried = np.unique(np.linspace(0, len(own) - 1, _TRIED).round().astype(int)).tolist() if own else []
    best: list[int] = []
    for couple in itertools.combinations(tried, 2):
        if _angle([own[at] for at in couple], number) < _LEAST_ANGLE_DEG:
            continue
        agreeing = _agree(_corners([own[at] for at in couple], number), own, number)
        if len(agreeing) > len(best):
            best = agreeing
    if len(best) > 1:
        best = _agree(_corners([own[at] for at in best], number), own, number)
    if len(best) < 2 or _angle([own[at] for at in best], number) < _LEAST_ANGLE_DEG:
        return None
    corners = _corners([own[at] for at in best], number)
    edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return _Tag(number, edges, tuple(places[at] for at in best))


def _rays(view: _View, number: int) -> Floats:
    """Unproject the corners of a tag to rays (4, 3) with z = 1, in camera axes."""
    camera, pixels = view.camera, view.tags[number]
    x = (pixels[:, 0] - camera.cx) / camera.fx
    y = (pixels[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(4)], axis=1)


def _angle(views: Sequence[_View], number: int) -> float:
    """Compute the maximum triangulation angle at the centre of a tag, degrees."""
    rays = np.array([_rays(view, number).mean(axis=0) @ view.camera_from_world[:3, :3] for view in views])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return math.degrees(math.acos(float(np.clip((rays @ rays.T).min(), -1, 1))))


def _corners(views: Sequence[_View], number: int) -> Floats:
    """Triangulate the corners (4, 3) of a tag in world coordinates.

    Minimises the reprojection error by iteratively reweighted linear least squares.
    """
    turns = np.array([view.camera_from_world[:3, :3] for view in views])
    shifts = np.array([view.camera_from_world[:3, 3] for view in views])
    rays = np.array([_rays(view, number) for view in views])
    focal = np.array([view.camera.fx for view in views])
    # x − X / Z = 0 and y − Y / Z = 0, multiplied by Z: linear in the point. The residual is Z times the
    # reprojection error; the weights 1 / Z undo this.
    rows = rays[:, :, :2, None] * turns[:, None, 2:3] - turns[:, None, :2]
    right = shifts[:, None, :2] - rays[:, :, :2] * shifts[:, None, 2:3]
    corners = np.zeros((4, 3))
    weights = np.broadcast_to(focal[:, None], rays.shape[:2])
    for _ in range(_ROUNDS):
        for at in range(4):
            weight = np.repeat(weights[:, at], 2)
            corners[at] = np.linalg.lstsq(
                weight[:, None] * rows[:, at].reshape(-1, 3), weight * right[:, at].reshape(-1), rcond=None
            )[0]
        depth = np.einsum("nj,kj->nk", turns[:, 2], corners) + shifts[:, 2:3]
        weights = focal[:, None] / np.maximum(np.abs(depth), np.finfo(np.float64).tiny)
    return corners


def _agree(corners: Floats, views: Sequence[_View], number: int) -> list[int]:
    """Return the indices of the views in which all corners of a tag are inliers."""
    places = []
    for at, view in enumerate(views):
        seen = corners @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
        if (seen[:, 2] <= 0).any():
            continue
        focal = np.array((view.camera.fx, view.camera.fy))
        shown = seen[:, :2] / seen[:, 2:] * focal + (view.camera.cx, view.camera.cy)
        pixels = view.tags[number]
        edge = float(np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1).mean())
        if np.linalg.norm(shown - pixels, axis=1).max() < max(_OFF_SHARE * edge, _OFF_PX):
            places.append(at)
    return places


def _agreeing(tags: Sequence[_Tag], edge: float, folder: Path) -> list[_Tag]:
    """Return the tags of the most common size, with a warning about the rejected ones.

    Raises
    ------
    InputError
        If no tag is square, or at most half of the tags have the same size.
    """
    square = [tag for tag in tags if np.ptp(tag.edges) < 2 * _DISAGREE * tag.edges.mean()]
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
    same = np.abs(sizes / np.median(sizes) - 1) <= _DISAGREE
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
