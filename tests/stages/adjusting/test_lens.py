"""Projection with lens distortion agrees with OpenCV, and its derivatives with finite differences."""

import cv2
import numpy as np
import pytest

from scanloom.stages.adjusting.lens import (
    compute_projection_derivatives,
    compute_rays,
    project_with_distortion,
)

LENSES = {
    "a pinhole": (500.0, 505.0, 318.0, 243.0, 0, 0, 0, 0, 0),
    "a barrel": (504.0, 504.0, 318.0, 245.0, -0.056, 0, 0, 0, 0),
    "TUM's freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
}


@pytest.fixture
def points() -> np.ndarray:
    """Sample points all over the image."""
    across, down = np.meshgrid(np.linspace(-0.55, 0.55, 9), np.linspace(-0.42, 0.42, 7))
    z = np.linspace(0.6, 3, across.size)
    return np.stack([across.ravel() * z, down.ravel() * z, z], axis=1)


@pytest.fixture(params=LENSES.values(), ids=LENSES)
def lens(request: pytest.FixtureRequest) -> np.ndarray:
    return np.array(request.param, np.float64)


def test_pixels_agree_with_opencv(points, lens):
    matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens[4:])
    np.testing.assert_allclose(project_with_distortion(points, lens), theirs[:, 0], atol=1e-9)


def test_rays_invert_the_projection(points, lens):
    found = compute_rays(project_with_distortion(points, lens), lens)
    np.testing.assert_allclose(found, points / points[:, 2:], atol=1e-5)


def test_derivatives_equal_finite_differences(points, lens):
    lenses = np.tile(lens, (len(points), 1))
    pixels, by_point, by_lens = compute_projection_derivatives(points, lenses)
    np.testing.assert_allclose(pixels, project_with_distortion(points, lens), atol=1e-9)
    step = 1e-6
    for axis in range(3):
        moved = step * np.eye(3)[axis]
        slope = (
            project_with_distortion(points + moved, lenses) - project_with_distortion(points - moved, lenses)
        ) / (2 * step)
        np.testing.assert_allclose(by_point[:, :, axis], slope, rtol=1e-5, atol=1e-4)
    for column, change in enumerate(_list_lens_changes(step)):
        slope = (
            project_with_distortion(points, change(lenses, 1))
            - project_with_distortion(points, change(lenses, -1))
        ) / (2 * step)
        np.testing.assert_allclose(by_lens[:, :, column], slope, rtol=1e-5, atol=1e-4)


def _list_lens_changes(step: float):
    def zoomed(lenses, sign):
        return lenses * np.array([np.exp(sign * step)] * 2 + [1.0] * 7)

    def added(place):
        return lambda lenses, sign: lenses + sign * step * np.eye(9)[place]

    return [zoomed, added(2), added(3), added(4)]
