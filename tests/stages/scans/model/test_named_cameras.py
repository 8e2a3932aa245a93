"""Cameras by name: nominal focal lengths are close to calibrated focal lengths."""

import re

import pytest

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.scans.model.named_cameras import NAMES, create_named_camera
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


# Calibrations of single devices, from the data sets in the shared folder and from factory calibrations.
@pytest.mark.parametrize(
    ("name", "size", "focal"),
    [
        ("d435", (640, 480), 615.2),
        ("d435", (640, 480), 616.9),
        ("RealSense D435i", (640, 480), 617.4),
        ("kinect1", (640, 480), 525.0),
        ("kinect1-depth", (640, 480), 585.0),
        ("kinect2", (512, 424), 365.5),
        ("Azure Kinect", (1280, 720), 607.0),
        ("azure", (640, 576), 504.0),
        ("azure", (320, 288), 252.0),
        ("iPhone 12 Pro Max", (1920, 1440), 1440.0),
        ("iphone", (1440, 1920), 1440.0),
    ],
)
def test_a_name_is_near_a_calibration(name: str, size: tuple[int, int], focal: float) -> None:
    camera = create_named_camera(name, *size)
    assert camera is not None
    assert camera.fx == camera.fy == pytest.approx(focal, rel=0.025)
    assert (camera.width, camera.height) == size
    assert (camera.cx, camera.cy) == ((size[0] - 1) / 2, (size[1] - 1) / 2)
    assert camera.is_guess, "frames refine it"


def test_cropped_images_keep_the_focal_length() -> None:
    wide, narrow = (create_named_camera("d435", width, 480) for width in (853, 640))
    assert wide is not None
    assert narrow is not None
    assert wide.fx == pytest.approx(narrow.fx, rel=1e-3)
    assert create_named_camera("d435-depth", 640, 480).fx < 0.7 * narrow.fx  # type: ignore[union-attr]


def test_a_name_is_an_option_and_a_wrong_one_is_refused(tmp_path, tiny) -> None:
    for number in (1, 2):
        tiny.color(tmp_path / "color" / f"{number}.png")
        tiny.depth(tmp_path / "depth" / f"{number}.png", 1000)
    scan = read_scan(tmp_path, ScanParams(intrinsics="d435"), complete=False)
    assert scan.frames[0].camera == create_named_camera("d435", 32, 24)
    assert not any(one.code == "camera.intrinsics-guessed" for one in scan.diagnostics)
    (guess,) = (
        one
        for one in read_scan(tmp_path, complete=False).diagnostics
        if one.code == "camera.intrinsics-guessed"
    )
    named = re.findall(r"(?<![\w.])(d435|azure|kinect2)\b", str(guess))
    assert len(named) == 3
    assert set(named) <= set(NAMES)
    with pytest.raises(UsageError, match=r"or a camera \(d435\)"):
        ScanParams(intrinsics="d436x")
    with pytest.raises(UsageError, match=r"or a camera \(kinect1, kinect2, "):
        ScanParams(intrinsics="my camera 1 2 3 4 5")
