import shutil
import struct

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_depth, read_pinhole
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

NAMES = ("10.png", "left side/a view 2.png")
HALF = 0.5**0.5
# camera_from_world of the second frame by hand: -90 degrees about y, and (3, -2, -1). Scalar first.
SECOND = (HALF, 0, -HALF, 0, 3, -2, -1)
FIRST = (1, 0, 0, 0, 0, 0, 0)
# Pixel centres at 0.5: the centre of the tiny camera moves by half a pixel.
PINHOLE = (1, (100, 100, 16.5, 12.5))
MODELS = {
    0: "SIMPLE_PINHOLE",
    1: "PINHOLE",
    2: "SIMPLE_RADIAL",
    3: "RADIAL",
    4: "OPENCV",
    5: "OPENCV_FISHEYE",
    7: "FOV",
    8: "SIMPLE_RADIAL_FISHEYE",
    9: "RADIAL_FISHEYE",
    10: "THIN_PRISM_FISHEYE",
}


def write_text(model, number=1, values=PINHOLE[1], empty_points=True):
    model.mkdir(parents=True, exist_ok=True)
    row = " ".join(str(value) for value in values)
    (model / "cameras.txt").write_text(f"# cameras\n7 {MODELS[number]} 32 24 {row}\n")
    points = ("", "1.5 2.5 -1 3 4 9") if empty_points else ("1 2 -1", "3 4 -1")
    lines = [
        f"{i} {' '.join(str(v) for v in pose)} 7 {name}\n{observed}\n"
        for i, (pose, name, observed) in enumerate(zip((SECOND, FIRST), NAMES, points, strict=True), 1)
    ]
    (model / "images.txt").write_text("# images, two lines each\n" + "".join(lines))


def binary_model(number=1, values=PINHOLE[1]):
    cameras = struct.pack(f"<QIiQQ{len(values)}d", 1, 7, number, 32, 24, *values)
    images = struct.pack("<Q", 2)
    for i, (pose, name) in enumerate(zip((SECOND, FIRST), NAMES, strict=True), 1):
        images += struct.pack("<I7dI", i, *pose, 7) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + 2 * struct.pack("<ddQ", 1.5, 2.5, 2**64 - 1)
    return cameras, images


def write_binary(model, number=1, values=PINHOLE[1]):
    model.mkdir(parents=True, exist_ok=True)
    cameras, images = binary_model(number, values)
    (model / "cameras.bin").write_bytes(cameras)
    (model / "images.bin").write_bytes(images)


def write_depth(path, shape=(24, 32), metres=2.0):
    path.parent.mkdir(parents=True, exist_ok=True)
    depth = np.full(shape, metres, "<f4")
    depth[0] = 0
    depth[-1] = metres + 1
    path.write_bytes(f"{shape[1]}&{shape[0]}&1&".encode() + depth.tobytes())


@pytest.fixture
def workspace(tmp_path, tiny):
    """Write a dense workspace without model and depth maps, which the tests add."""
    for name in NAMES:
        tiny.color(tmp_path / "images" / name)
    return tmp_path


@pytest.fixture
def scan_folder(workspace):
    for name in NAMES:
        write_depth(workspace / "stereo" / "depth_maps" / f"{name}.geometric.bin")
    return workspace


def assert_known_points(folder, tiny, **options):
    """Image IDs and names are in different orders: 2 comes before 10."""
    scan = read_scan(folder, ScanParams(**options))
    assert scan.layout == "colmap"
    assert [frame.name for frame in scan.frames] == ["left side/a view 2", "10"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)
    return scan


@pytest.mark.parametrize("place", ["sparse", "sparse/0", ".", "colmap/sparse/0", "colmap/sparse", "0"])
@pytest.mark.parametrize("write", [write_text, write_binary])
def test_known_points_come_out_in_the_world(scan_folder, tiny, place, write):
    write(scan_folder / place)
    for name in ("rigs", "frames"):
        (scan_folder / place / f"{name}.bin").write_bytes(b"of no use here")
    scan = assert_known_points(scan_folder, tiny)
    assert not scan.is_metric
    assert any("no metric scale" in text for text in map(str, scan.diagnostics))
    depth = read_depth(scan.frames[0])
    assert (depth[0, 5], depth[-1, 5]) == (0, 3)


