"""Motion of a turning plate, from marks on it seen from above.

Marks look alike, and steps may be too large for feature matching. Here only the distances between dots,
corners or letters must stay equal. The plate can only rotate about its normal and shift in its plane.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.projection import project
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, to_pinhole

Floats = NDArray[np.float64]

# RANSAC trials for a plane; maximum distance of an inlier, relative to its depth; minimum inliers, as ratio
# of all points and as count.
_TRIALS, _INLIER_RATIO, _MIN_PLANE_RATIO, _MIN_PLANE_POINTS = 400, 0.008, 0.1, 100
# Maximum number of candidate planes: plate, table, wall.
_MAX_PLATES = 3
# Maximum number of points for plane RANSAC; more do not improve the result.
_MAX_SAMPLE_POINTS = 6000
# Side of the top view, pixels; contrast and edge thresholds of SIFT for marks; maximum number of marks.
_TOP_VIEW_PX, _CONTRAST, _EDGE_THRESHOLD = 560, 0.03, 5.0
_MAX_MARKS = 60
# A mark that stays in place in more than this ratio of the other frames is on the table, not on the plate.
_MAX_STATIC_RATIO = 0.4
# Maximum distance between coinciding marks, relative to the distance of the plate.
_TOLERANCE_RATIO = 0.006
# Minimum distance between two marks that determine a rotation, in the same unit.
_MIN_DISTANCE_RATIO = 0.08
# Minimum number of coinciding marks; minimum ratio to the marks of any other rotation, which differs by more
# than the last value, radians. Then the maximum number of candidate motions.
_MIN_MARKS, _MIN_LEAD_FACTOR, _OTHER_ROTATION_RAD = 5, 1.4, np.radians(5)
_MAX_CANDIDATES = 6_000


@dataclass(frozen=True, eq=False)
class Plate:
    """Plane that supports an object, with the square region of its top view.

    Attributes
    ----------
    origin : (3,) centre of the square, metres, camera axes.
    axes : (3, 3) columns: two axes in the plane, and the normal towards the camera.
    side_m : side of the square, metres.
    """

    origin: Floats
    axes: Floats
    side_m: float

    @property
    def mark_tolerance_m(self) -> float:
        """Return the maximum distance between coinciding marks, metres."""
        return _TOLERANCE_RATIO * self.distance_m

    @property
    def distance_m(self) -> float:
        """Return the distance from the camera to the origin, metres."""
        return float(np.linalg.norm(self.origin))

    def compute_motion(self, angle: float, shift: Floats) -> Pose:
        """Compute the motion (4, 4) of a rotation about the origin and a shift.

        Parameters
        ----------
        angle : rotation about the normal, radians.
        shift : (2,) translation in the plane, metres.
        """
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = self.axes @ np.array(((cosine, -sine, 0), (sine, cosine, 0), (0, 0, 1))) @ self.axes.T
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = self.origin + self.axes[:, :2] @ shift - turn @ self.origin
        return pose


@dataclass(frozen=True, eq=False)
class PlateMotion:
    """Motion of a plate, target_from_source (4, 4), with the number of coinciding marks."""

    target_from_source: Pose
    mark_count: int


def detect_plates(points: Floats) -> Iterator[Plate]:
    """Detect planes in points (n, 3), the largest first.

    The plate need not be the largest plane, because it is usually on a table.
    """
    draw = np.random.default_rng(0)
    if len(points) > _MAX_SAMPLE_POINTS:
        points = points[draw.choice(len(points), _MAX_SAMPLE_POINTS, replace=False)]
    least = max(_MIN_PLANE_RATIO * len(points), _MIN_PLANE_POINTS)
    for _ in range(_MAX_PLATES):
        plate = _fit_plate(points, draw) if len(points) >= least else None
        if plate is None:
            return
        off = np.abs((points - plate.origin) @ plate.axes[:, 2])
        on = off < _INLIER_RATIO * plate.distance_m
        if np.count_nonzero(on) < least:
            return
        yield plate
        points = points[~on]


def _fit_plate(points: Floats, draw: np.random.Generator) -> Plate | None:
    near = _INLIER_RATIO * float(np.median(points[:, 2]))
    corners = points[draw.integers(0, len(points), (_TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    corners, normals = corners[lengths > 0, 0], normals[lengths > 0] / lengths[lengths > 0, None]
    if len(normals) == 0:
        return None
    counts = [
        int(np.count_nonzero(np.abs((points - corner) @ normal) < near))
        for corner, normal in zip(corners, normals, strict=True)
    ]
    origin, normal = corners[int(np.argmax(counts))], normals[int(np.argmax(counts))]
    for _ in range(3):
        on = points[np.abs((points - origin) @ normal) < near]
        origin = on.mean(axis=0)
        normal = np.linalg.svd(on - origin, full_matrices=False)[2][2]
    on = points[np.abs((points - origin) @ normal) < near]
    normal = -normal if normal @ origin > 0 else normal
    along = np.cross(normal, (0.0, 0.0, 1.0) if abs(normal[2]) < 0.9 else (0.0, 1.0, 0.0))
    along /= np.linalg.norm(along)
    axes = np.stack([along, np.cross(normal, along), normal], axis=1)
    flat = (on - origin) @ axes[:, :2]
    low, high = np.percentile(flat, (1, 99), axis=0)
    middle = origin + axes[:, :2] @ ((low + high) / 2)
    return Plate(middle, axes, 1.2 * float((high - low).max()))


def detect_marks(frame: Frame, plate: Plate) -> Floats:
    """Detect marks on a plate, in the top view of a frame.

    Returns positions (n, 2) in the plane, metres from its origin.
    """
    import cv2

    depth = read_depth(frame)
    assert depth is not None
    color = read_color_aligned_to_depth(frame, depth)
    camera = to_pinhole(frame.camera)
    pixels, z = _project_top_view(plate, camera)
    across, down = pixels[..., 0], pixels[..., 1]
    grey = cv2.remap(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), across, down, cv2.INTER_LINEAR)
    there = cv2.remap(depth, across, down, cv2.INTER_NEAREST)
    bare = (np.abs(there - z) < _INLIER_RATIO * z).astype(np.uint8)
    bare = cv2.erode(cv2.morphologyEx(bare, cv2.MORPH_CLOSE, np.ones((9, 9))), np.ones((5, 5)))
    sift = cv2.SIFT.create(nfeatures=0, contrastThreshold=_CONTRAST, edgeThreshold=_EDGE_THRESHOLD)
    found = sorted(sift.detect(np.asarray(grey, np.uint8), bare), key=lambda one: -one.response)
    places = np.array([one.pt for one in found], np.float64).reshape(-1, 2)
    # SIFT may detect the same mark at several scales.
    _, first = np.unique(np.round(places / 3), axis=0, return_index=True)
    places = places[np.sort(first)][:_MAX_MARKS]
    return np.asarray((places + 0.5) * (plate.side_m / _TOP_VIEW_PX) - plate.side_m / 2)


def drop_static_marks(marks: Mapping[int, Floats], plate: Plate) -> dict[int, Floats]:
    """Drop marks that stay in place, because they are on the table."""
    from scipy.spatial import cKDTree

    trees = {n: cKDTree(places) for n, places in marks.items() if len(places)}
    found = {}
    for n, places in marks.items():
        others = [tree for other, tree in trees.items() if other != n]
        stays = np.zeros(len(places))
        for tree in others:
            stays += tree.query(places)[0] < plate.mark_tolerance_m / 2 if len(places) else 0
        found[n] = places[stays <= _MAX_STATIC_RATIO * len(others)]
    return found


def _project_top_view(plate: Plate, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Project the pixels of the top view into the camera.

    Returns
    -------
    Pixels of the camera (s, s, 2), and depth (s, s), metres.
    """
    steps = (np.arange(_TOP_VIEW_PX) + 0.5) * (plate.side_m / _TOP_VIEW_PX) - plate.side_m / 2
    x, y = np.meshgrid(steps, steps)
    points = plate.origin + x[..., None] * plate.axes[:, 0] + y[..., None] * plate.axes[:, 1]
    z = np.where(points[..., 2] > 0, points[..., 2], np.inf)
    pixels = np.stack(project(points, camera), axis=-1)
    # Points behind the camera have no pixel; they are moved outside the image.
    pixels[~np.isfinite(z)] = -1e4
    return pixels.clip(-1e4, 1e5).astype(np.float32), z.astype(np.float32)


