import json
import re

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.layout_table import LAYOUTS
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import detect_layout, read_scan


def touch(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir() if not path.suffix else path.touch()


@pytest.mark.parametrize(
    ("names", "layout"),
    [
        (["scan.json"], "plain-rgbd"),
        (["rgb.txt", "depth.txt", "groundtruth.txt", "rgb", "depth"], "tum"),
        (["frame-000000.depth.png", "frame-000000.color.jpg"], "7scenes"),
        (["associations.txt", "rgb", "depth", "livingRoom0.gt.freiburg"], "icl-nuim"),
        (["color", "depth", "pose", "intrinsic"], "scannet"),
        (["color", "depth", "pose", "intrinsics_depth.txt"], "scannet"),
        (["rgb", "depth", "pose", "intrinsic"], "scannet"),
        (["color", "depth", "pose/0.txt", "trajectory.log", "intrinsic.json"], "redwood"),
        (["associations.txt", "livingRoom0.gt.freiburg", "rgb.txt", "depth.txt"], "icl-nuim"),
        (["scene0000_00.sens", "scene0000_00.txt"], "scannet-sens"),
        (["sparse/0/cameras.bin", "sparse/0/images.bin", "images"], "colmap"),
        (["sparse/cameras.bin", "sparse/images.bin", "sparse/rigs.bin", "sparse/frames.bin"], "colmap"),
        (["cameras.txt", "images.txt"], "colmap"),
        (["lowres_wide.traj", "lowres_depth"], "arkitscenes"),
        (["scene_camera.json", "rgb", "depth"], "bop"),
        (["traj.txt", "results"], "replica"),
        (["pose_left.txt", "image_left", "image_right"], "tartanair"),
        (["pose_lcam_front.txt", "image_lcam_front", "depth_lcam_front"], "tartanair"),
        (["mav0/cam0/sensor.yaml"], "euroc"),
        (["mav0/cam0/data.csv", "dso/camchain.yaml"], "euroc"),
        (["image_0", "image_1", "calib.txt"], "kitti"),
        (["image_2", "image_3", "calib.txt"], "kitti"),
        (["image_l", "image_r", "calib.txt"], "kitti"),
        (["image_02/data", "image_03/data"], "kitti"),
        (["image_2/000000_10.png", "image_3", "calib_cam_to_cam"], "kitti-stereo"),
        (["image_2/000000.png", "image_3", "calib.txt"], "kitti"),
        (["im0.png", "im1.png", "calib.txt"], "middlebury"),
        (["transforms.json", "images"], "nerfstudio"),
        (["transforms_train.json", "train"], "nerfstudio"),
        (["keyframes/cameras"], "polycam"),
        (["metadata.json", "rgb", "depth"], "record3d"),
        (["take.r3d"], "record3d"),
        (["camera/000000.npz", "depth/000000.npy", "color/000000.png"], "predictions"),
        (["take.bag"], "ros-bag"),
        (["take.db3", "metadata.yaml"], "ros-bag"),
        (["odometry.csv", "camera_matrix.csv", "rgb.mp4", "depth"], "stray-scanner"),
        (["templeR0001.png", "templeR_par.txt"], "middlebury-mview"),
        (["d-10.00-100.pgm", "r-10.03-101.ppm", "INDEX.txt"], "nyu"),
        (["image", "depth", "intrinsics.txt", "extrinsics"], "sun-rgbd"),
        (["image", "depth", "intrinsics.txt"], "redwood"),
        (["left", "right"], "plain-stereo"),
        (["image_l", "image_r"], "plain-stereo"),
        (["view1.png", "view5.png"], "pair"),
        (["left01.jpg", "right01.jpg", "intrinsics.yml"], "plain-stereo"),
        (["rgb/1305031102.175304.png", "depth/1305031102.160407.png"], "tum"),
        (["rgb", "depths", "associations.txt"], "tum"),
        (["color", "depth", "pose/0.txt"], "scannet"),
        (["color", "depth"], "redwood"),
        (["images", "depth_images"], "redwood"),
        (["rgb_0.png", "depth_0.png", "rgb_1.png", "depth_1.png"], "redwood"),
        (["color.png", "depth.png"], "redwood"),
        (["rgb", "depth", "trajectory.log"], "redwood"),
    ],
)
def test_signatures(tmp_path, names, layout):
    touch(tmp_path, *names)
    found, reason = detect_layout(tmp_path)
    assert found.name == layout
    assert reason


@pytest.mark.parametrize(
    ("names", "content", "name"),
    [
        (["take.svo2"], b"", "ZED"),
        (["take.mkv"], b"\x1a\x45\xdf\xa3 matroska K4A_COLOR_MODE", "Azure Kinect"),
        (["take_0.mcap.zstd", "metadata.yaml"], b"", "compressed ROS 2"),
    ],
)
def test_layouts_that_cannot_be_read_are_refused_by_name(tmp_path, names, content, name):
    touch(tmp_path, *names)
    (tmp_path / names[0]).write_bytes(content)
    with pytest.raises(
        InputError, match=f"{re.escape(tmp_path.name)}: this looks like .*{name}.*is not supported"
    ):
        read_scan(tmp_path)
    with pytest.raises(InputError, match=f"{re.escape(names[0])}: this looks like .*{name}"):
        read_scan(tmp_path / names[0])


def test_an_empty_folder(tmp_path):
    with pytest.raises(InputError, match="the folder is empty"):
        read_scan(tmp_path)


def test_no_folder(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        read_scan(tmp_path / "nowhere")


def test_a_file_instead_of_a_folder(tmp_path):
    touch(tmp_path, "scan.ply")
    with pytest.raises(InputError, match="a file, not a scan folder"):
        read_scan(tmp_path / "scan.ply")


def test_an_unknown_folder_is_reported_with_content_and_known_layouts(tmp_path):
    touch(tmp_path, "holiday.jpg", "notes.txt")
    with pytest.raises(InputError) as caught:
        read_scan(tmp_path)
    text = str(caught.value)
    assert "holiday.jpg, notes.txt" in text
    for layout in LAYOUTS:
        assert layout.name in text


def test_a_folder_above_a_scan_points_to_it(tmp_path):
    touch(tmp_path, "seq-01/frame-000000.depth.png", "readme.txt")
    touch(tmp_path, "seq-02/frame-000000.depth.png", "other/notes.txt")
    with pytest.raises(
        InputError,
        match=r"its folder seq-01/ looks like one \(7scenes\), and so do seq-02/; give that folder\.$",
    ):
        read_scan(tmp_path)


def test_a_list_of_frames_in_another_folder_is_reported_with_that_scan(tmp_path, tiny):
    frames = [{"file_path": "images/0.png", "transform_matrix": np.eye(4).tolist()}]
    model = {"fl_x": 40, "fl_y": 40, "cx": 16, "cy": 12, "w": 32, "h": 24, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(model))
    tiny.color(tmp_path / "undistorted" / "images" / "0.png")
    (tmp_path / "undistorted" / "transforms.json").write_text(json.dumps(model))
    with pytest.raises(InputError, match=r"frames can be used.*undistorted/ looks like a scan"):
        read_scan(tmp_path)


def test_the_layout_can_be_named(tmp_path):
    touch(tmp_path, "frame-000000.depth.png", "left", "right")
    with pytest.raises(InputError, match="no images in left/"):
        read_scan(tmp_path, ScanParams(layout="plain-stereo"))


@pytest.mark.parametrize("layout", [layout.name for layout in LAYOUTS])
def test_a_wrongly_named_layout_is_one_sentence(tmp_path, layout):
    touch(tmp_path, "notes.txt")
    with pytest.raises(InputError):
        read_scan(tmp_path, ScanParams(layout=layout))


def test_names_of_layouts_are_unique():
    assert len({layout.name for layout in LAYOUTS}) == len(LAYOUTS)


@pytest.mark.parametrize(
    "options",
    [
        {"layout": "unheard-of"},
        {"intrinsics": "1,2,3"},
        {"intrinsics": "a,b,c,d"},
        {"intrinsics": "-1,5,5,5"},
        {"intrinsics": "nan,5,5,5"},
        {"depth_scale": 0},
        {"every": 0},
        {"first": -1},
        {"baseline": -0.1},
    ],
)
def test_wrong_options_are_wrong_usage(options):
    with pytest.raises(UsageError):
        ScanParams(**options)


def test_folders_without_a_scan(shared_data):
    for folder in ("meshes", "images", "broken", "rgbd/open3d_testdata/RGBD/other_formats"):
        with pytest.raises(InputError, match="unknown layout"):
            read_scan(shared_data / folder)
