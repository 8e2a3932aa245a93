"""Incremental mapping by pycolmap, on matches in memory.

Schönberger and Frahm, "Structure-from-motion revisited", 2016. Seeds are fixed and mapping runs in one
thread, so that equal input gives equal models.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.registration.structure.photo_features import PhotoFeatures
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Pose
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
    known: Collection[Camera],
) -> VerifiedPairs:
    """Keep the pairs of photos whose matches agree with one camera motion.

    Parameters
    ----------
    photos : photos with features.
    matches : pairs of photos with their matches.
    max_pixels : number of pixels to which larger photos were downscaled.
    min_inlier_ratio : minimum ratio of the matches that agree.
    known : cameras that are not refined, with their distortion.

    Returns
    -------
    Indices of the two photos, and pycolmap's two-view geometry.
    """
    import pycolmap

    cameras = [_convert_camera(photo.camera, 1, known) for photo in photos]
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

    # Each estimate seeds the random numbers of the thread that computes it.
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
    poses: Mapping[int, Pose],
) -> list[ColmapModel]:
    """Compute models of the photos: one for each group of photos that connect.

    Photos with equal cameras share one, whose focal length and distortion are refined. With known poses, one
    model is computed: these poses and their cameras are kept, and the other photos are added.

    Parameters
    ----------
    images : ID and unique name of the image of each photo.
    pairs : result of `verify_matches`.
    report_photo : called before each photo that is added to a model.
    poses : known poses, camera from world, by index of the photo.

    Returns
    -------
    Models, the one with the most photos first.
    """
    import pycolmap

    manager = pycolmap.ReconstructionManager()
    options = _make_options(compute_downscaling(photos, max_pixels))
    known = {photos[index].camera for index in poses}
    by_image = {images[index][0]: pose for index, pose in poses.items()}
    with pycolmap.Database.open(":memory:") as database:
        cameras = _fill_database(database, photos, images, pairs, known)
        if poses:
            options.fix_existing_frames, options.multiple_models = True, False
            options.constant_cameras = {cameras[camera] for camera in known}
            _triangulate_posed(database, manager.get(manager.add()), by_image, options)
        pipeline = pycolmap.IncrementalPipeline(options, database, manager)
    next_photo = pycolmap.IncrementalPipelineCallback.NEXT_IMAGE_REG_CALLBACK
    pipeline.add_callback(next_photo.value, report_photo)
    pipeline.run()
    models = [manager.get(index) for index in range(manager.size())]
    if poses:
        _undo_normalization(models[0], by_image)
    return sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _triangulate_posed(
    database: pycolmap.Database,
    model: ColmapModel,
    poses: Mapping[int, Pose],
    options: pycolmap.IncrementalPipelineOptions,
) -> None:
    """Add images with known poses to an empty model, and triangulate their points.

    Parameters
    ----------
    poses : poses, camera from world, by image ID.
    """
    import pycolmap

    cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    model.load(cache)
    for image_id, pose in poses.items():
        frame = model.frame(image_id)
        camera_id = model.image(image_id).camera_id
        frame.set_cam_from_world(camera_id, pycolmap.Rigid3d(pose[:3]))
        model.register_frame(image_id)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    for image_id in poses:
        mapper.triangulate_image(options.triangulation, image_id)
    mapper.complete_and_merge_tracks(options.triangulation)
    mapper.filter_points(options.mapper)
    mapper.end_reconstruction(False)


def _undo_normalization(model: ColmapModel, poses: Mapping[int, Pose]) -> None:
    """Transform a model back to the world of known poses: mapping centres and scales the model.

    Parameters
    ----------
    poses : poses, camera from world, by image ID.
    """
    import pycolmap

    known = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses.values()])
    found = np.array([model.image(image_id).projection_center() for image_id in poses])
    spread = float(np.linalg.norm(found - found.mean(0)))
    scale = float(np.linalg.norm(known - known.mean(0))) / spread if spread > 0 else 1.0
    shift = known.mean(0) - scale * found.mean(0)
    model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), shift))


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
    known: Collection[Camera],
) -> dict[Camera, int]:
    """Write cameras, features and pairs, and return the IDs of the cameras.

    Parameters
    ----------
    known : cameras that are not refined, with their distortion.
    """
    import pycolmap

    identities: dict[Camera, int] = {}
    for photo, (image_id, name) in zip(photos, images, strict=True):
        identity = identities.get(photo.camera)
        if identity is None:
            identity = identities[photo.camera] = len(identities) + 1
            camera = _convert_camera(photo.camera, identity, known)
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
    return identities


def _convert_camera(camera: Camera, identity: int, known: Collection[Camera]) -> pycolmap.Camera:
    return _to_known_colmap(camera, identity) if camera in known else _to_colmap(camera, identity)


def _to_colmap(camera: Camera, identity: int) -> pycolmap.Camera:
    import pycolmap

    focal = math.sqrt(camera.fx * camera.fy)
    found = pycolmap.Camera.create_from_model_name(
        identity, _CAMERA_MODEL, focal, camera.width, camera.height
    )
    found.has_prior_focal_length = not camera.is_guess
    return found


def _to_known_colmap(camera: Camera, identity: int) -> pycolmap.Camera:
    """Convert a camera that is not refined."""
    import pycolmap

    # Pixel centres of COLMAP are at 0.5.
    intrinsics = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
    if camera.fisheye:
        model, count = "OPENCV_FISHEYE", 4
    else:
        model, count = ("OPENCV", 4) if len(camera.distortion) <= 4 else ("FULL_OPENCV", 8)
    distortion = [*camera.distortion, *[0.0] * count][:count]
    return pycolmap.Camera(
        camera_id=identity,
        model=model,
        width=camera.width,
        height=camera.height,
        params=[*intrinsics, *distortion],
        has_prior_focal_length=True,
    )
