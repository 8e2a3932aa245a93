import json
import zipfile

import cv2
import lzfse
import numpy as np
import OpenEXR
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

FACTOR = 4
HALF = 0.5**0.5
# Quaternion x y z w, then the position. OpenGL's camera is rotated by 180° about x: for the first pose, (1,
# 0, 0, 0). The second adds 90° about +y: (0, h, 0, h) · (1, 0, 0, 0) = (h, 0, -h, 0).
POSES = [[1, 0, 0, 0, 0, 0, 0], [HALF, 0, -HALF, 0, 1, 2, 3]]


def metadata(tiny, **change):
    camera = tiny.scaled_intrinsics(FACTOR)
    k = [camera["fx"], 0, 0, 0, camera["fy"], 0, camera["cx"], camera["cy"], 1]
    table = {"w": 32 * FACTOR, "h": 24 * FACTOR, "dw": 32, "dh": 24, "K": k, "fps": 60, "poses": POSES}
    return json.dumps(table | {"frameTimestamps": [10.5, 10.75]} | change)


def depth_map():
    depth = np.full((24, 32), 2, np.float32)
    depth[0, 0] = np.nan
    return depth


def trust():
    confidence = np.full((24, 32), 2, np.uint8)
    confidence[3, 4:6] = (0, 1)
    return confidence


def write_folder(folder, tiny, suffix=".exr"):
    (folder / "depth").mkdir()
    for number in (0, 1):
        tiny.dotted_file(folder / "rgb" / f"{number}.png", FACTOR)
        path = folder / "depth" / f"{number}{suffix}"
        if suffix == ".exr":
            OpenEXR.File({}, {"R": depth_map()}).write(str(path))
        elif suffix == ".npy":
            np.save(path, depth_map())
        else:
            tiny.depth(path, 1000)
    (folder / "metadata.json").write_text(metadata(tiny))


def write_archive(path, tiny, entries=(), **change):
    sharp = (
        cv2.IMWRITE_JPEG_QUALITY,
        100,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    )
    image = np.ascontiguousarray(tiny.dotted(FACTOR)[:, :, ::-1])
    files = {"metadata": metadata(tiny, **change).encode()}
    for number in (0, 1):
        files[f"rgbd/{number}.jpg"] = cv2.imencode(".jpg", image, sharp)[1].tobytes()
        files[f"rgbd/{number}.depth"] = lzfse.compress(depth_map().tobytes())
        files[f"rgbd/{number}.conf"] = lzfse.compress(trust().tobytes())
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (files | dict(entries)).items():
            if data is not None:
                archive.writestr(name, data)


@pytest.fixture(params=[".exr", ".npy", ".png", ".r3d"])
def scan_folder(request, tmp_path, tiny):
    """Write a scan in each of the forms that Record3D exports."""
    if request.param == ".r3d":
        write_archive(tmp_path / "take.r3d", tiny)
    else:
        write_folder(tmp_path, tiny, request.param)
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "record3d"
    assert [frame.timestamp for frame in scan.frames] == [10_500_000_000, 10_750_000_000]
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)
    assert read_depth(scan.frames[0])[0, 0] == 0


def test_colour_is_sampled_at_its_own_resolution(scan_folder, tiny):
    frames = read_scan(scan_folder).frames
    assert read_color(frames[0]).shape == (24 * FACTOR, 32 * FACTOR, 3)
    assert all(tiny.green_is_at_the_pixel(frame) for frame in frames)


@pytest.mark.parametrize(("least", "kept"), [(None, [0, 2, 2]), (0, [2, 2, 2]), (2, [0, 0, 2])])
@pytest.mark.parametrize("packed", [True, False])
def test_depth_of_little_confidence_is_left_out(tmp_path, tiny, packed, least, kept):
    if packed:
        write_archive(tmp_path / "take.r3d", tiny)
    else:
        write_folder(tmp_path, tiny)
        (tmp_path / "confidence").mkdir()
        for number in (0, 1):
            cv2.imwrite(str(tmp_path / "confidence" / f"{number}.png"), trust())
    scan = read_scan(tmp_path, ScanParams(min_confidence=least))
    assert read_depth(scan.frames[1])[3, 4:7].tolist() == kept
    assert any(
        f"confidence {1 if least is None else least} or higher" in text for text in map(str, scan.diagnostics)
    )


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_a_damaged_depth_map_costs_its_frame(tmp_path, tiny, suffix):
    write_folder(tmp_path, tiny, suffix)
    (tmp_path / "depth" / f"0{suffix}").write_bytes(b"hello")
    first, second = read_scan(tmp_path).frames
    np.testing.assert_allclose(tiny.seen(second), tiny.points[1], atol=1e-6)
    with pytest.raises(InputError, match=rf"0\{suffix}: "):
        read_depth(first)


