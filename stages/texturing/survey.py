"""Survey of all photos: visibility, resolution and exposure, and rejection of bad photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.comparing.codes import TEXTURE_PHOTOS_MISMATCH
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import areas
from scanloom.stages.texturing.codes import TEXTURE_PHOTOS_INCONSISTENT
from scanloom.stages.texturing.exposure import Exposures, exposures, no_exposure
from scanloom.stages.texturing.photos import Photos
from scanloom.stages.texturing.views import DrawnMesh, see

Floats = NDArray[np.float64]

# Points sampled on the surface by area, in addition to the centre of every triangle.
_POINTS = 150_000
# A photo is rejected if its median difference exceeds both limits (a multiple of the usual difference, and a
# number of levels), over a minimum number of points.
_WRONG_TIMES, _WRONG_LEVELS, _WRONG_POINTS = 4.0, 25.0, 100
# Points projected per batch: bounds memory.
_AT_ONCE = 500_000
# Maximum density of a triangle relative to the median of all triangles.
_MOST_DENSITY = 3.0
# Density of a triangle that no photo shows, relative to the median.
_UNSEEN_DENSITY = 0.25


@dataclass(frozen=True, eq=False)
class Survey:
    """Photo samples of points distributed over a mesh.

    Attributes
    ----------
    views : (n, k) int32, the photos that show a point best; -1 for none.
    flat : (n,) bool, the point is seen only at grazing angles.
    colors : (n, k, 3) uint8, levels of each sample.
    radii2 : (n, k) squared distance from the centre of the photo, 1 in its corners.
    pixels_per_m : (m,) float32, resolution of each triangle in its best photo, limited; low where no photo
        shows it.
    seen : ratio of the surface area that at least one photo shows.
    shown : for each photo, the parts of the mesh that it may show.
    """

    views: NDArray[np.int32]
    flat: NDArray[np.bool_]
    colors: NDArray[np.uint8]
    radii2: NDArray[np.float32]
    pixels_per_m: NDArray[np.float32]
    seen: float
    shown: Sequence[NDArray[np.uint32]]


def survey(
    mesh: Mesh,
    drawn: DrawnMesh,
    normals: Floats,
    photos: Photos,
    kept: int,
    progress: Callable[[], object],
) -> Survey:
    """Sample points all over a mesh in all photos.

    Parameters
    ----------
    mesh : surface to be textured.
    drawn : the same mesh, prepared for rendering.
    normals : (n, 3) vertex normals.
    photos : usable photos.
    kept : maximum number of photos kept per point.
    progress : called after each photo.

    Raises
    ------
    InputError
        If no photo shows the mesh.
    """
    of, shares = _points(mesh)
    points = _kernels.SurfacePoints(mesh.vertices, normals, mesh.triangles, of, shares, kept=kept)
    none = [no_exposure()] * len(photos)
    shown = see(points, drawn, photos, none, None, progress, is_blended=False)
    views, colors = points.samples()[:2]
    if (views < 0).all():
        raise InputError(
            TEXTURE_PHOTOS_MISMATCH,
            "none of the {photos_count} photos shows the mesh: poses and mesh have different coordinates.",
            photos_count=len(photos),
        )
    flat = points.flat()
    straight, best = np.zeros((2, len(mesh.triangles)), np.float32)
    np.maximum.at(straight, of, np.where(flat, np.float32(0), points.density()))
    np.maximum.at(best, of, points.density())
    area = areas(mesh.vertices, mesh.triangles)
    is_seen = best > 0
    # Grazing views determine the density only of triangles that have no better view.
    best = np.where(straight > 0, straight, best)
    middle = float(np.median(straight[straight > 0] if straight.any() else best[is_seen]))
    wanted = np.where(is_seen, np.minimum(best, _MOST_DENSITY * middle), _UNSEEN_DENSITY * middle)
    return Survey(
        views=views,
        flat=flat,
        colors=colors,
        radii2=_radii2(mesh, of, shares, views, photos),
        pixels_per_m=wanted.astype(np.float32),
        seen=float(area[is_seen].sum() / area.sum()),
        shown=shown,
    )


def judged(
    surveyed: Survey, photos: Photos, correct: bool
) -> tuple[Photos, Exposures, list[NDArray[np.uint32]]]:
    """Reject photos that contradict the others or do not show the mesh.

    Parameters
    ----------
    surveyed : result of `survey`.
    photos : photos of the survey.
    correct : estimate exposures; if False, all photos get the identity.

    Returns
    -------
    The accepted photos, their exposures, and the mesh parts that each may show.
    """
    views, colors, radii2 = surveyed.views, surveyed.colors, surveyed.radii2
    # Grazing views are too inaccurate for a comparison of photos.
    compared = np.where(surveyed.flat[:, None], np.int32(-1), views)
    found = exposures(compared, colors, radii2, len(photos))
    unseen = np.bincount(views[views >= 0], minlength=len(photos)) == 0
    wrong = {
        int(i): TEXTURE_PHOTOS_MISMATCH.warning("the photo does not show the mesh.")
        for i in np.flatnonzero(unseen)
    }
    usual = max(float(np.median(found.differences[~unseen])), 1.0)
    off = (found.differences > max(_WRONG_TIMES * usual, _WRONG_LEVELS)) & (found.samples >= _WRONG_POINTS)
    wrong |= {
        int(i): TEXTURE_PHOTOS_INCONSISTENT.warning(
            "the photo contradicts the others: the median difference is {levels:.0f} levels.",
            levels=float(found.differences[i]),
        )
        for i in np.flatnonzero(off & ~unseen)
    }
    if wrong:
        # Fit again without the rejected photos, which have distorted the means.
        compared = np.where(np.isin(compared, list(wrong)), np.int32(-1), compared)
        found = exposures(compared, colors, radii2, len(photos))
    if not correct:
        found = found.none()
    shown = [parts for number, parts in enumerate(surveyed.shown) if number not in wrong]
    return photos.without(wrong), found.without(wrong), shown


def _points(mesh: Mesh) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Sample points on the surface, at least one per triangle.

    Returns
    -------
    Triangle of each point (n,) and barycentric weights (n, 3).
    """
    area = areas(mesh.vertices, mesh.triangles)
    counts = 1 + np.floor(area / area.sum() * _POINTS).astype(np.int64)
    of = np.repeat(np.arange(len(area), dtype=np.uint32), counts)
    # Random but reproducible: a regular pattern could alias with regular structures.
    shares = np.random.RandomState(0).dirichlet((1, 1, 1), len(of)).astype(np.float32)
    shares[np.cumsum(counts) - counts] = 1 / 3
    return of, shares


