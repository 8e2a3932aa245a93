"""Incremental mapping by pycolmap, on matches in memory.

Schönberger and Frahm, "Structure-from-motion revisited", 2016. Seeds are fixed and mapping runs in one
thread, so that equal input gives equal models.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.registration.structure.photo_features import PhotoFeatures
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING

if TYPE_CHECKING:
    import pycolmap

# Minimum number of matches that agree with one camera motion.
_MIN_INLIERS = 15
# Maximum number of RANSAC trials; pairs of unrelated photos need all. Half of COLMAP's default.
_MAX_TRIALS = 5000
# Minimum number of photos of a model, and maximum number of models of one folder.
_MIN_MODEL_PHOTOS, _MAX_MODELS = 3, 10
# One focal length, the principal point in the centre, and one coefficient of radial distortion.
_CAMERA_MODEL = "SIMPLE_RADIAL"
_SEED = 1

VerifiedPairs = list[tuple[int, int, Any]]
# pycolmap's Reconstruction.
ColmapModel = Any


def require_pycolmap() -> None:
    """Check that `pycolmap` is installed, and silence its log.

    Raises
    ------
    UsageError
        If `pycolmap` is not installed; the message names the package to install.
    """
    try:
        import pycolmap
    except ImportError:
        raise UsageError(
            MACHINE_EXTRA_MISSING,
            "estimating the camera poses of photos requires pycolmap",
            remedy="install scanloom[sfm].",
        ) from None
    # Its warnings are no diagnostics; failures are reported by the result.
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL.value)


def verify_matches(
    photos: Sequence[PhotoFeatures],
    matches: Iterable[tuple[tuple[int, int], NDArray[np.int64]]],
    max_pixels: float,
    min_inlier_ratio: float,
) -> VerifiedPairs:
    """Keep the pairs of photos whose matches agree with one camera motion.

    Parameters
    ----------
    photos : photos with features.
    matches : pairs of photos with their matches.
    max_pixels : number of pixels to which larger photos were downscaled.
    min_inlier_ratio : minimum ratio of the matches that agree.

    Returns
    -------
    Indices of the two photos, and pycolmap's two-view geometry.
    """
    import pycolmap

    cameras = [_to_colmap(photo.camera, 1) for photo in photos]
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = _MIN_INLIERS
    options.ransac.random_seed = _SEED
    options.ransac.max_error *= compute_downscaling(photos, max_pixels)
    options.ransac.max_num_trials = _MAX_TRIALS

    def verify(one: tuple[tuple[int, int], NDArray[np.int64]]) -> tuple[int, int, Any] | None:
        (first, second), found = one
        if len(found) < _MIN_INLIERS:
            return None
        geometry = pycolmap.estimate_two_view_geometry(
            cameras[first],
            photos[first].pixels + 0.5,
            cameras[second],
            photos[second].pixels + 0.5,
            found.astype(np.uint32),
            options,
        )
        min_inliers = max(_MIN_INLIERS, min_inlier_ratio * len(found))
        return (first, second, geometry) if len(geometry.inlier_matches) >= min_inliers else None

    # Each estimate seeds the random numbers of its own thread.
    threads = get_worker_count()
    results = map_ordered(verify, matches, threads=threads, max_pending=2 * threads)
    return [one for one in results if one is not None]


def compute_downscaling(photos: Sequence[PhotoFeatures], max_pixels: float) -> float:
    """Return the median factor by which photos were downscaled; tolerances in pixels grow by it."""
    sizes = (photo.camera.width * photo.camera.height for photo in photos)
    return statistics.median(math.sqrt(max(1.0, size / max_pixels)) for size in sizes)


def map_photos(
    photos: Sequence[PhotoFeatures],
    images: Sequence[tuple[int, str]],
    pairs: VerifiedPairs,
    max_pixels: float,
    report_photo: Callable[[], None],
) -> list[ColmapModel]:
    """Compute models of the photos: one for each group of photos that connect.

    Photos with equal cameras share one, whose focal length and distortion are refined.

    Parameters
    ----------
    images : ID and unique name of the image of each photo.
    pairs : result of `verify_matches`.
    report_photo : called before each photo that is added to a model.

    Returns
    -------
    Models, the one with the most photos first.
    """
    import pycolmap

    manager = pycolmap.ReconstructionManager()
    with pycolmap.Database.open(":memory:") as database:
        _fill_database(database, photos, images, pairs)
        pipeline = pycolmap.IncrementalPipeline(
            _make_options(compute_downscaling(photos, max_pixels)), database, manager
        )
    next_photo = pycolmap.IncrementalPipelineCallback.NEXT_IMAGE_REG_CALLBACK
    pipeline.add_callback(next_photo.value, report_photo)
    pipeline.run()
    models = [manager.get(index) for index in range(manager.size())]
    return sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _make_options(downscaling: float) -> pycolmap.IncrementalPipelineOptions:
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.min_num_matches = _MIN_INLIERS
    options.min_model_size = _MIN_MODEL_PHOTOS
    options.max_num_models = _MAX_MODELS
    options.extract_colors = False
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = _SEED
    mapper, triangulation = options.mapper, options.triangulation
    mapper.init_max_error *= downscaling
    mapper.abs_pose_max_error *= downscaling
    mapper.filter_max_reproj_error *= downscaling
    triangulation.merge_max_reproj_error *= downscaling
    triangulation.complete_max_reproj_error *= downscaling
    return options


def _fill_database(
    database: pycolmap.Database,
    photos: Sequence[PhotoFeatures],
    images: Sequence[tuple[int, str]],
    pairs: VerifiedPairs,
) -> None:
    import pycolmap

    identities: dict[Camera, int] = {}
    for photo, (image_id, name) in zip(photos, images, strict=True):
        identity = identities.get(photo.camera)
        if identity is None:
            identity = identities[photo.camera] = len(identities) + 1
            camera = _to_colmap(photo.camera, identity)
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=identity)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        image = pycolmap.Image(name=name, camera_id=identity, image_id=image_id)
        database.write_image(image, use_image_id=True)
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = image_id, identity
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
        # Pixel centres of COLMAP are at 0.5.
        database.write_keypoints(image_id, (photo.pixels + 0.5).astype(np.float32))
    for first, second, geometry in pairs:
        database.write_two_view_geometry(images[first][0], images[second][0], geometry)


def _to_colmap(camera: Camera, identity: int) -> pycolmap.Camera:
    import pycolmap

    focal = math.sqrt(camera.fx * camera.fy)
    found = pycolmap.Camera.create_from_model_name(
        identity, _CAMERA_MODEL, focal, camera.width, camera.height
    )
    found.has_prior_focal_length = not camera.is_guess
    return found