def test_a_dense_workspace_below_the_project_is_found(scan_folder, tiny, tmp_path_factory):
    project = tmp_path_factory.mktemp("project")
    write_binary(scan_folder / "sparse")
    write_binary(project / "sparse" / "0", 5, (1, 1, 1, 1, 0, 0, 0, 0))
    (project / "dense").mkdir()
    scan_folder.rename(project / "dense" / "0")
    assert_known_points(project, tiny)


def test_points_lines_that_are_left_out(scan_folder, tiny):
    write_text(scan_folder / "sparse", empty_points=False)
    path = scan_folder / "sparse" / "images.txt"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if len(line.split()) != 3))
    assert_known_points(scan_folder, tiny)


def test_smaller_depth_maps_have_a_smaller_camera(scan_folder, tiny):
    write_text(scan_folder / "sparse", values=(200, 200, 33, 25))
    path = scan_folder / "sparse" / "cameras.txt"
    path.write_text(path.read_text().replace("32 24", "64 48"))
    for name in NAMES:
        image = np.zeros((48, 64, 3), np.uint8)
        image[34:36, 52:54] = 255  # covers the known pixel (26, 17) of the depth map
        cv2.imwrite(str(scan_folder / "images" / name), image)
    scan = assert_known_points(scan_folder, tiny)
    color = read_color_aligned_to_depth(scan.frames[0], read_depth(scan.frames[0]))
    assert [tuple(place) for place in np.argwhere(color[:, :, 0] > 128)] == [(17, 26)]


