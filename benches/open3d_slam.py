"""Open3D's dense SLAM up to the poses: each frame is placed to the model fused from all before it.

Written after Open3D's documentation ("Dense RGB-D SLAM"), with the defaults of its tensor reconstruction
system. Nothing is random, and no loop is closed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from open3d_images import read_images

from scanloom.stages._open3d import open3d
from scanloom.stages.registration.odometry import one_thread_each
from scanloom.stages.scans.model.scan import Frame, Pose

# Metres.
_VOXEL, _NEAREST, _FARTHEST, _REACH = 0.0058, 0.1, 3.0, 0.07
_TRUNCATION_VOXELS = 8.0
_BLOCK_VOXELS = 16
# Room at first: the model grows where it needs more, which changes no pose.
_BLOCKS = 10_000


def dense_slam(frames: Sequence[Frame]) -> dict[int, Pose]:
    """Return world_from_camera of every frame by its place, the first frame's camera being the world.

    Raises
    ------
    RuntimeError
        If Open3D cannot place a frame; it says why.
    """
    o3d = open3d()
    camera = frames[0].camera
    device = o3d.core.Device("CPU:0")
    matrix = o3d.core.Tensor(camera.matrix)
    pose = np.eye(4)
    model = o3d.t.pipelines.slam.Model(_VOXEL, _BLOCK_VOXELS, _BLOCKS, o3d.core.Tensor(pose), device)
    seen, expected = (
        o3d.t.pipelines.slam.Frame(camera.height, camera.width, matrix, device) for _ in range(2)
    )
    poses = {}
    # On one thread sums, and so poses, are the same every time.
    with one_thread_each():
        for place, frame in enumerate(frames):
            depth, color = read_images(frame)
            seen.set_data_from_image("depth", o3d.t.geometry.Image(o3d.core.Tensor(depth)))
            # Depth in floating point is taken with colours in floating point only.
            share = color / np.float32(255)
            seen.set_data_from_image("color", o3d.t.geometry.Image(o3d.core.Tensor(share)))
            if place > 0:
                found = model.track_frame_to_model(seen, expected, 1.0, _FARTHEST, _REACH)
                pose = pose @ found.transformation.numpy()
            poses[place] = pose
            model.update_frame_pose(place, o3d.core.Tensor(pose))
            model.integrate(seen, 1.0, _FARTHEST, _TRUNCATION_VOXELS)
            model.synthesize_model_frame(expected, 1.0, _NEAREST, _FARTHEST, _TRUNCATION_VOXELS)
    return poses
