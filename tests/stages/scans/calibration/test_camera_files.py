import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.camera_files import read_camera, read_depth_scale
from scanloom.stages.scans.calibration.rig_calibration import read_rig

K = [[100, 0, 16], [0, 110, 12], [0, 0, 1]]
BENT = [0.1, -0.2, 0.003, 0.004, 0.05]
# The right camera is 0.5 m right of the left one, rotated by 10° about y.
C, S = np.cos(np.radians(10)), np.sin(np.radians(10))
R = [[C, 0, S], [0, 1, 0], [-S, 0, C]]
T = [-0.5, 0.01, 0.02]


def opencv_matrix(values):
    values = np.atleast_2d(np.asarray(values, float))
    data = ", ".join(f"{value:.10e}" for value in values.ravel())
    rows, columns = values.shape
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"


def table(camera):
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in camera.items())


# The rectified x axis points from the left camera to the right one; the other axes are arbitrary.
TO_RIGHT = -np.array(T) / np.linalg.norm(T)
ASIDE = np.cross(TO_RIGHT, (0, 1, 0)) / np.linalg.norm(np.cross(TO_RIGHT, (0, 1, 0)))
RIGHT_TURN = np.array([TO_RIGHT, np.cross(ASIDE, TO_RIGHT), ASIDE])
LEFT_TURN = RIGHT_TURN @ R


def camera_info(turn, shift, keys=("K", "D", "R", "P"), **more):
    """Make a side of a rig in ROS's form; the rectified focal length is different, 90 pixels."""
    projection = [90, 0, 15, 90 * shift, 0, 90, 11, 0, 0, 0, 1, 0]
    numbers = (np.ravel(K).tolist(), BENT, np.ravel(turn).tolist(), projection)
    return (
        dict(zip(keys, numbers, strict=True))
        | {"width": 32, "height": 24, "distortion_model": "plumb_bob"}
        | more
    )


def opencv_xml(values):
    matrices = "".join(
        f"<{key} type_id='opencv-matrix'><rows>{len(value)}</rows><cols>{len(value[0])}</cols><dt>d</dt>"
        f"<data>\n{' '.join(map(str, np.ravel(value)))}</data></{key}>"
        for key, value in ((key, np.atleast_2d(value).tolist()) for key, value in values.items())
    )
    return f"<?xml version='1.0'?>\n<opencv_storage>\n<rectified>0</rectified>{matrices}</opencv_storage>"


