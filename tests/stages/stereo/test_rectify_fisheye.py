import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.scan import Camera, Frame, StereoRig
from scanloom.stages.stereo.rectify import rectify_rig

SIZE = (160, 120)
FOCAL, CENTRE = 60.0, (82.0, 57.0)
CAMERA = Camera(*SIZE, FOCAL, FOCAL, *CENTRE, (0.0, 0.0, 0.0, 0.0), fisheye=True)
# Expected value: a point at 45° is at a distance of π/4 focal lengths from the centre.
ASIDE = np.array([1.0, 0.0, 1.0])
POINTS = (np.array([0.8, 0.4, 1.5]), np.array([-0.5, -0.7, 1.2]), np.array([0.2, 0.1, 2.0]))


def project_equidistant(point):
    """Project a point in camera axes through an equidistant lens, where the angle is the radius."""
    x, y, z = point
    aside = np.hypot(x, y)
    length = FOCAL * np.arctan2(aside, z)
    return np.array(CENTRE) + length * np.array([x, y]) / aside


def draw_dot(pixel):
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    spot = np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / 4)
    return np.repeat((255 * spot).astype(np.uint8)[:, :, None], 3, axis=2)


def compute_centroid(image):
    weight = image[:, :, 0].astype(float)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


def test_the_equidistant_projection():
    np.testing.assert_allclose(project_equidistant(ASIDE), (CENTRE[0] + FOCAL * np.pi / 4, CENTRE[1]))


@pytest.mark.parametrize("point", POINTS)
def test_a_fisheye_pair_is_rectified_with_its_depth(point):
    # The right camera is 0.1 m to the right and rotated inward by 3°.
    c, s = np.cos(np.radians(3)), np.sin(np.radians(3))
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    right_from_left[:3, 3] = right_from_left[:3, :3] @ (-0.1, 0, 0)
    rig = StereoRig(CAMERA, CAMERA, right_from_left, is_rectified=False)
    rectified = rectify_rig(rig)
    there = (right_from_left @ (*point, 1))[:3]
    left, right = (
        compute_centroid(image)
        for image in rectified.apply(
            draw_dot(project_equidistant(point)), draw_dot(project_equidistant(there))
        )
    )
    assert abs(left[1] - right[1]) < 0.3
    x, y, z = rectified.rectified_from_left @ point
    expected = (rectified.left.fx * x / z + rectified.left.cx, rectified.left.fy * y / z + rectified.left.cy)
    np.testing.assert_allclose(left, expected, atol=0.3)
    depth = rectified.focal_baseline / (left[0] - right[0] + rectified.principal_offset)
    np.testing.assert_allclose(depth, z, rtol=0.1)
    assert rectified.baseline == pytest.approx(0.1)


@pytest.mark.parametrize("point", POINTS)
def test_colour_of_a_fisheye_depth_camera_becomes_a_pinhole_image(point):
    frame = Frame(
        "0", CAMERA, color=draw_dot(project_equidistant(point)), depth=np.ones(SIZE[::-1], np.float32)
    )
    x, y, z = point
    np.testing.assert_allclose(
        compute_centroid(read_color(frame)), (FOCAL * x / z + CENTRE[0], FOCAL * y / z + CENTRE[1]), atol=0.3
    )


def test_a_fisheye_paired_with_another_camera_is_refused():
    straight = Camera(*SIZE, FOCAL, FOCAL, *CENTRE)
    shifted = np.eye(4)
    shifted[0, 3] = -0.1
    with pytest.raises(InputError, match="both must have the same model"):
        rectify_rig(StereoRig(CAMERA, straight, shifted, is_rectified=False))