def test_intrinsics_of_a_frame_are_its_own(tmp_path, tiny):
    write_folder(tmp_path, tiny)
    fx, fy, cx, cy = tiny.scaled_intrinsics(FACTOR).values()
    own = [[fx * 2, fy, cx, cy], [fx, fy, cx, cy]]
    (tmp_path / "metadata.json").write_text(metadata(tiny, perFrameIntrinsicCoeffs=own))
    seen = [tiny.seen(frame) for frame in read_scan(tmp_path).frames]
    np.testing.assert_allclose(seen, [(0.1, 0.1, 2), tiny.points[1]], atol=1e-6)


def test_the_front_camera_has_no_poses(scan_folder, tiny):
    still = [[0, 0, 0, 1, 0, 0, 0]] * 2
    if (scan_folder / "take.r3d").exists():
        write_archive(scan_folder / "take.r3d", tiny, poses=still)
    else:
        (scan_folder / "metadata.json").write_text(metadata(tiny, poses=still))
    with pytest.raises(InputError, match="no poses: all 2 frames have the same pose"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": [1, 2, 3]}, "K in the metadata must be 9 numbers"),
        ({"K": None}, "K in the metadata must be 9 numbers"),
        ({"K": "x"}, "K is not a matrix"),
        ({"K": [400, 0, 66, 0, 400, 50, 0, 0, 1]}, "column-major"),
        ({"w": None}, "w in the metadata is 'None'"),
        ({"w": 24 * FACTOR, "h": 32 * FACTOR, "K": [400, 0, 0, 0, 400, 0, 40, 60, 1]}, "rotated by 90°"),
        ({"poses": []}, "no list of poses"),
        ({"poses": POSES[:1]}, "1 poses, but the scan has 2 frames"),
        ({"poses": [[1, 2, 3], [1, 2, 3]]}, "must be 7 numbers"),
        ({"poses": ["x", "y"]}, "not a matrix of numbers"),
        ({"poses": [[0, 0, 0, 9, 0, 0, 0]] * 2}, "quaternion has length 9"),
        ({"frameTimestamps": ["now", 2]}, "invalid timestamp 'now'"),
        ({"perFrameIntrinsicCoeffs": [[1, 2], [3, 4]]}, "must be 4 numbers"),
    ],
)
@pytest.mark.parametrize("packed", [True, False])
def test_damaged_metadata_is_one_sentence(tmp_path, tiny, packed, change, message):
    if packed:
        write_archive(tmp_path / "take.r3d", tiny, **change)
    else:
        write_folder(tmp_path, tiny)
        (tmp_path / "metadata.json").write_text(metadata(tiny, **change))
    with pytest.raises(InputError, match=message):
        read_scan(tmp_path)


def test_without_depth_the_reason_is_reported(tmp_path, tiny):
    write_archive(tmp_path / "take.r3d", tiny, {"rgbd/0.depth": None, "rgbd/1.depth": None})
    with pytest.raises(InputError, match="this layout requires depth"):
        read_scan(tmp_path)
    (tmp_path / "take.r3d").unlink()
    write_folder(tmp_path, tiny)
    for file in (tmp_path / "depth").iterdir():
        file.unlink()
    with pytest.raises(InputError, match="this layout requires depth"):
        read_scan(tmp_path)


def test_a_packed_frame_without_depth_is_left_out(tmp_path, tiny):
    write_archive(tmp_path / "take.r3d", tiny, {"rgbd/0.depth": None})
    scan = read_scan(tmp_path)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [("0", "its depth map is missing")]
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points[1:], atol=1e-6)


