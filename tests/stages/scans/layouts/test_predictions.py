import cv2
import numpy as np
import pytest
from predicted_views import FOCAL, HEIGHT, WIDTH, make_views

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

VIEWS = make_views()


def write_photos(folder, mapping, factor=4):
    """Write larger photos; `mapping` maps a stretched one to the photo of the camera."""
    folder.mkdir()
    for number, color in enumerate(VIEWS.colors):
        large = cv2.resize(color, (factor * WIDTH, factor * HEIGHT), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / f"photo {number + 10}.png"), mapping(large)[:, :, ::-1])


def assert_views(scan, names=None):
    assert (scan.layout, len(scan.frames), scan.is_metric) == ("predictions", len(VIEWS.depth), False)
    for number, frame in enumerate(scan.frames):
        assert frame.name == (names or [f"{n:06d}" for n in range(9)])[number]
        np.testing.assert_allclose(frame.world_from_camera, VIEWS.poses[number], atol=1e-5)
        np.testing.assert_allclose(read_depth(frame), VIEWS.depth[number], rtol=1e-6)
        assert (frame.camera.fx, frame.camera.cx, frame.camera.cy) == (FOCAL, WIDTH / 2, HEIGHT / 2)


@pytest.mark.parametrize("is_file", [False, True])
def test_predictions_of_vggt(tmp_path, is_file):
    archive = VIEWS.write(tmp_path)
    scan = read_scan(archive if is_file else tmp_path)
    assert_views(scan)
    for frame, color in zip(scan.frames, VIEWS.colors, strict=True):
        np.testing.assert_array_equal(read_color(frame), color)


def test_results_of_depth_anything_3(tmp_path):
    archive = tmp_path / "exports" / "npz" / "results.npz"
    archive.parent.mkdir(parents=True)
    np.savez_compressed(
        archive,
        image=VIEWS.colors,
        depth=VIEWS.depth,
        conf=np.full(VIEWS.depth.shape, 3.5, np.float32),
        extrinsics=np.linalg.inv(VIEWS.poses),
        intrinsics=VIEWS.intrinsics,
    )
    scan = read_scan(tmp_path)
    assert_views(scan)
    np.testing.assert_array_equal(read_color(scan.frames[2]), VIEWS.colors[2])


def test_poses_and_focal_lengths(tmp_path):
    focals = np.full((len(VIEWS.poses), 1), FOCAL)
    VIEWS.write(tmp_path, extrinsic=None, intrinsic=None, camera_poses=VIEWS.poses[None], focals=focals)
    assert_views(read_scan(tmp_path))


def write_view_files(root, **changes):
    """Write the files of CUT3R, with changes of the camera of view 2."""
    for folder in ("depth", "conf", "color", "camera"):
        (root / folder).mkdir()
    for number, pose in enumerate(VIEWS.poses):
        name = f"{number:06d}"
        np.save(root / "depth" / f"{name}.npy", VIEWS.depth[number])
        np.save(root / "conf" / f"{name}.npy", np.full((HEIGHT, WIDTH), 2.0))
        cv2.imwrite(str(root / "color" / f"{name}.png"), VIEWS.colors[number][:, :, ::-1])
        camera = {"pose": pose, "intrinsics": VIEWS.intrinsics[0]} | (changes if number == 2 else {})
        np.savez(root / "camera" / f"{name}.npz", **camera)


def test_files_of_cut3r(tmp_path):
    write_view_files(tmp_path)
    scan = read_scan(tmp_path)
    assert_views(scan)
    np.testing.assert_array_equal(read_color(scan.frames[2]), VIEWS.colors[2])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pose", np.eye(3)),
        ("pose", np.array("x")),
        ("intrinsics", np.eye(3)[:2]),
        ("intrinsics", np.array("x")),
    ],
)
def test_a_camera_of_another_shape_is_refused(tmp_path, name, value):
    write_view_files(tmp_path, **{name: value})
    with pytest.raises(InputError, match=r"000002\.npz"):
        read_scan(tmp_path)


# How the network made its image from a photo; then left, top, and scales of the image in the photo.
MAPPINGS = {
    "stretched": (lambda image: cv2.resize(image, (4 * WIDTH, 4 * HEIGHT - 3)), 0, 0, 4, 4 - 3 / HEIGHT),
    "cropped": (lambda image: cv2.copyMakeBorder(image, 30, 30, 0, 0, cv2.BORDER_CONSTANT), 0, 30, 4, 4),
    "padded": (lambda image: image[30:-30], 0, -30, 4, 4),
}


