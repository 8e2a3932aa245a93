import json
import math

import cv2
import numpy as np
import OpenEXR
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth, read_valid_pixels
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

FACTOR = 4
APPLIED = np.array([[0, 1, 0, 0.5], [1, 0, 0, -2], [0, 0, -1, 7], [0, 0, 0, 1.0]])


def document(tiny, poses=None):
    camera = tiny.scaled_intrinsics(FACTOR)
    poses = poses or [tiny.opengl(pose) for pose in (tiny.identity, tiny.second)]
    return {
        "camera_model": "OPENCV",
        "w": 32 * FACTOR,
        "h": 24 * FACTOR,
        "fl_x": camera["fx"],
        "fl_y": camera["fy"],
        # Pixel coordinates from the corner of the top left pixel.
        "cx": camera["cx"] + 0.5,
        "cy": camera["cy"] + 0.5,
        "frames": [
            {
                "file_path": f"images/{number}.png",
                "depth_file_path": f"./depth/{number}.png",
                "transform_matrix": pose.tolist(),
            }
            for number, pose in zip((2, 10), poses, strict=True)
        ],
    }


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for number in (2, 10):
        tiny.dotted_file(tmp_path / "images" / f"{number}.png", FACTOR)
        tiny.depth(tmp_path / "depth" / f"{number}.png", 1000)
    write(tmp_path, document(tiny))
    return tmp_path


def write(folder, content, name="transforms.json"):
    (folder / name).write_text(json.dumps(content))


def points(folder, tiny, **options):
    return [tiny.seen(frame) for frame in read_scan(folder, ScanParams(**options)).frames]


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "nerfstudio"
    assert (scan.is_metric, scan.up) == (True, None)
    assert [frame.name for frame in scan.frames] == ["2", "10"]
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_colour_is_sampled_at_its_own_resolution(scan_folder, tiny):
    for frame in read_scan(scan_folder).frames:
        assert (frame.color_camera.width, frame.camera.width) == (32 * FACTOR, 32)
        assert tiny.green_is_at_the_pixel(frame)


def test_frames_come_in_the_order_of_their_numbers(scan_folder, tiny):
    content = document(tiny)
    content["frames"].reverse()
    write(scan_folder, content)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_the_applied_transform_and_scale_are_undone(scan_folder, tiny):
    """p_file = s · A p: the original world is restored."""
    poses = [APPLIED @ tiny.opengl(pose) for pose in (tiny.identity, tiny.second)]
    for pose in poses:
        pose[:3, 3] *= 0.25
    content = document(tiny, poses)
    write(scan_folder, content | {"applied_transform": APPLIED[:3].tolist(), "applied_scale": 0.25})
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


@pytest.mark.parametrize("factor", [0.00118428, 250.0])
def test_a_scaled_homogeneous_pose_is_the_same(scan_folder, tiny, factor):
    poses = [factor * tiny.opengl(pose) for pose in (tiny.identity, tiny.second)]
    write(scan_folder, document(tiny, poses))
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


@pytest.mark.parametrize("last", [[0, 0, 0, 2], [0, 0, 0, -1], [0, 0.5, 0, 1], [0, 0, 0, 0]])
def test_a_last_row_that_no_division_makes_right_is_refused(scan_folder, tiny, last):
    poses = [tiny.opengl(pose) for pose in (tiny.identity, tiny.second)]
    poses[1][3] = last
    write(scan_folder, document(tiny, poses))
    with pytest.raises(InputError, match="frame 10: the last row of the pose is"):
        read_scan(scan_folder)


