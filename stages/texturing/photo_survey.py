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
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.codes import TEXTURE_PHOTOS_INCONSISTENT
from scanloom.stages.texturing.exposure import Exposures, estimate_exposures, make_identity_exposure
from scanloom.stages.texturing.photo_sampling import RenderMesh, sample_photos
from scanloom.stages.texturing.photos import Photos

Floats = NDArray[np.float64]

# Points sampled on the surface by area, in addition to the centre of every triangle.
_SAMPLE_POINTS = 150_000
# A photo is rejected if its median difference exceeds both limits (a multiple of the usual difference, and a
# number of levels), over a minimum number of points.
_REJECT_FACTOR, _REJECT_LEVELS, _REJECT_MIN_POINTS = 4.0, 25.0, 100
# Points projected per batch: bounds memory.
_BATCH_POINTS = 500_000
# Maximum density of a triangle relative to the median of all triangles.
_MAX_DENSITY_RATIO = 3.0
# Density of a triangle that no photo shows, relative to the median.
_UNSEEN_DENSITY_RATIO = 0.25


@dataclass(frozen=True, eq=False)
class PhotoSurvey:
    """Photo samples of points distributed over a mesh.

    Attributes
    ----------
    views : (n, k) int32, the photos that show a point best; -1 for none.
    is_grazing : (n,) bool, the point is seen only at grazing angles.
    colors : (n, k, 3) uint8, levels of each sample.
    radii2 : (n, k) squared distance from the centre of the photo, 1 in its corners.
    pixels_per_m : (m,) float32, resolution of each triangle in its best photo, limited; low where no photo
        shows it.
    coverage_ratio : ratio of the surface area that at least one photo shows.
    visible_parts : for each photo, the parts of the mesh that it may show.
    """

    views: NDArray[np.int32]
    is_grazing: NDArray[np.bool_]
    colors: NDArray[np.uint8]
    radii2: NDArray[np.float32]
    pixels_per_m: NDArray[np.float32]
    coverage_ratio: float
    visible_parts: Sequence[NDArray[np.uint32]]


def survey_photos(
    mesh: Mesh,
    render_mesh: RenderMesh,
    normals: Floats,
    photos: Photos,
    max_views: int,
    progress: Callable[[], object],
) -> PhotoSurvey:
    """Sample points all over a mesh in all photos.

    Parameters
    ----------
    mesh : surface to be textured.
    render_mesh : the same mesh, prepared for rendering.
    normals : (n, 3) vertex normals.
    photos : usable photos.
    max_views : maximum number of photos kept per point.
    progress : called after each photo.

    Raises
    ------
    InputError
        If no photo shows the mesh.
    """
    triangle_ids, weights = _sample_points(mesh)
    points = _kernels.SurfacePoints(
        mesh.vertices, normals, mesh.triangles, triangle_ids, weights, samples_per_point=max_views
    )
    identities = [make_identity_exposure()] * len(photos)
    visible_parts = sample_photos(points, render_mesh, photos, identities, None, progress, is_blended=False)
    views, colors = points.samples()[:2]
    if (views < 0).all():
        raise InputError(
            TEXTURE_PHOTOS_MISMATCH,
            "none of the {photos_count} photos shows the mesh: poses and mesh have different coordinates.",
            photos_count=len(photos),
        )
    flat = points.grazing_mask()
    direct_density, best_density = np.zeros((2, len(mesh.triangles)), np.float32)
    np.maximum.at(direct_density, triangle_ids, np.where(flat, np.float32(0), points.density()))
    np.maximum.at(best_density, triangle_ids, points.density())
    area = compute_areas(mesh.vertices, mesh.triangles)
    is_seen = best_density > 0
    # Grazing views determine the density only of triangles that have no better view.
    best_density = np.where(direct_density > 0, direct_density, best_density)
    median_density = float(
        np.median(direct_density[direct_density > 0] if direct_density.any() else best_density[is_seen])
    )
    requested_density = np.where(
        is_seen,
        np.minimum(best_density, _MAX_DENSITY_RATIO * median_density),
        _UNSEEN_DENSITY_RATIO * median_density,
    )
    return PhotoSurvey(
        views=views,
        is_grazing=flat,
        colors=colors,
        radii2=_compute_squared_radii(mesh, triangle_ids, weights, views, photos),
        pixels_per_m=requested_density.astype(np.float32),
        coverage_ratio=float(area[is_seen].sum() / area.sum()),
        visible_parts=visible_parts,
    )