CAMERA = {"fx": 100, "fy": 110, "cx": 16, "cy": 12, "distortion": BENT}
IN_MILLIMETRES = {"K1": K, "D1": BENT, "K2": K, "D2": BENT, "R": R, "T": [-500, 10, 20]}
FILES = {
    "tables.json": json.dumps({"left": CAMERA, "right": CAMERA, "R": R, "T": T}),
    "millimetres.json": json.dumps({"unit": "mm", **IN_MILLIMETRES}),
    "guessed.json": json.dumps(IN_MILLIMETRES),
    "tables.toml": f"R = {json.dumps(R)}\nT = {T}\n[left]\n{table(CAMERA)}\n[right]\n{table(CAMERA)}\n",
    "opencv.yml": "%YAML:1.0\n---\n"
    + "".join(
        f"{key}: {opencv_matrix(value)}"
        for key, value in {"K1": K, "D1": BENT, "K2": K, "D2": BENT, "R": R, "T": np.c_[T]}.items()
    ),
    "opencv.xml": opencv_xml({"K1": K, "D1": BENT, "K2": K, "D2": BENT, "R": R, "T": T}),
    "ros.json": json.dumps(
        {"left": camera_info(LEFT_TURN, 0), "right": camera_info(RIGHT_TURN, -np.linalg.norm(T))}
    ),
    "ros2.yaml": json.dumps(
        {
            "left": camera_info(LEFT_TURN, 0, "kdrp"),
            "right": camera_info(RIGHT_TURN, -np.linalg.norm(T), "kdrp"),
        }
    )
    + "\n---\n",
    "rodrigues.yaml": f"M1: {K}\nD1: {BENT}\nM2: {K}\nD2: {BENT}\nR: [0, {np.radians(10)}, 0]\nT: {T}\n",
    "kalibr.yaml": "".join(
        f"cam{i}:\n  camera_model: pinhole\n  intrinsics: [100, 110, 16, 12]\n  distortion_model: radtan\n"
        f"  distortion_coeffs: {BENT}\n  resolution: [32, 24]\n"
        for i in (0, 1)
    )
    + f"  T_cn_cnm1: {np.vstack([np.c_[R, T], (0, 0, 0, 1)]).tolist()}\n",
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_every_form_describes_the_same_rig(tmp_path, name):
    (tmp_path / name).write_text(FILES[name])
    with collecting() as warnings:
        rig = read_rig(tmp_path / name, 32, 24)
    for camera in (rig.left, rig.right):
        assert (camera.width, camera.height) == (32, 24)
        np.testing.assert_allclose(camera.matrix, K)
        np.testing.assert_allclose(camera.distortion, BENT)
    np.testing.assert_allclose(rig.right_from_left[:3, :3], R, atol=1e-9)
    np.testing.assert_allclose(rig.right_from_left[:3, 3], T, atol=1e-9)
    assert not rig.is_rectified
    assert bool(warnings) == (name in ("guessed.json", "ros.json", "ros2.yaml"))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("flat.json", json.dumps({"fx": 100, "fy": 110, "cx": 16, "cy": 12, "baseline": 0.5})),
        ("flat.toml", "fx = 100\nfy = 110\ncx = 16\ncy = 12\nbaseline = 50\nunit = 'cm'\n"),
        (
            "rectified.yml",
            "%YAML:1.0\nP1: " + opencv_matrix([[100, 0, 16, 0], [0, 110, 12, 0], [0, 0, 1, 0]])
            + "P2: " + opencv_matrix([[100, 0, 16, -50], [0, 110, 12, 0], [0, 0, 1, 0]]),
        ),
    ],
)  # fmt: skip
def test_rectified_forms(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    rig = read_rig(tmp_path / name, 32, 24)
    assert rig.is_rectified
    np.testing.assert_allclose(rig.left.matrix, K)
    np.testing.assert_allclose(rig.right_from_left[:3, 3], (-0.5, 0, 0))


def test_a_stated_rectified_wins_over_the_guess(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(
        json.dumps({"fx": 100, "fy": 110, "cx": 16, "cy": 12, "baseline": 0.5, "rectified": False})
    )
    assert not read_rig(path, 32, 24).is_rectified


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("k.txt", "100 0 16\n0 110 12\n0 0 1\n"),
        ("k4.txt", "100 0 16 0\n0 110 12 0\n0 0 1 0\n0 0 0 1\n"),
        ("four.txt", "100 110 16 12"),
        ("open3d.json", '{"width": 32, "height": 24, "intrinsic_matrix": [100, 0, 0, 0, 110, 0, 16, 12, 1]}'),
        ("named.json", json.dumps({"camera_matrix": K})),
        ("named.yaml", "%YAML:1.0\nimage_width: 32\nimage_height: 24\ncamera_matrix: " + opencv_matrix(K)),
    ],
)  # fmt: skip
def test_every_form_describes_the_same_camera(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    np.testing.assert_allclose(read_camera(tmp_path / name, 32, 24).matrix, K)


GOOD = {"fx": 100, "fy": 110, "cx": 16, "cy": 12, "baseline": 0.5}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": 0}, "focal lengths"),
        ({"fx": None}, "fx is 'None'"),
        ({"fx": float("nan")}, "fx is 'nan'"),
        ({"cx": 4000}, "another image size"),
        ({"width": 640, "height": 400}, "640×400 px, .*32×24 px. The aspect ratio differs"),
        ({"distortion": [0.1, 1e300, 0, 0]}, r"the distortion coefficient 1e\+300 is implausible"),
        ({"width": 0, "height": 24}, "its image size 0×24 is implausible"),
        ({"width": "wide", "height": 24}, "width is 'wide'; a number is expected"),
        ({"baseline": 0}, "the baseline is 0"),
        ({"unit": "furlong"}, "furlong"),
        ({"T": [0.5, 0, 0]}, "swapped"),
        ({"T": [1, 2]}, "T must be 3 numbers"),
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "R, T: the pose is not rigid"),
        ({"R": "none"}, "R is not a matrix"),
        ({"rectified": "perhaps"}, "rectified"),
        ({"distortion": [1, 2, 3]}, "3 coefficients"),
        ({"K1": 3, "K2": 4}, "camera matrix must be 3x3"),
        ({"left": 1, "right": 2}, "left must be a table"),
        ({"cam0": {}, "cam1": {}}, "intrinsics must be 4 numbers"),
    ],
)
def test_invalid_numbers_are_reported(tmp_path, change, message):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(InputError, match=message):
        read_rig(path, 32, 24)