def test_a_camera_for_each_frame(scan_folder, tiny):
    content = document(tiny)
    camera = {key: content.pop(key) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    for entry in content["frames"]:
        entry.update(camera)
    write(scan_folder, content)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


@pytest.mark.parametrize("everywhere", [True, False])
def test_a_camera_half_given_is_refused(scan_folder, tiny, everywhere):
    content = document(tiny)
    value = content["fl_x"] if everywhere else content.pop("fl_x")
    content["frames"][1]["fl_x"] = value
    write(scan_folder, content)
    with pytest.raises(InputError, match=r"transforms\.json: frame 10 states fl_x"):
        read_scan(scan_folder)


def test_blender_leaves_out_the_extension_and_gives_an_angle(tmp_path, tiny):
    for number in (0, 1):
        tiny.dotted_file(tmp_path / "train" / f"r_{number}.png", 1)
        tiny.depth(tmp_path / "train" / f"r_{number}_depth.png", 1000)
    content = {
        # A width of 31.9 px at a focal length of 100 px is an angle of 2 atan(0.1595).
        "camera_angle_x": 2 * math.atan(0.16),
        "frames": [
            {
                "file_path": f"./train/r_{number}",
                "depth_file_path": f"./train/r_{number}_depth.png",
                "transform_matrix": tiny.opengl(pose).tolist(),
            }
            for number, pose in enumerate((tiny.identity, tiny.second))
        ],
    }
    write(tmp_path, content, "transforms_train.json")
    assert read_scan(tmp_path).up is None
    # The script also writes the rotation between consecutive views.
    for entry in content["frames"]:
        entry["rotation"] = 0.0126
    write(tmp_path, content, "transforms_train.json")
    scan = read_scan(tmp_path)
    assert scan.up.source == "layout nerfstudio: z up"
    frames = scan.frames
    camera = frames[0].camera
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), (100, 100, 15.5, 11.5))
    assert read_color(frames[1]).shape == (24, 32, 3)
    # Half a pixel at a focal length of 100 px is 1 % of 2 m.
    seen = [tiny.seen(frame) for frame in frames]
    np.testing.assert_allclose(seen, np.add(tiny.points, [(0.01, 0.01, 0), (0, 0.01, -0.01)]), atol=1e-6)


def test_depth_in_steps_of_instant_ngp(scan_folder, tiny):
    for number in (2, 10):
        tiny.depth(scan_folder / "depth" / f"{number}.png", 4000)
    content = document(tiny) | {"integer_depth_scale": 1 / 4000, "enable_depth_loading": True}
    for entry in content["frames"]:
        entry["depth_path"] = entry.pop("depth_file_path")
    write(scan_folder, content)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    assert not read_scan(scan_folder).is_metric
    # A quarter of a metre per unit; depth is scaled, too.
    np.testing.assert_allclose(points(scan_folder, tiny, scale=0.25), np.array(tiny.points) / 4, atol=1e-6)


def test_depth_in_another_unit_can_be_stated(scan_folder, tiny):
    for number in (2, 10):
        tiny.depth(scan_folder / "depth" / f"{number}.png", 5000)
    np.testing.assert_allclose(points(scan_folder, tiny, depth_scale=5000), tiny.points, atol=1e-6)


