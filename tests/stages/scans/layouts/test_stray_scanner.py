import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

FACTOR = 8
HEADER = "timestamp, frame, x, y, z, qx, qy, qz, qw\n"
ROWS = "10.5, 000000, 0, 0, 0, 0, 0, 0, 1\n10.6, 000001, 1, 2, 3, 0, 0.70710678, 0, 0.70710678\n"


def write_video(path, images):
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), 30, (width, height))
    for image in images:
        writer.write(np.ascontiguousarray(image[:, :, ::-1]))
    writer.release()


@pytest.fixture
def scan_folder(tmp_path, tiny):
    write_video(tmp_path / "rgb.mp4", [tiny.dotted(FACTOR), np.roll(tiny.dotted(FACTOR), 5, 2)])
    camera = tiny.scaled_intrinsics(FACTOR)
    (tmp_path / "camera_matrix.csv").write_text(
        f"{camera['fx']}, 0.0, {camera['cx']}\n0.0, {camera['fy']}, {camera['cy']}\n0.0, 0.0, 1.0\n"
    )
    (tmp_path / "odometry.csv").write_text(HEADER + ROWS)
    (tmp_path / "confidence").mkdir()
    for number in (0, 1):
        tiny.depth(tmp_path / "depth" / f"{number:06d}.png", 1000)
        trust = np.full((24, 32), 2, np.uint8)
        trust[3, 4:6] = (0, 1)
        cv2.imwrite(str(tmp_path / "confidence" / f"{number:06d}.png"), trust)
    return tmp_path


def points(folder, tiny, **options):
    return [tiny.seen(frame) for frame in read_scan(folder, ScanParams(**options)).frames]


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "stray-scanner"
    assert [frame.timestamp for frame in scan.frames] == [10_500_000_000, 10_600_000_000]
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_colour_is_sampled_at_its_own_resolution(scan_folder, tiny):
    first, second = read_scan(scan_folder).frames
    assert tiny.green_is_at_the_pixel(first)
    # Channels in rotated order: green becomes another colour.
    assert not tiny.green_is_at_the_pixel(second)


def test_columns_are_known_by_their_names(scan_folder, tiny):
    """The old format has no time and no number, and columns in any order."""
    (scan_folder / "odometry.csv").write_text(
        "qw,x,y,z,qx,qy,qz\n1,0,0,0,0,0,0\n0.70710678,1,2,3,0,0.70710678,0\n"
    )
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    assert read_scan(scan_folder).frames[0].timestamp is None


def test_intrinsics_of_a_row_are_its_own(scan_folder, tiny):
    fx, fy, cx, cy = tiny.scaled_intrinsics(FACTOR).values()
    first, second = ROWS.splitlines()
    (scan_folder / "odometry.csv").write_text(
        HEADER.strip() + ", fx, fy, cx, cy\n"
        f"{first}, {fx * 2}, {fy}, {cx}, {cy}\n{second}, {fx}, {fy}, {cx}, {cy}\n"
    )
    seen = points(scan_folder, tiny)
    np.testing.assert_allclose(seen, [(0.1, 0.1, 2), tiny.points[1]], atol=1e-6)


def test_the_row_is_the_frame_of_the_video_and_the_number_that_of_the_depth(scan_folder):
    """Every tenth frame was recorded: depth files have frame numbers, video frames are consecutive."""
    (scan_folder / "odometry.csv").write_text(HEADER + ROWS.replace("000001", "000010"))
    (scan_folder / "depth" / "000001.png").rename(scan_folder / "depth" / "000010.png")
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["000000", "000010"]
    assert read_color(scan.frames[1])[17 * FACTOR + 4, 26 * FACTOR + 4, 0] > 200


def test_depth_in_arrays_is_in_millimetres(scan_folder, tiny):
    for number in (0, 1):
        (scan_folder / "depth" / f"{number:06d}.png").unlink()
        np.save(scan_folder / "depth" / f"{number:06d}.npy", np.full((24, 32), 2000, np.uint16))
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


@pytest.mark.parametrize(("least", "kept"), [(None, [0, 2, 2]), (0, [2, 2, 2]), (2, [0, 0, 2])])
def test_depth_of_little_confidence_is_left_out(scan_folder, least, kept):
    scan = read_scan(scan_folder, ScanParams(min_confidence=least))
    assert read_depth(scan.frames[0])[3, 4:7].tolist() == kept
    assert any(
        f"confidence {1 if least is None else least} or higher" in text for text in map(str, scan.diagnostics)
    )


def test_a_confidence_bound_above_the_maximum_is_refused(scan_folder):
    with pytest.raises(
        InputError, match="min_confidence is 255, but this layout has only the levels 0, 1, 2"
    ):
        read_scan(scan_folder, ScanParams(min_confidence=255))


def test_rows_beyond_the_video_are_left_out(scan_folder, tiny):
    write_video(scan_folder / "rgb.mp4", [tiny.dotted(FACTOR)])
    scan = read_scan(scan_folder)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("000001", "the video has only 1 frames")
    ]
    assert any("1 frames but odometry.csv has 2 rows" in text for text in map(str, scan.diagnostics))