@pytest.mark.parametrize("matrix", [[], [100], 3, [[[100]]], {"rows": 1, "cols": 2, "data": [100, 16]}])
def test_a_matrix_of_another_shape_is_reported(tmp_path, matrix):
    path = tmp_path / "intrinsic.json"
    path.write_text(json.dumps({"width": 32, "height": 24, "intrinsic_matrix": matrix}))
    with pytest.raises(InputError, match=r"intrinsic\.json: a camera matrix must be 3x3"):
        read_camera(path, 32, 24)


def test_missing_entries_are_reported(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"fx": 100, "fy": 110, "baseline": 0.5}))
    with pytest.raises(InputError, match="cx, cy"):
        read_rig(path, 32, 24)
    path.write_text(json.dumps({"fx": 100, "fy": 110, "cx": 16, "cy": 12}))
    with pytest.raises(InputError, match="R and T, or a baseline"):
        read_rig(path, 32, 24)
    rig = read_rig(path, 32, 24, baseline=0.25)
    assert rig.right_from_left[0, 3] == -0.25


BILLION_LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b""),
        ("a.json", b"[1, 2]"),
        ("a.json", b"[" * 100_000),
        ("a.toml", b"a = = 3"),
        ("a.yml", b""),
        ("a.yml", b"%YAML:1.0\nK1: !!opencv-matrix [1, 2]\n"),
        ("a.yml", b"%YAML:1.0\nK1: !!opencv-matrix\n   rows: 3\n   data: [1, 2]\nK2: 3\n"),
        ("a.yml", b"K1: !!opencv-matrix\n   rows: -3\n   cols: 3000000000\n   data: [1]\nK2: 3\n"),
        ("a.yml", b"K1: !!python/object/apply:os.system ['true']\n"),
        ("a.yml", b"? [a, b]\n: 3\n"),
        ("a.yml", b"[" * 5_000),
        ("a.yml", (BILLION_LAUGHS + "K1: *i\nK2: *i\n").encode()),
        ("a.yml", bytes(range(256))),
        ("a.xml", b"<?xml version='1.0'?><opencv_storage></opencv_storage>"),
        ("missing.yml", None),
    ],
)
def test_hostile_files_give_one_sentence(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_rig(tmp_path / name, 32, 24)


@settings(max_examples=150, deadline=None)
@given(
    text=st.text(alphabet="KDRTP12:[]{}!&*-., 0159eabc%\n\"'", max_size=100),
    suffix=st.sampled_from(["yml", "json", "toml"]),
)  # fmt: skip
def test_any_text_gives_a_rig_or_a_sentence(tmp_path_factory, text, suffix):
    path = tmp_path_factory.getbasetemp() / f"calibration.{suffix}"
    path.write_text(text)
    with pytest.raises(InputError, match="calibration"):
        read_rig(path, 32, 24)


def test_opencv_sample_intrinsics(shared_data):
    camera = read_camera(shared_data / "stereo" / "opencv_chessboard_rig" / "left_intrinsics.yml", 640, 480)
    assert camera.fx == pytest.approx(535.9157)
    assert camera.cy == pytest.approx(235.5708)
    assert camera.distortion[0] == pytest.approx(-0.26637, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "does not parse"),
        ("<opencv_storage><K1>", "does not parse"),
        ("<html></html>", "not an OpenCV file: its root tag is html"),
        ("<!DOCTYPE a [<!ENTITY b 'bbbb'>]><opencv_storage>&b;</opencv_storage>", "document type"),
        ("<opencv_storage>" + "<a>" * 20000 + "</a>" * 20000 + "</opencv_storage>", "does not parse"),
        (opencv_xml({"K1": K, "K2": K, "T": T}).replace("<rows>3</rows>", "<rows>x</rows>"), "not a matrix"),
        (opencv_xml({"K1": K, "K2": K, "T": T}).replace(" 110 ", " nan "), "not finite"),
    ],
)
def test_damaged_xml_is_reported(tmp_path, text, message):
    (tmp_path / "rig.xml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_rig(tmp_path / "rig.xml", 32, 24)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"P": [1, 2, 3]}, "P of the right camera is not a 3x4"),
        ({"P": [0] * 12}, "P of the right camera is not a 3x4"),
        ({"R": [1, 0, 0, 1]}, "R must be 3x3"),
        ({"R": [2, 0, 0, 0, 2, 0, 0, 0, 2]}, "not rigid"),
        ({"distortion_model": "mystery"}, "lens model mystery"),
        ({"width": 64}, "64×24"),
    ],
)
def test_damaged_camera_infos_are_reported(tmp_path, change, message):
    sides = {"left": camera_info(np.eye(3), 0), "right": camera_info(np.eye(3), -0.5, **change)}
    (tmp_path / "rig.json").write_text(json.dumps(sides))
    with pytest.raises(InputError, match=message):
        read_rig(tmp_path / "rig.json", 32, 24)