# Without images, photos of another shape count as cropped.
@pytest.mark.parametrize(
    ("name", "has_images"),
    [("stretched", True), ("cropped", True), ("padded", True), ("stretched", False), ("cropped", False)],
)
def test_photos_replace_the_images_of_the_network(tmp_path, name, has_images):
    mapping, left, top, across, down = MAPPINGS[name]
    VIEWS.write(tmp_path, **({} if has_images else {"images": None}))
    write_photos(tmp_path / "images", mapping)
    scan = read_scan(tmp_path)
    assert_views(scan, [f"photo {number + 10}" for number in range(len(VIEWS.poses))])
    camera = scan.frames[0].color_camera
    assert camera.width == 4 * WIDTH
    assert camera.fx == pytest.approx(FOCAL * across)
    assert camera.fy == pytest.approx(FOCAL * down)
    assert camera.cx == pytest.approx((WIDTH / 2 + 0.5) * across - 0.5 + left)
    assert camera.cy == pytest.approx((HEIGHT / 2 + 0.5) * down - 0.5 + top)


@pytest.mark.parametrize("fault", ["count", "content"])
def test_photos_of_something_else_are_not_used(tmp_path, fault):
    VIEWS.write(tmp_path)
    write_photos(tmp_path / "images", lambda image: image if fault == "count" else 255 - image)
    if fault == "count":
        (tmp_path / "images" / "photo 10.png").unlink()
    scan = read_scan(tmp_path)
    assert_views(scan)
    assert scan.frames[0].color_camera is None
    assert "scan.images-unpaired" in [one.code for one in scan.diagnostics]


def test_depth_of_low_confidence_is_dropped(tmp_path):
    confidence = np.full(VIEWS.depth.shape, 9.0, np.float32)
    confidence[:, 3:7, 5:9] = 2.5
    confidence[0, 0, 0] = np.nan
    VIEWS.write(tmp_path, depth_conf=confidence)
    depth = read_depth(read_scan(tmp_path).frames[0])
    np.testing.assert_array_equal(depth == 0, ~(confidence[0] > 3))
    everything = read_scan(tmp_path, ScanParams(min_confidence=0))
    assert (read_depth(everything.frames[0]) > 0).all()


def test_scale_and_offset_of_each_view_are_corrected(tmp_path):
    rng = np.random.default_rng(5)
    scales = 1 + 0.08 * rng.standard_normal((6, 1, 1))
    offsets = 0.05 * rng.standard_normal((6, 1, 1))
    scales, offsets = scales / scales.mean(), offsets - offsets.mean()
    VIEWS.write(tmp_path, depth=(scales * VIEWS.depth + offsets).astype(np.float32))
    scan = read_scan(tmp_path)
    assert "scan.depth-aligned" in [one.code for one in scan.diagnostics]
    ratio = np.array(
        [np.median(read_depth(one) / exact) for one, exact in zip(scan.frames, VIEWS.depth, strict=True)]
    )
    assert np.abs(scales.ravel() - 1).max() > 0.08
    np.testing.assert_allclose(ratio, 1, atol=0.012)


def test_consistent_depth_is_not_changed(tmp_path):
    VIEWS.write(tmp_path)
    scan = read_scan(tmp_path)
    assert "scan.depth-aligned" not in [one.code for one in scan.diagnostics]
    assert_views(scan)


def test_views_without_overlap_are_not_changed(tmp_path):
    extrinsics = VIEWS.extrinsics.copy()
    extrinsics[:, :, 3] += 100 * np.arange(6)[:, None]
    VIEWS.write(tmp_path, extrinsic=extrinsics)
    for frame, exact in zip(read_scan(tmp_path).frames, VIEWS.depth, strict=True):
        np.testing.assert_allclose(read_depth(frame), exact, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float16, np.float64])
def test_images_of_any_number_type(tmp_path, dtype):
    images = VIEWS.colors / (255 if np.dtype(dtype).kind == "f" else 1)
    scan = read_scan(VIEWS.write(tmp_path, images=images.astype(dtype)))
    np.testing.assert_array_equal(read_color(scan.frames[3]), VIEWS.colors[3])


def test_depth_beyond_single_precision_is_missing(tmp_path):
    depth = VIEWS.depth.astype(np.float64)
    depth[1, 5, 5], depth[1, 6, 6] = 1e300, np.nan
    found = read_depth(read_scan(VIEWS.write(tmp_path, depth=depth)).frames[1])
    assert (found[5, 5], found[6, 6]) == (0, 0)
    assert np.count_nonzero(found == 0) == 2