def estimate_plate_motion(source: Floats, target: Floats, plate: Plate) -> PlateMotion | None:
    """Estimate the motion with most coinciding marks; None if it is ambiguous.

    Parameters
    ----------
    source, target : (n, 2) and (m, 2) positions of marks, see `detect_marks`.
    """
    from scipy.spatial import cKDTree

    turns = _list_candidate_motions(source, target, plate)
    if len(turns) == 0:
        return None
    tree = cKDTree(target)

    def move_marks(angles: Floats, shifts: Floats) -> Floats:
        cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
        x = cosine * source[:, 0] - sine * source[:, 1] + shifts[:, :1]
        y = sine * source[:, 0] + cosine * source[:, 1] + shifts[:, 1:]
        return np.stack([x, y], axis=-1)

    places = move_marks(turns[:, 0], turns[:, 1:])
    off = tree.query(places.reshape(-1, 2))[0].reshape(places.shape[:2])
    counts = (off < plate.mark_tolerance_m).sum(axis=1)
    best = int(np.argmax(counts))
    apart = np.abs((turns[:, 0] - turns[best, 0] + np.pi) % (2 * np.pi) - np.pi) > _OTHER_ROTATION_RAD
    second = int(counts[apart].max()) if apart.any() else 0
    if counts[best] < max(_MIN_MARKS, _MIN_LEAD_FACTOR * second):
        return None
    angle, shift = float(turns[best, 0]), turns[best, 1:]
    for _ in range(3):
        distance, nearest = tree.query(move_marks(np.array([angle]), shift[None])[0])
        agree = distance < plate.mark_tolerance_m
        angle, shift = _fit_rotation_and_shift(source[agree], target[nearest[agree]])
    return PlateMotion(plate.compute_motion(angle, shift), int(np.count_nonzero(agree)))