def test_depth_of_a_renderer_is_in_the_unit_of_the_world(scan_folder, tiny):
    content = document(tiny)
    for entry in content["frames"]:
        entry["depth_file_path"] = entry["depth_file_path"].replace(".png", ".exr")
        depth = {"Z": np.full((24, 32), 2, np.float32)}
        OpenEXR.File({}, depth).write(str(scan_folder / entry["depth_file_path"]))
    write(scan_folder, content)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_distortion_has_opencvs_order(scan_folder, tiny):
    write(scan_folder, document(tiny) | {"k1": 0.1, "k2": 0.2, "k3": 0.3, "p1": 0.01, "p2": 0.02, "k4": 0.0})
    frame = read_scan(scan_folder).frames[0]
    assert frame.camera.distortion == frame.color_camera.distortion == (0.1, 0.2, 0.01, 0.02, 0.3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_model": "FISHEYE624"}, "unsupported camera_model 'FISHEYE624'"),
        ({"camera_model": "EQUIRECTANGULAR"}, "'EQUIRECTANGULAR': .* Undistort the images"),
        ({"camera_model": ["OPENCV"]}, "unsupported camera_model"),
        ({"k4": 0.1}, "k4 is not 0"),
        ({"fl_x": "wide"}, "fl_x is 'wide'"),
        ({"fl_x": -5}, "both must be positive"),
        ({"fl_x": math.nan}, "fl_x is 'nan'"),
        ({"fl_x": None, "fl_y": None}, "no focal length"),
        ({"w": 10.5}, "whole number"),
        ({"w": 10**400}, "w is 'inf'"),
        ({"h": 72, "cy": 30}, "another aspect ratio \\(128×72\\)"),
        ({"applied_scale": 0}, "applied_scale"),
        ({"applied_transform": np.diag((1.0, 1, -1, 1)).tolist()}, "applied_transform.*mirrors"),
        ({"applied_transform": None}, "applied_transform is not a 4x4"),
        ({"integer_depth_scale": 0}, "integer_depth_scale is 0"),
        ({"frames": []}, "no list of frames"),
        ({"frames": [1]}, "frame 0 is not an object"),
        ({"frames": [{"file_path": "a.png", "depth_file_path": "../b.png"}]}, "not a path inside the folder"),
        ({"frames": [{"file_path": "/a.png", "depth_file_path": "b.png"}]}, "not a path inside the folder"),
        ({"frames": [{"file_path": "a.png", "depth_file_path": ""}]}, "not a path inside the folder"),
        ({"frames": [{"file_path": "\ud800", "depth_file_path": "b.png"}]}, "not a path inside the folder"),
        ({"frames": [{"file_path": "a" * 300, "depth_file_path": "b.png"}]}, "not a path inside the folder"),
        (
            {"frames": [{"file_path": "images/2.png", "depth_file_path": "depth/2.png"}]},
            "frame 2: transform_matrix is not a 4x4",
        ),
    ],
)
def test_invalid_values_are_one_sentence(scan_folder, tiny, change, message):
    write(scan_folder, document(tiny) | change)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


