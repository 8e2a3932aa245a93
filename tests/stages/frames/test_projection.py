"""Projection of points to pixels, and unprojection of pixels."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.scans.model.scan import Camera

CAMERA = Camera(640, 480, 500.0, 510.0, 318.5, 241.0)


def test_unprojected_pixels_project_to_themselves() -> None:
    rows, columns = np.mgrid[: CAMERA.height : 60, : CAMERA.width : 60]
    depth = np.linspace(0.5, 4, rows.size).reshape(rows.shape)
    points = unproject(columns, rows, depth, CAMERA)
    assert points.shape == (*rows.shape, 3)
    np.testing.assert_array_equal(points[..., 2], depth)
    found = project(points, CAMERA)
    np.testing.assert_allclose(found, (columns, rows), atol=1e-9)


def test_projection_equals_the_camera_matrix() -> None:
    points = np.array([[0.1, -0.2, 1.5], [-1.0, 0.3, 2.0]])
    expected = points @ CAMERA.matrix.T
    np.testing.assert_allclose(np.stack(project(points, CAMERA), axis=1), expected[:, :2] / expected[:, 2:])


def test_points_not_in_front_of_the_camera_have_no_pixel() -> None:
    columns, rows = project(np.array([[0.0, 0.0, 1.0], [0.1, 0.1, 0.0], [0.1, 0.1, -1.0]]), CAMERA)
    assert np.isnan(columns).tolist() == np.isnan(rows).tolist() == [False, True, True]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rays_keep_the_precision_of_the_pixels(dtype: type) -> None:
    rays = unproject(np.array([0, 318.5], dtype), np.array([241, 0], dtype), 1, CAMERA)
    assert rays.dtype == dtype
    np.testing.assert_allclose(rays, [(-0.637, 0, 1), (0, -241 / 510, 1)], rtol=1e-6)