def _list_candidate_motions(source: Floats, target: Floats, plate: Plate) -> Floats:
    """List candidate motions that map two marks to two others.

    Returns (n, 3): an angle in radians and a shift in metres, for pairs of marks with equal distances.
    """
    if min(len(source), len(target)) < _MIN_MARKS:
        return np.zeros((0, 3))
    least = _MIN_DISTANCE_RATIO * plate.distance_m
    lengths = np.linalg.norm(source[:, None] - source, axis=2)
    others = np.linalg.norm(target[:, None] - target, axis=2)
    a, b = np.nonzero(np.triu(lengths > least))
    c, d = np.nonzero(others > least)
    couple, there = np.nonzero(np.abs(lengths[a, b][:, None] - others[c, d]) < plate.mark_tolerance_m)
    if len(couple) > _MAX_CANDIDATES:
        chosen = np.random.default_rng(0).choice(len(couple), _MAX_CANDIDATES, replace=False)
        couple, there = couple[chosen], there[chosen]
    way, other = source[b] - source[a], target[d] - target[c]
    angles = np.arctan2(other[there, 1], other[there, 0]) - np.arctan2(way[couple, 1], way[couple, 0])
    cosine, sine = np.cos(angles), np.sin(angles)
    x, y = ((source[a] + source[b]) / 2)[couple].T
    middle = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
    return np.column_stack([angles, ((target[c] + target[d]) / 2)[there] - middle])


def _fit_rotation_and_shift(source: Floats, target: Floats) -> tuple[float, Floats]:
    """Fit rotation angle and shift (2,) between points of a plane (least squares)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    angle = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = np.array(((cosine, -sine), (sine, cosine))) @ source.mean(axis=0)
    return angle, target.mean(axis=0) - turned
