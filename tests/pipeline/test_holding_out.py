"""Held-out photos get the pose correction of the next frame, and the same camera."""

from dataclasses import replace

import numpy as np
import pytest
from wall_photos import CAMERA, photo, pose

from scanloom.pipeline.evaluation.held_out_frames import transfer_neighbour_poses
from scanloom.stages.scans.model.scan import Frame


@pytest.fixture
def frames() -> list[Frame]:
    return [photo(number, pose(0.1 * number, 0.5)) for number in range(6)]


def test_held_out_frames_move_with_the_next_frame(frames):
    left_out, given = frames[1::3], [frame for number, frame in enumerate(frames) if number % 3 != 1]
    shift = np.eye(4)
    shift[:3, 3] = 0.01, -0.02, 0.03
    used = [
        replace(frame, world_from_camera=shift @ frame.world_from_camera, color_camera=CAMERA)
        for frame in given
    ]
    for one, before in zip(transfer_neighbour_poses(left_out, 3, given, used), left_out, strict=True):
        np.testing.assert_allclose(one.world_from_camera, shift @ before.world_from_camera, atol=1e-12)
        assert one.color_camera == CAMERA
        assert one.shutter_turn is None


def test_held_out_frames_have_a_rolling_shutter_with_unknown_rotation(frames):
    turn = np.array([0.01, 0.02, -0.01])
    used = [replace(frame, shutter_turn=turn) for frame in frames[1:]]
    (one,) = transfer_neighbour_poses(frames[:1], 6, frames[1:], used)
    np.testing.assert_array_equal(one.shutter_turn, np.zeros(3))
