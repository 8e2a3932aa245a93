"""Scaling of non-metric scans to metres: all lengths at once, before frames are selected."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tagged_wall

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.transforms.scale import apply_scale

CAMERA = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
FACTOR = 0.25


def pose(x: float) -> np.ndarray:
    made = np.eye(4)
    made[:3, 3] = (x, 2.0, -3.0)
    return made


def everything(**more) -> Scan:
    """Make a scan with every kind of length."""
    frame = Frame(
        "a",
        CAMERA,
        depth=np.full((3, 4), 2.0, np.float32),
        world_from_camera=pose(1.0),
        color_from_depth=pose(0.5),
        depth_range=(0.5, 8.0),
    )
    rig = StereoRig(CAMERA, CAMERA, pose(-0.1), is_rectified=True)
    return Scan("made", [frame], rig, bounding_box=np.array([[0, 0, 0], [1, 2, 3.0]]), **more)


def scaled(scan: Scan, **options) -> Scan:
    with collecting() as found:
        scaled = apply_scale(scan, ScanParams(**options), Path("scan"))
    return replace(scaled, diagnostics=tuple(found))


def test_all_lengths_are_multiplied() -> None:
    scan = scaled(everything(is_metric=False), scale=FACTOR)
    (frame,) = scan.frames
    np.testing.assert_allclose(frame.world_from_camera[:3, 3], (0.25, 0.5, -0.75))
    np.testing.assert_allclose(frame.color_from_depth[:3, 3], (0.125, 0.5, -0.75))
    np.testing.assert_array_equal(frame.world_from_camera[:3, :3], np.eye(3))
    assert frame.depth_range == (0.125, 2.0)
    assert read_depth(frame)[0, 0] == 0.5
    np.testing.assert_allclose(scan.bounding_box, [[0, 0, 0], [0.25, 0.5, 0.75]])
    assert scan.rig.right_from_left[0, 3] == pytest.approx(-0.025)
    assert (scan.is_metric, scan.diagnostics) == (True, ())
    assert scan.scale.to_dict() == {"metres_per_unit": 0.25, "source": "given", "spread_ratio": None}
    assert scaled(scan).diagnostics == ()


def test_a_missing_scale_is_reported_with_the_options() -> None:
    scan = scaled(everything(is_metric=False))
    assert not scan.is_metric
    (said,) = map(str, scan.diagnostics)
    assert "no metric scale" in said
    assert all(f"scan.{name}=" in said for name in ("scale", "known_distance", "tag_size"))
    assert scaled(everything()).diagnostics == ()


def test_an_implausible_scale_of_metric_scans_is_reported() -> None:
    assert scaled(everything(), scale=1.04).diagnostics == ()
    (said,) = map(str, scaled(everything(), scale=3.2).diagnostics)
    assert said == "layout made is metric, but its lengths are multiplied by 3.2"


def test_with_measured_depth_only_user_poses_are_scaled() -> None:
    scan = scaled(everything(), scale=FACTOR, poses="colmap.tum")
    (frame,) = scan.frames
    np.testing.assert_allclose(frame.world_from_camera[:3, 3], (0.25, 0.5, -0.75))
    assert read_depth(frame)[0, 0] == 2.0
    assert scan.rig.baseline == everything().rig.baseline
    assert scan.diagnostics == ()


@pytest.mark.parametrize(
    ("text", "factor"),
    [("2 0.5", 0.25), (" 1e1  2.5 ", 0.25), ("0,0,0 0,3,4 2.5", 0.5), ("-1,-1,-1 -1,-1,1 1", 0.5)],
)
def test_a_known_distance_is_a_scale(text: str, factor: float) -> None:
    scan = scaled(everything(is_metric=False), known_distance=text)
    assert scan.scale.metres_per_unit == pytest.approx(factor)
    assert scan.scale.source == "a known distance"


@pytest.mark.parametrize(
    "options",
    [
        *(
            {"known_distance": text}
            for text in ("", "1", "0 1", "1 0", "-1 1", "1 nan", "inf 1", "a b", "1 2 3")
        ),
        *(
            {"known_distance": text}
            for text in ("1,2 3,4 1", "0,0,0 0,0,0 1", "0,0,0 1,1,1", "0,0,0 1e400,0,0 1")
        ),
        {"scale": 0.0},
        {"scale": float("inf")},
        {"tag_size": -1.0},
        {"tag_family": "qr"},
        {"scale": 2.0, "tag_size": 0.1},
        {"scale": 2.0, "known_distance": "1 2"},
    ],
)
def test_an_invalid_scale_is_a_usage_error(options: dict[str, object]) -> None:
    with pytest.raises(UsageError, match=f"^{next(iter(options))}"):
        ScanParams(**options)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write photos of a wall with tags in nerfstudio's form, in a world of 0.31 m per unit."""
    folder = tmp_path_factory.mktemp("views")
    (folder / "images").mkdir()
    camera = tagged_wall.CAMERA
    entries = []
    for frame in tagged_wall.frames(metres_per_unit=0.31):
        cv2.imwrite(str(folder / "images" / f"{frame.name}.png"), frame.color)
        turned = frame.world_from_camera.copy()
        turned[:3, 1:3] *= -1
        entries.append({"file_path": f"images/{frame.name}.png", "transform_matrix": turned.tolist()})
    table = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    table |= {"cx": camera.cx + 0.5, "cy": camera.cy + 0.5, "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(table))
    return folder


def test_tags_are_searched_in_all_frames_of_a_folder(views: Path) -> None:
    whole = read_scan(views, ScanParams(tag_size=0.12))
    assert whole.scale.metres_per_unit == pytest.approx(0.31, rel=0.005)
    assert (whole.is_metric, whole.diagnostics) == (True, ())
    few = read_scan(views, ScanParams(tag_size=0.12, first=1, last=4, hold_out=4))
    assert few.scale == whole.scale
    # Held-out frames are in the same world.
    for frame in (*few.frames, *few.held_out):
        same = next(one for one in whole.frames if one.name == frame.name)
        np.testing.assert_array_equal(frame.world_from_camera, same.world_from_camera)
    assert len(few.held_out) == 1
    truth = tagged_wall.poses()
    for frame, true in zip(whole.frames, truth, strict=True):
        np.testing.assert_allclose(frame.world_from_camera[:3, 3], true[:3, 3], rtol=0.006, atol=0.002)


def test_poses_that_were_adjusted_in_metres_stay(views: Path, tmp_path: Path) -> None:
    better = {"accepted": True, "color_camera": None, "color_from_depth": None, "names": {"0": "0000"}}
    (tmp_path / "cameras.json").write_text(json.dumps(better | {"poses": {"0": pose(7.0).tolist()}}))
    options = ScanParams(scale=0.31, adjusted_cameras=str(tmp_path / "cameras.json"))
    np.testing.assert_array_equal(read_scan(views, options).frames[0].world_from_camera, pose(7.0))


def test_a_folder_without_tags_is_refused(views: Path) -> None:
    with pytest.raises(InputError, match=r"views.*no tag of aruco-7x7 was found"):
        read_scan(views, ScanParams(tag_size=0.12, tag_family="aruco-7x7"))


def test_the_repr_of_a_scan_states_its_units() -> None:
    assert "not metric" in repr(everything(is_metric=False))
    assert "not metric" not in repr(replace(everything(), is_metric=True))
