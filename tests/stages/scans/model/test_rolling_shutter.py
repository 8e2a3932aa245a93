"""Rolling shutter images are corrected to the pose of the middle row."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from wall_photos import CAMERA, intersect_plane, paint, photo, pose

from scanloom.stages.scans.model.images import (
    read_color,
    read_depth,
    read_photo,
    read_pinhole,
    read_valid_pixels,
)
from scanloom.stages.scans.model.scan import Camera, Frame

TURN = np.radians((2.0, -3.0, 1.5))
STAND = pose(0.5, 0.5, z=-0.6, turn=5)
# The inner part: pixels near the border may be unseen.
INNER = np.s_[12:-12, 12:-12]


def still() -> tuple[np.ndarray, np.ndarray]:
    """Render the wall from the pose of the middle row: colours and depth."""
    x, y, depth = intersect_plane(STAND)
    return paint(x, y), depth


def bent(camera: Camera) -> Frame:
    """Render a rolling shutter photo of a camera with distortion."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    of = cv2.fisheye.undistortPoints if camera.fisheye else cv2.undistortPoints
    flat = of(pixels, camera.matrix, np.array(camera.distortion))[:, 0]
    late = (v.ravel() + 0.5) / camera.height - 0.5
    turned = np.stack([cv2.Rodrigues(share * TURN)[0] for share in late])
    way = np.einsum("nij,nj->ni", turned, np.column_stack([flat, np.ones(len(flat))])) @ STAND[:3, :3].T
    depth = -STAND[2, 3] / way[:, 2]
    x, y, _ = (STAND[:3, 3] + way * depth[:, None]).T
    shape = (camera.height, camera.width)
    color = np.rint(paint(x, y)).astype(np.uint8).reshape(*shape, 3)
    return Frame("bent", camera, color, depth=depth.astype(np.float32).reshape(shape), shutter_turn=TURN)


@pytest.mark.parametrize(
    "frame",
    [
        replace(photo(0, STAND, turn=TURN), shutter_turn=TURN),
        bent(replace(CAMERA, distortion=(0.1, -0.05, 0.002, -0.001))),
        bent(replace(CAMERA, distortion=(0.05, -0.01, 0.0, 0.0), fisheye=True)),
    ],
    ids=["pinhole", "distorted", "fisheye"],
)
def test_a_corrected_image_equals_a_global_shutter_image(frame):
    levels, depth = still()
    for image in (read_color(frame), read_photo(frame)[0]):
        off = np.abs(image - levels)[INNER]
        assert np.median(off) < 2
        assert np.percentile(off, 99) < 8
    measured = read_depth(frame)[INNER]
    # Depth is sampled at the nearest pixel; half a pixel is 2 mm here.
    assert np.abs(measured - depth[INNER])[measured > 0].max() < 0.003
    assert (measured > 0).mean() > 0.95


def test_without_its_turn_it_does_not():
    levels, depth = still()
    frame = photo(0, STAND, turn=TURN)
    assert np.median(np.abs(read_color(frame) - levels)[INNER]) > 3
    assert np.abs(read_depth(frame) - depth)[INNER].max() > 0.009


def test_unseen_pixels_have_no_depth_and_are_invalid():
    frame = replace(photo(0, STAND, turn=TURN), shutter_turn=3 * TURN)
    _, _, seen = read_photo(frame)
    assert 0.6 < seen.mean() < 0.98
    assert not read_depth(frame)[~seen].any()


def test_a_view_without_depth_and_its_mask_turn_as_well():
    levels, _ = still()
    mask = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    mask[:, :80] = 255
    view = replace(photo(0, STAND, with_depth=False, turn=TURN), shutter_turn=TURN, mask=mask)
    assert np.median(np.abs(read_pinhole(view) - levels)[INNER]) < 2
    _, _, shown = read_photo(view)
    np.testing.assert_array_equal(read_valid_pixels(view), shown)
    # The mask has a straight edge in the distorted image, so the corrected edge is sheared.
    edge = [np.flatnonzero(row).max() for row in read_valid_pixels(view)[12:-12]]
    assert np.ptp(edge) >= 5


def test_a_separate_colour_camera_rotates_with_the_depth_camera():
    aside = np.eye(4)
    aside[:3, :3] = cv2.Rodrigues(np.radians((0.0, 0.0, 90.0)))[0]
    # The colour camera is rotated by 90° relative to the depth camera, so its rotation vector is rotated,
    # too.
    frame = photo(0, STAND, turn=aside[:3, :3] @ TURN)
    frame = replace(frame, color_camera=CAMERA, color_from_depth=aside, shutter_turn=TURN)
    levels, _ = still()
    assert np.median(np.abs(read_color(frame) - levels)[INNER]) < 2


def test_larger_images_turn_as_much():
    frame = replace(photo(0, STAND, turn=TURN), shutter_turn=TURN)
    large = cv2.resize(frame.color, (2 * CAMERA.width, 2 * CAMERA.height), interpolation=cv2.INTER_CUBIC)
    small = cv2.resize(read_color(replace(frame, color=large)), (CAMERA.width, CAMERA.height))
    assert np.abs(small.astype(int) - read_color(frame))[INNER].mean() < 3


def test_no_turn_at_all_leaves_images_as_they_are():
    frame = photo(0, STAND)
    at_once = replace(frame, shutter_turn=np.zeros(3))
    np.testing.assert_array_equal(read_color(at_once), read_color(frame))
    np.testing.assert_allclose(read_depth(at_once), read_depth(frame), rtol=1e-6)