def _radii2(
    mesh: Mesh,
    of: NDArray[np.uint32],
    shares: NDArray[np.float32],
    views: NDArray[np.int32],
    photos: Photos,
) -> NDArray[np.float32]:
    """Compute the squared photo radius of samples (n, k); 1 in the corners."""
    radii2 = np.empty(views.shape, np.float32)
    for start in range(0, len(of), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        corners = mesh.vertices[mesh.triangles[of[rows]]]
        places = np.einsum("nc,ncx->nx", shares[rows].astype(np.float64), corners)
        radii2[rows] = _radii2_at(places, views[rows], photos)
    return radii2


def _radii2_at(places: Floats, views: NDArray[np.int32], photos: Photos) -> NDArray[np.float32]:
    """Compute the squared photo radius of samples (n, k) of points (n, 3)."""
    radii2 = np.zeros(views.shape, np.float32)
    order = np.argsort(views, axis=None, kind="stable")
    bounds = np.searchsorted(views.ravel()[order], np.arange(len(photos) + 1))
    for number in np.flatnonzero(np.diff(bounds)):
        chosen = order[bounds[number] : bounds[number + 1]]
        camera, pose = photos.cameras[number], photos.poses[number]
        seen = places[chosen // views.shape[1]] @ pose[:3, :3].T + pose[:3, 3]
        x = (camera.fx * seen[:, 0] / seen[:, 2] + camera.cx) / (camera.width - 1) * 2 - 1
        y = (camera.fy * seen[:, 1] / seen[:, 2] + camera.cy) / (camera.height - 1) * 2 - 1
        aspect = camera.height / camera.width
        radii2.ravel()[chosen] = (x**2 + (aspect * y) ** 2) / (1 + aspect**2)
    return radii2