def test_a_scale_holds_for_depth_and_poses(scan_folder, tiny):
    write_text(scan_folder / "sparse")
    scan = read_scan(scan_folder, ScanParams(depth_scale=4.0))
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), np.array(point) / 4, atol=1e-6)
    assert scan.is_metric
    assert not any("no metric scale" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize(
    ("number", "values", "distortion"),
    [
        (0, (100, 16.5, 12.5), ()),
        (1, (100, 100, 16.5, 12.5), ()),
        (2, (100, 16.5, 12.5, 0.1), (0.1, 0, 0, 0)),
        (3, (100, 16.5, 12.5, 0.1, 0.2), (0.1, 0.2, 0, 0)),
        (4, (100, 100, 16.5, 12.5, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
        (4, (100, 100, 16.5, 12.5, 0, 0, 0, 0), ()),
    ],
)
@pytest.mark.parametrize("write", [write_text, write_binary])
def test_camera_models(scan_folder, number, values, distortion, write):
    write(scan_folder / "sparse", number, values)
    scan = read_scan(scan_folder)
    camera = scan.frames[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 100, 16, 12)
    assert camera.distortion == distortion
    assert any("distortion" in text for text in map(str, scan.diagnostics)) == bool(distortion)


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_unsupported_camera_models_are_refused_with_the_reason(scan_folder, write):
    write(scan_folder / "sparse", 10, (100, 100, 16.5, 12.5, *[0.0] * 8))
    with pytest.raises(InputError, match=r"THIN_PRISM_FISHEYE.*image_undistorter"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("number", "values", "distortion"),
    [
        (5, (100, 100, 16.5, 12.5, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
        (8, (100, 16.5, 12.5, 0.1), (0.1, 0, 0, 0)),
        (9, (100, 16.5, 12.5, 0.1, 0.2), (0.1, 0.2, 0, 0)),
        (9, (100, 16.5, 12.5, 0, 0), (0, 0, 0, 0)),
    ],
)
@pytest.mark.parametrize("write", [write_text, write_binary])
def test_fisheye_models(workspace, number, values, distortion, write):
    write(workspace / "sparse", number, values)
    camera = read_scan(workspace).frames[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 100, 16, 12)
    assert (camera.distortion, camera.fisheye) == (distortion, True)
    stated = read_scan(workspace, ScanParams(intrinsics="90,91,15,11")).frames[0].camera
    assert (stated.fx, stated.distortion, stated.fisheye) == (90, distortion, True)


@pytest.mark.parametrize("omega", [0.0, 0.6, 0.9, 1.1])
def test_a_lens_of_the_fov_model(workspace, omega):
    """The projection of the model is evaluated for a point (0.1, 0.05, 1) and a point far off axis."""
    write_text(workspace / "sparse", 7, (20, 22, 16.5, 12.5, omega))
    camera = read_scan(workspace).frames[0].camera
    for x, y in ((0.1, 0.05), (-0.5, 0.3)):
        far = np.hypot(x, y)
        bent = np.arctan(2 * far * np.tan(omega / 2)) / omega / far if omega else 1
        expected = (20 * x * bent + 16, 22 * y * bent + 12)
        if camera.fisheye:
            point, still = np.array([[[x, y, 1.0]]]), np.zeros(3)
            seen = cv2.fisheye.projectPoints(point, still, still, camera.matrix, np.array(camera.distortion))[
                0
            ].ravel()
        else:
            seen = camera.matrix[:2] @ (x, y, 1)
        np.testing.assert_allclose(seen, expected, atol=0.01)
    assert camera.fisheye == (omega > 0)


@pytest.mark.parametrize("omega", [-1, 3.5, 2.9])
def test_lenses_of_the_fov_model_that_cannot_be_read(workspace, omega):
    write_text(workspace / "sparse", 7, (500, 500, 16.5, 12.5, omega))
    path = workspace / "sparse" / "cameras.txt"
    path.write_text(path.read_text().replace("32 24", "3200 2400").replace("16.5 12.5", "1600 1200"))
    with pytest.raises(InputError, match=r"cameras\.txt.*FOV lens"):
        read_scan(workspace)


def test_a_fisheye_view_becomes_the_view_of_a_pinhole(workspace):
    """A fisheye: a point at 45° is π/4 · 10 pixels from the centre, and 10 pixels after undistortion."""
    write_text(workspace / "sparse", 5, (10, 10, 16.5, 12.5, 0, 0, 0, 0))
    u, v = np.meshgrid(np.arange(32.0), np.arange(24.0))
    image = np.zeros((24, 32, 3), np.uint8)
    image[:, :, 1] = 255 * np.exp(-((u - 16 - 10 * np.pi / 4) ** 2 + (v - 12) ** 2) / 2)
    cv2.imwrite(str(workspace / "images" / NAMES[1]), image)
    frame = next(one for one in read_scan(workspace).frames if one.name == "left side/a view 2")
    green = read_pinhole(frame)[:, :, 1]
    assert np.unravel_index(green.argmax(), green.shape) == (12, 16 + 10)


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_the_largest_of_several_models_is_read_and_reported(scan_folder, tiny, write):
    # The first model contains only one of the images, in a different world.
    write(scan_folder / "sparse" / "0")
    if write is write_text:
        path = scan_folder / "sparse" / "0" / "images.txt"
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:3]).replace("3 -2", "9 -9"))
    else:
        path = scan_folder / "sparse" / "0" / "images.bin"
        one = (len(path.read_bytes()) - 8 - len(NAMES[1]) + len(NAMES[0])) // 2
        path.write_bytes(struct.pack("<Q", 1) + path.read_bytes()[8 : 8 + one])
    for number in ("1", "10"):
        write(scan_folder / "sparse" / number)
    scan = assert_known_points(scan_folder, tiny)
    said = [text for text in map(str, scan.diagnostics) if "has 3 models" in text]
    assert ["0/ (1), 1/ (2), 10/ (2)" in text for text in said] == [True]


def test_undistorted_images_without_depth_maps(workspace, tiny, tmp_path_factory):
    project = tmp_path_factory.mktemp("project")
    write_binary(workspace / "sparse")
    workspace.rename(project / "dense")
    tiny.assert_views(read_scan(project))


# 30 points in front of each view, 1 to 3 m away along its axis; the second faces +x from (1, 2, 3).
AWAY = np.linspace(1, 3, 30)
POINTS = [(0.0, 0.0, z) for z in AWAY] + [(1 + x, 2.0, 3.0) for x in AWAY]
# Image IDs as written: FIRST is 2, SECOND is 1; there is no 7.
SEEN = [(2,)] * 30 + [(1, 7)] * 30


def text_points():
    return "# points\n" + "".join(
        f"{n} {x} {y} {z} 9 9 9 0.5 {' '.join(f'{image} {n}' for image in seen)}\n"
        for n, ((x, y, z), seen) in enumerate(zip(POINTS, SEEN, strict=True))
    )


def binary_points():
    data = struct.pack("<Q", len(POINTS))
    for n, (point, seen) in enumerate(zip(POINTS, SEEN, strict=True)):
        data += struct.pack("<Q3d3BdQ", n, *point, 9, 9, 9, 0.5, len(seen))
        data += b"".join(struct.pack("<II", image, n) for image in seen)
    return data


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_views_without_any_depth_are_single_views_with_a_range_of_depth(workspace, tiny, write):
    write(workspace / "sparse")
    points = text_points().encode() if write is write_text else binary_points()
    (workspace / "sparse" / f"points3D.{'txt' if write is write_text else 'bin'}").write_bytes(points)
    scan = read_scan(workspace)
    tiny.assert_views(scan)
    assert [frame.name for frame in scan.frames] == ["left side/a view 2", "10"]
    # The 2nd and the 98th percentile are 1.04 m and 2.96 m, and the range has a margin.
    for frame in scan.frames:
        near, far = frame.depth_range
        assert 0.75 < near < 1.0
        assert 3.0 < far < 6.0
    assert len(scan.diagnostics) == 1
    assert "no metric scale" in str(scan.diagnostics[0])
    scaled = read_scan(workspace, ScanParams(depth_scale=2))
    np.testing.assert_allclose(scaled.frames[1].world_from_camera[:3, 3], (0.5, 1, 1.5), atol=1e-9)
    np.testing.assert_allclose(scaled.frames[1].depth_range, (near / 2, far / 2), rtol=1e-9)


def test_single_views_without_points(workspace, tiny):
    write_text(workspace / "sparse")
    scan = read_scan(workspace)
    tiny.assert_views(scan)
    assert [frame.depth_range for frame in scan.frames] == [None, None]
    assert any("no points" in text and "depth.min_depth" in text for text in map(str, scan.diagnostics))


def test_single_views_may_be_distorted_and_smaller_than_their_cameras(workspace):
    write_text(workspace / "sparse", 4, (200, 200, 33, 25, 0.1, 0, 0, 0))
    path = workspace / "sparse" / "cameras.txt"
    path.write_text(path.read_text().replace("32 24", "64 48"))
    scan = read_scan(workspace)
    camera = scan.frames[0].camera
    assert (camera.width, camera.fx, camera.cx, camera.cy) == (32, 100, 16, 12)
    assert camera.distortion == (0.1, 0, 0, 0)
    assert not any("distortion" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize("end", [".bin", ".txt"])
def test_damaged_points_are_reported(workspace, end):
    write_text(workspace / "sparse")
    path = workspace / "sparse" / f"points3D{end}"
    sound = binary_points() if end == ".bin" else b"1 0 0 2 9 9 9 0.5 2 1\n"
    cuts = (4, 30, len(sound) - 3) if end == ".bin" else (3, 12, len(sound) - 3)
    for end_of_file in cuts:
        path.write_bytes(sound[:end_of_file])
        with pytest.raises(InputError, match="points3D"):
            read_scan(workspace)
    for wrong in (b"1 x 0 2 9 9 9 0.5 2 1\n", b"1 0 0 2 9 9 9 0.5 2.5 1\n", b"9" * 5000) * (end == ".txt"):
        path.write_bytes(wrong)
        with pytest.raises(InputError, match="line 1"):
            read_scan(workspace)
    if end == ".bin":
        path.write_bytes(struct.pack("<Q", 2**63) + sound[8:])
        with pytest.raises(InputError, match="truncated"):
            read_scan(workspace)
    else:
        path.write_bytes(b"".join(b"%d nan inf 1e400 9 9 9 0.5 2 1\n" % n for n in range(30)))
        assert read_scan(workspace).frames[0].depth_range is None


def test_photometric_maps_replace_missing_ones_and_are_reported(workspace, tiny):
    write_text(workspace / "sparse")
    for name in NAMES:
        write_depth(workspace / "stereo" / "depth_maps" / f"{name}.photometric.bin")
    scan = assert_known_points(workspace, tiny)
    assert any(text.startswith("2 depth maps are photometric") for text in map(str, scan.diagnostics))


def test_a_view_without_depth_or_with_a_damaged_map_is_skipped(scan_folder):
    write_text(scan_folder / "sparse")
    path = scan_folder / "stereo" / "depth_maps" / f"{NAMES[0]}.geometric.bin"
    path.unlink()
    scan = read_scan(scan_folder)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [("10", "its depth map is missing.")]
    for data in (b"", b"32&24", b"32&24&1&" + bytes(100), b"999999999&999999999&1&", b"0&0&1&", b"32&24&3&"):
        path.write_bytes(data)
        scan = read_scan(scan_folder)
        assert [one.name for one in scan.skipped_frames] == ["10"]
        assert "10.png.geometric.bin" in scan.skipped_frames[0].reason


def test_a_map_of_another_shape_is_skipped(scan_folder):
    write_text(scan_folder / "sparse")
    write_depth(scan_folder / "stereo" / "depth_maps" / f"{NAMES[0]}.geometric.bin", (24, 24))
    assert "24×24" in read_scan(scan_folder).skipped_frames[0].reason


@pytest.mark.parametrize("name", ["../../out.png", "/etc/out.png", "x" * 300, "x\0y"])
def test_names_stay_below_the_folder(scan_folder, name):
    write_text(scan_folder / "sparse")
    path = scan_folder / "sparse" / "images.txt"
    path.write_text(path.read_text().replace("10.png", name))
    with pytest.raises(InputError, match="not a path inside"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("cameras.txt", "7 PINHOLE 32 24 100 100 16.5\n"),
        ("cameras.txt", "7 PINHOLE 32 x 100 100 16.5 12.5\n"),
        ("cameras.txt", "7 PINHOLE 32000000 24000000 100 100 16.5 12.5\n"),
        ("cameras.txt", "7 PINHOLE 32 24 nan 100 16.5 12.5\n"),
        ("cameras.txt", "7 LENS 32 24 1\n"),
        ("cameras.txt", "7\n"),
        ("images.txt", "1 1 0 0 0 0 0 0 8 10.png\n\n"),
        ("images.txt", "1 9 9 9 9 0 0 0 7 10.png\n\n"),
        ("images.txt", "1 nan 0 0 0 0 0 0 7 10.png\n\n"),
        ("images.txt", "hello\n"),
        ("images.txt", "\xff\xfe\x00"),
    ],
)
def test_wrong_text_models_are_refused(scan_folder, file, text):
    write_text(scan_folder / "sparse")
    (scan_folder / "sparse" / file).write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=file):
        read_scan(scan_folder)


@pytest.mark.parametrize("which", [0, 1])
def test_binary_models_cut_anywhere_are_refused(scan_folder, which):
    write_binary(scan_folder / "sparse")
    file = ("cameras.bin", "images.bin")[which]
    data = binary_model()[which]
    for end in range(len(data)):
        (scan_folder / "sparse" / file).write_bytes(data[:end])
        with pytest.raises(InputError, match=file):
            read_scan(scan_folder)


@pytest.mark.slow
@pytest.mark.parametrize("value", [0x00, 0x7F, 0xFF])
def test_any_damaged_byte_of_points_is_refused_or_read(workspace, value):
    write_text(workspace / "sparse")
    data = binary_points()
    # Every byte of the first two points of one image, of the first two points of two images, and of the last
    # point.
    one, two = 59, 67
    middle = 8 + 30 * one
    assert len(data) == middle + 30 * two
    for at in (*range(8 + 2 * one), *range(middle, middle + two), *range(len(data) - two, len(data))):
        (workspace / "sparse" / "points3D.bin").write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
        try:
            for frame in read_scan(workspace, ScanParams(layout="colmap")).frames:
                assert frame.depth_range is None or 0 < frame.depth_range[0] < frame.depth_range[1] < 1e10
        except InputError as error:
            assert "points3D.bin" in str(error)  # noqa: PT017


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("value", [0x00, 0x7F, 0xFF])
def test_any_damaged_byte_is_refused_or_read(scan_folder, which, value):
    write_binary(scan_folder / "sparse")
    file = ("cameras.bin", "images.bin")[which]
    data = binary_model()[which]
    for at in range(len(data)):
        (scan_folder / "sparse" / file).write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
        try:
            for frame in read_scan(scan_folder).frames:
                read_depth(frame)
        except InputError as error:
            assert str(scan_folder) in str(error)  # noqa: PT017


def test_a_dense_workspace_is_read_and_reported(scan_folder, tiny, tmp_path_factory):
    write_text(scan_folder / "sparse")
    project = tmp_path_factory.mktemp("project")
    write_text(project / "sparse" / "0", values=(90, 90, 16.5, 12.5))
    (project / "dense").mkdir()
    # Without depth maps, which would have priority.
    shutil.rmtree(scan_folder / "stereo")
    scan_folder.rename(project / "dense" / "0")
    scan = read_scan(project)
    tiny.assert_views(scan)
    said = (
        "the images of sparse/0/ are missing or have another shape: "
        "dense/0/, whose images match, is read instead"
    )
    assert said in map(str, scan.diagnostics)
    # Images in the root folder have priority.
    for name in NAMES:
        tiny.color(project / "images" / name)
    scan = read_scan(project)
    assert scan.frames[0].camera.fx == 90
    assert said not in map(str, scan.diagnostics)


@pytest.mark.parametrize("with_confidence", [True, False])
def test_depth_that_a_network_predicted(workspace, with_confidence):
    write_binary(workspace / "sparse")
    confidence = np.full((12, 16), 8.0, np.float32)
    confidence[2, 3] = 1.0
    for name in NAMES:
        for folder, values in (("depth", np.full((12, 16, 1), 2.0, np.float32)), ("conf", confidence)):
            path = (workspace / folder / name).with_suffix(".npy")
            path.parent.mkdir(parents=True, exist_ok=True)
            if folder == "depth" or with_confidence:
                np.save(path, values)
    scan = read_scan(workspace)
    assert (scan.layout, scan.is_depth_predicted, scan.skipped_frames) == ("colmap", True, ())
    depth = read_depth(scan.frames[0])
    assert depth.shape == (12, 16)
    assert depth[2, 3] == (0 if with_confidence else 2)
    assert depth[5, 5] == 2
    assert scan.frames[0].camera.fx == 50


def test_predicted_depth_of_another_shape_is_skipped(workspace):
    write_binary(workspace / "sparse")
    (workspace / "depth").mkdir()
    np.save(workspace / "depth" / "10.npy", np.full((12, 16, 2), 2.0, np.float32))
    with pytest.raises(InputError, match="none of its 2"):
        read_scan(workspace)