@pytest.mark.parametrize("said", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheye_cameras(scan_folder, tiny, said):
    bent = {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}
    write(scan_folder, document(tiny) | bent | said)
    frame = read_scan(scan_folder).frames[0]
    for camera in (frame.camera, frame.color_camera):
        assert (camera.fisheye, camera.distortion) == (True, (0.1, 0.2, 0.3, 0.4))
    # Given intrinsics do not turn a fisheye into a pinhole.
    stated = read_scan(scan_folder, ScanParams(intrinsics="300,300,65.5,49.5")).frames[0].color_camera
    assert (stated.fx, stated.fisheye, stated.distortion) == (300, True, (0.1, 0.2, 0.3, 0.4))


def test_depth_of_a_fisheye_camera_stays_depth_along_the_axis(scan_folder, tiny):
    """A fisheye: a point at 45° to the right is π/4 · 8 pixels from the centre."""
    content = document(tiny)
    factor = 8 / 100
    wide = {key: content[key] * factor for key in ("fl_x", "fl_y")}
    write(scan_folder, content | wide | {"camera_model": "OPENCV_FISHEYE"})
    depth = np.full((24, 32), 3000, np.uint16)
    column = round(16 + 8 * np.pi / 4)
    depth[12, column] = 2000
    for entry in content["frames"]:
        assert cv2.imwrite(str(scan_folder / entry["depth_file_path"]), depth)
    frame = read_scan(scan_folder).frames[0]
    assert frame.camera.fx == pytest.approx(8)
    seen = read_depth(frame)
    # Depth is sampled at the nearest pixel, without interpolation.
    assert set(np.unique(seen)) <= {0.0, 2.0, 3.0}
    rows, columns = np.nonzero(seen == 2)
    assert (rows.min(), rows.max(), columns.mean()) == (12, 12, pytest.approx(16 + 8, abs=0.6))


def test_intrinsics_are_stated_for_the_size_of_the_colour_image(scan_folder, tiny):
    write(scan_folder, document(tiny) | {"fl_x": 1, "fl_y": 1})
    seen = points(scan_folder, tiny, intrinsics="400,400,65.5,49.5")
    np.testing.assert_allclose(seen, tiny.points, atol=1e-6)


def test_a_file_that_is_no_list_is_one_sentence(scan_folder):
    for text in ("[]", "{", "null", ""):
        (scan_folder / "transforms.json").write_text(text)
        with pytest.raises(InputError, match=r"transforms\.json"):
            read_scan(scan_folder)


def without_depth(tiny, poses=None):
    content = document(tiny, poses)
    for entry in content["frames"]:
        del entry["depth_file_path"]
    return content


def test_frames_without_any_depth_are_single_views(scan_folder, tiny):
    write(scan_folder, without_depth(tiny))
    scan = read_scan(scan_folder)
    tiny.assert_views(scan)
    assert not scan.is_metric
    assert any("scan.scale=" in text for text in map(str, scan.diagnostics))


def test_single_views_in_another_unit(scan_folder, tiny):
    poses = [tiny.opengl(pose) for pose in (tiny.identity, tiny.second)]
    for pose in poses:
        pose[:3, 3] *= 1000
    write(scan_folder, without_depth(tiny, poses))
    scan = read_scan(scan_folder, ScanParams(depth_scale=1000))
    tiny.assert_views(scan)
    assert scan.diagnostics == ()
    # Given poses are in metres.
    rows = [" ".join(map(str, pose[:3].ravel())) for pose in (tiny.identity, tiny.second)]
    (scan_folder / "poses.txt").write_text("\n".join(rows))
    tiny.assert_views(read_scan(scan_folder, ScanParams(depth_scale=1000, poses="poses.txt")))


def test_single_views_can_differ_in_size(scan_folder, tiny):
    """Images reduced after camera estimation are used; a cropped image is skipped."""
    tiny.dotted_file(scan_folder / "images" / "10.png", 1)
    write(scan_folder, without_depth(tiny))
    scan = read_scan(scan_folder)
    assert [frame.camera.width for frame in scan.frames] == [32 * FACTOR, 32]
    tiny.assert_views(scan)
    tiny.color(scan_folder / "images" / "2.png", (100, 30))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10"]
    assert "the camera has another aspect ratio" in scan.skipped_frames[0].reason


@pytest.mark.parametrize("with_depth", [True, False])
def test_masks_exclude_pixels(scan_folder, tiny, with_depth):
    mask = np.full((24 * FACTOR, 32 * FACTOR), 255, np.uint8)
    mask[: 4 * FACTOR] = 0
    content = document(tiny) if with_depth else without_depth(tiny)
    for entry in content["frames"]:
        entry["mask_path"] = entry["file_path"].replace("images", "masks")
        (scan_folder / "masks").mkdir(exist_ok=True)
        cv2.imwrite(str(scan_folder / entry["mask_path"]), mask)
    write(scan_folder, content)
    frame = read_scan(scan_folder).frames[0]
    seen = read_depth(frame) > 0 if with_depth else read_valid_pixels(frame)
    factor = 1 if with_depth else FACTOR
    assert seen.shape == (24 * factor, 32 * factor)
    assert not seen[: 4 * factor].any()
    assert seen[4 * factor :].all()
    content["frames"][0]["mask_path"] = "../mask.png"
    write(scan_folder, content)
    with pytest.raises(InputError, match="mask_path is not a path inside"):
        read_scan(scan_folder)


def test_transparency_is_a_mask(scan_folder, tiny):
    image = np.full((24 * FACTOR, 32 * FACTOR, 4), 200, np.uint8)
    image[:, :40, 3] = 127
    cv2.imwrite(str(scan_folder / "images" / "2.png"), image)
    write(scan_folder, without_depth(tiny))
    first, second = read_scan(scan_folder).frames
    assert np.flatnonzero(~read_valid_pixels(first).all(axis=0)).tolist() == list(range(40))
    assert read_valid_pixels(first)[:, 40:].all()
    assert second.mask is None


def test_frames_without_depth_are_left_out(scan_folder, tiny):
    content = document(tiny)
    del content["frames"][0]["depth_file_path"]
    write(scan_folder, content)
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10"]
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("2", "it has no depth_file_path or depth_path")
    ]


def test_a_frame_whose_pose_is_lost_is_left_out(scan_folder, tiny):
    content = document(tiny)
    content["frames"][0]["transform_matrix"] = np.full((4, 4), np.nan).tolist()
    write(scan_folder, content)
    assert [one.name for one in read_scan(scan_folder).skipped_frames] == ["2"]


