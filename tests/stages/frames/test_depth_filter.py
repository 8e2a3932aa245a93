"""The depth filter kernel, compared with a NumPy reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.frames import depth_filter
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, to_pinhole
from scanloom.stages.scans.reader import read_scan
from tests.stages.frames import numpy_filter

LIMITS = {"max_jump": 0.05, "max_angle": 87.0}
CAMERA = Camera(97, 71, 80.0, 82.0, 47.3, 36.1)


def make_scene(seed: int) -> NDArray[np.float32]:
    """Make a wall, an oblique floor and a sphere in front, with noise, holes and gaps of one pixel."""
    draw = np.random.default_rng(seed)
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    inverse = np.maximum(1 / 3 + 0.1 * x, y / 0.3)
    away = np.hypot(x - 0.1, y + 0.05) / 0.25
    ball = 1 / (2 - 0.4 * np.sqrt(np.maximum(1 - away**2, 0)))
    depth = 1 / np.where(away < 1, ball, inverse)
    depth *= 1 + 0.004 * draw.standard_normal(depth.shape)
    depth[draw.random(depth.shape) < 0.03] = 0
    depth[20:30, 5:25] = 0
    depth[::9] = 0
    return depth.astype(np.float32)


def assert_alike(depth: NDArray[np.float32], camera: Camera) -> None:
    """Check for equal results up to rounding; rounding may decide about single pixels."""
    found = depth_filter.orient_depth(depth, camera, **LIMITS)
    expected = numpy_filter.orient_depth(depth, camera, **LIMITS)
    assert ((found.depth > 0) != (expected.depth > 0)).mean() < 1e-4
    both = (found.depth > 0) & (expected.depth > 0)
    assert both.mean() > 0.3
    np.testing.assert_array_equal(found.depth[both], expected.depth[both])
    # Window means are summed in another order; the difference is small against slopes nearby.
    off = np.abs(found.obliqueness - expected.obliqueness)[both] / expected.obliqueness[both]
    assert np.quantile(off, 0.999) < 1e-5
    for axis, other in zip(found.normal, expected.normal, strict=True):
        assert np.quantile(np.abs(axis - other)[both] / expected.obliqueness[both], 0.999) < 1e-5


@pytest.mark.parametrize("seed", range(5))
def test_the_kernel_agrees_with_numpy(seed: int) -> None:
    depth = make_scene(seed)
    found = depth_filter.orient_depth(depth, CAMERA, **LIMITS)
    steep = (found.depth > 0) & (found.obliqueness > 2.9)
    # Both cases of steep pixels occur: the floor is kept, the rim of the sphere is clamped.
    assert steep.sum() > 50
    assert (np.abs(found.obliqueness - 2.9) < 1e-4).sum() > 10
    assert_alike(depth, CAMERA)


def test_the_kernel_agrees_with_numpy_on_sensor_frames(shared_data: Path) -> None:
    frame = read_scan(shared_data / "rgbd" / "7scenes_redkitchen").frames[40]
    depth = read_depth(frame)
    assert depth is not None
    assert_alike(depth, to_pinhole(frame.camera))


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 2), (3, 60)])
def test_images_of_few_pixels(shape: tuple[int, int]) -> None:
    camera = Camera(shape[1], shape[0], 50.0, 50.0, shape[1] / 2, shape[0] / 2)
    depth = np.full(shape, 2, np.float32)
    depth[0, 0] = 0
    found = depth_filter.orient_depth(depth, camera, **LIMITS)
    expected = numpy_filter.orient_depth(depth, camera, **LIMITS)
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_allclose(found.obliqueness, expected.obliqueness, rtol=1e-6)


def test_depth_outside_the_limits_or_not_finite_is_missing() -> None:
    depth = np.full((71, 97), 2, np.float32)
    for k, value in enumerate((np.nan, np.inf, -1, 0.3, 7)):
        depth[10 * k + 5 : 10 * k + 9, 20:40] = value
    found = depth_filter.orient_depth(depth, CAMERA, **LIMITS, min_depth=0.5, max_depth=5.0)
    assert set(np.unique(found.depth)) == {0, 2}
    assert all(np.isfinite(image).all() for image in (*found.normal, found.obliqueness))
    for k in range(5):
        assert (found.depth[10 * k + 5 : 10 * k + 9, 20:40] == 0).all()


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    depth = np.tile(make_scene(1), (4, 1))
    pixels = (CAMERA.fx, CAMERA.fy, CAMERA.cx, 2.0 * CAMERA.height, CAMERA.width, 4 * CAMERA.height)

    def run(threads: int) -> bytes:
        found, normal, length = _kernels.filter_depth(
            depth, pixels, limits=(0.0, np.inf, 0.05, 0.05), wanted_threads=threads
        )
        return b"".join(image.tobytes() for image in (found, *normal, length))

    assert run(1) == run(2) == run(7)
