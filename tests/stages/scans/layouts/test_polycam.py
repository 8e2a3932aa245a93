import json

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth, read_valid_pixels
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

FACTOR = 4
STEMS = ("9999999", "10000000")


def write_camera(path, pose, camera, **change):
    names = [f"t_{row}{column}" for row in range(3) for column in range(4)]
    table = dict(zip(names, pose[:3].ravel().tolist(), strict=True)) | camera
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        json.dumps(table | {"width": 32 * FACTOR, "height": 24 * FACTOR, "blur_score": 12.5} | change)
    )


@pytest.fixture
def scan_folder(tmp_path, tiny):
    keyframes = tmp_path / "keyframes"
    for stem, pose in zip(STEMS, (tiny.identity, tiny.second), strict=True):
        for name in ("cameras", "corrected_cameras"):
            # The tracked poses are inaccurate, the corrected ones are right.
            drift = np.zeros((4, 4))
            drift[0, 3] = 0.5 * (name == "cameras")
            write_camera(
                keyframes / name / f"{stem}.json", tiny.opengl(pose) + drift, tiny.scaled_intrinsics(FACTOR)
            )
        for name in ("images", "corrected_images"):
            tiny.dotted_file(keyframes / name / f"{stem}.png", FACTOR)
        tiny.depth(keyframes / "depth" / f"{stem}.png", 1000)
        (keyframes / "confidence").mkdir(exist_ok=True)
        trust = np.full((24, 32), 255, np.uint8)
        trust[3, 4:6] = (0, 127)
        cv2.imwrite(str(keyframes / "confidence" / f"{stem}.png"), trust)
    return tmp_path


def points(folder, tiny, **options):
    return [tiny.seen(frame) for frame in read_scan(folder, ScanParams(**options)).frames]


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "polycam"
    assert [frame.timestamp for frame in scan.frames] == [9_999_999_000, 10_000_000_000]
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_colour_is_sampled_at_its_own_resolution(scan_folder, tiny):
    assert all(tiny.green_is_at_the_pixel(frame) for frame in read_scan(scan_folder).frames)


@pytest.mark.parametrize(("least", "kept"), [(None, [0, 2, 2]), (0, [2, 2, 2]), (255, [0, 0, 2])])
def test_depth_of_little_confidence_is_left_out(scan_folder, least, kept):
    scan = read_scan(scan_folder, ScanParams(min_confidence=least))
    assert read_depth(scan.frames[0])[3, 4:7].tolist() == kept
    assert any(
        f"confidence {127 if least is None else least} or higher" in text
        for text in map(str, scan.diagnostics)
    )


def test_without_corrected_cameras_the_tracked_ones_are_used_and_reported(scan_folder, tiny):
    for file in (scan_folder / "keyframes" / "corrected_cameras").iterdir():
        file.unlink()
    scan = read_scan(scan_folder)
    assert any("poses, which drift" in text for text in map(str, scan.diagnostics))
    np.testing.assert_allclose(
        [tiny.seen(frame) for frame in scan.frames], np.add(tiny.points, (0.5, 0, 0)), atol=1e-6
    )


def test_a_frame_that_lacks_something_is_left_out(scan_folder, tiny):
    (scan_folder / "keyframes" / "depth" / f"{STEMS[0]}.png").unlink()
    scan = read_scan(scan_folder)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [(STEMS[0], "its depth map is missing")]
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points[1:], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t_11": None}, "the pose is incomplete: t_00 to t_23"),
        ({"t_11": "x"}, "not a 4x4 matrix"),
        ({"t_11": 5}, "not rigid"),
        ({"width": None}, "width and height"),
        ({"width": 1e300}, "invalid camera size"),
        ({"width": 24 * FACTOR, "height": 32 * FACTOR, "cx": 40, "cy": 60}, "rotated by 90°"),
        ({"fx": 0}, "must be positive"),
    ],
)
def test_a_damaged_camera_costs_its_frame(scan_folder, tiny, change, message):
    cameras = scan_folder / "keyframes" / "corrected_cameras"
    write_camera(
        cameras / f"{STEMS[0]}.json", tiny.opengl(tiny.identity), tiny.scaled_intrinsics(FACTOR), **change
    )
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == [STEMS[1]]
    (left_out,) = scan.skipped_frames
    assert message in left_out.reason
    (cameras / f"{STEMS[1]}.json").write_text("{")
    with pytest.raises(InputError, match="none of its 2 frames can be used"):
        read_scan(scan_folder)


def test_images_of_another_shape_are_refused(scan_folder, tiny):
    for stem in STEMS:
        tiny.color(scan_folder / "keyframes" / "corrected_images" / f"{stem}.png", (128, 72))
    with pytest.raises(InputError, match=r"size of the images is 128×72 pixels.*without cropping"):
        read_scan(scan_folder)


def test_without_depth_the_frames_are_single_views(scan_folder, tiny):
    for file in (scan_folder / "keyframes" / "depth").iterdir():
        file.unlink()
    scan = read_scan(scan_folder)
    tiny.assert_views(scan)
    assert scan.diagnostics == ()
    (scan_folder / "keyframes" / "corrected_images" / f"{STEMS[1]}.png").unlink()
    assert [(one.name, one.reason) for one in read_scan(scan_folder).skipped_frames] == [
        (STEMS[1], "its image is missing")
    ]


def test_black_borders_of_corrected_images_are_invalid(scan_folder):
    """Five black columns at the left edge and the next one are invalid, dark pixels inside are valid."""
    for stem in STEMS:
        for name in ("images", "corrected_images"):
            path = str(scan_folder / "keyframes" / name / f"{stem}.png")
            image = cv2.imread(path)
            image[:, :5] = 3
            image[40:60, 60:80] = 0
            cv2.imwrite(path, image)
    depth = read_depth(read_scan(scan_folder).frames[0])
    # A depth pixel covers four image pixels.
    assert not depth[:, 0].any()
    assert (depth[4:, 1:] > 0).all()
    for file in (scan_folder / "keyframes" / "depth").iterdir():
        file.unlink()
    view = read_scan(scan_folder).frames[0]
    assert np.flatnonzero(~read_valid_pixels(view).all(axis=0)).tolist() == [0, 1, 2, 3, 4, 5]
    for file in (scan_folder / "keyframes" / "corrected_images").iterdir():
        file.unlink()
    assert read_valid_pixels(read_scan(scan_folder).frames[0]).all()


def test_without_images_the_reason_is_reported(tmp_path):
    (tmp_path / "keyframes" / "cameras").mkdir(parents=True)
    with pytest.raises(InputError, match="neither corrected_cameras/"):
        read_scan(tmp_path)
