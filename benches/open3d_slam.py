"""Open3D's dense SLAM up to the poses: frame-to-model tracking.

Follows Open3D's documentation ("Dense RGB-D SLAM") with the defaults of its tensor reconstruction system. It
uses no random numbers and closes no loops.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from open3d_images import read_images

from scanloom.stages._open3d import import_open3d
from scanloom.stages.registration.surface_alignment import limit_threads
from scanloom.stages.scans.model.scan import Frame, Pose

# Metres, Open3D's defaults: voxel size, depth range, maximum correspondence distance.
_VOXEL, _MIN_DEPTH, _MAX_DEPTH, _MAX_CORRESPONDENCE_DISTANCE = 0.0058, 0.1, 3.0, 0.07
_TRUNCATION_VOXELS = 8.0
_BLOCK_VOXELS = 16
# Initial block count. The volume grows if it needs more, which does not change the poses.
_INITIAL_BLOCKS = 10_000


def run_dense_slam(frames: Sequence[Frame]) -> dict[int, Pose]:
    """Estimate world_from_camera of every frame, by index.

    The world is the camera of the first frame.

    Raises
    ------
    RuntimeError
        If Open3D cannot track a frame.
    """
    o3d = import_open3d()
    camera = frames[0].camera
    device = o3d.core.Device("CPU:0")
    matrix = o3d.core.Tensor(camera.matrix)
    pose = np.eye(4)
    model = o3d.t.pipelines.slam.Model(_VOXEL, _BLOCK_VOXELS, _INITIAL_BLOCKS, o3d.core.Tensor(pose), device)
    seen, expected = (
        o3d.t.pipelines.slam.Frame(camera.height, camera.width, matrix, device) for _ in range(2)
    )
    poses = {}
    # A single thread makes sums, and so poses, reproducible.
    with limit_threads():
        for place, frame in enumerate(frames):
            depth, color = read_images(frame)
            seen.set_data_from_image("depth", o3d.t.geometry.Image(o3d.core.Tensor(depth)))
            # Float depth requires float colours.
            share = color / np.float32(255)
            seen.set_data_from_image("color", o3d.t.geometry.Image(o3d.core.Tensor(share)))
            if place > 0:
                found = model.track_frame_to_model(
                    seen, expected, 1.0, _MAX_DEPTH, _MAX_CORRESPONDENCE_DISTANCE
                )
                pose = pose @ found.transformation.numpy()
            poses[place] = pose
            model.update_frame_pose(place, o3d.core.Tensor(pose))
            model.integrate(seen, 1.0, _MAX_DEPTH, _TRUNCATION_VOXELS)
            model.synthesize_model_frame(expected, 1.0, _MIN_DEPTH, _MAX_DEPTH, _TRUNCATION_VOXELS)
    return poses
