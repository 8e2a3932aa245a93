import json

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# Units of 0.1 mm.
UNITS = 10_000


def entry(world_from_camera=None, **more):
    """Make the entry of an image; poses are world-to-camera in millimetres."""
    table = {"cam_K": [100, 0, 16, 0, 100, 12, 0, 0, 1], "depth_scale": 1000 / UNITS}
    if world_from_camera is not None:
        pose = invert_pose(world_from_camera)
        table |= {"cam_R_w2c": pose[:3, :3].ravel().tolist(), "cam_t_w2c": (1000 * pose[:3, 3]).tolist()}
    return table | more


def write(folder, tables):
    (folder / "scene_camera.json").write_text(json.dumps(tables))


@pytest.fixture
def scan_folder(tmp_path, tiny):
    folder = tmp_path / "000001"
    for number in (3, 10):
        tiny.color(folder / "rgb" / f"{number:06d}.png")
        tiny.depth(folder / "depth" / f"{number:06d}.png", UNITS)
    write(folder, {"3": entry(tiny.identity), "10": entry(tiny.second)})
    # Object poses and visibility are not used.
    (folder / "scene_gt.json").write_text("{}")
    tiny.color(folder / "mask_visib" / "000003_000000.png")
    return folder


def assert_known_points(folder, tiny, **options):
    scan = read_scan(folder, ScanParams(**options))
    assert scan.layout == "bop"
    assert [frame.name for frame in scan.frames] == ["000003", "000010"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-4)
    return scan


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    assert assert_known_points(scan_folder, tiny).diagnostics == ()


def test_images_may_be_grey_and_in_other_formats(scan_folder, tiny):
    (scan_folder / "rgb").rename(scan_folder / "gray")
    for path in (scan_folder / "gray").iterdir():
        path.unlink()
        tiny.color(path.with_suffix(".jpg"))
    assert_known_points(scan_folder, tiny)


def test_each_image_has_its_own_camera_and_unit(scan_folder, tiny):
    tiny.depth(scan_folder / "depth" / "000010.png", 1000)
    bent = [100, 0, 16, 0, 100, 13, 0, 0, 1]
    write(scan_folder, {"3": entry(tiny.identity), "10": entry(tiny.second, depth_scale=1.0, cam_K=bent)})
    first, second = read_scan(scan_folder).frames
    assert (first.camera.cy, second.camera.cy) == (12, 13)
    assert (first.depth_scale, second.depth_scale) == (UNITS, 1000)


def test_without_a_world_there_are_no_poses(scan_folder):
    write(scan_folder, {"3": entry(), "10": entry()})
    with pytest.raises(InputError, match=r"has no cam_R_w2c; name a trajectory with"):
        read_scan(scan_folder)
    scan = read_scan(scan_folder, complete=False)
    assert [frame.world_from_camera for frame in scan.frames] == [None, None]
    rows = ["0 0 0 0 0 0 0 1", "1 0.5 0 0 0 0 0 1"]
    (scan_folder / "poses.txt").write_text("\n".join(rows))
    assert len(read_scan(scan_folder, ScanParams(poses="poses.txt")).frames) == 2


def test_views_without_depth_are_single_views(scan_folder):
    for path in (scan_folder / "depth").iterdir():
        path.unlink()
    (scan_folder / "depth").rmdir()
    scan = read_scan(scan_folder)
    assert [frame.depth for frame in scan.frames] == [None, None]
    assert scan.frames[1].world_from_camera is not None


def test_entries_without_image_are_reported(scan_folder, tiny):
    write(scan_folder, {"3": entry(tiny.identity), "10": entry(tiny.second), "11": entry(tiny.second)})
    told = "scene_camera.json has entries for 1 images that do not exist; they are ignored"
    assert [str(one) for one in assert_known_points(scan_folder, tiny).diagnostics] == [told]


@pytest.mark.parametrize(
    ("table", "why"),
    [
        (None, "has no entry for this image"),
        (entry(np.eye(4), cam_K=[1, 2]), "cam_K must be a list of 9 numbers"),
        (entry(np.eye(4), cam_t_w2c=[0, 0, 10**400]), "a value that is not finite"),
        (entry(np.eye(4), depth_scale="fine"), "depth_scale is 'fine'"),
        (entry(np.eye(4), depth_scale=0), "depth_scale is 0; it must be positive"),
        (entry(), "the frame has no pose"),
        (entry(np.eye(4), cam_R_w2c=[1.0] * 9), "the pose is not rigid"),
        (entry(cam_R_w2c=[1, 0, 0, 0, 1, 0, 0, 0, 1]), "cam_t_w2c must be a list of 3 numbers"),
    ],
)
def test_an_invalid_entry_only_skips_its_image(scan_folder, tiny, table, why):
    write(scan_folder, {"3": entry(tiny.identity)} | ({} if table is None else {"10": table}))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["000003"]
    assert [one.name for one in scan.skipped_frames] == ["000010"]
    assert why in scan.skipped_frames[0].reason


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"a": {}}', '{"3": 4}', '{"99999999999": {}}', "{"])
def test_a_wrong_camera_file_is_refused(scan_folder, text):
    (scan_folder / "scene_camera.json").write_text(text)
    with pytest.raises(InputError, match=r"scene_camera\.json"):
        read_scan(scan_folder)


def test_names_that_are_no_numbers_are_left_alone(scan_folder, tiny):
    for name in ("²", "000003_old", "thumbs"):
        tiny.color(scan_folder / "rgb" / f"{name}.png")
    assert_known_points(scan_folder, tiny)