def test_the_size_of_packed_depth_is_known_by_its_length(tmp_path, tiny):
    """Older recordings lack the size: the LiDAR of a phone gives 256×192."""
    camera = tiny.scaled_intrinsics(FACTOR)
    large = lzfse.compress(np.full((192, 256), 2, np.float32).tobytes())
    entries = {"rgbd/0.depth": large, "rgbd/1.depth": large, "rgbd/0.conf": None, "rgbd/1.conf": None}
    write_archive(tmp_path / "take.r3d", tiny, entries, dw=None, dh=None)
    frame = read_scan(tmp_path).frames[0]
    assert read_depth(frame).shape == (192, 256)
    np.testing.assert_allclose(frame.camera.fx, camera["fx"] * 2)


@pytest.mark.parametrize(
    ("entry", "data"),
    [
        ("rgbd/0.depth", lambda: b""),
        ("rgbd/0.depth", lambda: b"hello"),
        ("rgbd/0.depth", lambda: lzfse.compress(bytes(100))),
        ("rgbd/0.depth", lambda: lzfse.compress(depth_map().tobytes())[:-10]),
        # Created lazily, because it takes seconds.
        pytest.param("rgbd/0.depth", lambda: lzfse.compress(bytes(1 << 26)), marks=pytest.mark.slow),
        ("rgbd/0.conf", lambda: lzfse.compress(bytes(10))),
    ],
)
def test_a_damaged_packed_depth_is_reported(tmp_path, tiny, entry, data):
    write_archive(tmp_path / "take.r3d", tiny, {entry: data()})
    with pytest.raises(InputError, match=rf"take\.r3d: {entry}: "):
        read_depth(read_scan(tmp_path).frames[0])


def test_a_damaged_packed_image_is_reported(tmp_path, tiny):
    turned = cv2.imencode(".jpg", np.zeros((32 * FACTOR, 24 * FACTOR, 3), np.uint8))[1].tobytes()
    for data, message in ((b"hello", "does not decode"), (turned, "rotated by 90°"), (turned[:80], "image")):
        write_archive(tmp_path / "take.r3d", tiny, {"rgbd/0.jpg": data})
        with pytest.raises(InputError, match=message):
            read_color(read_scan(tmp_path).frames[0])


def test_an_archive_cut_short_or_damaged_is_reported(tmp_path, tiny):
    path = tmp_path / "take.r3d"
    write_archive(path, tiny)
    data = path.read_bytes()
    for content in (b"", b"hello", data[: len(data) // 2], data[:-30]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"take\.r3d: "):
            read_scan(tmp_path)
    at = data.index(b"bvx")
    path.write_bytes(data[: at + 20] + b"\xff" + data[at + 21 :])
    with pytest.raises(InputError, match=r"rgbd/0\.depth cannot be read from the archive"):
        read_depth(read_scan(tmp_path).frames[0])
    write_archive(path, tiny, {"metadata": None})
    with pytest.raises(InputError, match="metadata cannot be read"):
        read_scan(tmp_path)
    for text in (b"{", b"[]", b"\xff\xfe"):
        write_archive(path, tiny, {"metadata": text})
        with pytest.raises(InputError, match=r"take\.r3d: "):
            read_scan(tmp_path)


def test_two_recordings_in_a_folder_are_not_mixed(tmp_path, tiny):
    for name in ("a.r3d", "b.r3d"):
        write_archive(tmp_path / name, tiny)
    with pytest.raises(InputError, match=r"2 \.r3d files.*give the file to read"):
        read_scan(tmp_path)
    assert read_scan(tmp_path / "b.r3d").frames[0].depth.file.name == "b.r3d"


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_archive_of_another_compression_is_one_sentence(tmp_path, tiny, method):
    write_archive(tmp_path / "take.r3d", tiny)
    with zipfile.ZipFile(tmp_path / "take.r3d") as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(tmp_path / "take.r3d", "w", method) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    with pytest.raises(InputError, match=r"take\.r3d: metadata has an unsupported compression method"):
        read_scan(tmp_path)


def test_an_implausibly_large_entry_is_refused(tmp_path, tiny, monkeypatch):
    write_archive(tmp_path / "take.r3d", tiny)
    monkeypatch.setattr("scanloom.stages.scans.layouts.record3d._MAX_ENTRY_BYTES", 100)
    with pytest.raises(InputError, match=r"take\.r3d: metadata is too large: it has .* at most 100 are"):
        read_scan(tmp_path)
