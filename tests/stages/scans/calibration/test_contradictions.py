"""Contradicting numbers of a calibration are reported together with the number that is used."""

import json

import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.scans.calibration.camera_files import read_camera
from scanloom.stages.scans.calibration.rig_calibration import read_rig
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

K = [[100, 0, 16], [0, 100, 12], [0, 0, 1]]
OPENCV = {"K1": K, "K2": K, "R": np.eye(3).tolist(), "T": [-0.5, 0, 0]}
P2 = [[100, 0, 16, -50], [0, 100, 12, 0], [0, 0, 1, 0]]


def told(read, tmp_path, table, **options):
    (tmp_path / "rig.json").write_text(json.dumps(table))
    with collecting() as found:
        read(tmp_path / "rig.json", 32, 24, **options)
    assert all(one.code == "camera.calibration-contradictory" for one in found)
    return [str(one) for one in found]


def turned(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return [[c, 0, s], [0, 1, 0], [-s, 0, c]]


def chain(shift, turn=0.0):
    relation, body = np.eye(4), np.eye(4)
    relation[0, 3], body[:3, :3], body[0, 3] = -0.5, turned(turn), shift
    camera = {"intrinsics": [100, 100, 16, 12], "resolution": [32, 24]}
    return {
        "cam0": camera | {"T_cam_imu": np.eye(4).tolist()},
        "cam1": camera | {"T_cam_imu": body.tolist(), "T_cn_cnm1": relation.tolist()},
    }


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (OPENCV | {"baseline": 0.12}, "states different baselines, 0.5 (T) and 0.12 (baseline)"),
        (
            OPENCV | {"P2": [[100, 0, 16, -30], [0, 100, 12, 0], [0, 0, 1, 0]]},
            "states different baselines, 0.5 (T) and 0.3 (P2)",
        ),
        (OPENCV | {"R": turned(3), "rectified": True}, "declares rectified images, but"),
        (
            OPENCV | {"K2": [[150, 0, 16], [0, 150, 12], [0, 0, 1]]},
            "its two cameras differ, 100 and 150 px",
        ),
        (
            chain(-0.3),
            "its extrinsics cam1.T_cn_cnm1 and T_cam_imu differ",
        ),
        (chain(-0.5, 2), "differ by 0 in position and 2° in rotation; the first one is used"),
    ],
)
def test_a_rig(tmp_path, table, said):
    (found,) = told(read_rig, tmp_path, table)
    assert said in found


@pytest.mark.parametrize(
    "table",
    [
        OPENCV,
        OPENCV | {"P2": P2},
        OPENCV | {"P1": np.eye(3, 4).tolist(), "P2": np.eye(3, 4).tolist()},
        # The same length in two units.
        OPENCV | {"T": [-500, 0, 0], "unit": "mm", "baseline": 0.5},
        chain(-0.5),
    ],
)
def test_consistent_numbers_give_no_report(tmp_path, table):
    assert told(read_rig, tmp_path, table) == []


def test_a_baseline_that_the_person_states_ends_it(tmp_path):
    assert told(read_rig, tmp_path, OPENCV | {"baseline": 0.12}, baseline=0.12) == []


def test_a_camera(tmp_path):
    (found,) = told(read_camera, tmp_path, {"K": K, "fx": 130})
    assert "different focal lengths, 100 px (matrix) and 130 px (fx); the first one is used" in found
    (found,) = told(read_camera, tmp_path, {"fx": 100, "fy": 16, "cx": 20, "cy": 12})
    assert "Are its numbers in the order fx, fy, cx, cy?" in found


def test_the_two_baselines_of_a_real_file(shared_data):
    file = shared_data / "real" / "calibrations" / "far_stereo.yaml"
    with collecting() as found:
        rig = read_rig(file, 1280, 524)
    assert rig.baseline == pytest.approx(0.6011, abs=1e-4)
    assert [str(one) for one in found if one.code == "camera.calibration-contradictory"] == [
        f"{file}: it states different baselines, 0.6011 (RIGHT.P) and 0.3116 (Camera.bf); the first one "
        "is used; scan.baseline=METRES overrides it"
    ]


def test_an_angle_of_view_that_is_not_that_of_the_focal_length(tmp_path, tiny):
    tiny.color(tmp_path / "a.png")
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
    table = {"fl_x": 100, "fl_y": 100, "cx": 16.5, "cy": 12.5, "w": 32, "h": 24, "camera_angle_x": 0.4}
    (tmp_path / "transforms.json").write_text(json.dumps(table | {"frames": [frame, frame]}))
    said = "the focal length 100 px (fl_x) contradicts 78.93 px (camera_angle_x, for 32 px)"
    scan = read_scan(tmp_path, ScanParams(), complete=False)
    assert sum(said in text for text in map(str, scan.diagnostics)) == 1