ORB_SLAM = "%YAML:1.0\nCamera.fx: 100.0\nCamera.fy: 110.0\nCamera.cx: 16.0\nCamera.cy: 12.0\n"


def test_settings_of_orb_slam(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text(ORB_SLAM + "Camera.k1:0.1\nCamera.p2: 0.004\nCamera.bf: 50.0\nDepthMapFactor: 5000\n")
    camera = read_camera(file, 32, 24)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 110, 16, 12)
    assert camera.distortion == (0.1, 0, 0, 0.004, 0)
    assert read_depth_scale(file) == 5000
    rig = read_rig(file, 32, 24)
    assert rig.baseline == pytest.approx(0.5)
    file.write_text(ORB_SLAM + "Camera.width: 64\nCamera.height: 24\n")
    with pytest.raises(InputError, match="it is for images of 64×24"):
        read_camera(file, 32, 24)
    # ROS sends metres as floating point.
    file.write_text(ORB_SLAM + "DepthMapFactor: 1.0\n")
    assert read_depth_scale(file) is None


def test_settings_of_orb_slam_3_for_two_fisheyes(tmp_path):
    file = tmp_path / "settings.yaml"
    sides = "".join(
        f"Camera{n}.fx: {100 + n}.0\nCamera{n}.fy: 100.0\nCamera{n}.cx: 16.0\nCamera{n}.cy: 12.0\n"
        f"Camera{n}.k1: 0.1\nCamera{n}.k2: 0.0\nCamera{n}.k3: 0.0\nCamera{n}.k4: 0.02\n"
        for n in (1, 2)
    )
    left_from_right = np.eye(4)
    left_from_right[:3, :3], left_from_right[:3, 3] = np.array(R).T, -np.array(R).T @ T
    file.write_text(
        f'%YAML:1.0\nCamera.type: "KannalaBrandt8"\n{sides}Stereo.T_c1_c2: {opencv_matrix(left_from_right)}'
    )
    rig = read_rig(file, 32, 24)
    assert (rig.left.fx, rig.right.fx, rig.left.fisheye) == (101, 102, True)
    assert rig.left.distortion == (0.1, 0, 0, 0.02)
    np.testing.assert_allclose(rig.right_from_left[:3, 3], T, atol=1e-9)
    np.testing.assert_allclose(rig.right_from_left[:3, :3], R, atol=1e-9)


def test_kalibr_with_one_camera_and_with_several(tmp_path):
    camera = (
        "  camera_model: pinhole\n  intrinsics: [100, 110, 16, 12]\n  resolution: [32, 24]\n"
        "  distortion_model: radtan\n  distortion_coeffs: [0.1, 0, 0, 0]\n"
    )
    file = tmp_path / "camchain.yaml"
    file.write_text(f"cam0:\n{camera}")
    assert read_camera(file, 32, 24).fy == 110
    file.write_text(f"cam0:\n{camera}cam1:\n{camera}")
    with pytest.raises(InputError, match=r"several cameras \(cam0, cam1\), and the camera of these images"):
        read_camera(file, 32, 24)


def realsense(**changes):
    """Describe a stream like librealsense."""
    return {
        "width": 32,
        "height": 24,
        "fx": 100.0,
        "fy": 110.0,
        "ppx": 16.0,
        "ppy": 12.0,
        "model": "distortion.inverse_brown_conrady",
        "coeffs": BENT,
    } | changes


