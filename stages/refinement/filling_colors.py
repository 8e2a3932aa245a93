"""Colours of filled holes, from the photos that show them.

1. Choose photos, so that each vertex of a filling is in a few of them.
2. Sample the photos at the vertices that they show from the front, unoccluded.
3. The colours of the mesh are means of more photos, and photos differ in exposure. The difference at the rim
   is continued smoothly over the filling. Source: seamless cloning, Pérez, Gangnet and Blake, "Poisson image
   editing", 2003.
4. Vertices that no photo shows are interpolated from the others and from the rim.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.frames.projection import project
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.scan import Frame, to_pinhole
from scanloom.stages.surface.cap_fairing import interpolate_values
from scanloom.stages.surface.edges import Ids, label_components
from scanloom.stages.surface.mesh import Colors, Mesh, Triangles
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.texturing.exposure import make_identity_exposure
from scanloom.stages.texturing.photo_sampling import prepare_render_mesh, sample_photos
from scanloom.stages.texturing.photos import compute_photo_pose, load_photos

Floats = NDArray[np.float64]

# Number of photos that are wanted for each vertex.
_VIEWS_PER_VERTEX = 4
# Photos are chosen a second time for vertices that the chosen ones turn out not to show.
_MAX_ROUNDS = 2
# Photos are chosen for at most this many vertices, evenly distributed: limits memory.
_MAX_CHOICE_VERTICES = 5000
# Minimum cosine of the viewing angle of a chosen photo (75°), and minimum rating: a third of the resolution
# of the best photo.
_MIN_COSINE, _MIN_RATING = 0.26, 10
# Samples that differ from their median by more than both limits are ignored, in deviations and in levels.
_OUTLIER_DEVIATIONS, _OUTLIER_LEVELS = 5.0, 12.0


class _Samples(NamedTuple):
    """Colours of photos at vertices.

    Attributes
    ----------
    vertices : (n,) vertices of the mesh, in any order.
    colors : (n, 3) levels.
    is_seen : (n,) False if no photo shows the vertex.
    """

    vertices: Ids
    colors: Floats
    is_seen: NDArray[np.bool_]


def color_fillings(
    mesh: Mesh,
    is_filled: NDArray[np.bool_],
    frames: Sequence[Frame],
    progress: Callable[[int], object] = lambda _: None,
) -> Colors | None:
    """Compute the colours (n, 3) of a mesh with filled holes.

    Only the colours of filled vertices change. Photos that cannot be read are ignored.

    Parameters
    ----------
    mesh : mesh with colours at the rims; colours of filled vertices are not used.
    is_filled : (n,) True for the vertices inside of filled holes.
    frames : frames of the scan. Those without photo or pose are ignored.
    progress : called with the number of photos done.

    Returns
    -------
    None for a mesh without colours.
    """
    if mesh.colors is None or not is_filled.any():
        return mesh.colors
    posed = [frame for frame in frames if frame.color is not None and frame.world_from_camera is not None]
    (triangle_ids,) = np.nonzero(is_filled[mesh.triangles].any(axis=1))
    if posed:
        samples = _sample_photos(mesh, triangle_ids, posed, progress)
    else:
        vertices = np.unique(mesh.triangles[triangle_ids])
        samples = _Samples(vertices, np.zeros((len(vertices), 3)), np.zeros(len(vertices), bool))
    return _blend_with_rim(mesh, mesh.triangles[triangle_ids], samples, is_filled)


def _sample_photos(
    mesh: Mesh, triangle_ids: Ids, frames: Sequence[Frame], progress: Callable[[int], object]
) -> _Samples:
    """Sample photos at the vertices of some triangles."""
    corners = mesh.triangles[triangle_ids].reshape(-1)
    vertices, first = np.unique(corners, return_index=True)
    # The kernel wants points in the order of their triangles.
    order = np.argsort(first, kind="stable")
    vertices, first = vertices[order], first[order]
    normals = compute_vertex_normals(mesh)
    points = _kernels.SurfacePoints(
        mesh.vertices,
        normals,
        mesh.triangles,
        triangle_ids[first // 3].astype(np.uint32),
        np.eye(3, dtype=np.float32)[first % 3],
        samples_per_point=_VIEWS_PER_VERTEX,
    )
    step = -(-len(vertices) // _MAX_CHOICE_VERTICES)
    ratings = _rate_photos(mesh.vertices[vertices[::step]], normals[vertices[::step]], frames)
    render_mesh = prepare_render_mesh(mesh)
    done = 0

    def report_photo() -> None:
        nonlocal done
        done += 1
        progress(done)

    for _ in range(_MAX_ROUNDS):
        is_missing = (points.samples()[0][::step] < 0).all(axis=1)
        chosen = _choose_photos(ratings[:, is_missing])
        if not chosen:
            break
        photos = load_photos([frames[number] for number in chosen], ignore_progress)
        if len(photos):
            exposures = [make_identity_exposure()] * len(photos)
            sample_photos(points, render_mesh, photos, exposures, None, report_photo, is_blended=False)
        # No photo is used twice.
        ratings[chosen] = 0
    colors, labels, _ = points.blend(
        blurred=1, details=1, deviations=_OUTLIER_DEVIATIONS, levels=_OUTLIER_LEVELS, wanted_threads=0
    )
    return _Samples(vertices, colors.astype(np.float64), labels >= 0)


def _rate_photos(points: Floats, normals: Floats, frames: Sequence[Frame]) -> NDArray[np.int16]:
    """Rate the photos of frames by the resolution at which they may show points, without occlusion.

    Returns
    -------
    Ratings (f, n) from 0 to 100, the best photo of each point.
    """
    scores = np.zeros((len(frames), len(points)), np.float32)
    for number, frame in enumerate(frames):
        camera = to_pinhole(frame.color_camera or frame.camera)
        pose = compute_photo_pose(frame)
        seen = points @ pose[:3, :3].T + pose[:3, 3]
        columns, rows = project(seen, camera)
        squares = (seen * seen).sum(axis=1)
        cosines = -(seen * (normals @ pose[:3, :3].T)).sum(axis=1) / np.sqrt(squares)
        with np.errstate(invalid="ignore"):
            is_inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        shown = is_inside & (cosines > _MIN_COSINE)
        scores[number, shown] = (cosines * camera.fx * camera.fy / squares)[shown]
    ratings = np.rint(100 * scores / np.maximum(scores.max(axis=0), np.finfo(np.float32).tiny))
    return np.where(ratings < _MIN_RATING, 0, ratings).astype(np.int16)


def _choose_photos(ratings: NDArray[np.int16]) -> list[int]:
    """Choose few photos that show every point several times, if possible.

    Parameters
    ----------
    ratings : (f, n) rating of each photo for each point; 0 if it does not show the point.

    Returns
    -------
    Indices of the photos, ascending.
    """
    gains = ratings.sum(axis=1, dtype=np.int64)
    missing = np.full(ratings.shape[1], _VIEWS_PER_VERTEX)
    is_left = np.ones(len(ratings), bool)
    while (gains * is_left).any():
        best = int((gains * is_left).argmax())
        is_left[best] = False
        shown = ratings[best] > 0
        missing[shown] -= 1
        # Points with enough photos need no more.
        gains -= ratings[:, shown & (missing == 0)].sum(axis=1, dtype=np.int64)
    return [number for number, left in enumerate(is_left) if not left]


def _blend_with_rim(
    mesh: Mesh, triangles: Triangles, samples: _Samples, is_filled: NDArray[np.bool_]
) -> Colors:
    """Return the colours of the mesh, with photo colours in fillings.

    Parameters
    ----------
    triangles : triangles of the fillings.
    """
    assert mesh.colors is not None
    vertices, sampled, is_seen = samples
    rows = np.empty(len(mesh.vertices), np.int32)
    rows[vertices] = np.arange(len(vertices))
    corners, points = rows[triangles], mesh.vertices[vertices]
    values = mesh.colors[vertices].astype(np.float64)
    inside = is_filled[vertices]
    if is_seen.any():
        differences = _continue_differences(points, corners, values - sampled, inside, is_seen)
        values[inside & is_seen] = (sampled + differences)[inside & is_seen]
    (free,) = np.nonzero(inside & ~is_seen)
    if len(free):
        values[free] = interpolate_values(points, corners, free, values)
    colors: Colors = mesh.colors.copy()
    colors[vertices[inside]] = np.rint(values[inside]).clip(0, 255).astype(np.uint8)
    return colors


def _continue_differences(
    points: Floats,
    triangles: Triangles,
    differences: Floats,
    inside: NDArray[np.bool_],
    is_seen: NDArray[np.bool_],
) -> Floats:
    """Continue the differences (n, 3) of mesh and photos from the rims over the fillings.

    Parameters
    ----------
    points : (n, 3) vertices of the fillings and of their rims, metres.
    triangles : (m, 3) triangles of the fillings.
    differences : (n, 3) levels, used at rim vertices that a photo shows.
    inside : (n,) False for rim vertices.
    is_seen : (n,) True for vertices that a photo shows.
    """
    is_known = is_seen & ~inside
    _, holes = label_components(
        len(points), triangles[:, [0, 1]].reshape(-1), triangles[:, [1, 2]].reshape(-1)
    )
    # At the other rim vertices, the difference is the mean of the hole.
    counts = np.bincount(holes[is_known], minlength=holes.max() + 1)
    sums = np.stack(
        [np.bincount(holes[is_known], one[is_known], len(counts)) for one in differences.T], axis=1
    )
    continued = np.where(is_known[:, None], differences, (sums / np.maximum(counts, 1)[:, None])[holes])
    (free,) = np.nonzero(inside)
    continued[free] = interpolate_values(points, triangles, free, continued)
    return continued