@pytest.mark.parametrize("size", [(128, 0), (0, 96)])
@pytest.mark.parametrize("is_stated", [True, False])
def test_an_image_without_rows_is_one_sentence(scan_folder, tiny, size, is_stated):
    """The intrinsics of its depth camera were scaled with a height of 0."""
    content = document(tiny)
    if not is_stated:
        content = {key: value for key, value in content.items() if key not in "wh"}
    write(scan_folder, content)
    for folder in ("depth", "images"):
        for path in (scan_folder / folder).iterdir():
            data = bytearray(path.read_bytes())
            data[16:24] = size[0].to_bytes(4, "big") + size[1].to_bytes(4, "big")
            path.write_bytes(data)
    with pytest.raises(InputError, match=r"\.png: its header is damaged: it states .* pixels"):
        points(scan_folder, tiny)


@pytest.mark.parametrize(
    "moved",
    ["/home/me/scan/images/{}.png", "C:\\\\Users\\\\me\\\\{}.png", "../elsewhere/{}.jpeg", "frames/{}.jpeg"],
)
def test_paths_of_another_computer_are_found_by_their_names(scan_folder, tiny, moved):
    moved = moved.replace("\\\\", "\\")
    content = document(tiny)
    for entry, number in zip(content["frames"], (2, 10), strict=True):
        entry["file_path"] = moved.format(number)
        entry["depth_file_path"] = f"/home/me/scan/depth/{number}.png"
    write(scan_folder, content)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    (said,) = [text for text in map(str, read_scan(scan_folder).diagnostics) if "found by name" in text]
    assert said.startswith("2 image paths in transforms.json point outside the scan")
    assert said.endswith("(images/2.png)")


def test_an_absolute_path_is_never_read_outside_the_folder(scan_folder, tiny, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    content = document(tiny)
    for entry in content["frames"]:
        tiny.color(outside / f"x{entry['file_path'].rpartition('/')[2]}")
        entry["file_path"] = str(outside / f"x{entry['file_path'].rpartition('/')[2]}")
    write(scan_folder, content)
    with pytest.raises(InputError, match="frame x2: file_path is not a path inside the folder"):
        read_scan(scan_folder)


def test_a_frame_of_another_computer_that_is_not_there_is_left_out(scan_folder, tiny):
    content = document(tiny)
    for entry in content["frames"]:
        entry["file_path"] = "/home/me/" + entry["file_path"]
    write(scan_folder, content)
    (scan_folder / "images" / "10.png").unlink()
    scan = read_scan(scan_folder)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [("10", "10.png is missing")]


def test_a_real_toy_with_paths_of_another_machine(shared_data, tmp_path):
    source = shared_data / "real" / "nerf_alpha_toy"
    content = json.loads((source / "transforms.json").read_text())
    for entry in content["frames"]:
        stem = entry["file_path"].rpartition("/")[2].partition(".")[0]
        entry["file_path"] = f"/home/someone/{stem}.jpeg"
    write(tmp_path, content)
    (tmp_path / "images").symlink_to(source / "images", target_is_directory=True)
    scan = read_scan(tmp_path)
    assert len(scan.frames) == 24
    assert any("such as '/home/someone/" in text for text in map(str, scan.diagnostics))


def test_photos_of_nearly_the_size_of_their_camera_are_reported(scan_folder, tiny):
    """A camera of undistorted photos together with photos from before undistortion."""
    content = document(tiny)
    for entry in content["frames"]:
        del entry["depth_file_path"]
    write(scan_folder, content)
    assert not any("undistorted images" in text for text in map(str, read_scan(scan_folder).diagnostics))
    write(scan_folder, content | {"w": 124.0, "h": 93.0})
    (told,) = [text for text in map(str, read_scan(scan_folder).diagnostics) if "undistorted images" in text]
    said = (
        f"{scan_folder / 'images' / '2.png'}: the image is 128×96 but its camera 124×93: "
        "such cameras usually belong to undistorted images"
    )
    assert told.startswith(said)
    assert told.endswith("The camera is scaled (and 1 more files)")
    write(scan_folder, content | {"w": 64 * FACTOR, "h": 48 * FACTOR})
    assert not any("undistorted images" in text for text in map(str, read_scan(scan_folder).diagnostics))