def test_a_view_without_valid_depth_is_not_compared(tmp_path):
    depth = VIEWS.depth.copy()
    depth[2] = 0
    VIEWS.write(tmp_path, depth=depth)
    scan = read_scan(tmp_path)
    np.testing.assert_allclose(read_depth(scan.frames[1]), VIEWS.depth[1], rtol=1e-6)


def test_a_single_view(tmp_path):
    arrays = {name: np.asarray(array)[:1] for name, array in VIEWS.to_arrays().items()}
    np.savez(tmp_path / "predictions.npz", **arrays)
    assert len(read_scan(tmp_path).frames) == 1


def test_scale_applies_to_poses_and_depth(tmp_path):
    VIEWS.write(tmp_path)
    scan = read_scan(tmp_path, ScanParams(scale=2.0))
    assert scan.is_metric
    np.testing.assert_allclose(read_depth(scan.frames[1]), 2 * VIEWS.depth[1], rtol=1e-6)
    np.testing.assert_allclose(scan.frames[1].world_from_camera[:3, 3], 2 * VIEWS.poses[1, :3, 3], atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"extrinsic": np.zeros((6, 12))}, "extrinsic"),
        ({"extrinsic": np.full((6, 3, 4), 3.0)}, "not rigid"),
        ({"intrinsic": None}, "intrinsic is missing"),
        ({"intrinsic": np.zeros((6, 3, 4))}, "intrinsic"),
        ({"depth": np.zeros((6, 3))}, "depth"),
        ({"depth": np.zeros((0, 3, 4))}, "depth"),
        ({"depth_conf": np.zeros((5, HEIGHT, WIDTH))}, "depth_conf"),
    ],
)
def test_unsuitable_arrays_are_refused(tmp_path, changes, message):
    archive = VIEWS.write(tmp_path, **changes)
    with pytest.raises(InputError, match=message):
        read_scan(archive)


def test_images_of_another_shape_are_refused(tmp_path):
    scan = read_scan(VIEWS.write(tmp_path, images=np.zeros((6, 3, 5, 5), np.float32)))
    with pytest.raises(InputError, match="images"):
        read_color(scan.frames[0])


def test_an_archive_without_images_needs_photos(tmp_path):
    VIEWS.write(tmp_path, images=None)
    with pytest.raises(InputError, match=r"no images.*into images/"):
        read_scan(tmp_path)


def test_a_view_with_an_impossible_camera_is_skipped(tmp_path):
    matrices = VIEWS.intrinsics
    matrices[2, 0, 0] = np.nan
    scan = read_scan(VIEWS.write(tmp_path, intrinsic=matrices))
    assert [one.name for one in scan.skipped_frames] == ["000002"]


def test_objects_are_never_unpickled(tmp_path):
    archive = VIEWS.write(tmp_path, depth=np.array([{"a": 1}], object))
    with pytest.raises(InputError, match="depth is missing"):
        read_scan(archive)


@pytest.mark.parametrize("is_packed", [False, True])
def test_a_truncated_archive_is_refused(tmp_path, is_packed):
    save = np.savez_compressed if is_packed else np.savez
    save(tmp_path / "a.npz", **VIEWS.to_arrays())
    data = (tmp_path / "a.npz").read_bytes()
    for cut in (10, len(data) // 2, len(data) - 5):
        (tmp_path / "b.npz").write_bytes(data[:cut])
        with pytest.raises(InputError):
            read_scan(tmp_path / "b.npz")


def test_arrays_that_expand_a_thousand_times_are_refused(tmp_path):
    depth, images = np.zeros((6, 2048, 2048), np.float32), np.zeros((6, 3, 2048, 2048), np.uint8)
    scan_file = tmp_path / "a.npz"
    np.savez_compressed(scan_file, **VIEWS.to_arrays(depth=depth, depth_conf=None, images=images))
    assert scan_file.stat().st_size < 1 << 18
    with pytest.raises(InputError, match="too large"):
        read_scan(scan_file)


def test_an_archive_of_something_else_is_no_scan(tmp_path):
    np.savez(tmp_path / "calibration.npz", mtx=np.eye(3), dist=np.zeros(5))
    with pytest.raises(InputError, match="unknown layout"):
        read_scan(tmp_path)
