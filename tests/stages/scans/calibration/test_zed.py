"""Factory calibration of a ZED from its manufacturer's file."""

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.camera_files import read_camera
from scanloom.stages.scans.calibration.rig_calibration import read_rig

CONF = """
[LEFT_CAM_2K]
fx=1400.2
fy=1400.2
cx=1104.5
cy=633.8
k1=-0.17

[RIGHT_CAM_2K]
fx=1401.2
fy=1401.2
cx=1100.5
cy=630.8
k1=-0.17

[LEFT_CAM_HD]
fx=700.5
fy=700.1
cx=639.2
cy=361.8
k1=-0.171
k2=0.0273
p1=0.0001
p2=-0.0002
k3=0

[RIGHT_CAM_HD]
fx=701.0
fy=700.6
cx=641.5
cy=360.2
k1=-0.169
k2=0.0261

[STEREO]
Baseline=119.87
TY=0.046
TZ=-0.468
CV_2K=0.007
RX_2K=0.0024
RZ_2K=-0.0021
CV_HD=0.0021
RX_HD=-0.0009
RZ_HD=0.0004
"""


@pytest.fixture
def conf(tmp_path):
    path = tmp_path / "SN12345.conf"
    path.write_text(CONF)
    return path


def test_the_rig_of_a_size_of_images(conf):
    rig = read_rig(conf, 1280, 720)
    assert (rig.left.fx, rig.left.cy, rig.right.fx, rig.is_rectified) == (700.5, 361.8, 701.0, False)
    assert rig.left.distortion == (-0.171, 0.0273, 0.0001, -0.0002, 0)
    assert rig.right.distortion == (-0.169, 0.0261, 0, 0, 0)
    assert rig.baseline == pytest.approx(np.hypot(0.11987, np.hypot(0.000046, 0.000468)))
    turn = cv2.Rodrigues(rig.right_from_left[:3, :3])[0].ravel()
    np.testing.assert_allclose(turn, (-0.0009, 0.0021, 0.0004), atol=1e-12)
    assert rig.right_from_left[0, 3] == pytest.approx(-0.11987)


def test_the_calibration_is_chosen_by_image_size_or_aspect_ratio(conf):
    assert read_rig(conf, 2208, 1242).left.fx == 1400.2
    with collecting() as told:
        smaller = read_rig(conf, 640, 360).left
    assert {one.code for one in told} == {"camera.calibration-scaled"}
    assert smaller.fx in (pytest.approx(700.5 / 2), pytest.approx(1400.2 * 640 / 2208))
    assert read_camera(conf, 1280, 720).fx == 700.5
    with pytest.raises(
        InputError, match=r"it is for images of 2208×1242, 1280×720 px, but these are 640×480 px"
    ):
        read_rig(conf, 640, 480)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[STEREO]", "[OTHER]", r"the section \[STEREO\] with the extrinsics is missing"),
        ("[RIGHT_CAM_HD]", "[SOME_CAM_HD]", r"\[RIGHT_CAM_HD\] is missing"),
        ("fx=700.5\n", "", "fx is missing"),
        ("RX_HD=-0.0009", "", "rx_HD is missing"),
        ("Baseline=119.87", "Baseline=wide", "baseline is 'wide'; a number is expected"),
        ("Baseline=119.87", "Baseline=0", "not right of the first"),
        ("fx=700.5", "fx=-700.5", "must be positive"),
    ],
)
def test_missing_or_wrong_entries_are_reported(conf, old, new, said):
    conf.write_text(CONF.replace(old, new))
    with pytest.raises(InputError, match=said):
        read_rig(conf, 1280, 720)


@pytest.mark.parametrize("text", ["[LEFT_CAM_HD]\nfx\x00", "[LEFT_CAM_HD\nfx=3", "fx=3\n[LEFT_CAM_HD]"])
def test_a_damaged_file_is_reported(conf, text):
    conf.write_text(text)
    with pytest.raises(InputError):
        read_rig(conf, 1280, 720)