def reject_inconsistent_photos(
    photo_survey: PhotoSurvey, photos: Photos, corrects_exposure: bool
) -> tuple[Photos, Exposures, list[NDArray[np.uint32]]]:
    """Reject photos that contradict the others or do not show the mesh.

    Parameters
    ----------
    photo_survey : result of `survey_photos`.
    photos : photos of the survey.
    corrects_exposure : estimate exposures; if False, all photos get the identity.

    Returns
    -------
    The accepted photos, their exposures, and the mesh parts that each may show.
    """
    views, colors, radii2 = photo_survey.views, photo_survey.colors, photo_survey.radii2
    # Grazing views are too inaccurate for a comparison of photos.
    compared = np.where(photo_survey.is_grazing[:, None], np.int32(-1), views)
    exposures_found = estimate_exposures(compared, colors, radii2, len(photos))
    is_unseen = np.bincount(views[views >= 0], minlength=len(photos)) == 0
    rejected = {
        int(i): TEXTURE_PHOTOS_MISMATCH.warning("the photo does not show the mesh.")
        for i in np.flatnonzero(is_unseen)
    }
    usual_difference = max(float(np.median(exposures_found.differences[~is_unseen])), 1.0)
    is_outlier = (exposures_found.differences > max(_REJECT_FACTOR * usual_difference, _REJECT_LEVELS)) & (
        exposures_found.samples >= _REJECT_MIN_POINTS
    )
    rejected |= {
        int(i): TEXTURE_PHOTOS_INCONSISTENT.warning(
            "the photo contradicts the others: the median difference is {levels:.0f} levels.",
            levels=float(exposures_found.differences[i]),
        )
        for i in np.flatnonzero(is_outlier & ~is_unseen)
    }
    if rejected:
        # Fit again without the rejected photos, which have distorted the means.
        compared = np.where(np.isin(compared, list(rejected)), np.int32(-1), compared)
        exposures_found = estimate_exposures(compared, colors, radii2, len(photos))
    if not corrects_exposure:
        exposures_found = exposures_found.reset_corrections()
    visible_parts = [
        parts for number, parts in enumerate(photo_survey.visible_parts) if number not in rejected
    ]
    return photos.drop_photos(rejected), exposures_found.drop_photos(rejected), visible_parts


def _sample_points(mesh: Mesh) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Sample points on the surface, at least one per triangle.

    Returns
    -------
    Triangle of each point (n,) and barycentric weights (n, 3).
    """
    area = compute_areas(mesh.vertices, mesh.triangles)
    counts = 1 + np.floor(area / area.sum() * _SAMPLE_POINTS).astype(np.int64)
    of = np.repeat(np.arange(len(area), dtype=np.uint32), counts)
    # Random but reproducible: a regular pattern could alias with regular structures.
    shares = np.random.RandomState(0).dirichlet((1, 1, 1), len(of)).astype(np.float32)
    shares[np.cumsum(counts) - counts] = 1 / 3
    return of, shares


def _compute_squared_radii(
    mesh: Mesh,
    triangle_ids: NDArray[np.uint32],
    weights: NDArray[np.float32],
    views: NDArray[np.int32],
    photos: Photos,
) -> NDArray[np.float32]:
    """Compute the squared distance of samples (n, k) from the centre of their photo; 1 in the corners."""
    radii2 = np.empty(views.shape, np.float32)
    for start in range(0, len(triangle_ids), _BATCH_POINTS):
        rows = slice(start, start + _BATCH_POINTS)
        corners = mesh.vertices[mesh.triangles[triangle_ids[rows]]]
        sample_points = np.einsum("nc,ncx->nx", weights[rows].astype(np.float64), corners)
        radii2[rows] = _project_squared_radii(sample_points, views[rows], photos)
    return radii2


def _project_squared_radii(points: Floats, views: NDArray[np.int32], photos: Photos) -> NDArray[np.float32]:
    """Compute how far each point (n, 3) is from the centre of its photos (n, k), squared.

    The distance of the corners is 1.
    """
    radii2 = np.zeros(views.shape, np.float32)
    order = np.argsort(views, axis=None, kind="stable")
    bounds = np.searchsorted(views.ravel()[order], np.arange(len(photos) + 1))
    for number in np.flatnonzero(np.diff(bounds)):
        samples = order[bounds[number] : bounds[number + 1]]
        camera, pose = photos.cameras[number], photos.poses[number]
        camera_points = points[samples // views.shape[1]] @ pose[:3, :3].T + pose[:3, 3]
        x = (camera.fx * camera_points[:, 0] / camera_points[:, 2] + camera.cx) / (camera.width - 1) * 2 - 1
        y = (camera.fy * camera_points[:, 1] / camera_points[:, 2] + camera.cy) / (camera.height - 1) * 2 - 1
        aspect = camera.height / camera.width
        radii2.ravel()[samples] = (x**2 + (aspect * y) ** 2) / (1 + aspect**2)
    return radii2