def test_a_stream_of_realsense(tmp_path):
    file = tmp_path / "intrinsics.json"
    file.write_text(json.dumps(realsense(depth_scale=0.00025)))
    camera = read_camera(file, 32, 24)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion) == (100, 110, 16, 12, tuple(BENT))
    assert read_depth_scale(file) == 4000
    file.write_text(json.dumps(realsense(model="kannala_brandt4", coeffs=[0.1, 0.2, 0.3, 0.4, 0])))
    camera = read_camera(file, 32, 24)
    assert (camera.fisheye, camera.distortion) == (True, (0.1, 0.2, 0.3, 0.4))
    # The library's number of a distortion model; without distortion it is 0.
    file.write_text(json.dumps(realsense(model=2)))
    assert read_camera(file, 32, 24).distortion == tuple(BENT)
    file.write_text(json.dumps(realsense(model="ftheta", coeffs=[0.0] * 5)))
    assert read_camera(file, 32, 24).distortion == ()
    file.write_text(json.dumps(realsense(model="ftheta")))
    with pytest.raises(InputError, match="the lens model ftheta is not supported"):
        read_camera(file, 32, 24)


@pytest.mark.parametrize(
    ("said", "bent"),
    [
        ({"mtx": K, "dist": [BENT]}, BENT),
        ({"K": K, "distortion_coeffs": BENT}, BENT),
        ({"K": K, "coeffs": BENT}, BENT),
        ({"camera_matrix": K, "dist_coeff": [BENT]}, BENT),
        ({"camera_matrix": K, "distCoeffs": [BENT]}, BENT),
        ({"K": K, "k1": 1, "k2": 2, "k3": 3, "k4": 4, "k5": 5, "k6": 6}, [1, 2, 0, 0, 3, 4, 5, 6]),
        ({"RGB": {"intrinsic": {"K": K}, "distortion": {"k1": 0.1, "k2": 0.2}}}, [0.1, 0.2, 0, 0, 0]),
        ({"intrinsic": {"K": K}, "distortion": {"k1": 0.1, "k2": 0.2, "k3": 0.5}}, [0.1, 0.2, 0, 0, 0.5]),
        ({"cam_K": np.ravel(K).tolist(), "depth_scale": 0.1}, []),
        (
            {"fx": 100, "fy": 110, "cx": 16, "cy": 12, "k1": 0.1, "k2": -0.2, "p1": 0.003},
            [0.1, -0.2, 0.003, 0, 0],
        ),
        (
            {"K": K, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "distortion_model": "equidistant"},
            [0.1, 0.2, 0.3, 0.4],
        ),
    ],
)
def test_other_names_of_the_lens(tmp_path, said, bent):
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(said))
    camera = read_camera(file, 32, 24)
    assert (camera.fx, camera.fy, camera.distortion) == (100, 110, tuple(bent))


def test_a_lens_under_an_unknown_name_is_reported(tmp_path):
    file = tmp_path / "camera.json"
    file.write_text(json.dumps({"K": K, "lens_distortion": BENT}))
    with collecting() as told:
        assert read_camera(file, 32, 24).distortion == ()
    assert [str(one) for one in told] == [
        f"{file}: the key lens_distortion is unknown; the lens is assumed to have no distortion"
    ]


@pytest.mark.parametrize(
    ("matrices", "lenses"),
    [
        ("K1 K2", "dist1 dist2"),
        ("M1 M2", "dist_coeffs1 dist_coeffs2"),
        ("cameraMatrix1 cameraMatrix2", "distCoeffs1 distCoeffs2"),
        ("mtxL mtxR", "distL distR"),
        ("Left_camera_matrix Right_camera_matrix", "leftDistortion rightDistortion"),
        ("Intrinsic_mtx_1 Intrinsic_mtx_2", "dist_1 dist_2"),
        ("K_cam0 K_cam1", "D_cam0 D_cam1"),
        ("l_mtx r_mtx", "l_coeffs r_coeffs"),
    ],
)
def test_other_names_of_a_pair(tmp_path, matrices, lenses):
    file = tmp_path / "rig.json"
    said = dict.fromkeys(matrices.split(), K) | dict.fromkeys(lenses.split(), BENT) | {"R": R, "T": T}
    file.write_text(json.dumps(said))
    rig = read_rig(file, 32, 24)
    assert rig.left.distortion == rig.right.distortion == tuple(BENT)
    unknown = {f"distortion of {number}": said.pop(key) for number, key in enumerate(lenses.split(), 3)}
    file.write_text(json.dumps(said | unknown))
    with collecting() as told:
        assert read_rig(file, 32, 24).left.distortion == ()
    assert [str(one) for one in told] == [
        f"{file}: the key {key} is unknown; the lens is assumed to have no distortion" for key in unknown
    ]