def test_a_row_without_depth_is_left_out(scan_folder):
    (scan_folder / "depth" / "000000.png").unlink()
    assert [one.name for one in read_scan(scan_folder).skipped_frames] == ["000000"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "column x, y, z"),
        (HEADER, "has no poses"),
        ("timestamp, frame, x, y, z, qx, qy, qz\n1,2,3,4,5,6,7,8\n", "column qw is missing"),
        (HEADER + "10.5, 0, 0, 0, 0, 0, 0\n", "line 2 does not have 9 numbers"),
        (HEADER + ROWS + "10.7, 2, here, 0, 0, 0, 0, 0, 1\n", "line 4 does not have 9 numbers"),
        (HEADER + "10.5, 0, 0, 0, 0, 0, 0, 0, 9\n", "line 2: the quaternion has length 9"),
        (HEADER + "10.5, nan, 0, 0, 0, 0, 0, 0, 1\n", "line 2: invalid frame number"),
        (HEADER + "nan, 0, 0, 0, 0, 0, 0, 0, 1\n", "line 2: the time"),
        (HEADER + "1, 0, inf, 0, 0, 0, 0, 0, 1\n", "line 2: the pose holds a value that is not finite"),
    ],
)
def test_a_damaged_odometry_is_one_sentence(scan_folder, content, message):
    (scan_folder / "odometry.csv").write_text(content)
    with pytest.raises(InputError, match=rf"odometry\.csv: .*{message}"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "content", ["", "1, 2\n", "a, b, c\n", "0,0,0\n0,0,0\n0,0,1\n", "nan,0,9\n0,9,9\n0,0,1\n"]
)
def test_a_damaged_matrix_is_one_sentence(scan_folder, content):
    (scan_folder / "camera_matrix.csv").write_text(content)
    with pytest.raises(InputError, match=r"camera_matrix\.csv"):
        read_scan(scan_folder)


def test_without_its_video_the_reason_is_reported(scan_folder):
    (scan_folder / "rgb.mp4").unlink()
    with pytest.raises(InputError, match=r"rgb\.mp4 is missing"):
        read_scan(scan_folder)


def test_without_depth_the_reason_is_reported(scan_folder):
    for file in (scan_folder / "depth").iterdir():
        file.unlink()
    with pytest.raises(InputError, match=r"this layout requires depth"):
        read_scan(scan_folder)


def test_a_video_of_another_shape_is_refused(scan_folder, tiny):
    write_video(scan_folder / "rgb.mp4", [np.rot90(tiny.dotted(FACTOR)).copy()] * 2)
    with pytest.raises(InputError, match="rotated by 90°"):
        read_scan(scan_folder)


IMU = "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n"


def other_poses(folder):
    """A world without known up direction: the frame of the first camera."""
    (folder / "found.txt").write_text("000000 0 0 0 0 0 0 1\n000001 0 0 1 0 0 0 1\n")
    return ScanParams(poses="found.txt")


def readings(x, y, z):
    return IMU + "".join(f"{10.45 + 0.01 * i}, {x}, {y}, {z}, 0.1, 0.2, 0.3\n" for i in range(20))


@pytest.mark.parametrize(
    ("reading", "up"),
    [
        # In units of g: the phone is upright, so the image is rotated, and up is on its left side.
        ((0, -1, 0), (-1, 0, 0)),
        # The right side of the phone is up, so its images are upright.
        ((-1, 0, 0), (0, -1, 0)),
        # The phone is on its back, in m/s² of older versions: the camera faces the table.
        ((0, 0, -9.81), (0, 0, -1)),
    ],
)
def test_the_accelerometer_gives_up_for_user_poses(scan_folder, reading, up):
    (scan_folder / "imu.csv").write_text(readings(*reading))
    for frame in read_scan(scan_folder, other_poses(scan_folder)).frames:
        np.testing.assert_allclose(frame.up, up, atol=1e-12)


def test_poses_of_the_phone_have_priority_over_the_accelerometer(scan_folder):
    (scan_folder / "imu.csv").write_text(readings(0, 0, -1))
    scan = read_scan(scan_folder)
    assert not any("imu.csv" in warning for warning in map(str, scan.diagnostics))
    for frame in scan.frames:
        np.testing.assert_allclose(frame.up, frame.world_from_camera[1, :3], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time, ax, ay, az\n1, 2, 3, 4\n", "the column timestamp, a_x, a_y, a_z is missing"),
        (readings(0, -1, 0) + "10.7, 0.0, -1", "1 of 21 lines are not valid readings"),
        (readings(0, -0.3, 0), "which is not gravity: it is not used"),
    ],
)
def test_invalid_accelerometer_data_is_reported_and_ignored(scan_folder, text, said):
    (scan_folder / "imu.csv").write_text(text)
    scan = read_scan(scan_folder, other_poses(scan_folder))
    assert len(scan.frames) == 2
    assert any(said in warning for warning in map(str, scan.diagnostics))
