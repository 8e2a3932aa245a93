"""Photos are localised to a small part of a pixel."""

import cv2
import numpy as np
import pytest
from wall_photos import CAMERA, paint, photo, pose, wall

from scanloom.stages.comparing.photo_localization import generate_pose_candidates
from scanloom.stages.scans.model.scan import Camera, to_pinhole
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

# Size of a pixel on the wall at the distance of `pose`, metres.
PIXEL = 0.8 / CAMERA.fx


@pytest.fixture(scope="module")
def painted() -> RaycastingSurface:
    """Make the painted wall with at least one vertex per pixel."""
    fine = wall(250)
    x, y, _ = fine.vertices.T
    return RaycastingSurface(Mesh(fine.vertices, fine.triangles, np.rint(paint(x, y)).astype(np.uint8)))


def measure_candidate_errors(
    painted: RaycastingSurface, shift: tuple[float, float, float], gain: float = 1.0
) -> list[np.ndarray]:
    """Compute errors of the pose candidates in pixels."""
    truth = pose(0.5, 0.5, turn=5)
    image = np.rint(np.asarray(photo(0, truth).color) * gain).astype(np.uint8)
    given = truth.copy()
    given[:3, 3] += shift
    found = generate_pose_candidates(image, to_pinhole(CAMERA), given, painted)
    return [np.abs(one[:3, 3] - truth[:3, 3]) / PIXEL for one in found]


def test_a_photo_is_localised(painted):
    given, recognised, by_flow = measure_candidate_errors(painted, (0.02, -0.01, 0.01))
    assert given.max() > 3
    for found in (recognised, by_flow):
        assert found.max() < 0.2


def test_optical_flow_localises_a_photo_without_feature_matches(painted):
    given, by_flow = measure_candidate_errors(painted, (0.02, -0.01, 0.01), gain=0.6)
    assert given.max() > 3
    assert by_flow.max() < 0.5


def test_a_photo_that_cannot_be_localised_keeps_its_pose(painted):
    away = pose(40.0, 0.5)
    image = np.asarray(photo(0, pose(0.5, 0.5)).color)
    assert [one.tolist() for one in generate_pose_candidates(image, to_pinhole(CAMERA), away, painted)] == [
        away.tolist()
    ]


@pytest.mark.parametrize("side", [2, 5, 7, 12, 30])
def test_small_photos_are_accepted(painted, side):
    camera = Camera(side, side, 0.8 * side, 0.8 * side, (side - 1) / 2, (side - 1) / 2)
    there = pose(0.5, 0.5)
    image = cv2.resize(np.asarray(photo(0, there).color)[:, 20:140], (side, side))
    assert all(np.isfinite(one).all() for one in generate_pose_candidates(image, camera, there, painted))