@pytest.mark.parametrize(
    ("name", "model"), [("stereo_fisheye", None), ("stereo", "fisheye"), ("stereo", None)]
)
def test_a_fisheye_rig_is_marked_or_named(tmp_path, name, model):
    file = tmp_path / f"{name}.json"
    said = {"K1": K, "K2": K, "D1": BENT[:4], "D2": BENT[:4], "R": R, "T": T}
    file.write_text(json.dumps(said | ({} if model is None else {"distortion_model": model})))
    with collecting() as told:
        rig = read_rig(file, 32, 24)
    is_fisheye = name == "stereo_fisheye" or model is not None
    assert (rig.left.fisheye, rig.right.fisheye) == (is_fisheye, is_fisheye)
    assert rig.left.distortion == tuple(BENT[:4])
    assert any("name contains fisheye" in one for one in map(str, told)) == (name == "stereo_fisheye")


@pytest.mark.parametrize(("said", "units"), [({"cam_K": K}, 10000), ({"K": K}, 10), ({"fx": 100}, 10)])
def test_in_bop_a_depth_scale_is_in_millimetres(tmp_path, said, units):
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(said | {"depth_scale": 0.1}))
    assert read_depth_scale(file) == pytest.approx(units)


def test_one_camera_of_a_device_is_chosen(tmp_path):
    file = tmp_path / "cameras.json"
    file.write_text(json.dumps({"camera": CAMERA}))
    assert read_camera(file, 32, 24).fy == 110
    depth = realsense(fx=90.0, depth_scale=0.001)
    file.write_text(json.dumps({"raw_depth": depth, "color": realsense(), "offset": {"T": T}}))
    with collecting() as told:
        assert read_camera(file, 32, 24).fx == 100
    assert read_depth_scale(file) == 1000
    assert [str(one) for one in told] == [
        f"{file}: the file has several cameras (raw_depth, color); color is used"
    ]
    # Native depth together with larger colour images.
    file.write_text(json.dumps({"raw_depth": depth, "color": realsense(width=64, height=48)}))
    with collecting() as told:
        assert read_camera(file, 32, 24).fx == 90
    assert [str(one) for one in told] == [
        f"{file}: the file has several cameras (raw_depth, color); raw_depth is used"
    ]
    file.write_text(json.dumps({"infra1": depth, "infra2": realsense()}))
    with pytest.raises(InputError, match=r"several cameras \(infra1, infra2\), and the camera"):
        read_camera(file, 32, 24)


def test_real_settings_and_camchains(shared_data):
    files = shared_data / "real" / "calibrations"
    assert read_camera(files / "orbslam2_TUM3.yaml", 640, 480).fx == 535.4
    assert read_camera(files / "kalibr_single_camchain.yaml", 1280, 720).fx == pytest.approx(
        863.728, abs=1e-3
    )
    with collecting() as found:
        rig = read_rig(files / "far_stereo.yaml", 1280, 524)
    codes = ["camera.calibration-assumed", "camera.calibration-contradictory"]
    assert [one.code for one in found] == codes
    assert rig.left.fx == pytest.approx(1927.268, abs=1e-3)
    # Baseline of RIGHT.P; Camera.bf is half of that.
    assert rig.baseline == pytest.approx(1181.878 / 1966.836, rel=1e-3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Camera.bf: 1" + "0" * 390, "baseline is 'inf'"),
        ("Camera.bf: nothing", "the extrinsics are missing"),
        ("Camera2.fx: 1\nTlr: [1, 2, 3]", "the extrinsics of the cameras must be 4x4|the file has no camera"),
    ],
)
def test_damaged_settings_are_reported(tmp_path, line, message):
    file = tmp_path / "settings.yaml"
    file.write_text(f"{ORB_SLAM}{line}\n")
    with pytest.raises(InputError, match=message):
        read_rig(file, 32, 24)
