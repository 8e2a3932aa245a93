"""A first look with all photos: how bright each is, how much they show where, and which are wrong."""

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

# Points of the surface that are looked at, beside the middle of every triangle.
_POINTS = 150_000
# A photo is wrong if it differs from the others by so many times what is usual, and so many levels, in the
# median of so many points at least.
_WRONG_TIMES, _WRONG_LEVELS, _WRONG_POINTS = 4.0, 25.0, 100
# Points whose place in photos is found at a time: bounds the memory.
_AT_ONCE = 500_000
# Of the median of all triangles: no triangle gets texels for more pixels than this.
_MOST_DENSITY = 3.0
# Of the median: what a triangle gets that no photo shows.
_UNSEEN_DENSITY = 0.25


@dataclass(frozen=True, eq=False)
class Survey:
    """What photos show of points all over a mesh.

    Attributes
    ----------
    views : (n, k) int32, the photos that show a point best; -1 for none.
    flat : (n,) whether these are so flat that none would be taken if there were a better one.
    colors : (n, k, 3) uint8, its levels there.
    radii2 : (n, k) squared distance from the middle of the photo, 1 in its corners.
    pixels_per_m : (m,) float32, of each triangle in the photo that shows it best; less where none does.
    seen : share of the surface that some photo shows.
    shown : of each photo, the parts of the drawn mesh that it may show.
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
    """Look at points all over a mesh with all photos.

    Parameters
    ----------
    drawn : the same mesh.
    normals : (n, 3) of the vertices.
    kept : photos that are kept of each point.
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
            "none of the {photos_count} photos shows the mesh: do poses and mesh belong together?",
            photos_count=len(photos),
        )
    flat = points.flat()
    straight, best = np.zeros((2, len(mesh.triangles)), np.float32)
    np.maximum.at(straight, of, np.where(flat, np.float32(0), points.density()))
    np.maximum.at(best, of, points.density())
    area = areas(mesh.vertices, mesh.triangles)
    is_seen = best > 0
    # Flat looks decide nothing for what is seen better.
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
    """Return the photos that show the mesh, and agree, how bright each is, and what parts it may show.

    Parameters
    ----------
    correct : find how bright photos are; else all count as equal.
    """
    views, colors, radii2 = surveyed.views, surveyed.colors, surveyed.radii2
    # Photos are compared by what they show well.
    compared = np.where(surveyed.flat[:, None], np.int32(-1), views)
    found = exposures(compared, colors, radii2, len(photos))
    unseen = np.bincount(views[views >= 0], minlength=len(photos)) == 0
    wrong = {
        int(i): TEXTURE_PHOTOS_MISMATCH.warning("its photo does not show the mesh.")
        for i in np.flatnonzero(unseen)
    }
    usual = max(float(np.median(found.differences[~unseen])), 1.0)
    off = (found.differences > max(_WRONG_TIMES * usual, _WRONG_LEVELS)) & (found.samples >= _WRONG_POINTS)
    wrong |= {
        int(i): TEXTURE_PHOTOS_INCONSISTENT.warning(
            "its photo shows something else than the others: {levels:.0f} levels difference in the median.",
            levels=float(found.differences[i]),
        )
        for i in np.flatnonzero(off & ~unseen)
    }
    if wrong:
        # What they show must not count for the others.
        compared = np.where(np.isin(compared, list(wrong)), np.int32(-1), compared)
        found = exposures(compared, colors, radii2, len(photos))
    if not correct:
        found = found.none()
    shown = [parts for number, parts in enumerate(surveyed.shown) if number not in wrong]
    return photos.without(wrong), found.without(wrong), shown


def _points(mesh: Mesh) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Return points all over the surface, one a triangle at least: triangles, and shares of corners."""
    area = areas(mesh.vertices, mesh.triangles)
    counts = 1 + np.floor(area / area.sum() * _POINTS).astype(np.int64)
    of = np.repeat(np.arange(len(area), dtype=np.uint32), counts)
    # Chosen by chance, but the same each time: a lattice could miss what is regular.
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
    """Return the squared distance of samples (n, k) from the middle of their photos, 1 in the corners."""
    radii2 = np.empty(views.shape, np.float32)
    for start in range(0, len(of), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        corners = mesh.vertices[mesh.triangles[of[rows]]]
        places = np.einsum("nc,ncx->nx", shares[rows].astype(np.float64), corners)
        radii2[rows] = _radii2_at(places, views[rows], photos)
    return radii2


def _radii2_at(places: Floats, views: NDArray[np.int32], photos: Photos) -> NDArray[np.float32]:
    """Return it for samples (n, k) of points that lie at these places (n, 3)."""
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
